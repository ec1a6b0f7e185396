"""Decorators of kernels, which use machine code shipped with the package or compile by Numba.

A wheel of a platform holds an extension module with the machine code of all kernels
(``.ci/kernels.py`` makes it).  It is part of the installed package, and so as trusted as the
package's code.  If there is none for these sources, this Python and this processor, Numba is
imported and compiles each kernel when it is first called.  Neither the shipped code nor Numba's
contracts or reorders arithmetic, so that both give the same bits.

Numba compiles a cached kernel again only if the kernel's own file changes.  After a change of a
helper in another file, delete ``ssdr/kernels/__pycache__``.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
import importlib.machinery
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

Function = TypeVar("Function", bound=Callable[..., Any])

# What the processor must have for the code of each level, as LLVM's features; the best comes first.
LEVELS = {"avx2": "+avx2", "baseline": ""}


def code_file(level: str) -> Path:
    """File of the machine code of a level, named after the sources that it was compiled from."""
    folder = Path(__file__).parent
    sources = sorted(folder.glob("*.py"))
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    return folder / f"{level}_{digest[:16]}{importlib.machinery.EXTENSION_SUFFIXES[0]}"


def _load() -> dict[str, Any]:
    """Load the best shipped machine code that this processor can run; return its functions by name.

    The dict is empty if there is none.
    """
    core = "core" if np.__version__ < "2" else "_core"
    has = importlib.import_module(f"numpy.{core}._multiarray_umath").__cpu_features__
    for level, features in LEVELS.items():
        path = code_file(level)
        if all(has.get(f.upper()) for f in features.split("+") if f) and path.exists():
            spec: Any = importlib.util.spec_from_file_location(path.name.partition(".")[0], path)
            with contextlib.suppress(ImportError):
                module = importlib.util.module_from_spec(spec)
                spec.loader.exec_module(module)
                return vars(module)
    return {}


SHIPPED = _load()


def is_cached(function: Any) -> bool:
    """Whether Numba's cache holds code of a kernel that is newer than the kernel's file."""
    source = Path(function.py_func.__code__.co_filename)
    found = Path(function.stats.cache_path).glob(f"{source.stem}.{function.__name__}-*.nbc")
    return any(path.stat().st_mtime > source.stat().st_mtime for path in found)


class Ready:
    """A kernel with machine code for some types of arguments, or a helper of such kernels.

    Numba compiles it for other types, and as a part of other kernels.
    """

    def __init__(self, function: Callable[..., Any], compiler: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)
        self._compiler = compiler
        self._codes = {}
        for name, code in SHIPPED.items():
            kernel_name, *kinds = name.split(" ")
            if kernel_name == f"{function.__module__}.{function.__qualname__}":
                key = [None if k == "-" else (np.dtype(k[0]), int(k[1:]), True) for k in kinds]
                self._codes[tuple(key)] = code

    @functools.cached_property
    def dispatcher(self) -> Any:
        """The function as Numba compiles it."""
        return self._compiler(self.__wrapped__)  # type: ignore[attr-defined]

    @property
    def _numba_type_(self) -> Any:
        return self.dispatcher._numba_type_

    def __call__(self, *args: Any) -> Any:
        key = [
            (a.dtype, a.ndim, a.flags.c_contiguous and a.flags.aligned)
            if isinstance(a, np.ndarray)
            else None
            for a in args
        ]
        code = self._codes.get(tuple(key))
        return self.dispatcher(*args) if code is None else code(*args)


def _decorator(compiler: Callable[..., Any]) -> Callable[[Function], Function]:
    def decorate(function: Any) -> Any:
        own = function.__module__.rpartition(".")[0] == __package__
        return Ready(function, compiler) if own and SHIPPED else compiler(function)

    return decorate


@_decorator
def kernel(function: Function) -> Function:
    """Compile a kernel that releases the GIL, is cached on disk and divides by 0 as NumPy does."""
    import numba

    from .code_cache import CheckedFiles

    compiled: Any = numba.njit(nogil=True, cache=True, error_model="numpy")(function)
    if hasattr(compiled, "_cache"):  # not with NUMBA_DISABLE_JIT
        compiled._cache._cache_file = CheckedFiles(compiled._cache._cache_file)
        typed = compiled.typeof_pyval
        compiled.typeof_pyval = lambda value: _writable(typed(value))
    return compiled  # type: ignore[no-any-return]


def _writable(kind: Any) -> Any:
    """The type with which a kernel is compiled: read-only arrays need no code of their own."""
    array = hasattr(kind, "layout") and not kind.mutable
    return kind.copy(readonly=False) if array else kind


@_decorator
def inline(function: Function) -> Function:
    """Compile a helper of kernels, cached as part of each kernel; its integers have 64 bits."""
    import numba

    njit: Any = numba.njit  # its stubs do not know the last two options
    compiled: Any = njit(
        nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True
    )(function)
    resolve = getattr(compiled, "get_call_template", None)
    if resolve is not None:
        # Otherwise Numba compiles a helper for each type of integer and, while it infers the
        # types of a kernel, for literals: half of the time of compiling all kernels.
        compiled.get_call_template = lambda args, kws: resolve(tuple(map(_wide, args)), kws)
    return compiled  # type: ignore[no-any-return]


def _wide(kind: Any) -> Any:
    import numba

    return numba.types.int64 if isinstance(kind, numba.types.Integer) else kind
