"""Zip archives of ``.npy`` arrays, checked before they are inflated.

The type and shape in a member's ``.npy`` header must agree with its size in the archive, and the
sizes must stay below the limit of memory. Nothing is unpickled.
"""

from __future__ import annotations

import contextlib
import fnmatch
import math
import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...common.errors import FormatError, InputError
from ..atomic import atomic_path
from ..file_errors import afford, check, reading
from ..signatures import describe

_npy: Any = np.lib.format  # NumPy types it only in part
_MOST_HEADER = 10_000  # characters of an .npy header; NumPy's own limit, against costly parsing
_CHUNK = 16 << 20  # bytes written at a time: more only takes more memory
# Data above this size that inflate by more than this ratio are refused: frames of a real
# animation shrink to a tenth at best, and a small file must not fill the memory.
_MOST_RATIO, _UNSUSPICIOUS_BYTES = 100, 256 << 20


def read_arrays(
    path: Path,
    *,
    required: Sequence[str],
    optional: Sequence[str] = (),
    max_bytes: int | None = None,
) -> dict[str, NDArray[Any]]:
    """Read arrays of an archive by name and ignore its other members.

    Parameters
    ----------
    path : Path
    required, optional : names
        Names of the arrays to read; optional ones may be patterns (``texture_*``).
    max_bytes : int, optional
        Largest total size of the arrays that are read. By default it is `MOST_BYTES`, and arrays
        that inflate like a zip bomb are refused as well.

    Raises
    ------
    FormatError
        If the archive is damaged or hostile, or a required name is missing.
    """
    with _open(path) as (archive, members):
        missing = [key for key in required if key not in members]
        found = ", ".join(list(members)[:12]) or "nothing"
        check(not missing, f"no array {', '.join(missing)}; it holds {found}")
        patterns = (*required, *optional)
        chosen = [k for k in members if any(fnmatch.fnmatchcase(k, p) for p in patterns)]
        read = [members[key] for key in chosen]
        for info in read:
            _header_of(archive, info)
        size, stored = sum(i.file_size for i in read), sum(i.compress_size for i in read)
        what = f"reading {', '.join(i.filename for i in read[:9])}"
        afford(size, what, path, max_bytes)
        if max_bytes is None and size > max(_UNSUSPICIOUS_BYTES, _MOST_RATIO * stored):
            raise FormatError(
                f"{path}: {what} needs {size} bytes, inflated {size // max(1, stored)}-fold like a "
                f"zip bomb; max_bytes={size} admits it"
            )
        return {key: _read(archive, members[key]) for key in chosen}


def write_arrays(path: Path, arrays: Mapping[str, Any], *, compress: bool = True) -> int:
    """Write an archive and return its size in bytes.  Equal arrays give equal bytes.

    Arrays are copied in chunks along the first axis, so that lazy ones take little memory.
    """
    with atomic_path(path) as temporary:
        method = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
        with zipfile.ZipFile(temporary, "w", method) as archive:
            for key, value in arrays.items():
                array = value if hasattr(value, "shape") else np.asarray(value)
                if np.dtype(array.dtype).hasobject:
                    raise InputError(key, "numbers or text", "Python objects")
                # A member that is opened by its name gets the zip format's first date, 1980.
                with archive.open(f"{key}.npy", "w", force_zip64=True) as member:
                    write_array(member, array)
        return temporary.stat().st_size


def read_array(path: Path, *, mmap: bool = False) -> NDArray[Any]:
    """Read or map the array of a ``.npy`` file, whose size must be what its header states."""
    with reading(path), path.open("rb") as stream:
        head = stream.read(64)
        check(head.startswith(b"\x93NUMPY"), f"not a .npy array: {describe(head)}")
        stream.seek(0)
        dtype, shape, order = _read_header(stream)
        offset = stream.tell()
        _check_size("the array", dtype, shape, path.stat().st_size - offset)
        if mmap:
            return np.memmap(path, dtype, "r", offset, shape, order)
        flat = np.fromfile(stream, dtype=dtype, count=math.prod(shape))
        return np.ascontiguousarray(flat.reshape(shape, order=order))


def write_array(stream: IO[bytes], array: Any) -> None:
    """Write a ``.npy`` header and the rows of an array, in chunks along its first axis."""
    dtype = np.dtype(array.dtype)
    header = {
        "descr": _npy.dtype_to_descr(dtype),
        "fortran_order": False,
        "shape": tuple(int(n) for n in array.shape),
    }
    _npy.write_array_header_1_0(stream, header)
    if not array.shape:
        stream.write(np.asarray(array).tobytes())
        return
    row = math.prod(array.shape[1:]) * dtype.itemsize
    step = max(1, _CHUNK // max(1, row))
    for start in range(0, array.shape[0], step):
        stream.write(np.ascontiguousarray(array[start : start + step]).tobytes())


def names_in(path: Path) -> set[str]:
    """Names of the arrays in an archive."""
    with _open(path) as (_, members):
        return set(members)


def shape_of(path: Path, key: str) -> tuple[int, ...]:
    """Shape of the array `key` of an archive, read from its header alone."""
    with _open(path) as (archive, members):
        return _header_of(archive, members[key])[1]


_Members = dict[str, zipfile.ZipInfo]
_Header = tuple[np.dtype[Any], tuple[int, ...], Literal["C", "F"]]


@contextlib.contextmanager
def _open(path: Path) -> Iterator[tuple[zipfile.ZipFile, _Members]]:
    """Open an archive; yield it, and a dict from array names to members."""
    with reading(path), path.open("rb") as stream:
        head = stream.read(64)
        check(head.startswith(b"PK\x03\x04"), f"not an .npz archive: {describe(head)}")
        stream.seek(0)
        with zipfile.ZipFile(stream) as archive:
            members: _Members = {}
            for info in archive.infolist():
                key = info.filename.removesuffix(".npy")
                check(key not in members, f"two members are called {key!r}")
                if key != info.filename:
                    members[key] = info
            yield archive, members


def _read_header(stream: IO[bytes], member: str = "the array") -> _Header:
    """Read type, shape and memory order from a ``.npy`` header, which ends where the data begin.

    Raises
    ------
    FormatError
        If the stream has no valid ``.npy`` header, or holds objects (a pickle) or records.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy warns about headers by Python 2
        try:
            version = _npy.read_magic(stream)
            read = {(1, 0): _npy.read_array_header_1_0, (2, 0): _npy.read_array_header_2_0}[version]
            shape, fortran, dtype = read(stream, max_header_size=_MOST_HEADER)
        except Exception as error:
            raise FormatError(f"{member} has no usable .npy header ({error})") from error
    check(not dtype.hasobject, f"{member} holds pickled Python objects, which are never read")
    plain = dtype.kind == "U" or (dtype.kind in "fiub" and dtype.itemsize)
    check(plain, f"{member} holds {dtype}, neither numbers nor text")
    check(all(type(n) is int and n >= 0 for n in shape), f"{member} has the shape {shape}")
    return dtype, shape, "F" if fortran else "C"


def _check_size(member: str, dtype: np.dtype[Any], shape: tuple[int, ...], held: int) -> None:
    stated = math.prod(shape) * dtype.itemsize
    problem = f"{member} states the shape {shape} of {dtype}, {stated} bytes, but holds {held}"
    check(held == stated, problem)


def _header_of(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> _Header:
    known = info.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
    check(known, f"{info.filename} is neither stored nor deflated")
    with archive.open(info) as member:
        dtype, shape, order = _read_header(member, info.filename)
        _check_size(info.filename, dtype, shape, info.file_size - member.tell())
    return dtype, shape, order


def _read(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(info) as member:
        array = _npy.read_array(member, allow_pickle=False, max_header_size=_MOST_HEADER)
        member.read(1)  # the checksum is compared at the end of the member
    return np.ascontiguousarray(array).reshape(array.shape)  # the call makes a scalar a vector
