"""NumPy archives (``.npz``), the package's own format.

A sequence is stored as arrays ``vertices, faces, fps``. A skinning is stored as ``rest, indices,
weights, transforms, faces, fps, format_version`` and, if it has a hierarchy, ``parents,
joint_positions``.
"""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import InputError
from ...mesh.clips import Clip, pick
from ...mesh.sequence import MeshSequence
from ...mesh.surface import Material, Space, Surface
from ...model.shapes import ShapedSkinning, Shapes, Skinned
from ...model.skinning import Skinning
from ..file_clips import bake, pick_clip
from ..file_errors import afford, check, reading
from ..save_report import SaveReport
from .array_files import names_in, read_arrays, shape_of, write_arrays

_log = logging.getLogger(__name__)

# Of the arrays' names and meaning; raised when old readers would misread a file.  Version 3 has
# shapes; files without shapes have version 2.
FORMAT_VERSION = 3
_SURFACE = (
    *("surface_uv", "surface_normals", "surface_colors", "surface_material_index"),
    *("materials", "texture_*"),
    "vertex_normals",  # (V, 3), in place of surface_normals where no vertex has two
)
_SKINNING = ("rest", "indices", "weights", "transforms", "faces", "fps", "format_version")
# of a Surface
_FIELDS = dict.fromkeys(("uv", "normals", "colors"), "float32") | {"material_index": "int32"}
_SPACE = ("units", "up")
_WHERE_GIVEN = ("keyframes", "vertex_map", "parents", "joint_positions")
# displacements (N, 3) that are not 0, the shape and vertex (N, 2) of each; amounts (F, S)
_SHAPES = ("shape_displacements", "shape_vertices", "shape_amounts", "shape_names")


def read(
    path: Path,
    *,
    clip: str | int | None = None,
    fps: float | None = None,
    max_bytes: int | None = None,
) -> MeshSequence:
    """Read a sequence, or the vertices of a skinning in every frame.

    Parameters
    ----------
    path : Path
    clip : str or int, optional
        Clip of a skinning that has several; the first by default.
    fps : float, optional
        Frames per second, in place of those in the file.
    max_bytes : int, optional
        Largest total size of the arrays in memory. By default it is 16 GiB, and arrays above 256
        MiB that inflate more than 100-fold are refused, too.

    Raises
    ------
    FormatError
        If the archive is damaged or hostile, or lacks an array.
    """
    if _is_skinning(path):
        skinning = read_skinning(path, fps=fps, max_bytes=max_bytes)
        names = [one.name for one in _named(skinning.clips, skinning.name, path)]
        index = pick_clip(names, clip, path)
        skinning = skinning.select(index)
        count, n = skinning.n_frames, skinning.n_vertices
        size = count * n * 3 * skinning.skinning.rest.itemsize
        afford(size, f"baking {count} frames of {n} vertices", path, max_bytes)
        with reading(path):
            return bake(skinning)
    arrays = read_arrays(
        path,
        required=("vertices", "faces"),
        optional=("fps", "name", "clip", "vertex_map", *_SPACE, *_SURFACE),
        max_bytes=max_bytes,
    )
    with reading(path):
        if fps is None and "fps" not in arrays:
            _log.info("%s: no fps stated, 24 assumed", path)
        sequence = MeshSequence(
            arrays["vertices"],
            arrays["faces"],
            _number(arrays, "fps", 24.0) if fps is None else fps,
            name=_text(arrays, "name") or path.stem,
            clip=_text(arrays, "clip"),
            surface=surface_from(arrays),
            vertex_map=arrays.get("vertex_map"),
            space=_space(arrays),
        )
    pick([sequence.clip or sequence.name], clip)
    return sequence


def list_clips(
    path: Path, *, fps: float | None = None, max_bytes: int | None = None
) -> tuple[Clip, ...]:
    """Clips of the skinning in a file; a sequence counts as one clip."""
    if _is_skinning(path):
        skinning = read_skinning(path, fps=fps, max_bytes=max_bytes)
        return _named(skinning.clips, skinning.name, path)
    names = ("fps", "name", "clip")
    arrays = read_arrays(path, required=(), optional=names, max_bytes=max_bytes)
    with reading(path):
        name = _text(arrays, "clip") or _text(arrays, "name") or path.stem
        rate = _number(arrays, "fps", 24.0) if fps is None else fps
        return (Clip(name, 0, shape_of(path, "vertices")[0], rate),)


def _is_skinning(path: Path) -> bool:
    names = names_in(path)
    return "rest" in names and "vertices" not in names


def _named(clips: tuple[Clip, ...], name: str, path: Path) -> tuple[Clip, ...]:
    return tuple(dataclasses.replace(c, name=c.name or name or path.stem) for c in clips)


def write_sequence(sequence: MeshSequence, path: Path, *, compress: bool = True) -> SaveReport:
    """Write a sequence without loss, with its name, clip, surface and vertex map if it has them.

    Parameters
    ----------
    sequence : MeshSequence
    path : Path
    compress : bool
        Compress by deflate, which takes less space and more time.
    """
    return _write(sequence, path, {"vertices": sequence.vertices}, compress)


def read_skinning(path: Path, *, fps: float | None = None, max_bytes: int | None = None) -> Skinned:
    """Read a file of :func:`write_skinning`; `fps`, if given, becomes the rate of every clip."""
    arrays = read_arrays(
        path,
        required=_SKINNING,
        optional=(
            *("bone_model", "bone_names", "name", *_WHERE_GIVEN, *_SURFACE),
            *("clip_names", "clip_offsets", "clip_fps", *_SPACE, *_SHAPES, "driven"),
        ),
        max_bytes=max_bytes,
    )
    with reading(path):
        version = int(_number(arrays, "format_version", 0))
        problem = f"format_version {version}; this release reads 2 to {FORMAT_VERSION}"
        check(2 <= version <= FORMAT_VERSION, problem)
        names = _text(arrays, "bone_names")
        clips = _clips_from(arrays)
        if fps is not None and clips is not None:
            clips = [dataclasses.replace(clip, fps=fps) for clip in clips]
        skinning = Skinning(
            arrays["rest"],
            arrays["indices"],
            arrays["weights"],
            arrays["transforms"],
            faces=arrays["faces"],
            fps=_number(arrays, "fps", 24.0) if fps is None else fps,
            clips=clips,
            bone_model=_text(arrays, "bone_model") or "rigid",  # type: ignore[arg-type]
            surface=surface_from(arrays),
            bone_names=tuple(json.loads(names)) if names else None,
            name=_text(arrays, "name"),
            space=_space(arrays),
            **{key: arrays.get(key) for key in _WHERE_GIVEN},
        )
        shapes = _shapes_from(arrays, path, max_bytes)
        if shapes is None:
            return skinning
        return ShapedSkinning(skinning, shapes, driven=bool(_number(arrays, "driven", 0)))


def write_skinning(model: Skinned, path: Path, *, compress: bool = True) -> SaveReport:
    """Write a model without loss, with all its fields."""
    skinning = model.skinning
    arrays: dict[str, Any] = {
        "rest": skinning.rest,
        "indices": skinning.indices,
        "weights": skinning.weights,
        "transforms": skinning.transforms,
        "format_version": np.int64(2 if model is skinning else FORMAT_VERSION),
        "bone_model": np.array(skinning.bone_model),
    }
    if isinstance(model, ShapedSkinning):
        shapes, (s, v) = model.shapes, np.nonzero(model.shapes.moved)
        names = np.array(json.dumps(shapes.names))
        rows = np.stack([s, v], axis=1).astype(np.int32)
        found = shapes.displacements[s, v], rows, shapes.amounts, names
        arrays |= dict(zip(_SHAPES, found, strict=True))
        arrays |= {"driven": np.int64(1)} if model.driven else {}
    if skinning.bone_names is not None:
        arrays["bone_names"] = np.array(json.dumps(skinning.bone_names))
    clips = skinning.clips
    if len(clips) > 1 or clips[0].name != skinning.name:
        arrays["clip_names"] = np.array(json.dumps([clip.name for clip in clips]))
        arrays["clip_offsets"] = np.array([0, *(clip.stop for clip in clips)], dtype=np.int64)
        arrays["clip_fps"] = np.array([clip.fps for clip in clips])
    return _write(skinning, path, arrays, compress)


def _write(thing: Any, path: Path, arrays: dict[str, Any], compress: bool) -> SaveReport:
    """Write `arrays`, and the fields of `thing` that sequences and skinnings have in common."""
    arrays |= {"faces": thing.faces, "fps": np.float64(thing.fps)}
    for key in ("name", "clip"):
        if getattr(thing, key, ""):
            arrays[key] = np.array(getattr(thing, key))
    for key in _WHERE_GIVEN:
        if getattr(thing, key, None) is not None:
            arrays[key] = getattr(thing, key)
    for key in _SPACE:
        if getattr(thing.space, key) is not None:
            arrays[key] = np.array(getattr(thing.space, key))
    arrays |= _surface_arrays(thing)
    size = write_arrays(path, arrays, compress=compress)
    return SaveReport(path=path, bytes=size)


def _clips_from(arrays: Mapping[str, NDArray[Any]]) -> Any:
    """Clips that the arrays of an archive describe, or None."""
    text = _text(arrays, "clip_names")
    if not text:
        return None
    names, offsets, rates = json.loads(text), arrays["clip_offsets"], arrays["clip_fps"]
    if not (isinstance(names, list) and offsets.dtype.kind in "iu" and rates.dtype.kind == "f"):
        raise InputError("clip_names", "a list of names with their frames and rates", text[:100])
    if offsets.shape != (len(names) + 1,):
        raise InputError("clip_offsets", f"shape ({len(names) + 1},)", offsets.shape)
    return [Clip(*one) for one in zip(names, offsets[:-1], offsets[1:], rates, strict=True)]


def _shapes_from(
    arrays: Mapping[str, NDArray[Any]], path: Path, max_bytes: int | None
) -> Shapes | None:
    """Shapes that the arrays of an archive describe, or None."""
    missing = [name for name in _SHAPES if name not in arrays]
    if len(missing) == len(_SHAPES):
        return None
    check(not missing, f"shapes without {', '.join(missing)}")
    found, rows, amounts = (arrays[name] for name in _SHAPES[:3])
    fits = rows.dtype.kind in "iu" and rows.shape == (len(found), 2) and found.ndim == 2
    size = np.array([amounts.shape[-1], len(arrays["rest"])])
    problem = f"shape_vertices {rows.shape} of {len(found)} displacements"
    check(fits and amounts.ndim == 2 and (rows >= 0).all() and (rows < size).all(), problem)
    afford(
        3.0 * size.prod() * found.itemsize,
        f"{size[0]} shapes of {size[1]} vertices",
        path,
        max_bytes,
    )
    moved = np.zeros((*size, 3), dtype=found.dtype)
    moved[tuple(rows.T)] = found
    return Shapes(moved, amounts, names=json.loads(_text(arrays, "shape_names")))


def _space(arrays: Mapping[str, NDArray[Any]]) -> Space:
    units = _number(arrays, "units", 1.0) if "units" in arrays else None
    return Space(units, _text(arrays, "up") or None)  # type: ignore[arg-type]


def _number(arrays: Mapping[str, NDArray[Any]], key: str, default: float) -> float:
    return float(_only(arrays.get(key, np.array(default)), key, "number", "fiu"))


def _text(arrays: Mapping[str, NDArray[Any]], key: str) -> str:
    return str(_only(arrays.get(key, np.array("")), key, "text", "U"))


def _only(array: NDArray[Any], key: str, what: str, kinds: str) -> Any:
    """Check that an array has a single entry, of a kind in `kinds`, and return the entry."""
    if array.size != 1 or array.dtype.kind not in kinds:
        raise InputError(key, f"one {what}", f"{array.dtype} of shape {array.shape}")
    return array.ravel()[0]


def _surface_arrays(thing: MeshSequence | Skinning) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    surface = thing.surface
    if surface is None:
        return arrays
    for field in _FIELDS:
        if getattr(surface, field) is not None:
            arrays[f"surface_{field}"] = np.asarray(getattr(surface, field))
    if surface.normals is not None:
        at_vertices = np.zeros((thing.n_vertices, 3), dtype=np.float32)
        at_vertices[thing.faces] = surface.normals
        if np.array_equal(at_vertices[thing.faces], surface.normals):
            del arrays["surface_normals"]
            arrays["vertex_normals"] = at_vertices
    records = [dataclasses.asdict(material) for material in surface.materials]
    for k, record in enumerate(records):
        texture = record.pop("texture")
        if texture is not None:
            arrays[f"texture_{k}"] = np.frombuffer(texture, dtype=np.uint8)
    if records:
        arrays["materials"] = np.array(json.dumps(records, sort_keys=True))
    return arrays


def surface_from(arrays: Mapping[str, NDArray[Any]]) -> Surface | None:
    """Surface that the arrays of an archive describe, or None."""
    fields: dict[str, Any] = {}
    if "vertex_normals" in arrays:
        arrays = {**arrays, "surface_normals": arrays["vertex_normals"][arrays["faces"]]}
    for field, kind in _FIELDS.items():
        array = arrays.get(f"surface_{field}")
        if array is None:
            continue
        if array.dtype.kind != np.dtype(kind).kind or not np.isfinite(array).all():
            raise InputError(f"surface_{field}", f"finite numbers, {kind}", f"{array.dtype}")
        fields[field] = array.astype(kind, copy=False)
    materials = []
    for k, record in enumerate(json.loads(_text(arrays, "materials") or "[]")):
        texture = arrays.get(f"texture_{k}")
        if "base_color" in record:
            record["base_color"] = tuple(float(c) for c in record["base_color"])
        materials.append(Material(**record, texture=None if texture is None else texture.tobytes()))
    if not (fields or materials):
        return None
    return Surface(**fields, materials=tuple(materials))
