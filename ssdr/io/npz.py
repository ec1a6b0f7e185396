"""NumPy archives (``.npz``), the package's own format.

Members are looked at before they are inflated: type and shape in their ``.npy``
header must agree with the size in the archive, and that with what is plausible.
Nothing is ever unpickled.
"""

from __future__ import annotations

import dataclasses
import fnmatch
import json
import logging
import math
import struct
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, InputError
from ..sequence import Material, MeshSequence, Surface
from .atomic import atomic_path
from .registry import SaveReport, bake, describe, reading

if TYPE_CHECKING:
    from ..skinning import Skinning

__all__ = [
    "FORMAT_VERSION",
    "read",
    "read_arrays",
    "read_header",
    "read_skinning",
    "write_arrays",
    "write_sequence",
    "write_skinning",
]

_log = logging.getLogger(__name__)
_npy: Any = np.lib.format  # NumPy types it only in part

FORMAT_VERSION = 1
_MAX_BYTES = 16 << 30
_BOMB_BYTES, _BOMB_RATIO = 256 << 20, 250
_MAX_HEADER = 10_000
_CHUNK = 16 << 20
_SURFACE = ("surface_uv", "surface_normals", "surface_material_index", "materials", "texture_*")
_SKINNING = ("rest", "joints", "weights", "transforms", "faces", "fps", "format_version")
# The time stamp that every member gets, the earliest a zip can hold: same content, same bytes.
_EPOCH = (1980, 1, 1, 0, 0, 0)


def read(
    path: Path, *, fps: float | None = None, mmap: bool = False, max_bytes: int | None = None
) -> MeshSequence:
    """Read ``vertices, faces, fps``, or bake a skinning.

    Parameters
    ----------
    path : Path
    fps : float, optional
        Instead of the file's own.
    mmap : bool
        Map the vertices of an uncompressed archive instead of reading them.
    max_bytes : int, optional
        Largest size of the arrays in memory; 16 GiB by default, and then
        arrays that inflate more than 250-fold beyond 256 MiB are refused too.

    Raises
    ------
    FormatError
        If the archive is damaged, hostile, or lacks a key.
    InputError
        If `mmap` is asked of a compressed archive.
    """
    if not _has(path, "vertices") and _has(path, "rest"):
        skinning = read_skinning(path, max_bytes=max_bytes)
        return bake(skinning if fps is None else dataclasses.replace(skinning, fps=fps))
    arrays = read_arrays(
        path,
        required=("vertices", "faces"),
        optional=("fps", "name", "vertex_map", *_SURFACE),
        mapped=("vertices",) if mmap else (),
        max_bytes=max_bytes,
    )
    with reading(path):
        if fps is None and "fps" not in arrays:
            _log.info("%s: no fps stated, 24 assumed", path)
            fps = 24.0
        return MeshSequence(
            arrays["vertices"],
            arrays["faces"],
            float(_scalar(arrays["fps"], "fps")) if fps is None else fps,
            name=_text(arrays, "name") or path.stem,
            surface=_surface_from(arrays),
            vertex_map=arrays.get("vertex_map"),
        )


def write_sequence(sequence: MeshSequence, path: Path, *, compress: bool = True) -> SaveReport:
    """Write ``vertices, faces, fps`` and, where given, name, surface and map; exact.

    Parameters
    ----------
    sequence : MeshSequence
    path : Path
    compress : bool
        Deflate; an uncompressed archive can be memory-mapped.
    """
    arrays: dict[str, Any] = {
        "vertices": sequence.vertices,
        "faces": sequence.faces,
        "fps": np.float64(sequence.fps),
    }
    if sequence.name:
        arrays["name"] = np.array(sequence.name)
    if sequence.vertex_map is not None:
        arrays["vertex_map"] = sequence.vertex_map
    arrays.update(_surface_arrays(sequence.surface))
    return SaveReport(path=path, bytes=write_arrays(path, arrays, compress=compress))


def read_skinning(path: Path, *, max_bytes: int | None = None) -> Skinning:
    """Read what :func:`write_skinning` wrote."""
    from ..skinning import Skinning

    arrays = read_arrays(
        path,
        required=_SKINNING,
        optional=("bone_model", "keyframes", "bone_names", "name", "vertex_map", *_SURFACE),
        max_bytes=max_bytes,
    )
    with reading(path):
        version = int(_scalar(arrays["format_version"], "format_version"))
        if not 1 <= version <= FORMAT_VERSION:
            raise FormatError(
                f"{path}: format_version {version}; this release reads up to {FORMAT_VERSION}"
            )
        names = _text(arrays, "bone_names")
        return Skinning(
            arrays["rest"],
            arrays["joints"],
            arrays["weights"],
            arrays["transforms"],
            faces=arrays["faces"],
            fps=float(_scalar(arrays["fps"], "fps")),
            bone_model=_text(arrays, "bone_model") or "rigid",  # type: ignore[arg-type]
            keyframes=arrays.get("keyframes"),
            surface=_surface_from(arrays),
            vertex_map=arrays.get("vertex_map"),
            bone_names=tuple(json.loads(names)) if names else None,
            name=_text(arrays, "name"),
        )


def write_skinning(skinning: Skinning, path: Path, *, compress: bool = True) -> SaveReport:
    """Write ``rest, joints, weights, transforms, faces, fps, format_version`` and more; exact."""
    arrays: dict[str, Any] = {
        "rest": skinning.rest,
        "joints": skinning.joints,
        "weights": skinning.weights,
        "transforms": skinning.transforms,
        "faces": skinning.faces,
        "fps": np.float64(skinning.fps),
        "format_version": np.int64(FORMAT_VERSION),
        "bone_model": np.array(skinning.bone_model),
    }
    for key in ("keyframes", "vertex_map"):
        if getattr(skinning, key) is not None:
            arrays[key] = getattr(skinning, key)
    if skinning.bone_names is not None:
        arrays["bone_names"] = np.array(json.dumps(skinning.bone_names))
    if skinning.name:
        arrays["name"] = np.array(skinning.name)
    arrays.update(_surface_arrays(skinning.surface))
    size = write_arrays(path, arrays, compress=compress)
    return SaveReport(path=path, bytes=size, influences=skinning.n_influences)


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
                    _write_array(member, array)
        return temporary.stat().st_size


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


def _write_array(stream: IO[bytes], array: Any) -> None:
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


def _has(path: Path, key: str) -> bool:
    with reading(path), path.open("rb") as stream, _archive(path, stream) as archive:
        return f"{key}.npy" in archive.namelist()


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


def _scalar(array: NDArray[Any], key: str) -> Any:
    if array.size != 1 or array.dtype.kind not in "fiu":
        raise InputError(key, "one number", f"{array.dtype} of shape {array.shape}")
    return array.ravel()[0]


def _text(arrays: Mapping[str, NDArray[Any]], key: str) -> str:
    if key not in arrays:
        return ""
    array = arrays[key]
    if array.size != 1 or array.dtype.kind != "U":
        raise InputError(key, "one text", f"{array.dtype} of shape {array.shape}")
    return str(array.ravel()[0])


def _surface_arrays(surface: Surface | None) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    if surface is None:
        return arrays
    for field in ("uv", "normals", "material_index"):
        value = getattr(surface, field)
        if value is not None:
            arrays[f"surface_{field}"] = np.asarray(value)
    if surface.materials:
        records = []
        for k, material in enumerate(surface.materials):
            record = dataclasses.asdict(material)
            texture = record.pop("texture")
            if texture is not None:
                arrays[f"texture_{k}"] = np.frombuffer(texture, dtype=np.uint8)
            records.append(record)
        arrays["materials"] = np.array(json.dumps(records, sort_keys=True))
    return arrays


def _surface_from(arrays: Mapping[str, NDArray[Any]]) -> Surface | None:
    uv, normals, index = (
        arrays.get(f"surface_{field}") for field in ("uv", "normals", "material_index")
    )
    text = _text(arrays, "materials")
    if uv is None and normals is None and index is None and not text:
        return None
    materials = []
    for k, record in enumerate(json.loads(text) if text else []):
        texture = arrays.get(f"texture_{k}")
        record["base_color"] = tuple(float(c) for c in record["base_color"])
        materials.append(Material(**record, texture=None if texture is None else texture.tobytes()))
    for field, array in (("uv", uv), ("normals", normals)):
        if array is not None and (array.dtype.kind != "f" or not np.isfinite(array).all()):
            raise InputError(f"surface_{field}", "finite numbers", f"{array.dtype}, NaN or Inf")
    if index is not None and index.dtype.kind not in "iu":
        raise InputError("surface_material_index", "integers", f"dtype {index.dtype}")
    return Surface(
        uv=None if uv is None else uv.astype(np.float32, copy=False),
        normals=None if normals is None else normals.astype(np.float32, copy=False),
        material_index=None if index is None else index.astype(np.int32, copy=False),
        materials=tuple(materials),
    )
