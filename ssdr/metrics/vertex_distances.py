"""Distances between corresponding vertices."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from ..common.parallel import chunk_bounds
from ..common.short_repr import short_repr
from ..model.frame_error import motion_rms, rmse_of, share_of
from ..model.shapes import Skinned
from ..model.skinning import skinning_in
from .matching import Frames, as_pair, as_sequence, check_finite, chunk_size, matched, read


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Distances:
    """Statistics of the distances ‖d_i^t‖ between vertex i of two sequences in frame t.

    Attributes
    ----------
    rmse : float
        √(Σ ‖d‖² / (F V)), pooled over vertices and frames, in the mesh's units.
    coordinate_rmse : float
        √(Σ ‖d‖² / (3 F V)), the RMSE per coordinate.
    E : float
        1000 · ‖A − Ã‖_F / √(3 F V), a thousand times `coordinate_rmse` (Kavan et al. 2010; not
        normalised by the size of the mesh).
    percent_of_diagonal : float
        100 · rmse / diagonal.
    motion : float
        Root mean square distance √(Σ ‖A_t v_i^t − m_i‖² / (F V)) of the reference's vertices from
        their mean pose m, with each frame carried onto the first by the rigid motion A_t that fits
        best (Kabsch 1976); over about 500 frames at most.  0 if all motion may be rounding.
    percent_of_motion : float
        100 · rmse / motion: how much of the deformation is lost, root mean square.  NaN where
        nothing deforms.
    mean, max : float
        Mean and largest distance.
    max_frame, max_vertex : int
        Indices of frame and vertex of the largest distance; the first if several are equal.
    per_frame : (F,) float64
        RMSE of each frame.
    per_vertex : (V,) float64
        RMSE of each vertex.
    diagonal : float
        Diagonal of the reference's bounding box in the frame where it is largest.

    Examples
    --------
    >>> reference = np.zeros((2, 4, 3))
    >>> other = reference.copy()
    >>> other[1, 2] = [3, 4, 0]
    >>> result = ssdr.metrics.distances(reference, other)
    >>> round(result.max, 3), result.max_frame, result.max_vertex
    (5.0, 1, 2)
    """

    rmse: float
    coordinate_rmse: float
    E: float
    percent_of_diagonal: float
    motion: float
    percent_of_motion: float
    mean: float
    max: float
    max_frame: int
    max_vertex: int
    per_frame: NDArray[np.float64]
    per_vertex: NDArray[np.float64]
    diagonal: float

    __repr__ = short_repr


def distances(reference: Frames, other: Frames) -> Distances:
    """Statistics of the distances between corresponding vertices.

    Parameters
    ----------
    reference, other : MeshSequence, Skinning, a result that has one, or (F, V, 3) array
        Read by chunks of frames; distances are computed in float64.

    Raises
    ------
    InputError
        If shapes differ, or a number is not finite or too large to be squared.

    Examples
    --------
    >>> reference = np.zeros((2, 4, 3))
    >>> result = ssdr.metrics.distances(reference, reference + [3, 4, 0])
    >>> round(result.mean, 3), result.per_frame.shape
    (5.0, (2,))
    """
    model = skinning_in(other)
    first, second = as_sequence(reference, None, "reference"), model
    if isinstance(model, Skinned):
        first = matched(first, model)
    else:
        first, second = as_pair(first, model)
    n_frames, n_vertices = first.n_frames, first.n_vertices
    per_frame = np.empty(n_frames)
    per_vertex = np.zeros(n_vertices)
    total, largest, where, diagonal = 0.0, -1.0, (0, 0), 0.0
    for start, stop in chunk_bounds(n_frames, chunk_size(first)):
        a = read(first, start, stop)
        with np.errstate(over="ignore", invalid="ignore"):
            square = ((a - read(second, start, stop)) ** 2).sum(axis=2)
            extent = ((a.max(axis=1) - a.min(axis=1)) ** 2).sum(axis=1)
        check_finite(first, second, square, extent)
        per_frame[start:stop] = square.mean(axis=1)
        per_vertex += square.sum(axis=0)
        total += float(np.sqrt(square).sum())
        t, i = np.unravel_index(int(square.argmax()), square.shape)
        if square[t, i] > largest:
            largest, where = float(square[t, i]), (start + int(t), int(i))
        diagonal = max(diagonal, float(extent.max()))
    pooled = rmse_of(per_vertex, n_frames)
    diagonal = math.sqrt(diagonal)
    motion = motion_rms([first])
    share = pooled / diagonal if diagonal > 0 else (0.0 if pooled == 0 else math.inf)
    return Distances(
        rmse=pooled,
        coordinate_rmse=pooled / math.sqrt(3),
        E=1000 * pooled / math.sqrt(3),
        percent_of_diagonal=100 * share,
        motion=motion,
        percent_of_motion=100 * share_of(pooled, motion),
        mean=total / (n_frames * n_vertices),
        max=math.sqrt(largest),
        max_frame=where[0],
        max_vertex=where[1],
        per_frame=np.sqrt(per_frame),
        per_vertex=np.sqrt(per_vertex / n_frames),
        diagonal=diagonal,
    )


def rmse(reference: Frames, other: Frames) -> float:
    """Root mean square √(Σ ‖d‖² / (F V)) of the distances ‖d‖ between corresponding vertices.

    The sum is over all V vertices and F frames; the result is in the mesh's units.

    Parameters
    ----------
    reference, other : MeshSequence, Skinning, a result that has one, or (F, V, 3) array

    Raises
    ------
    InputError
        If shapes differ, or a number is not finite or too large to be squared.

    Examples
    --------
    >>> reference = np.zeros((2, 4, 3))
    >>> round(ssdr.metrics.rmse(reference, reference + [3, 4, 0]), 3)
    5.0
    """
    return distances(reference, other).rmse
