"""Content of a page: a document of names and numbers, and blocks of arrays.

Positions are stored in units of the mesh's diagonal, relative to the middle of the rest pose or of
all frames, so that float32 in a shader is exact enough wherever the mesh is and whatever its unit.
"""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.filesize import decimal

from ... import metrics
from ...common.checks import check_whole
from ...common.errors import InputError
from ...io.corners import rest_normals
from ...mesh.clips import Clip
from ...mesh.sequence import MeshSequence, as_sequences, joined, sequence_in
from ...mesh.surface import Surface
from ...metrics.matching import matched
from ...metrics.normal_angles import known_errors
from ...model.bone_ends import limb_ends
from ...model.drawn_normals import holders_of
from ...model.shapes import ShapedSkinning, Shapes, Skinned, skinning_and_shapes
from ...model.size import size
from ...model.skinning import Skinning, skinning_in
from ...model.transforms import RIGID, rest_diagonal
from ..camera import up_axes
from ..palette import bone_colors, mix, srgb_from_linear
from .blocks import Blocks, difference_entry, heat_scales, surface_entries, weight_entries
from .motion import Motion, walk

MAX_BYTES = 64_000_000
MOST_INFLUENCES = 8  # that the shader sums
_EMPTY_BYTES = 100_000  # of a page without content: markup, style and script
_LEAST_ANGLE = 1.0  # degrees at the end of a scale
_TRAVELS = 0.8  # of the diagonal: the camera follows a mesh that goes farther
Float = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Payload:
    """Content of a page.

    Attributes
    ----------
    document : dict
        For JSON; an entry of an array names its block.
    blocks : tuple of bytes
    notes : tuple of str
        What was left out or rounded, in words.
    """

    document: dict[str, Any]
    blocks: tuple[bytes, ...]
    notes: tuple[str, ...]


def payload(
    model: Any,
    reference: Any = None,
    *,
    title: str | None = None,
    up: str = "y",
    file: Path | str | None = None,
    reference_name: str = "",
    max_bytes: int = MAX_BYTES,
) -> Payload:
    """Content of the page of a model and its input; arguments are those of :func:`ssdr.view`.

    Raises
    ------
    InputError
        If an argument is not valid, the reference does not match the model, or even one frame is
        too large for a page.
    """
    subject = sequence_in(skinning_in(model))
    if not isinstance(subject, (Skinning, ShapedSkinning, MeshSequence)):
        expected = "a Skinning, Decomposition or MeshSequence"
        raise InputError("model", expected, type(model).__name__)
    basis = np.stack([up_axes(up)[k] for k in (2, 0, 1)])
    check_whole(max_bytes, "max_bytes", 1)
    file = None if file is None else Path(file)
    truth = None if reference is None else joined(as_sequences(reference))
    skinned, alone, shapes = isinstance(subject, Skinned), False, None
    if isinstance(subject, Skinned):
        model, shapes = skinning_and_shapes(subject)
    elif truth is not None:
        model = _of_vertices(subject)
    else:
        model, alone = _standing(subject), True
        truth = subject
    notes = []
    if model.n_influences > MOST_INFLUENCES:
        model = model.prune(MOST_INFLUENCES)
        notes.append(f"The {MOST_INFLUENCES} largest weights of each vertex are shown.")
    if truth is not None:
        own = {"faces": model.faces, "surface": model.surface, "vertex_map": None}
        truth = dataclasses.replace(matched(truth, model), **own, validate=False)
    # what is drawn: the model, or it with its shapes
    shown = model if shapes is None else ShapedSkinning(model, shapes)
    motion = walk(shown, truth, basis[1], hidden=alone)
    errors = angles = None
    if truth is not None and not alone:
        errors = metrics.distances(truth, shown)
        angles = known_errors(truth, shown if skinned else subject)
    scale = motion.diagonal or 1.0
    surface = model.surface
    if skinned:
        normals = rest_normals(model, model.rest)
        surface = dataclasses.replace(surface or Surface(), normals=normals)
    blocks = Blocks()
    rest = model.rest.astype(np.float64)
    rest_center = (rest.min(axis=0) + rest.max(axis=0)) / 2
    document: dict[str, Any] = {
        "title": title or subject.name or "Animation",
        "skinned": skinned,
        "basis": basis.ravel().tolist(),
        "vertices": model.n_vertices,
        "bones": model.n_bones,
        "center": motion.center.tolist(),
        "scale": scale,
        "whole": ((motion.whole - motion.center) / scale).round(5).tolist(),
        "body": ((motion.body - motion.center) / scale).round(5).tolist(),
        "heat": heat_scales(),
        "rest": blocks.fixed((rest - rest_center) / scale),
        **weight_entries(model, blocks),
        **surface_entries(
            model.faces,
            surface,
            model.n_vertices,
            blocks,
            notes,
            turned=skinned,
            holders=None if truth is None else holders_of(truth, model),
        ),
        **_shape_entries(shapes, scale, blocks),
        "rig": _rig(model, rest_center, scale, blocks) if skinned else None,
    }
    fixed = sum(map(len, blocks.data)) + len(json.dumps(document)) + _EMPTY_BYTES
    step = _thinning(model, fixed, max_bytes, truth is not None)
    frames = np.concatenate([np.arange(c.start, c.stop, step) for c in model.clips])
    if step > 1:
        notes.append(
            f"To keep the page small, it shows one frame in {step}: {len(frames):,} of "
            f"{model.n_frames:,}. The figures are those of all frames."
        )
    transforms = model.transforms[frames].astype(np.float64)
    moved = transforms[..., 3] + transforms[..., :3] @ rest_center - motion.center
    transforms[..., 3] = moved / scale
    if shapes is not None:
        document["amounts"] = blocks.array(shapes.amounts[frames].astype(np.float32))
    driven = isinstance(subject, ShapedSkinning) and subject.driven
    document |= {
        "expressions": [c.name for c in model.clips] if driven and step == 1 else None,
        "step": step,
        "frames": len(frames),
        "clips": _clips(model.clips, step),
        "transforms": blocks.fixed(transforms),
        "path": blocks.array((motion.path[frames] / scale).astype(np.float32)),
        "follow": bool(np.linalg.norm(np.ptp(motion.path, axis=0)) > _TRAVELS * scale),
        "error": errors and _error(motion, errors, frames),
        "angles": angles and {"mean": angles.mean, "top": max(angles.p95, _LEAST_ANGLE)},
        "input": truth and _input(shown, truth, motion.reach, frames, scale, blocks),
        "summary": _summary(model, skinned, errors, file),
        "figures": _figures(
            shown,
            skinned,
            motion.diagonal,
            errors,
            angles,
            file,
            reference_name or "the input",
        ),
        "notes": notes,
    }
    return Payload(document=document, blocks=tuple(blocks.data), notes=tuple(notes))


def _standing(sequence: MeshSequence) -> Skinning:
    """Model with one bone that never moves; the sequence is stored as differences from it."""
    still = np.tile(np.eye(3, 4), (sequence.n_frames, 1, 1, 1))
    return _bones_of(sequence, np.zeros(sequence.n_vertices, dtype=np.int32), still)


def _of_vertices(sequence: MeshSequence) -> Skinning:
    """Model with one translating bone per vertex, which reproduces a sequence exactly."""
    vertices = sequence.frames(slice(None))
    moves = np.zeros((*vertices.shape, 4), dtype=vertices.dtype)
    moves[..., :3] = np.eye(3)
    moves[..., 3] = vertices - vertices[0]
    return _bones_of(sequence, np.arange(sequence.n_vertices), moves)


def _bones_of(sequence: MeshSequence, bones: NDArray[Any], transforms: NDArray[Any]) -> Skinning:
    names = ("faces", "fps", "surface", "name", "vertex_map")
    kept = {name: getattr(sequence, name) for name in names}
    rest, weights = sequence.frames(0), np.ones((sequence.n_vertices, 1), dtype=np.float32)
    return Skinning(rest, bones[:, None], weights, transforms, **kept)


def _rig(model: Skinning, center: Float, scale: float, blocks: Blocks) -> dict[str, Any]:
    """Names, places, colours and tree of the bones, and each bone's share of the weights.

    The colours of the vertices are appended to `blocks`.
    """
    centroids = model.centroids()
    heads = centroids if model.parents is None else np.asarray(model.joint_positions, np.float64)
    ends, rigid = None, False
    if model.parents is not None:
        tails = limb_ends(heads, model.parents, model.rest, model.indices, model.weights)
        ends = ((tails - center) / scale).round(7).tolist()
        gaps = model.joint_gaps().max()
        rigid = bool(model.bone_model == "rigid" and gaps <= 10 * RIGID * rest_diagonal(model.rest))
    colors = bone_colors(centroids)
    share = np.asarray(model.sparse_weights().sum(axis=0)).ravel() / model.n_vertices
    shade = mix(colors, model.weights, model.indices)
    return {
        "names": list(model.names()),
        "parents": None if model.parents is None else model.parents.tolist(),
        "rigid": rigid,
        "heads": ((heads - center) / scale).round(7).tolist(),
        "ends": ends,
        "colors": (255 * srgb_from_linear(colors)).round().astype(int).tolist(),
        "share": share.round(6).tolist(),
        "shade": blocks.array((255 * srgb_from_linear(shade)).round().astype(np.uint8)),
    }


def _shape_entries(shapes: Shapes | None, scale: float, blocks: Blocks) -> dict[str, Any]:
    """Append the displacements of shapes to `blocks`; return their document entries.

    Normals are not displaced.
    """
    if shapes is None:
        return {"shapes": None}
    shape, vertex = np.nonzero(shapes.moved)
    moves = shapes.displacements[shape, vertex] / scale
    return {
        "shapes": np.searchsorted(shape, np.arange(len(shapes) + 1)).tolist(),
        "shapeVertices": blocks.array(vertex.astype(np.uint32), delta=True),
        "shapeMoves": blocks.array(moves.astype(np.float32)),
    }


def _thinning(model: Skinning, fixed: int, max_bytes: int, held: bool) -> int:
    """Smallest frame step at which a page fits `max_bytes` even if nothing can be compressed.

    Raises
    ------
    InputError
        If there is no room for a single frame.
    """
    frame = 150 + 48 * model.n_bones + (6 * model.n_vertices if held else 0)
    room = math.floor((0.75 * max_bytes - fixed) / frame)  # base64 writes 3 bytes as 4
    least = len(model.clips)
    if room < least:
        needed = math.ceil((fixed + least * frame) / 0.75)
        raise InputError("max_bytes", f"at least {needed:,} for this mesh", f"{max_bytes:,}")
    step = max(1, math.ceil(model.n_frames / room))
    while sum(-(-clip.n_frames // step) for clip in model.clips) > room:
        step += 1
    return step


def _clips(clips: tuple[Clip, ...], step: int) -> list[dict[str, Any]]:
    """Names, rates and frames of the clips; `first` is a clip's first frame in the model."""
    found: list[dict[str, Any]] = []
    for clip in clips:
        start = found[-1]["stop"] if found else 0
        stop = start - (-clip.n_frames // step)
        about = {"name": clip.name, "start": start, "stop": stop, "first": clip.start}
        found.append({**about, "fps": clip.fps / step})
    return found


def _error(motion: Motion, errors: metrics.Distances, frames: NDArray[np.int64]) -> dict[str, Any]:
    """Errors of the frames shown, in the mesh's units, and the top of the colour scale."""
    return {
        "mean": motion.mean[frames].tolist(),
        "largest": motion.largest[frames].tolist(),
        "worst": motion.worst[frames].tolist(),
        "top": max(float(motion.high.max()), 1e-6 * (errors.diagonal or 1.0)),
        "max": errors.max,
        "frame": errors.max_frame,
        "diagonal": errors.diagonal,
    }


def _input(
    model: Skinned,
    truth: MeshSequence,
    reach: float,
    frames: NDArray[np.int64],
    scale: float,
    blocks: Blocks,
) -> dict[str, Any]:
    """Append the differences from the model to the input; return their document entry."""

    def difference(k: int) -> Float:
        one = slice(int(frames[k]), int(frames[k]) + 1)
        return np.asarray((truth.frames(one) - model.skin(one, dtype=np.float64))[0])

    return difference_entry(difference, len(frames), model.n_vertices, reach, scale, blocks)


def _figures(
    shown: Skinned,
    skinned: bool,
    diagonal: float,
    errors: metrics.Distances | None,
    angles: metrics.NormalErrors | None,
    file: Path | None,
    reference_name: str,
) -> list[tuple[str, str, str]]:
    """Rows of a table: name, value, and where the value comes from."""
    model = shown.skinning
    cache = 12 * model.n_frames * model.n_vertices
    cached = "every vertex of every frame in float32"
    seconds = sum(clip.n_frames / clip.fps for clip in model.clips)
    rows = [
        ("Vertices", f"{model.n_vertices:,}", f"{len(model.faces):,} triangles"),
        ("Frames", f"{model.n_frames:,}", f"{seconds:.3g} seconds"),
    ]
    if skinned:
        held = size(shown).total
        tree = "without a hierarchy" if model.parents is None else "in a hierarchy"
        used = int((model.weights > 0).sum(axis=1).max())
        rows += [
            ("Bones", f"{model.n_bones:,}", f"{model.bone_model}, {tree}"),
            ("Influences", f"{used}", "most bones that move one vertex"),
        ]
        if file is not None:
            rows.append(("File", decimal(file.stat().st_size), file.name))
        times = f"{cache / max(held, 1):,.1f} × the {decimal(held)} of animation, mesh and weights"
        rows.append(("Vertex cache", decimal(cache), f"{cached}: {times}"))
    else:
        rows.append(("Vertex cache", decimal(cache), cached))
    if errors is not None:
        source = f"root mean square over all frames and vertices, against {reference_name}"
        where = f"in frame {errors.max_frame} at vertex {errors.max_vertex}"
        rows += [
            ("RMSE", _with_share(errors.rmse, errors.diagonal), source),
            ("Largest error", _with_share(errors.max, errors.diagonal), where),
        ]
    unit = "the mesh's units; per cent above are of this"
    rows.append(("Diagonal", f"{diagonal:.4g}", unit))
    if angles is not None:
        source = f"mean angle to those of {reference_name}"
        source += ", as engines draw them" if skinned else ""
        source += f"; 95 % within {angles.p95:.3g}°, {100 * angles.inwards:.2g} % inwards"
        rows.append(("Normals", f"{angles.mean:.3g}°", source))
    return rows


def _with_share(length: float, diagonal: float) -> str:
    """Text of a length, with its percentage of the diagonal."""
    return f"{length:.3g} ({100 * length / (diagonal or 1.0):.2g} %)"


def _summary(
    model: Skinning, skinned: bool, errors: metrics.Distances | None, file: Path | None
) -> str:
    """One line of text with the most important quantities."""
    parts = [f"{model.n_bones:,} bones"] if skinned else []
    parts += [f"{model.n_vertices:,} vertices", f"{model.n_frames:,} frames"]
    if errors is not None:
        parts.append(f"RMSE {_with_share(errors.rmse, errors.diagonal)}")
    if file is not None:
        parts.append(f"file {decimal(file.stat().st_size)}")
    return " · ".join(parts)
