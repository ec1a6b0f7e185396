"""Checks of arguments and reading of frames in chunks, shared by all metrics."""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..common.checks import LARGEST
from ..common.errors import InputError
from ..common.parallel import chunk_bounds
from ..mesh.edges import triangle_edges
from ..mesh.sequence import MeshSequence
from ..model.shapes import Skinned
from ..model.skinning import skinning_in


class _Result(Protocol):
    """Result of a function that makes a model."""

    @property
    def skinning(self) -> Skinned: ...


Frames = MeshSequence | Skinned | _Result | ArrayLike
_CHUNK_BYTES = 16 << 20  # bytes of float64 compared at a time, to bound memory


def as_sequence(frames: Frames, faces: ArrayLike | None, argument: str) -> MeshSequence:
    """Convert `frames` to a MeshSequence; a model is skinned.

    `faces`, if given, replace the triangles of `frames`.  `argument` is the name of `frames` in
    errors.
    """
    frames = skinning_in(frames)
    if isinstance(frames, Skinned):
        rows = frames.vertex_map
        frames = MeshSequence(
            frames.skin(), frames.faces, frames.fps, vertex_map=rows, validate=False
        )
    if isinstance(frames, MeshSequence):
        if faces is None:
            return frames
        return MeshSequence(frames.vertices, faces, frames.fps, validate=False)
    try:
        return MeshSequence(frames, faces)
    except InputError as error:
        name = "faces" if error.argument == "faces" else argument
        raise InputError(name, error.expected, error.got) from error


def as_pair(
    reference: Frames, other: Frames, faces: ArrayLike | None = None
) -> tuple[MeshSequence, MeshSequence]:
    """Convert both arguments to sequences of the same vertices, and check their numbers of frames.

    Where one of them was welded, both are read at the vertices that are left.
    """
    first = as_sequence(reference, faces, "reference")
    second = as_sequence(other, faces, "other")
    first = _at_vertices_of(second, first)
    return first, matched(second, first, "other", "the reference")


def matched(
    reference: MeshSequence,
    model: MeshSequence | Skinned,
    argument: str = "reference",
    whose: str = "the model",
) -> MeshSequence:
    """The reference of a model, read at the vertices of the model.

    Raises
    ------
    InputError
        If it has other frames, or neither the vertices of the model nor those before its welding,
        nor those that it had itself before it was welded.
    """
    found, welded = _at_vertices_of(model, reference), reference.vertex_map
    if welded is not None and len(welded) == model.n_vertices != found.n_vertices:
        found = found.with_vertices(welded, np.arange(found.n_vertices))
        surface = model.surface
        found = dataclasses.replace(found, faces=model.faces, surface=surface, validate=False)
    if (found.n_frames, found.n_vertices) != (model.n_frames, model.n_vertices):
        raise InputError(
            argument,
            f"{model.n_frames} frames of {model.n_vertices} vertices, as {whose} has",
            f"{reference.n_frames} frames of {reference.n_vertices}",
        )
    return found


def _at_vertices_of(model: MeshSequence | Skinned, sequence: MeshSequence) -> MeshSequence:
    """The first of the vertices that were welded into each of a model; else all, unchanged."""
    rows = model.vertex_map
    if rows is None or not len(rows) == sequence.n_vertices != model.n_vertices:
        return sequence
    kept = np.unique(rows, return_index=True)[1]
    chosen = sequence.with_vertices(kept, np.asarray(rows))
    return dataclasses.replace(chosen, faces=model.faces, surface=model.surface, validate=False)


def check_finite(first: MeshSequence, second: MeshSequence | Skinned, *results: Any) -> None:
    """Raise an InputError if a result is not finite.

    Raises
    ------
    InputError
        If a result is not finite.  The error names the coordinates that are too large to be
        squared, if there are any.
    """
    if all(np.isfinite(result).all() for result in results):
        return
    expected = f"coordinates of less than {LARGEST:g}, which can be squared and summed"
    for name, sequence in (("reference", first), ("other", second)):
        for start, stop in chunk_bounds(sequence.n_frames, chunk_size(sequence)):
            size = np.abs(read(sequence, start, stop)).max(axis=(1, 2))
            if not size.max() < LARGEST:
                raise InputError(name, expected, f"larger ones in frame {start + size.argmax()}")
    raise InputError("reference and other", "a result within float64", "parameters that give none")


def edges_of(first: MeshSequence, second: MeshSequence) -> NDArray[np.int32]:
    """Edges ``(E, 2)`` of the first sequence, or of the second if only the second has faces."""
    faces = first.faces if len(first.faces) else second.faces
    return triangle_edges(faces, first.n_vertices).astype(np.int32)


def chunk_size(sequence: MeshSequence | Skinned, per_frame: int = 0) -> int:
    """Number of frames in a chunk, if a frame takes `per_frame` numbers (at least 3 V)."""
    return max(1, _CHUNK_BYTES // (8 * max(per_frame, 3 * sequence.n_vertices)))


def read(frames: MeshSequence | Skinned, start: int, stop: int) -> NDArray[np.float64]:
    """Read or skin the frames ``start:stop`` as a float64 array ``(n, V, 3)``."""
    some = slice(start, stop)
    block = frames.skin(some) if isinstance(frames, Skinned) else frames.frames(some)
    return np.asarray(block, dtype=np.float64)
