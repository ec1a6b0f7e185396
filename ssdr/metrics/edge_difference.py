"""Spatio-temporal edge difference (STED) of two animations of one mesh."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from ..common.parallel import chunk_bounds, run_chunks
from ..common.short_repr import short_repr
from ..mesh.sequence import MeshSequence
from .matching import Frames, as_pair, check_finite, chunk_size, edges_of, read

_HALF = 2  # virtual edges on each side of the one in the middle of a window


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Sted:
    """The spatio-temporal edge difference and its two parts, all dimensionless.

    Attributes
    ----------
    value : float
        √(spatial² + temporal²).
    spatial, temporal : float
        Means of the local deviations; `spatial` is 0 without edges, `temporal` is 0 for fewer than
        three frames.
    spatial_per_frame : (F,) float64
    temporal_per_frame : (F - 1,) float64
        Entry t is for the virtual edges from frame t to frame t + 1.
    speed : float
        Length s by which motion was divided, in the mesh's units.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> result = ssdr.metrics.sted(dancer, dancer)
    >>> result.value, result.spatial_per_frame.shape, result.temporal_per_frame.shape
    (0.0, (24,), (23,))
    """

    value: float
    spatial: float
    temporal: float
    spatial_per_frame: NDArray[np.float64]
    temporal_per_frame: NDArray[np.float64]
    speed: float

    __repr__ = short_repr


def sted(reference: Frames, other: Frames, faces: ArrayLike | None = None) -> Sted:
    """Perceived difference of two animations: local changes of edge lengths in space and time.

    With l the length of an edge in the reference and l' in `other`, its relative
    difference is δ = |l − l'| / l.  The deviation over a set N of edges is

        dev(N) = √( Σ_N l (δ − δ̄)² / Σ_N l ),   δ̄ = Σ_N l δ / Σ_N l.

    The spatial part is the mean, over frames and vertices, of dev(edges at the vertex in that
    frame).  The temporal part is the mean, over frames and vertices, of dev(virtual edges in time),
    which lead from p_i^t to p_i^{t+1} and have the length √(‖p_i^{t+1} − p_i^t‖² / s² + 1), over
    the five around t, or those of them that the sequence has.  s is the mean length of a vertex's
    step from frame to frame in the reference or, for one that never moves, its diagonal.

    Parameters
    ----------
    reference, other : MeshSequence, Skinning, a result that has one, or (F, V, 3) array
    faces : (T, 3) int array, optional
        Triangles; those of the sequences by default.

    Returns
    -------
    Sted

    Raises
    ------
    InputError
        If shapes differ.

    Notes
    -----
    The spatial part does not change if the frames of either animation are moved rigidly, each in
    its own way.  Neither part changes if all frames are moved by the same rigid motion, or if both
    animations are scaled alike.  An edge of length 0 in the
    reference has weight 0.  Vertices without edges are left out of the spatial part.

    The paper states no parameters, so compare only values of this function.

    References
    ----------
    Váša and Skala, "A perception correlated comparison method for dynamic
    meshes", 2011.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> moved = dancer.vertices + np.float32(1)
    >>> ssdr.metrics.sted(dancer, moved, dancer.faces).value < 1e-3
    True
    """
    first, second = as_pair(reference, other, faces)
    with np.errstate(over="ignore", invalid="ignore"):
        speed = _speed(first)
        check_finite(first, second, speed)
        spatial, spatial_frames = _spatial(first, second)
        temporal, temporal_frames = _temporal(first, second, speed)
    value = math.hypot(spatial, temporal)
    check_finite(first, second, value)
    return Sted(
        value=value,
        spatial=spatial,
        temporal=temporal,
        spatial_per_frame=spatial_frames,
        temporal_per_frame=temporal_frames,
        speed=speed,
    )


def _spatial(first: MeshSequence, second: MeshSequence) -> tuple[float, NDArray[np.float64]]:
    edges = edges_of(first, second)
    per_frame = np.zeros(first.n_frames)
    if len(edges) == 0:
        return 0.0, per_frame
    near = _edges_at(edges, first.n_vertices)
    starts, members = near.indptr[:-1].astype(np.intp), near.indices
    counts = np.diff(near.indptr)
    begin, end = edges[:, 0], edges[:, 1]

    def work(_: int, start: int, stop: int) -> None:
        a, b = read(first, start, stop), read(second, start, stop)
        length = _norm(a[:, end] - a[:, begin])
        delta = _relative(length, _norm(b[:, end] - b[:, begin]))
        total = np.add.reduceat(length[:, members], starts, axis=1)
        safe = np.where(total > 0, total, 1.0)
        mean = np.add.reduceat((length * delta)[:, members], starts, axis=1) / safe
        # Two passes, since a difference of sums of squares loses small deviations to rounding.
        spread = delta[:, members] - np.repeat(mean, counts, axis=1)
        spread *= spread
        spread *= length[:, members]
        deviation = np.sqrt(np.add.reduceat(spread, starts, axis=1) / safe)
        per_frame[start:stop] = deviation.mean(axis=1)

    step = chunk_size(first, 4 * len(members))
    run_chunks(work, chunk_bounds(first.n_frames, step))
    return float(per_frame.mean()), per_frame


def _temporal(
    first: MeshSequence, second: MeshSequence, speed: float
) -> tuple[float, NDArray[np.float64]]:
    count = first.n_frames - 1
    per_frame = np.zeros(count)
    if count < 2:
        return 0.0, per_frame

    def work(_: int, start: int, stop: int) -> None:
        low, high = max(0, start - _HALF), min(count, stop + _HALF)
        length, other = (
            np.sqrt(_norm(np.diff(read(x, low, high + 1), axis=0) / speed) ** 2 + 1)
            for x in (first, second)
        )
        delta = _relative(length, other)
        for t in range(start, stop):
            inside = slice(max(0, t - _HALF) - low, min(count, t + _HALF + 1) - low)
            weight = length[inside]
            total = weight.sum(axis=0)
            mean = (weight * delta[inside]).sum(axis=0) / total
            square = (weight * (delta[inside] - mean) ** 2).sum(axis=0) / total
            per_frame[t] = np.sqrt(square).mean()

    step = max(_HALF, chunk_size(first, 6 * first.n_vertices))
    run_chunks(work, chunk_bounds(count, step))
    return float(per_frame.mean()), per_frame


def _edges_at(edges: NDArray[np.int32], n_vertices: int) -> csr_array:
    """Incidence matrix with a column per edge, and a row per vertex that has edges."""
    columns = np.repeat(np.arange(len(edges)), 2)
    ones = np.ones(len(columns))
    touch = csr_array((ones, (edges.ravel(), columns)), (n_vertices, len(edges)))
    return csr_array(touch[np.diff(touch.indptr) > 0])


def _speed(reference: MeshSequence) -> float:
    """Mean length of a vertex's step or, without motion, the diagonal; 1 for a single point."""
    steps, step = 0.0, chunk_size(reference)
    for start in range(0, reference.n_frames - 1, step):
        block = read(reference, start, start + step + 1)
        steps += float(_norm(np.diff(block, axis=0)).sum())
    mean = steps / (max(reference.n_frames - 1, 1) * reference.n_vertices)
    return mean or reference.diagonal() or 1.0


def _relative(length: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    change = np.abs(length - other)
    return np.divide(change, length, out=np.zeros_like(change), where=length > 0)


def _norm(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.sqrt(np.einsum("...c,...c->...", vectors, vectors)))
