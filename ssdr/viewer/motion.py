"""Bounding boxes, errors and path of a model and its input, from one pass over all frames."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import check_squarable
from ..errors import InputError
from ..sequence import MeshSequence
from ..skinning import Skinning

Float = NDArray[np.float64]
_OUTLINES = 64  # frames whose outermost vertices are looked for
_CHUNK_BYTES = 32 << 20  # of vertices that are skinned at a time


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class MotionFigures:
    """Extent, path and errors of a model over all frames.

    Attributes
    ----------
    center : (3,) float64
        Middle of the bounding box of all frames.
    whole : (26, 3) float64
        Outermost vertices of up to 64 frames in 26 directions.
    path : (F, 3) float64
        Path of the middle of the bounding box across the ground, relative to the first frame.
    body : (26, 3) float64
        Outermost vertices as in `whole`, after `path` is subtracted from them.
    diagonal : float
        Diagonal of the bounding box (of the reference, if any) in the frame where it is largest.
    mean, rms, largest, high : (F,) float64
        Mean, root mean square, largest and 99.5th percentile of the errors of each frame.
    worst : (F,) int64
        Index of the vertex with the largest error in each frame.
    reach : float
        Largest absolute difference of a coordinate between model and reference.
    """

    center: Float
    whole: Float
    path: Float
    body: Float
    diagonal: float
    mean: Float
    rms: Float
    largest: Float
    high: Float
    worst: NDArray[np.int64]
    reach: float

    @property
    def rmse(self) -> float:
        """Root mean square of all errors."""
        return math.sqrt(float((self.rms**2).mean()))

    @property
    def worst_frame(self) -> int:
        """Index of the frame with the largest error."""
        return int(self.largest.argmax())

    def in_words(self, length: float) -> str:
        """Text of a length, with its percentage of the diagonal."""
        return f"{length:.3g} ({100 * length / (self.diagonal or 1.0):.2g} %)"


@dataclasses.dataclass(frozen=True, eq=False)
class Truth:
    """A reference sequence, read at the vertices of the model.

    `rows` (V,) holds the reference's indices of these vertices if the model was welded and the
    reference was not.  Otherwise it is None.
    """

    sequence: MeshSequence
    rows: NDArray[np.intp] | None

    @classmethod
    def of(cls, model: Skinning, reference: MeshSequence) -> Truth:
        """Check that a reference has the frames and vertices of a model, and return it as a Truth.

        Raises
        ------
        InputError
            If its number of frames or vertices differs from the model's.
        """
        rows, count = None, model.n_vertices
        if model.vertex_map is not None and reference.n_vertices != count:
            count = len(model.vertex_map)
            _, rows = np.unique(model.vertex_map, return_index=True)
        if (reference.n_frames, reference.n_vertices) != (model.n_frames, count):
            raise InputError(
                "reference",
                f"{model.n_frames} frames of {count} vertices, as the model has",
                f"{reference.n_frames} frames of {reference.n_vertices}",
            )
        return cls(reference, rows)

    def on(self, model: Skinning) -> MeshSequence:
        """The reference with the vertices, triangles and hard edges of the model."""
        vertices = self.sequence.vertices if self.rows is None else self.read(slice(None))
        return MeshSequence(vertices, model.faces, surface=model.surface, validate=False)

    def read(self, frames: slice) -> Float:
        """Vertices ``(f, V, 3)`` of some frames."""
        block = np.asarray(self.sequence.frames(frames), dtype=np.float64)
        return block if self.rows is None else block[:, self.rows]


def walk(
    model: Skinning, truth: Truth | None, vertical: Float, *, hidden: bool = False
) -> MotionFigures:
    """Extent and path of a model over all frames, and its errors against a reference.

    A `hidden` model counts only for the errors, not for extent and path.

    Raises
    ------
    InputError
        If coordinates are too large to be squared.
    """
    boxes, paths, diagonal, reach = [], [], 0.0, 0.0
    outer = Outermost(), Outermost()
    every_nth = -(-model.n_frames // _OUTLINES)
    found: list[tuple[Any, ...]] = []
    for frames in _chunks(model.n_frames, model.n_vertices):
        shown = model.skin(frames, dtype=np.float64)
        check_squarable(shown, "model")
        seen = [] if hidden else [shown]
        if truth is None:
            found.append((np.zeros(len(shown)),) * 4 + (np.zeros(len(shown), dtype=np.int64),))
        else:
            off = truth.read(frames)
            check_squarable(off, "reference")
            size_of = np.linalg.norm(np.ptp(off, axis=1), axis=1)
            diagonal = max(diagonal, float(size_of.max()))
            seen.append(off)
            off = off - shown
            reach = max(reach, float(np.abs(off).max()))
            error = np.linalg.norm(off, axis=2)
            mean, rms = error.mean(axis=1), np.sqrt((error**2).mean(axis=1))
            high = np.quantile(error, 0.995, axis=1)
            found.append((mean, rms, error.max(axis=1), high, error.argmax(axis=1)))
        points = seen[0] if len(seen) == 1 else np.concatenate(seen, axis=1)
        box = np.stack([points.min(axis=1), points.max(axis=1)], axis=1)
        boxes.append(box)
        path = box.mean(axis=1) - boxes[0][0].mean(axis=0)
        paths.append(path - np.outer(path @ vertical, vertical))
        for k in range(-frames.start % every_nth, len(points), every_nth):
            outer[0].add(points[k])
            outer[1].add(points[k] - paths[-1][k])
    every = np.concatenate(boxes)
    center = (every[:, 0].min(axis=0) + every[:, 1].max(axis=0)) / 2
    if truth is None:
        diagonal = float(np.linalg.norm(every[:, 1] - every[:, 0], axis=1).max())
    mean, rms, largest, high, worst = (np.concatenate(x) for x in zip(*found, strict=True))
    return MotionFigures(
        center=center,
        whole=outer[0].points,
        path=np.concatenate(paths),
        body=outer[1].points,
        diagonal=diagonal,
        mean=mean,
        rms=rms,
        largest=largest,
        high=high,
        worst=worst,
        reach=reach,
    )


class Outermost:
    """The outermost of all points that were added, in 26 directions, to frame a picture.

    Attributes
    ----------
    points : (26, 3) float64
    """

    ways = np.array([w for w in np.ndindex(3, 3, 3) if w != (1, 1, 1)]) - 1.0

    def __init__(self) -> None:
        self.points = np.zeros((len(self.ways), 3))
        self._reach = np.full(len(self.ways), -np.inf)

    def add(self, points: NDArray[np.floating]) -> None:
        along = points @ self.ways.T
        last = along.argmax(axis=0)
        reach = along.max(axis=0)
        farther = reach > self._reach
        self._reach[farther] = reach[farther]
        self.points[farther] = points[last[farther]]


def _chunks(n_frames: int, n_vertices: int) -> list[slice]:
    step = max(1, _CHUNK_BYTES // (24 * n_vertices))
    return [slice(k, min(k + step, n_frames)) for k in range(0, n_frames, step)]
