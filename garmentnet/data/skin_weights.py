"""Skin weights on the body's joints, and vertices of the garment that are bound to the body.

Parts of a garment that are pinned to the body (a bodice, a waistband) are moved by its joints
alone.  Such vertices are called bound to the body; they are skinned, not predicted.  They and their
weights are found from the clips, so that a store need not state them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import ssdr
from ssdr.laplacian import LaplacianSmoother

if TYPE_CHECKING:
    from .store import ClipStore

# Largest error, metres, of skinning by the body at which a vertex counts as bound, in all frames.
_CLOSE = 1e-4
# Largest error, metres, of a vertex whose place at rest is solved for, and how often it is.  The
# error of a pin falls to an eighth in ten solves; that of other vertices soon stays.
_NEAR = 0.05
_SOLVES, _EVERY = 80, 10
_INFLUENCES = 8  # joints per vertex, as many as engines support
_FRAMES = 240  # number of frames compared, evenly spread over the clips


@dataclasses.dataclass(frozen=True, eq=False)
class BodyBound:
    """Vertices of a garment that the body's joints alone move, and their skin weights.

    Attributes
    ----------
    index : (b,) int32
        Indices of the vertices, ascending.
    rest, smooth : (b, 3) float64
        Rest positions in metres, as they are and smoothed (the low frequencies).
    indices, weights : (b, K) int32, float64
        Joints of the body that move each vertex, and their weights.
    """

    index: NDArray[np.int32]
    rest: NDArray[np.float64]
    smooth: NDArray[np.float64]
    indices: NDArray[np.int32]
    weights: NDArray[np.float64]

    def place(self, vertices: NDArray[Any], joints: Any) -> NDArray[Any]:
        """A copy of `vertices` ``(F, V, 3)`` with the bound ones skinned by joints (F, J, 3, 4)."""
        out = np.array(vertices)
        m = np.asarray(joints, np.float64)
        out[:, self.index] = ssdr.skin(self.rest, self.indices, self.weights, m)
        return out


def find_body_bound(
    store: ClipStore,
    names: Sequence[str],
    smoother: LaplacianSmoother | None = None,
    *,
    also: tuple[ArrayLike, ArrayLike] | None = None,
) -> BodyBound | None:
    """Vertices that skinning by the body reproduces within 0.1 mm; None if there are none.

    If stored vertices are rounded, the rounding error is added to the tolerance.  The place at rest
    of a vertex that nearly follows the body is solved from its motion.

    Parameters
    ----------
    store : ClipStore
    names : sequence of str
        Training clips.
    smoother : LaplacianSmoother, optional
        Smoother on the store's rest pose; without it `smooth` is `rest`.
    also : pair of arrays, optional
        Vertices ``(F, V, 3)`` and joints ``(F, J, 3, 4)`` of a clip that is not stored.
    """
    parts, step = [also] if also else [], 0.0
    for clip, here in store.sample(names, _FRAMES) if names else ():
        step = max(step, clip.step)
        parts.append((clip.sequence.frames(here), clip.joints[here]))
    truth = np.concatenate([np.asarray(v) for v, _ in parts])
    moved = np.concatenate([np.asarray(m, np.float64) for _, m in parts])
    # Rounding moves a vertex by at most half the diagonal of a cube of side `step`.
    rest, close = np.array(store.rest, np.float64), _CLOSE + math.sqrt(3) / 2 * step
    influences = min(_INFLUENCES, moved.shape[1])
    fit = ssdr.fit_weights(truth, rest, moved, influences=influences).skinning
    gap = np.linalg.norm(ssdr.skin(rest, fit.indices, fit.weights, moved) - truth, axis=2)
    joints_of, weights = np.array(fit.indices), np.array(fit.weights)
    # Where the garment at rest is a frame of the simulation, a pin's place at rest is only near.
    before = np.full(len(rest), 2 * _NEAR)
    for solve in range(_SOLVES):
        worst = gap.max(axis=0)
        if solve % _EVERY == 0:
            hopeful, before = worst < before / 2, worst
        near = np.flatnonzero((worst >= close) & hopeful)
        if not len(near):
            break
        part = truth[:, near]
        rest[near] = _rest_points(part, joints_of[near], weights[near], moved)
        fit = ssdr.fit_weights(part, rest[near], moved, influences=influences).skinning
        joints_of[near], weights[near] = fit.indices, fit.weights
        skinned = ssdr.skin(rest[near], joints_of[near], weights[near], moved)
        gap[:, near] = np.linalg.norm(skinned - part, axis=2)
    index = np.flatnonzero(gap.max(axis=0) < close).astype(np.int32)
    if not len(index):
        return None
    smooth = rest if smoother is None else np.asarray(smoother.smooth(rest[None]))[0]
    return BodyBound(
        index,
        rest[index],
        smooth[index],
        joints_of[index].astype(np.int32),
        weights[index].astype(np.float64),
    )


def _rest_points(
    truth: NDArray[Any],
    joints: NDArray[np.integer],
    weights: NDArray[np.floating],
    moved: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Rest positions ``(n, 3)`` with which skinning comes nearest to the motion (F, n, 3)."""
    found = np.empty((truth.shape[1], 3))
    for v in range(len(found)):
        blend = np.einsum("k,fkab->fab", weights[v], moved[:, joints[v]])
        target = truth[:, v] - blend[..., 3]
        found[v] = np.linalg.lstsq(blend[..., :3].reshape(-1, 3), target.ravel(), rcond=1e-6)[0]
    return found
