"""Opening of stages, after checks that their layers are safe to open."""

from __future__ import annotations

import contextlib
import errno
import itertools
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd, UsdUtils

from ...common.errors import FormatError, is_real
from ...mesh.clips import readable
from ..file_errors import check, refuse_device
from ..references import HINT, OUTSIDE, is_inside

_DEEPEST = 1000  # levels of nesting; usd-core crashes the process at some tens of thousands
# Strings, asset paths and comments of a text layer, closed or not; brackets in them do not count.
_QUOTED = re.compile(
    rb'"""(?:\\.|[^\\])*?(?:"""|\Z)|"(?:\\.|[^"\\\n])*"?'
    rb"|'''(?:\\.|[^\\])*?(?:'''|\Z)|'(?:\\.|[^'\\\n])*'?"
    rb"|@@@(?:\\@@@|.)*?(?:@@@|\Z)|@[^@\n]*@?"
    rb"|#[^\n]*|//[^\n]*|/\*.*?(?:\*/|\Z)",
    re.DOTALL,
)
# What USD says, without the place in its own code.
_SAID = re.compile(r"Error in '.*?' at line \d+ in file .*? : '(.*)")
_MOST_CLIPS = 100_000  # files of value clips that USD looks for, each of them some 10 µs
_TEMPLATE = ("templateStartTime", "templateEndTime", "templateStride")
_STEPS = np.zeros(256, dtype=np.int8)
_STEPS[list(b"([{")], _STEPS[list(b")]}")] = 1, -1


def open_stage(path: Path) -> Any:
    """Open a stage from the current contents of its file, not from those that USD has in memory.

    To be called inside :func:`~ssdr.io.file_errors.reading`.

    Raises
    ------
    FormatError
        If the file is not a usable stage, or opening it would be unsafe (see `_check_layers`).
    """
    try:
        _check_layers(path)
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        said = _SAID.search(str(error))
        text = said[1].strip().removesuffix("'") if said else " ".join(str(error).split())
        text = text.removeprefix(f"{path}:")
        raise FormatError(f"not a usable USD file (USD says: {text[:300]})") from error
    check(stage, "not a usable USD file")
    stage.Reload()  # USD caches layers by name; the file may have been written anew
    for layer in stage.GetUsedLayers():
        inside = not layer.realPath or is_inside(Path(layer.realPath), path.parent)
        check(inside, f"refers to {layer.realPath}, which {OUTSIDE}; {HINT}")
    return stage


def _check_layers(path: Path) -> None:
    """Check a file and all layers that it refers to, before USD opens them.

    Raises
    ------
    FormatError
        If one of them is missing or not USD, is nested too deeply, lies outside the folder of the
        file, is a device or a package, or if they name more value clips than can be looked for.
    """
    seen, waiting = set(), [path]
    templates: list[dict[str, Any]] = []
    while waiting:
        file = waiting.pop()
        if file.resolve() in seen:
            continue
        seen.add(file.resolve())
        refuse_device(file)
        check(file.is_file(), f"refers to {file.name}, which is missing")
        _check_nesting(file)
        layer = Sdf.Layer.FindOrOpen(str(file))
        check(
            layer,
            "not a USD file" if file == path else f"refers to {file.name}, which is no USD file",
        )
        templates += _templates(layer)
        for asset in itertools.chain(*UsdUtils.ExtractExternalReferences(str(file))):
            named = Sdf.Layer.SplitIdentifier(asset)[0].partition("[")[0]
            name = Path(Sdf.ComputeAssetPathRelativeToLayer(layer, named))
            if not Sdf.FileFormat.FindByExtension(name.suffix[1:] or "none"):
                continue  # a picture or the like, which USD does not open
            inside = is_inside(name, path.parent)
            check(inside, f"refers to {asset}, which {OUTSIDE}; {HINT}")
            # the files of value clips can be named by a pattern such as clip.###.usd
            pattern = "*".join(re.split("#+", name.name))
            waiting += name.parent.glob(pattern) if "#" in name.name else [name]
    _check_templates(templates)


def _templates(layer: Any) -> list[dict[str, Any]]:
    """Template start time, end time and stride of each set of value clips in a layer.

    There is one dict per set that states any of them, without the keys that it does not state.

    Raises
    ------
    FormatError
        If the layer lists a prim or property that it does not contain.  Reading one would crash
        usd-core.
    """
    found: list[dict[str, Any]] = []

    def look(path: Any) -> None:
        of_prim = path.IsPrimPath() or path.IsPrimVariantSelectionPath()
        if not (of_prim or path.IsPropertyPath() or path.isEmpty):
            return  # targets of relationships and connections hold nothing
        spec: Any = None if path.isEmpty else layer.GetObjectAtPath(path)
        check(spec, f"damaged: it names a part {path or 'without a name'}, which it does not hold")
        if of_prim and spec.HasInfo("clips"):
            for one in spec.GetInfo("clips").values():
                given = one if isinstance(one, dict) else {}
                times = {k: given[k] for k in _TEMPLATE if is_real(given.get(k), finite=False)}
                found.extend([times] if times else [])

    layer.Traverse(Sdf.Path.absoluteRootPath, look)
    return found


def _check_templates(templates: list[dict[str, Any]]) -> None:
    """Refuse patterns of value clips that name too many files for USD to look for.

    A layer may override some of the times that a weaker layer states, so the times of incomplete
    sets are combined with those of each complete set.
    """
    whole = [times for times in templates if len(times) == len(_TEMPLATE)]
    partial = [times for times in templates if len(times) < len(_TEMPLATE)]
    total = 0.0
    for stated in (partial, *([one, *partial] for one in whole)):
        first, last, step = ([t[k] for t in stated if k in t] for k in _TEMPLATE)
        rising = [s for s in step if s > 0]  # USD refuses any other
        if first and last and rising:
            total += (max(last) - min(first)) / min(rising)
    check(total <= _MOST_CLIPS, f"value clips of {total:.3g} files, at most {_MOST_CLIPS} are read")


def _check_nesting(file: Path) -> None:
    """Refuse a package, and a text layer nested so deeply that usd-core would crash the process."""
    data = file.read_bytes()
    packed = data.startswith(b"PK")
    check(not packed, f"{file.name} is a package (.usdz), which is not read: unpack it first")
    if data.startswith(b"PXR-USDC"):
        return
    steps = _STEPS[np.frombuffer(_QUOTED.sub(b"", data), dtype=np.uint8)]
    depth = np.cumsum(steps[steps != 0], dtype=np.int64).max(initial=0)
    problem = f"{file.name} is nested {depth} deep, at most {_DEEPEST} is read"
    check(depth <= _DEEPEST, problem)


@contextlib.contextmanager
def system_errors(path: Path) -> Iterator[None]:
    """Context that turns USD's errors about writing `path` into the OSErrors that caused them.

    Raises
    ------
    OSError
        If `path` cannot be written.
    """
    try:
        yield
    except Tf.ErrorException as error:
        text = " ".join(str(error).split())
        known = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EROFS)
        number = next((n for n in known if os.strerror(n) in text), None)
        reason = text if number is None else os.strerror(number)
        raise OSError(number or errno.EIO, reason, str(path)) from error


def identifier(name: str) -> str:
    """Identifier that USD accepts, made from a name by replacing other characters."""
    return str(Tf.MakeValidIdentifier(readable(name)))
