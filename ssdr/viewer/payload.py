"""Content of a page: a document of names and numbers, and blocks of arrays.

Positions are stored in units of the mesh's diagonal, relative to the middle of the rest pose or of
all frames, so that float32 in a shader is exact enough wherever the mesh is and whatever its unit.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import metrics
from ..clips import Clip
from ..driving import is_driven
from ..errors import InputError
from ..frames.normals import holders_of
from ..hierarchy.bone_ends import limb_ends
from ..hierarchy.transforms import RIGID, rest_diagonal
from ..io.corners import rest_normals
from ..render.camera import up_axes
from ..render.palette import bone_colors, heat, mix, srgb_from_linear
from ..sequence import MeshSequence
from ..skinning import Skinning
from ..surface import Surface
from .blocks import Blocks
from .figures import figures, summary
from .motion import MotionFigures, Truth, walk
from .surface import surface_entries

MOST_INFLUENCES = 8  # that the shader sums
_SPAN_BYTES = 1 << 20  # of 16-bit differences that are decoded at a time
_WEIGHT_STEPS = 1 << 20
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
    subject: Skinning | MeshSequence,
    reference: MeshSequence | None,
    *,
    title: str,
    up: str,
    keep_input: bool,
    file: Path | None,
    reference_name: str,
    max_bytes: int,
) -> Payload:
    """Content of the page of a model and its input; arguments are those of :func:`ssdr.view`.

    Raises
    ------
    InputError
        If the reference does not match the model, or even one frame is too large for a page.
    """
    basis = np.stack([up_axes(up)[k] for k in (2, 0, 1)])
    skinned, alone = isinstance(subject, Skinning), False
    if isinstance(subject, Skinning):
        model = subject
    elif reference is not None:
        model = _of_vertices(subject)
    else:
        model, alone = _standing(subject), True
        reference, keep_input = subject, True
    notes = []
    if model.n_influences > MOST_INFLUENCES:
        model = model.prune(MOST_INFLUENCES)
        notes.append(f"The {MOST_INFLUENCES} largest weights of each vertex are shown.")
    truth = None if reference is None else Truth.of(model, reference)
    motion = walk(model, truth, basis[1], hidden=alone)
    measured = None if alone else truth
    angles = (
        None if measured is None else _angles(measured.on(model), model if skinned else subject)
    )
    scale = motion.diagonal or 1.0
    surface = model.surface
    if skinned:
        normals = rest_normals(model, model.rest)
        surface = dataclasses.replace(surface or Surface(), normals=normals)
    blocks = Blocks()
    rest = model.rest.astype(np.float64)
    rest_center = (rest.min(axis=0) + rest.max(axis=0)) / 2
    document: dict[str, Any] = {
        "title": title,
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
            holders=None if truth is None else holders_of(truth.on(model), model),
        ),
        **_shape_entries(model, scale, blocks),
        "rig": _rig(model, rest_center, scale, blocks) if skinned else None,
    }
    held = truth is not None and keep_input
    fixed = sum(map(len, blocks.data)) + len(json.dumps(document)) + _EMPTY_BYTES
    step = _thinning(model, fixed, max_bytes, held)
    frames = np.concatenate([np.arange(c.start, c.stop, step) for c in model.clips])
    if step > 1:
        notes.append(
            f"To keep the page small, it shows one frame in {step}: {len(frames):,} of "
            f"{model.n_frames:,}. The figures are those of all frames."
        )
    transforms = model.transforms[frames].astype(np.float64)
    moved = transforms[..., 3] + transforms[..., :3] @ rest_center - motion.center
    transforms[..., 3] = moved / scale
    if model.shapes is not None:
        document["amounts"] = blocks.array(model.shapes.amounts[frames].astype(np.float32))
    document |= {
        "expressions": [c.name for c in model.clips] if step == 1 and is_driven(model) else None,
        "step": step,
        "frames": len(frames),
        "clips": _clips(model.clips, step),
        "transforms": blocks.fixed(transforms),
        "path": blocks.array((motion.path[frames] / scale).astype(np.float32)),
        "follow": bool(np.linalg.norm(np.ptp(motion.path, axis=0)) > _TRAVELS * scale),
        "error": None if measured is None else _error(motion, frames),
        "angles": angles and {"mean": angles.mean, "top": max(angles.p95, _LEAST_ANGLE)},
        "input": _input(model, truth, motion, frames, scale, blocks) if truth and held else None,
        "summary": summary(model, skinned, motion, measured, file),
        "figures": figures(model, skinned, motion, measured, angles, file, reference_name),
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


def weight_entries(model: Skinning, blocks: Blocks) -> dict[str, Any]:
    """Append indices and weights, the largest first, to `blocks`; return their document entries.

    The stored weights of a vertex sum to exactly 1.
    """
    order = np.argsort(-model.weights, axis=1, kind="stable")
    weights = np.take_along_axis(model.weights, order, axis=1).astype(np.float64)
    steps = np.rint(_WEIGHT_STEPS * weights).astype(np.int32)
    steps[:, 0] += _WEIGHT_STEPS - steps.sum(axis=1)
    used = max(1, int((steps > 0).any(axis=0).sum()))
    indices = np.where(steps > 0, np.take_along_axis(model.indices, order, axis=1), 0)
    return {
        "indices": blocks.array(indices[:, :used].astype(np.uint32)),
        "weights": {**blocks.array(steps[:, :used]), "step": 1 / _WEIGHT_STEPS},
    }


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


def _shape_entries(model: Skinning, scale: float, blocks: Blocks) -> dict[str, Any]:
    """Append the displacements of shapes to `blocks`; return their document entries.

    Normals are not displaced.
    """
    if model.shapes is None:
        return {"shapes": None}
    shape, vertex = np.nonzero(model.shapes.moved)
    moves = model.shapes.displacements[shape, vertex] / scale
    return {
        "shapes": np.searchsorted(shape, np.arange(len(model.shapes) + 1)).tolist(),
        "shapeVertices": blocks.array(vertex.astype(np.uint32), delta=True),
        "shapeMoves": blocks.array(moves.astype(np.float32)),
    }


def heat_scales() -> list[list[list[float]]]:
    """Colour scales of the error for a light and a dark page, the smallest error first (sRGB)."""
    scales = heat(np.linspace(0, 1, 16)), _from_grey(heat(np.linspace(0.6, 0, 16)))
    return [srgb_from_linear(colors).round(4).tolist() for colors in scales]


def _from_grey(colors: Float) -> Float:
    """Colours (linear RGB) of which the first five fade in from a medium grey."""
    grey = np.linspace(1.0, 0.0, 6)[:, None]
    return np.concatenate([grey * 0.2 + (1 - grey) * colors[:6], colors[6:]])


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


def _error(motion: MotionFigures, frames: NDArray[np.int64]) -> dict[str, Any]:
    """Errors of the frames shown, in the mesh's units, and the top of the colour scale."""
    return {
        "mean": motion.mean[frames].tolist(),
        "largest": motion.largest[frames].tolist(),
        "worst": motion.worst[frames].tolist(),
        "top": max(float(motion.high.max()), 1e-6 * (motion.diagonal or 1.0)),
        "max": float(motion.largest.max()),
        "frame": motion.worst_frame,
        "diagonal": motion.diagonal,
    }


def _angles(
    reference: MeshSequence, subject: Skinning | MeshSequence
) -> metrics.NormalErrors | None:
    """Error of normals, or None if no triangle has an area."""
    try:
        return metrics.normals(reference, subject)
    except InputError:
        return None


def _input(
    model: Skinning,
    truth: Truth,
    motion: MotionFigures,
    frames: NDArray[np.int64],
    scale: float,
    blocks: Blocks,
) -> dict[str, Any]:
    """Append the differences from the model to the input; return their document entry."""

    def difference(k: int) -> Float:
        one = slice(int(frames[k]), int(frames[k]) + 1)
        off: Float = truth.read(one)[0] - model.skin(one, dtype=np.float64)[0]
        return off

    count = len(frames), model.n_vertices
    return difference_entry(difference, *count, motion.reach, scale, blocks)


def difference_entry(
    difference: Callable[[int], NDArray[np.floating]],
    n_frames: int,
    n_vertices: int,
    reach: float,
    scale: float,
    blocks: Blocks,
) -> dict[str, Any]:
    """Append the 16-bit differences of an input in spans of frames; return their document entry.

    `difference` returns those (V, 3) of a frame, `reach` is the largest, and `scale` the length of
    the page's unit.
    """
    step = (reach or 1.0) / 32767
    length = max(1, _SPAN_BYTES // (6 * n_vertices))
    spans = []
    for start in range(0, n_frames, length):
        some = range(start, min(start + length, n_frames))
        off = np.stack([np.rint(difference(k) / step).astype(np.int16) for k in some])
        spans.append(blocks.array(off, delta=True))
    return {"step": step / scale, "length": length, "spans": spans}
