"""Unknowns of similarity bones: a rotation, a translation and a relative change of size."""

from __future__ import annotations

import numpy as np

from ...kernels.bones import LARGEST, SMALLEST
from ..model import Model
from ..trajectories import Array
from .rigid import GENERATORS, RigidTangent

# the generator of σ, which adds σ p to the change of p
_GROWTH = np.concatenate([np.eye(3), np.zeros((1, 3))])[:, :, None]


class SimilarityTangent(RigidTangent):
    """Unknowns x (F, B, 7): (ω, τ, σ) of each bone, with δM = M [[ω]× + σI, τ; 0 0]."""

    precision = np.float64
    generators = np.concatenate([GENERATORS, _GROWTH], axis=2)

    def image(self, x: Array) -> Array:
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

    def pullback(self, gradient: Array) -> Array:
        scale = self.data.frame_scale
        m = np.ascontiguousarray(self.model.transforms.transpose(0, 2, 3, 1))
        g = gradient.reshape(m.shape)
        out = np.empty((7, len(m), m.shape[3]))
        out[6] = 0.0
        for d in range(3):
            e, f = (d + 1) % 3, (d + 2) % 3
            out[d] = (m[:, :, f] * g[:, :, e] - m[:, :, e] * g[:, :, f]).sum(axis=1)
            out[3 + d] = (m[:, :, d] * g[:, :, 3]).sum(axis=1)
            out[6] += (m[:, :, d] * g[:, :, d]).sum(axis=1)
        return np.ascontiguousarray((out * scale[:, None]).transpose(1, 2, 0))

    def move(self, model: Model, x: Array) -> None:
        """Replace M by M exp(x), with its size kept within the allowed range (in place)."""
        super().move(model, np.ascontiguousarray(x[..., :6]))
        m = model.transforms
        size = np.linalg.norm(m[..., 0], axis=-1)
        grown = size * np.exp(np.clip(x[..., 6], -1.0, 1.0))
        grown = np.clip(grown, np.minimum(size, SMALLEST), np.maximum(size, LARGEST))
        m[..., :3] *= (grown / size)[..., None, None]
