"""NumPy archives (``.npz``), the package's own format.

A sequence is ``vertices, faces, fps``; a skinning ``rest, indices, weights,
transforms, faces, fps, format_version``, with ``parents, joint_positions`` where it has a
hierarchy.
"""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...clips import Clip, pick
from ...errors import FormatError, InputError
from ...sequence import Material, MeshSequence, Surface
from ..registry import SaveReport, bake, reading
from .archive import has, read_arrays, shape_of, write_arrays

if TYPE_CHECKING:
    from ...skinning import Skinning

__all__ = [
    "FORMAT_VERSION",
    "list_clips",
    "read",
    "read_skinning",
    "write_sequence",
    "write_skinning",
]

_log = logging.getLogger(__name__)

FORMAT_VERSION = 2  # of the arrays' names and meaning; raised when an old reader would misread
_SURFACE = ("surface_uv", "surface_normals", "surface_material_index", "materials", "texture_*")
_SKINNING = ("rest", "weights", "transforms", "faces", "fps", "format_version")


def read(
    path: Path,
    *,
    clip: str | int | None = None,
    fps: float | None = None,
    mmap: bool = False,
    max_bytes: int | None = None,
) -> MeshSequence:
    """Read ``vertices, faces, fps``, or bake a skinning.

    Parameters
    ----------
    path : Path
    clip : str or int, optional
        Of a skinning of several clips; the first by default.
    fps : float, optional
        Instead of the file's own.
    mmap : bool
        Map the vertices of an uncompressed archive instead of reading them.
    max_bytes : int, optional
        Largest size of the arrays in memory; 16 GiB by default, and then
        arrays that inflate more than 100-fold beyond 256 MiB are refused too.

    Raises
    ------
    FormatError
        If the archive is damaged, hostile, or lacks a key.
    InputError
        If `mmap` is asked of a compressed archive.
    """
    if not has(path, "vertices") and has(path, "rest"):
        skinning = read_skinning(path, fps=fps, max_bytes=max_bytes)
        names = [one.name for one in _named(skinning.clips, skinning.name, path)]
        index = pick(names, clip)
        if len(names) > 1:
            _log.info("%s: clip %r of %s", path, names[index], names)
        skinning = skinning.select(index)
        return bake(skinning)
    arrays = read_arrays(
        path,
        required=("vertices", "faces"),
        optional=("fps", "name", "clip", "vertex_map", *_SURFACE),
        mapped=("vertices",) if mmap else (),
        max_bytes=max_bytes,
    )
    with reading(path):
        if fps is None and "fps" not in arrays:
            _log.info("%s: no fps stated, 24 assumed", path)
            fps = 24.0
        sequence = MeshSequence(
            arrays["vertices"],
            arrays["faces"],
            float(_scalar(arrays["fps"], "fps")) if fps is None else fps,
            name=_text(arrays, "name") or path.stem,
            clip=_text(arrays, "clip"),
            surface=_surface_from(arrays),
            vertex_map=arrays.get("vertex_map"),
        )
    pick([sequence.clip or sequence.name], clip)
    return sequence


def list_clips(
    path: Path, *, fps: float | None = None, max_bytes: int | None = None
) -> tuple[Clip, ...]:
    """The clips of a skinning; a sequence is one."""
    if not has(path, "vertices") and has(path, "rest"):
        skinning = read_skinning(path, fps=fps, max_bytes=max_bytes)
        return _named(skinning.clips, skinning.name, path)
    names = ("fps", "name", "clip")
    arrays = read_arrays(path, required=(), optional=names, max_bytes=max_bytes)
    with reading(path):
        name = _text(arrays, "clip") or _text(arrays, "name") or path.stem
        if fps is None:
            fps = float(_scalar(arrays["fps"], "fps")) if "fps" in arrays else 24.0
        return (Clip(name, 0, shape_of(path, "vertices")[0], fps),)


def _named(clips: tuple[Clip, ...], name: str, path: Path) -> tuple[Clip, ...]:
    return tuple(dataclasses.replace(c, name=c.name or name or path.stem) for c in clips)


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
    for key in ("name", "clip"):
        if getattr(sequence, key):
            arrays[key] = np.array(getattr(sequence, key))
    if sequence.vertex_map is not None:
        arrays["vertex_map"] = sequence.vertex_map
    arrays.update(_surface_arrays(sequence.surface))
    return SaveReport(path=path, bytes=write_arrays(path, arrays, compress=compress))


def read_skinning(
    path: Path, *, fps: float | None = None, max_bytes: int | None = None
) -> Skinning:
    """Read what :func:`write_skinning` wrote; `fps` is the rate of all clips instead of theirs."""
    from ...skinning import Skinning

    arrays = read_arrays(
        path,
        required=_SKINNING,
        optional=(
            *("indices", "joints"),  # as version 1 called them
            *("bone_model", "keyframes", "bone_names", "name", "vertex_map"),
            *("clip_names", "clip_offsets", "clip_fps", "parents", "joint_positions"),
            *_SURFACE,
        ),
        max_bytes=max_bytes,
    )
    with reading(path):
        version = int(_scalar(arrays["format_version"], "format_version"))
        if not 1 <= version <= FORMAT_VERSION:
            raise FormatError(
                f"{path}: format_version {version}; this release reads up to {FORMAT_VERSION}"
            )
        names = _text(arrays, "bone_names")
        rate = float(_scalar(arrays["fps"], "fps")) if fps is None else fps
        clips = _clips_from(arrays)
        if fps is not None and clips is not None:
            clips = [dataclasses.replace(clip, fps=fps) for clip in clips]
        return Skinning(
            arrays["rest"],
            arrays["joints" if version == 1 else "indices"],
            arrays["weights"],
            arrays["transforms"],
            faces=arrays["faces"],
            fps=rate,
            clips=clips,
            bone_model=_text(arrays, "bone_model") or "rigid",  # type: ignore[arg-type]
            keyframes=arrays.get("keyframes"),
            surface=_surface_from(arrays),
            vertex_map=arrays.get("vertex_map"),
            bone_names=tuple(json.loads(names)) if names else None,
            name=_text(arrays, "name"),
            parents=arrays.get("parents"),
            joint_positions=arrays.get("joint_positions"),
        )


def write_skinning(skinning: Skinning, path: Path, *, compress: bool = True) -> SaveReport:
    """Write ``rest, indices, weights, transforms, faces, fps, format_version`` and more; exact."""
    arrays: dict[str, Any] = {
        "rest": skinning.rest,
        "indices": skinning.indices,
        "weights": skinning.weights,
        "transforms": skinning.transforms,
        "faces": skinning.faces,
        "fps": np.float64(skinning.fps),
        "format_version": np.int64(FORMAT_VERSION),
        "bone_model": np.array(skinning.bone_model),
    }
    for key in ("keyframes", "vertex_map", "parents", "joint_positions"):
        if getattr(skinning, key) is not None:
            arrays[key] = getattr(skinning, key)
    if skinning.bone_names is not None:
        arrays["bone_names"] = np.array(json.dumps(skinning.bone_names))
    if skinning.name:
        arrays["name"] = np.array(skinning.name)
    clips = skinning.clips
    if len(clips) > 1 or clips[0].name != skinning.name:
        arrays["clip_names"] = np.array(json.dumps([clip.name for clip in clips]))
        arrays["clip_offsets"] = np.array([0, *(clip.stop for clip in clips)], dtype=np.int64)
        arrays["clip_fps"] = np.array([clip.fps for clip in clips])
    arrays.update(_surface_arrays(skinning.surface))
    size = write_arrays(path, arrays, compress=compress)
    return SaveReport(path=path, bytes=size, influences=skinning.n_influences)


def _clips_from(arrays: Mapping[str, NDArray[Any]]) -> Any:
    """Clips of an archive; None where it was written before there were any."""
    text = _text(arrays, "clip_names")
    if not text:
        return None
    names, offsets, rates = json.loads(text), arrays["clip_offsets"], arrays["clip_fps"]
    if not (isinstance(names, list) and offsets.dtype.kind in "iu" and rates.dtype.kind == "f"):
        raise InputError("clip_names", "a list of names with their frames and rates", text[:100])
    if offsets.shape != (len(names) + 1,) or rates.shape != (len(names),):
        raise InputError(
            "clip_offsets", f"shape ({len(names) + 1},)", f"{offsets.shape}, rates {rates.shape}"
        )
    return [
        Clip(name, start, stop, rate)
        for name, start, stop, rate in zip(names, offsets[:-1], offsets[1:], rates, strict=True)
    ]


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
