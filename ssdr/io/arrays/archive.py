"""Zip archives of ``.npy`` arrays that are looked at before they are inflated.

Type and shape in a member's ``.npy`` header must agree with its size in the
archive, and that with what is plausible.  Nothing is ever unpickled.
"""

from __future__ import annotations

import fnmatch
import math
import struct
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError, InputError
from ..atomic import atomic_path
from ..registry import describe, reading

__all__ = ["has", "read_array", "read_arrays", "shape_of", "write_array", "write_arrays"]

_npy: Any = np.lib.format  # NumPy types it only in part
_MAX_BYTES = 16 << 30  # 16 GiB in one archive unless the caller allows more: stops a false size
_BOMB_BYTES, _BOMB_RATIO = 256 << 20, 100
_MAX_HEADER = 10_000  # characters of an .npy header; NumPy's own limit, against costly parsing
_CHUNK = 16 << 20  # bytes read or written at a time: more only takes more memory
# The time stamp that every member gets, the earliest a zip can hold: same content, same bytes.
_EPOCH = (1980, 1, 1, 0, 0, 0)


def read_arrays(
    path: Path,
    *,
    required: Sequence[str],
    optional: Sequence[str] = (),
    mapped: Sequence[str] = (),
    max_bytes: int | None = None,
) -> dict[str, NDArray[Any]]:
    """Read arrays of an archive by name; other members are not looked at.

    Parameters
    ----------
    path : Path
    required, optional : names
        Optional names may be patterns (``texture_*``).
    mapped : names
        To be memory-mapped rather than read.
    max_bytes : int, optional
        See :func:`read`.

    Raises
    ------
    FormatError
        If the archive is damaged or hostile, or a required name is missing.
    """
    if max_bytes is not None and max_bytes <= 0:
        raise InputError("max_bytes", "a positive number", max_bytes)
    unmappable = ""
    with reading(path), path.open("rb") as stream, _archive(path, stream) as archive:
        members = _members(path, archive)
        missing = [key for key in required if key not in members]
        if missing:
            found = ", ".join(list(members)[:12]) or "nothing"
            raise FormatError(f"{path}: no array {', '.join(missing)}; it holds {found}")
        chosen = [
            key
            for key in members
            if key in required or any(fnmatch.fnmatchcase(key, p) for p in optional)
        ]
        headers = {key: _member_header(path, archive, members[key]) for key in chosen}
        read_now = [key for key in chosen if key not in mapped]
        _refuse_bombs(path, [members[key] for key in read_now], max_bytes)
        arrays: dict[str, NDArray[Any]] = {}
        for key in chosen:
            if key in read_now:
                arrays[key] = _read_member(path, archive, members[key], headers[key])
            elif members[key].compress_type == zipfile.ZIP_STORED:
                arrays[key] = _map_member(path, stream, members[key], headers[key])
            else:
                unmappable = key
    if unmappable:
        raise InputError("mmap", "an uncompressed archive", f"{path}, compressed")
    return arrays


def write_arrays(path: Path, arrays: Mapping[str, Any], *, compress: bool = True) -> int:
    """Write an archive at once; the same arrays give the same bytes.

    Arrays may be lazy (a memory map, zarr): they are copied by chunks of the
    first axis.  Returns the size in bytes.
    """
    with atomic_path(path) as temporary:
        with zipfile.ZipFile(temporary, "w") as archive:
            for key, value in arrays.items():
                array = value if hasattr(value, "shape") else np.asarray(value)
                if np.dtype(array.dtype).hasobject:
                    raise InputError(key, "numbers or text", "Python objects")
                info = zipfile.ZipInfo(f"{key}.npy", _EPOCH)
                info.compress_type = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
                info.create_system = 3
                info.external_attr = 0o644 << 16
                size = math.prod(array.shape) * array.dtype.itemsize
                with archive.open(info, "w", force_zip64=size > 1 << 30) as member:
                    write_array(member, array)
        return temporary.stat().st_size


def read_array(path: Path, *, mmap: bool = False) -> NDArray[Any]:
    """Read or map one array; its size must be what its header states."""
    with reading(path), path.open("rb") as stream:
        head = stream.read(6)
        if head != b"\x93NUMPY":
            raise FormatError(f"{path}: not a .npy array: {describe(head + stream.read(64))}")
        stream.seek(0)
        dtype, shape, fortran = read_header(stream)
        offset = stream.tell()
        held, stated = path.stat().st_size - offset, math.prod(shape) * dtype.itemsize
        if held != stated:
            raise FormatError(
                f"{path}: states the shape {shape} of {dtype}, {stated} bytes, but holds {held}"
            )
        if mmap:
            return np.memmap(path, dtype, "r", offset, shape, "F" if fortran else "C")
        flat = np.fromfile(stream, dtype=dtype, count=math.prod(shape))
        return np.ascontiguousarray(flat.reshape(shape, order="F" if fortran else "C"))


def read_header(stream: IO[bytes]) -> tuple[np.dtype[Any], tuple[int, ...], bool]:
    """Type, shape and Fortran order of a ``.npy`` stream, left at its data.

    Raises
    ------
    FormatError
        If it is not one, or holds objects (a pickle) or records.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy warns about headers by Python 2
        try:
            version = _npy.read_magic(stream)
            if version not in ((1, 0), (2, 0)):
                raise ValueError(f"version {version}")
            readers = (
                _npy.read_array_header_1_0,
                _npy.read_array_header_2_0,
            )
            shape, fortran, dtype = readers[version[0] - 1](stream, max_header_size=_MAX_HEADER)
        except Exception as error:
            raise FormatError(f"no usable .npy header ({error})") from error
    if dtype.hasobject:
        raise FormatError("holds pickled Python objects, which are never read")
    if dtype.kind not in "fiubU" or (dtype.itemsize == 0 and dtype.kind != "U"):
        raise FormatError(f"holds {dtype}, neither numbers nor text")
    if any(type(n) is not int or n < 0 for n in shape):
        raise FormatError(f"has the shape {shape}")
    return dtype, shape, fortran


def write_array(stream: IO[bytes], array: Any) -> None:
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


def _archive(path: Path, stream: IO[bytes]) -> zipfile.ZipFile:
    head = stream.read(64)
    if not head.startswith(b"PK\x03\x04"):
        raise FormatError(f"{path}: not an .npz archive: {describe(head)}")
    stream.seek(0)
    return zipfile.ZipFile(stream)


def _members(path: Path, archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    members: dict[str, zipfile.ZipInfo] = {}
    for info in archive.infolist():
        key = info.filename.removesuffix(".npy")
        if key in members:
            raise FormatError(f"{path}: two members are called {key!r}")
        if key != info.filename:
            members[key] = info
    return members


def has(path: Path, key: str) -> bool:
    """Whether an archive has an array of that name."""
    with reading(path), path.open("rb") as stream, _archive(path, stream) as archive:
        return f"{key}.npy" in archive.namelist()


def shape_of(path: Path, key: str) -> tuple[int, ...]:
    """Shape of an array of an archive, which is not read."""
    with reading(path), path.open("rb") as stream, _archive(path, stream) as archive:
        return _member_header(path, archive, _members(path, archive)[key])[1]


_Header = tuple[np.dtype[Any], tuple[int, ...], bool, int]


def _member_header(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> _Header:
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise FormatError(f"{path}: {info.filename} is neither stored nor deflated")
    with archive.open(info) as member:
        try:
            dtype, shape, fortran = read_header(member)
        except FormatError as error:
            raise FormatError(f"{path}: {info.filename} {error}") from error
        size = math.prod(shape) * dtype.itemsize
        offset = info.file_size - size
        if offset != member.tell():
            raise FormatError(
                f"{path}: {info.filename} states the shape {shape} of {dtype}, {size} bytes, "
                f"but holds {info.file_size - member.tell()}"
            )
    return dtype, shape, fortran, offset


def _refuse_bombs(path: Path, infos: list[zipfile.ZipInfo], max_bytes: int | None) -> None:
    total = sum(info.file_size for info in infos)
    limit = _MAX_BYTES if max_bytes is None else max_bytes
    if total > limit:
        raise FormatError(f"{path}: needs {total} bytes in memory, max_bytes is {limit}")
    if max_bytes is not None:
        return
    for info in infos:
        if info.file_size > max(_BOMB_BYTES, _BOMB_RATIO * info.compress_size):
            raise FormatError(
                f"{path}: {info.filename} inflates {info.file_size // max(1, info.compress_size)}"
                f"-fold to {info.file_size} bytes, like a zip bomb; max_bytes={total} admits it"
            )


def _read_member(
    path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo, header: _Header
) -> NDArray[Any]:
    dtype, shape, fortran, offset = header
    buffer = bytearray(info.file_size - offset)
    view = memoryview(buffer)
    with archive.open(info) as member:
        member.read(offset)
        filled = 0
        while filled < len(buffer):
            block = member.read(min(_CHUNK, len(buffer) - filled))
            if not block:
                raise FormatError(f"{path}: {info.filename} is truncated")
            view[filled : filled + len(block)] = block
            filled += len(block)
        member.read(1)  # the end of the member is where its checksum is compared
    return _shaped(np.frombuffer(buffer, dtype=dtype), shape, fortran)


def _map_member(
    path: Path, stream: IO[bytes], info: zipfile.ZipInfo, header: _Header
) -> NDArray[Any]:
    dtype, shape, fortran, offset = header
    stream.seek(info.header_offset + 26)
    name, extra = struct.unpack("<HH", stream.read(4))
    start = info.header_offset + 30 + name + extra + offset
    return np.memmap(path, dtype, "r", start, shape, "F" if fortran else "C")


def _shaped(flat: NDArray[Any], shape: tuple[int, ...], fortran: bool) -> NDArray[Any]:
    return np.ascontiguousarray(flat.reshape(shape, order="F")) if fortran else flat.reshape(shape)
