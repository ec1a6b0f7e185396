"""Normals of a model with shapes: those of the rest pose, and the vectors that each shape adds."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.parallel import chunk_bounds, run_chunks, serial_blas
from ..mesh.normals import NormalHolders, corner_normals, normal_holders, surface_normals
from .shapes import ShapedSkinning

Array = NDArray[np.float64]
_NUMBERS = 1 << 22  # in an array of a task

_PULL = 1e-3  # towards the initial normals, relative to the sum of squared amounts
_LEAST = 1e-6  # norm of a fitted normal: a smaller one has no direction
_MOST = 500  # frames that normals are fitted to


@dataclasses.dataclass(frozen=True, eq=False)
class ShapedNormals:
    """Normals of a rest pose, and the vectors that shapes add to them.

    Attributes
    ----------
    corner : (T, 3) int32
        Index of the normal at each triangle corner.
    rest : (N, 3) float64
        Unit normals.
    added : (S, N, 3) float64
    """

    corner: NDArray[np.int32]
    rest: Array
    added: Array


def shaped_normals(face: ShapedSkinning) -> ShapedNormals:
    """Fit rest normals n, and a vector d_s added by each shape, to the model's deformed surface.

    With a_t the amounts in frame t, an engine shades with A_t (n + Σ_s a_ts d_s), normalised, where
    A_t is the blended 3×3 matrix.  At triangles that shapes move, n and d are fitted by least
    squares to the normals of the model's surface in at most 500 frames, evenly spaced.  Elsewhere n
    is the model's own normal, and d is 0.  Where the frames leave d_s undetermined, it is the
    change that shape s makes to the rest surface's normal.
    """
    model, shapes, faces = face.skinning, face.shapes, face.faces
    holders = normal_holders(faces, model.n_vertices, model.surface)
    rest, count = np.asarray(model.rest, dtype=np.float64), len(holders.vertex)
    own = None if model.surface is None else model.surface.normals
    given = corner_normals(rest, faces, None) if own is None else own
    start = surface_normals(np.concatenate([rest[None], rest + shapes.displacements]), holders)
    start -= start[:1]
    start[0, holders.corner] = given
    reached = np.zeros((len(shapes), count), dtype=bool)
    for s in range(len(shapes)):
        touched = np.flatnonzero(np.any(shapes.displacements[s], axis=1))
        reached[s, holders.corner[np.isin(faces, touched).any(axis=1)]] = True
    found = np.concatenate([start[:1], np.where(reached[..., None], start[1:], 0.0)])
    frames = np.linspace(0, model.n_frames - 1, min(_MOST, model.n_frames)).astype(int)
    targets = _targets(face, frames, holders)
    solved = fit_vectors(
        face,
        frames,
        targets,
        vertex=holders.vertex,
        used=np.concatenate([np.any(reached, axis=0, keepdims=True), reached]),
        start=start,
        pull=_PULL,
        known=np.any(targets, axis=2),
    )
    size = np.linalg.norm(solved[0], axis=1)
    fitted = np.flatnonzero(reached.any(axis=0) & (size > _LEAST))
    found[:, fitted] = solved[:, fitted] / size[fitted, None]
    return ShapedNormals(holders.corner, found[0], found[1:])


def _targets(face: ShapedSkinning, frames: NDArray[np.int64], holders: NormalHolders) -> Array:
    """Normals ``(f, N, 3)`` of the model's deformed surface in some frames."""
    out = np.empty((len(frames), len(holders.vertex), 3))
    for k, frame in enumerate(frames):
        out[k] = surface_normals(face.skin([frame], dtype=np.float64), holders)[0]
    return out


@serial_blas()
def fit_vectors(
    face: ShapedSkinning,
    frames: NDArray[np.int64],
    goal: Array,
    *,
    vertex: NDArray[np.integer],
    used: NDArray[np.bool_],
    start: Array,
    pull: float,
    known: NDArray[np.bool_] | None = None,
) -> Array:
    """Fit vectors ``(1 + S, N, 3)``: x in the rest pose, and d_s, which shape s adds to x.

    With a_t the amounts in frame t, and A_t the blended 3×3 matrix of a point, A_t (x + Σ_s a_ts
    d_s) comes as close to the goals as it can: Σ_t |A_t (x + Σ_s a_ts d_s) − g_t|² is least.

    Parameters
    ----------
    face : ShapedSkinning
        Of its shapes only the amounts are used.
    frames : (f,) int array
    goal : (f, N, 3) array
    vertex : (N,) int array
        Index of the vertex whose matrix A_t each point has.
    used : (1 + S, N) bool array
        Which vectors each point has; the others are 0.
    start : (1 + S, N, 3) array
        Values of the vectors that the goals do not determine.
    pull : float
        Weight of the distance from `start`, relative to the sum of squared amounts.
    known : (f, N) bool array, optional
        Whether a goal is known; all by default.
    """
    model, amounts = face.skinning, face.shapes.amounts
    factors = np.concatenate([np.ones((len(frames), 1)), amounts[frames]], axis=1)
    squares = (factors**2).sum(axis=0)
    pulls = pull * np.where(squares > 0, squares, 1.0)
    transforms = np.asarray(model.transforms, dtype=np.float64)[frames]
    turns = transforms[..., :3].swapaxes(0, 1).reshape(model.n_bones, -1)
    weights = model.sparse_weights().astype(np.float64)
    # points with equally many vectors lie together, so that few are solved for in vain
    counts = used.sum(axis=0)
    order = np.argsort(counts, kind="stable")[np.count_nonzero(counts == 0) :]
    found = np.zeros(start.shape)

    def work(_: int, i: int, k: int) -> None:
        some = order[i:k]
        width = int(counts[some].max())
        which = np.argsort(~used[:, some], axis=0, kind="stable")[:width].T
        real = np.take_along_axis(used[:, some].T, which, axis=1)
        turn: Any = (weights[vertex[some]] @ turns).reshape(len(some), -1, 3, 3)
        if known is not None:
            turn = np.where(known[:, some].T[..., None, None], turn, 0.0)
        back = turn.swapaxes(2, 3)
        own = factors.T[which] * real[..., None]
        pairs = (own[:, :, None] * own[:, None]).reshape(len(some), width * width, -1)
        grams = (pairs @ (back @ turn).reshape(len(some), -1, 9)).reshape(-1, width, width, 3, 3)
        system = grams.swapaxes(2, 3).reshape(len(some), 3 * width, 3 * width)
        system += np.repeat(pulls[which], 3, axis=1)[..., None] * np.eye(3 * width)
        begin = start[which, some[:, None]] * real[..., None]
        right = own @ (back @ goal[:, some].swapaxes(0, 1)[..., None])[..., 0]
        right += pulls[which, None] * begin
        solved = np.linalg.solve(system, right.reshape(len(some), -1, 1)).reshape(begin.shape)
        found[which[real], np.repeat(some, width).reshape(-1, width)[real]] = solved[real]

    most = int(counts.max(initial=1)) ** 2 * max(len(frames), 9)
    run_chunks(work, chunk_bounds(len(order), max(1, _NUMBERS // most)))
    return found
