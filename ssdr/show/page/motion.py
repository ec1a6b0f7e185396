"""Bounding boxes, path and errors of a model and its input, from one pass over all frames."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ...common.checks import check_squarable
from ...common.parallel import chunk_bounds
from ...mesh.sequence import MeshSequence
from ...metrics.matching import chunk_size, read
from ...model.shapes import Skinned

Float = NDArray[np.float64]
_OUTLINES = 64  # frames whose outermost vertices are looked for


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Motion:
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
    mean, largest, high : (F,) float64
        Mean, largest and 99.5th percentile of the errors of each frame.
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
    largest: Float
    high: Float
    worst: NDArray[np.int64]
    reach: float


def walk(
    model: Skinned, truth: MeshSequence | None, vertical: Float, *, hidden: bool = False
) -> Motion:
    """Extent and path of a model over all frames, and its errors against a reference.

    A `hidden` model counts only for the errors, not for extent and path.

    Raises
    ------
    InputError
        If coordinates are too large to be squared.
    """
    count = model.n_frames
    boxes, path = np.empty((count, 2, 3)), np.empty((count, 3))
    mean, largest, high = np.zeros((3, count))
    worst, diagonal, reach = np.zeros(count, dtype=np.int64), 0.0, 0.0
    outer = Outermost(), Outermost()
    every_nth = -(-count // _OUTLINES)
    for start, stop in chunk_bounds(count, chunk_size(model)):
        some = slice(start, stop)
        shown = model.skin(some, dtype=np.float64)
        check_squarable(shown, "model")
        seen = [] if hidden else [shown]
        if truth is not None:
            true = read(truth, start, stop)
            check_squarable(true, "reference")
            seen.append(true)
            off = true - shown
            reach = max(reach, float(np.abs(off).max()))
            error = np.linalg.norm(off, axis=2)
            mean[some], largest[some] = error.mean(axis=1), error.max(axis=1)
            high[some], worst[some] = np.quantile(error, 0.995, axis=1), error.argmax(axis=1)
        points = seen[0] if len(seen) == 1 else np.concatenate(seen, axis=1)
        boxes[some] = np.stack([points.min(axis=1), points.max(axis=1)], axis=1)
        size = np.linalg.norm(np.ptp(seen[-1], axis=1), axis=1)
        diagonal = max(diagonal, float(size.max()))
        path[some] = boxes[some].mean(axis=1) - boxes[0].mean(axis=0)
        path[some] -= np.outer(path[some] @ vertical, vertical)
        for k in range(-start % every_nth, len(points), every_nth):
            outer[0].add(points[k])
            outer[1].add(points[k] - path[start + k])
    return Motion(
        center=(boxes[:, 0].min(axis=0) + boxes[:, 1].max(axis=0)) / 2,
        whole=outer[0].points,
        path=path,
        body=outer[1].points,
        diagonal=diagonal,
        mean=mean,
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
