"""Spatio-temporal edge difference (STED) of two animations of one mesh."""

from __future__ import annotations

import dataclasses
import math
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array, eye_array

from ..common.checks import LARGEST, check_whole
from ..common.errors import InputError, check_flag, is_real
from ..common.parallel import chunk_bounds, run_chunks
from ..common.short_repr import short_repr
from ..mesh.sequence import MeshSequence
from .matching import Frames, as_pair, check_finite, chunk_size, edges_of, read

Normaliser = Literal["speed", "diagonal"]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Sted:
    """The spatio-temporal edge difference and its two parts, all dimensionless.

    Attributes
    ----------
    value : float
        √(spatial² + c² temporal²).
    spatial, temporal : float
        Means of the local deviations; `spatial` is 0 without edges, `temporal` is 0 for fewer than
        three frames.
    spatial_per_frame : (F,) float64
    temporal_per_frame : (F - 1,) float64
        Entry t is for the virtual edges from frame t to frame t + 1.
    neighbourhood, window, dt, c, signed
        Parameters of the call.
    normaliser : float
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
    neighbourhood: int
    window: int
    dt: float
    c: float
    normaliser: float
    signed: bool

    __repr__ = short_repr


def sted(
    reference: Frames,
    other: Frames,
    faces: ArrayLike | None = None,
    *,
    neighbourhood: int = 1,
    window: int = 5,
    dt: float = 1.0,
    c: float = 1.0,
    normaliser: Normaliser | float = "speed",
    signed: bool = False,
) -> Sted:
    """Perceived difference of two animations: local changes of edge lengths in space and time.

    With l the length of an edge in the reference and l' in `other`, its relative
    difference is δ = |l − l'| / l.  The deviation over a set N of edges is

        dev(N) = √( Σ_N l (δ − δ̄)² / Σ_N l ),   δ̄ = Σ_N l δ / Σ_N l.

    The spatial part is the mean, over frames and vertices, of dev(edges near the
    vertex in that frame).  The temporal part is the mean, over frames and vertices,
    of dev(virtual edges in time), which lead from p_i^t to p_i^{t+1} and have the
    length √(‖p_i^{t+1} − p_i^t‖² / s² + dt²), within a window of frames around t.

    Parameters
    ----------
    reference, other : MeshSequence, Skinning, a result that has one, or (F, V, 3) array
    faces : (T, 3) int array, optional
        Triangles; those of the sequences by default.
    neighbourhood : int
        An edge is near a vertex if one of its ends is less than this number of
        edges away; 1 takes the edges at the vertex.
    window : int
        Odd number of virtual edges, centred at t and clipped at both ends of the sequence.
    dt : float
        Length of the virtual edge of a vertex that does not move, in units of s.  The smaller it
        is, the more do changes of slow motions count.
    c : float
        Weight of the temporal part.
    normaliser : {"speed", "diagonal"} or float
        s, in the mesh's units: the mean length of a vertex's step from frame to frame in the
        reference, the reference's diagonal, or a number.  For a reference that never moves, the
        diagonal replaces the speed.
    signed : bool
        Use δ = (l − l') / l instead of its absolute value, which is the same for an edge that
        stretches and one that shrinks by the same share.

    Returns
    -------
    Sted

    Raises
    ------
    InputError
        If shapes differ or an argument is not usable.

    Notes
    -----
    The spatial part does not change if the frames of either animation are moved rigidly, each in
    its own way.  Neither part changes if all frames are moved by the same rigid motion, or if both
    animations are scaled alike (unless the normaliser is a number).  An edge of length 0 in the
    reference has weight 0.  Vertices without edges are left out of the spatial part.

    The paper states no parameters, so compare only values of this function with equal parameters.

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
    neighbourhood = check_whole(neighbourhood, "neighbourhood", 1)
    window = check_whole(window, "window", 1)
    if window % 2 == 0:
        raise InputError("window", "an odd number", window)
    _check_number("dt", dt, positive=True)
    _check_number("c", c, positive=False)
    signed = check_flag(signed, "signed")
    with np.errstate(over="ignore", invalid="ignore"):
        scale = _normaliser(first, normaliser)
        check_finite(first, second, scale)
        spatial, spatial_frames = _spatial(first, second, neighbourhood, signed)
        temporal, temporal_frames = _temporal(first, second, window, dt, scale, signed)
    value = math.hypot(spatial, c * temporal)
    check_finite(first, second, value)
    return Sted(
        value=value,
        spatial=spatial,
        temporal=temporal,
        spatial_per_frame=spatial_frames,
        temporal_per_frame=temporal_frames,
        neighbourhood=neighbourhood,
        window=window,
        dt=float(dt),
        c=float(c),
        normaliser=scale,
        signed=signed,
    )


def _spatial(
    first: MeshSequence, second: MeshSequence, neighbourhood: int, signed: bool
) -> tuple[float, NDArray[np.float64]]:
    edges = edges_of(first, second)
    per_frame = np.zeros(first.n_frames)
    if len(edges) == 0:
        return 0.0, per_frame
    near = _edges_near(edges, first.n_vertices, neighbourhood)
    starts, members = near.indptr[:-1].astype(np.intp), near.indices
    counts = np.diff(near.indptr)
    begin, end = edges[:, 0], edges[:, 1]

    def work(_: int, start: int, stop: int) -> None:
        a, b = read(first, start, stop), read(second, start, stop)
        length = _norm(a[:, end] - a[:, begin])
        delta = _relative(length, _norm(b[:, end] - b[:, begin]), signed)
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
    first: MeshSequence, second: MeshSequence, window: int, dt: float, scale: float, signed: bool
) -> tuple[float, NDArray[np.float64]]:
    count, half = first.n_frames - 1, window // 2
    per_frame = np.zeros(count)
    if count < 2:
        return 0.0, per_frame

    def work(_: int, start: int, stop: int) -> None:
        low, high = max(0, start - half), min(count, stop + half)
        length, other = (
            np.sqrt(_norm(np.diff(read(x, low, high + 1), axis=0) / scale) ** 2 + dt**2)
            for x in (first, second)
        )
        delta = _relative(length, other, signed)
        for t in range(start, stop):
            inside = slice(max(0, t - half) - low, min(count, t + half + 1) - low)
            weight = length[inside]
            total = weight.sum(axis=0)
            mean = (weight * delta[inside]).sum(axis=0) / total
            square = (weight * (delta[inside] - mean) ** 2).sum(axis=0) / total
            per_frame[t] = np.sqrt(square).mean()

    step = max(half, chunk_size(first, 6 * first.n_vertices), 1)
    run_chunks(work, chunk_bounds(count, step))
    return float(per_frame.mean()), per_frame


def _edges_near(edges: NDArray[np.int32], n_vertices: int, neighbourhood: int) -> csr_array:
    """Incidence matrix with a column per edge, and a row per vertex that has edges.

    The ones of a row are at the edges near the vertex.
    """
    n_edges = len(edges)
    columns = np.repeat(np.arange(n_edges), 2)
    touch = csr_array((np.ones(2 * n_edges), (edges.ravel(), columns)), (n_vertices, n_edges))
    step = eye_array(n_vertices, format="csr") + (touch @ touch.T)
    reach = touch
    for _ in range(neighbourhood - 1):
        reach = csr_array(step @ reach)
        reach.data[:] = 1.0
    return csr_array(reach[np.diff(touch.indptr) > 0])


def _normaliser(reference: MeshSequence, normaliser: Normaliser | float) -> float:
    if isinstance(normaliser, str):
        if normaliser not in get_args(Normaliser):
            raise InputError("normaliser", "'speed', 'diagonal' or a number > 0", repr(normaliser))
        speed = 0.0
        if normaliser == "speed" and reference.n_frames > 1:
            step = chunk_size(reference)
            for start in range(0, reference.n_frames - 1, step):
                block = read(reference, start, start + step + 1)
                speed += float(_norm(np.diff(block, axis=0)).sum())
            speed /= (reference.n_frames - 1) * reference.n_vertices
        return speed or reference.diagonal() or 1.0
    _check_number("normaliser", normaliser, positive=True)
    return float(normaliser)


def _relative(
    length: NDArray[np.float64], other: NDArray[np.float64], signed: bool
) -> NDArray[np.float64]:
    change = length - other
    if not signed:
        np.abs(change, out=change)
    return np.divide(change, length, out=np.zeros_like(change), where=length > 0)


def _norm(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.sqrt(np.einsum("...c,...c->...", vectors, vectors)))


def _check_number(argument: str, value: object, *, positive: bool) -> None:
    if is_real(value) and 0 <= float(value) < LARGEST and (value > 0 or not positive):
        return
    expected = f"a number {'> 0' if positive else '>= 0'}, less than {LARGEST:g}"
    raise InputError(argument, expected, repr(value))
