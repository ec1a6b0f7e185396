"""Bones that stretch, scaled rotations and affine maps: their polish and their gauge."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..kernels.bones import LARGEST, SMALLEST
from .affine import admissible, flat_blocks, ridge_blocks
from .alternation import bone_step
from .chain_polish import ChainPolish
from .model import FREE, Fixed, Model
from .polish import Polish
from .recycling import Recycled
from .trajectories import Array, Trajectories

__all__ = ["AffinePolish", "SimilarityPolish", "fit_motion", "normalise_gauge", "polish_of"]

# the growth σ of a bone adds σ p to the change of p under (ω, τ)
_GROWTH = np.concatenate([np.eye(3), np.zeros((1, 3))])[:, :, None]


# Polish steps on joints in place of one leap of free bones, until one gains less than this.
_STEPS_OF_A_LEAP, _SETTLED = 3, 1e-3


class SimilarityPolish(Polish):
    """Tangents (ω, τ, σ): δM = M [[ω]× + σI, τ; 0 0]."""

    generators = np.concatenate([Polish.generators, _GROWTH], axis=2)
    precision = np.float64

    def _image(self, x: Array) -> Array:
        scale = self.data.frame_scale
        m = np.ascontiguousarray(self.model.transforms.transpose(0, 2, 3, 1))
        x = np.ascontiguousarray((x * scale[:, None, None]).transpose(2, 0, 1))[:, :, None]
        out = np.empty_like(m)
        out[:, :, 3] = 0.0
        for d in range(3):
            e, f = (d + 1) % 3, (d + 2) % 3
            out[:, :, d] = m[:, :, e] * x[f] - m[:, :, f] * x[e] + m[:, :, d] * x[6]
            out[:, :, 3] += m[:, :, d] * x[3 + d]
        return out.reshape(-1, 4 * m.shape[3])

    def _pullback(self, g: Array) -> Array:
        scale = self.data.frame_scale
        m = np.ascontiguousarray(self.model.transforms.transpose(0, 2, 3, 1))
        g = g.reshape(m.shape)
        out = np.empty((7, len(m), m.shape[3]))
        out[6] = 0.0
        for d in range(3):
            e, f = (d + 1) % 3, (d + 2) % 3
            out[d] = (m[:, :, f] * g[:, :, e] - m[:, :, e] * g[:, :, f]).sum(axis=1)
            out[3 + d] = (m[:, :, d] * g[:, :, 3]).sum(axis=1)
            out[6] += (m[:, :, d] * g[:, :, d]).sum(axis=1)
        return np.ascontiguousarray((out * scale[:, None]).transpose(1, 2, 0))

    def _move(self, transforms: Array, x: Array) -> None:
        super()._move(transforms, np.ascontiguousarray(x[..., :6]))
        size = np.linalg.norm(transforms[..., 0], axis=-1)
        grown = size * np.exp(np.clip(x[..., 6], -1.0, 1.0))
        grown = np.clip(grown, np.minimum(size, SMALLEST), np.maximum(size, LARGEST))
        grown[:, self._locked] = size[:, self._locked]
        transforms[..., :3] *= (grown / size)[..., None, None]


class AffinePolish(Polish):
    """Tangents are the twelve numbers of a transform: H_mm is the same U in every frame."""

    generators = np.zeros((4, 3, 12))  # only their number is used
    precision = np.float64

    def _image(self, x: Array) -> Array:
        n_frames, n_bones = x.shape[:2]
        return self.data.hat(x.reshape(n_frames, n_bones, 3, 4))

    def _pullback(self, g: Array) -> Array:
        n_frames, n_bones = self.model.transforms.shape[:2]
        blocks = g.reshape(n_frames, 3, 4, n_bones) * self.data.frame_scale[:, None, None, None]
        return np.ascontiguousarray(blocks.transpose(0, 3, 1, 2)).reshape(n_frames, n_bones, 12)

    def _preconditioner(
        self, u: Array
    ) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
        """The exact inverse of U + λD, and λD, with D the spread of each bone."""
        n_bones = len(u)
        metric = ridge_blocks(u, 1.0)
        index = np.arange(n_bones)
        damping = np.zeros_like(u)
        damping[index, index] = self.damping * metric
        own = np.zeros_like(u)
        own[index, index] = 1e-9 * metric
        matrix = flat_blocks(u + damping + own)
        try:
            inverse = np.linalg.inv(matrix)
        except np.linalg.LinAlgError:  # a bone that moves one point, far from the origin
            inverse = np.linalg.pinv(matrix, hermitian=True)
        inverse = 0.5 * (inverse + inverse.T)
        damped = flat_blocks(damping)
        weight = self.data.frame_scale[:, None, None] ** 2

        def times(x: Array, matrix: Array) -> Array:
            n_frames = len(x)
            flat = x.reshape(n_frames, n_bones, 3, 4).transpose(0, 2, 3, 1)
            flat = np.ascontiguousarray(flat).reshape(3 * n_frames, 4 * n_bones) @ matrix
            back = flat.reshape(n_frames, 3, 4, n_bones).transpose(0, 3, 1, 2)
            return np.ascontiguousarray(back).reshape(x.shape)

        def precondition(r: Array) -> Array:
            out = times(r, inverse) / weight
            out[:, self._locked] = 0.0
            return out

        return precondition, lambda x: times(x, damped) * weight

    def _move(self, transforms: Array, x: Array) -> None:
        step = x.reshape(transforms.shape).copy()
        step[:, self._locked] = 0.0
        moved = transforms + step
        good = admissible(transforms, moved)
        transforms[good] = moved[good]


def normalise_gauge(model: Model, importance: Array, fixed: Fixed) -> None:
    """Give bones a mean stretch of 1 (in place); no vertex moves in any frame.

    p → A p, L → L A⁻¹ changes nothing for the bones and vertices of a part that
    shares none with the rest of the mesh.  A, about the part's centroid, is the
    root of the mean LᵀL over its bones and frames (its mean size only, for scaled
    rotations), so that the rest pose has the mean size and proportions of the motion.
    """
    if fixed.bone_model == "rigid" or fixed.rest or fixed.bones is not None:
        return
    n_bones = model.n_bones
    used = model.weights > 0
    first = np.broadcast_to(model.indices[:, :1], used.shape)[used]
    links = coo_array((np.ones(len(first)), (first, model.indices[used])), shape=(n_bones, n_bones))
    count, part = connected_components(links, directed=False)
    share = importance[:, None] * model.weights
    mass = np.bincount(model.indices.ravel(), weights=share.ravel(), minlength=n_bones)
    linear, shift = model.transforms[..., :3], model.transforms[..., 3]
    stretch = np.einsum("tjca,tjcb->jab", linear, linear) / len(linear)
    for k in range(count):
        bones, mine = part == k, part[model.indices[:, 0]] == k
        if not mass[bones].sum() > 0:
            continue
        mean = np.einsum("j,jab->ab", mass[bones] / mass[bones].sum(), stretch[bones])
        if fixed.bone_model == "similarity":
            mean = np.eye(3) * np.trace(mean) / 3
        values, vectors = np.linalg.eigh(mean)
        root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))
        shape, back = (vectors * root) @ vectors.T, (vectors / root) @ vectors.T
        centre = model.rest[mine].mean(axis=0)
        old = linear[:, bones]
        new = old @ back
        shift[:, bones] += (old - new) @ centre
        linear[:, bones] = new
        model.rest[mine] = (model.rest[mine] - centre) @ shape.T + centre


def fit_motion(data: Trajectories, model: Model, *, fixed: Fixed, sweeps: int, leaps: int) -> None:
    """Bones of every frame under the weights and rest pose that there are (in place).

    Those that hang on joints turn about them, and the roots move about; joints stay.
    """
    if model.tree is None:
        bone_step(data, model, sweeps=sweeps, fixed=fixed, leaps=leaps)
        return
    every = np.ones(data.n_vertices, dtype=bool)
    as_is = dataclasses.replace(fixed, rest=True, weights=every, joints=True)
    polish = polish_of(data, model, fixed=as_is)
    for _ in range(_STEPS_OF_A_LEAP * leaps):
        before = polish.value
        if polish.step() and polish.value > (1 - _SETTLED) * before:
            break


def polish_of(
    data: Trajectories,
    model: Model,
    *,
    fixed: Fixed = FREE,
    damping: float | None = None,
    recycled: Recycled | None = None,
) -> Polish:
    """The polish of the bones that `fixed` allows, or of those that hang on joints."""
    if model.tree is not None:
        return ChainPolish(data, model, fixed=fixed, damping=damping, recycled=recycled)
    kinds = {"rigid": Polish, "similarity": SimilarityPolish, "affine": AffinePolish}
    kind = kinds[fixed.bone_model]
    return kind(data, model, fixed=fixed, damping=damping, recycled=recycled)
