"""A small fitted model with dense Jacobians by finite differences, for tests of the polish."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

import ssdr
from helpers import motions
from ssdr.solver.alternation import vertex_step
from ssdr.solver.model import FREE, Fixed, Model
from ssdr.solver.polish import Polish
from ssdr.solver.trajectories import Trajectories, gather

__all__ = ["Tiny"]


class Tiny:
    """A small fitted model, its residual as a function of all unknowns, and the Jacobian."""

    def __init__(self, seed: int = 0, *, fixed: Fixed = FREE, importance: bool = True) -> None:
        rng = np.random.default_rng(seed)
        self.n, self.bones, self.frames, self.k = 8, 3, 4, 3
        rest = rng.standard_normal((self.n, 3))
        indices, weights = motions.weights_of(rng, self.n, self.bones, self.k)
        truth = motions.motions(rng, self.frames, self.bones)
        frames = motions.blend(rest, indices, weights, truth)
        frames += 0.1 * rng.standard_normal(frames.shape)
        self.data: Trajectories = gather(
            [ssdr.MeshSequence(frames)],
            bones=99,
            vertex_importance=0.5 + rng.random(self.n) if importance else None,
            frame_importance=0.5 + rng.random(self.frames) if importance else None,
        )
        assert self.data.q is None
        inner, start = self.data.from_world(rest, truth)
        assert start is not None
        start[..., 3] += 0.05 * rng.standard_normal(start[..., 3].shape)
        self.model = Model.start(start, inner, indices[:, 0].astype(np.intp), self.k)
        self.model.indices[:], self.model.weights[:] = indices, weights
        self.model.restart_support()
        self.fixed = fixed
        vertex_step(self.data, self.model, fixed=fixed)
        self.polish = Polish(self.data, self.model, fixed=fixed, conjugate_steps=2000)

    def freedoms(self) -> list[tuple[int, int]]:
        """(vertex, variable): weights of the support but the first, then x, y, z."""
        keep = self.fixed.keep_weights(self.n)
        out = []
        for i in range(self.n):
            used = int((self.model.weights[i] > 0).sum())
            out += [(i, q) for q in range(1, used) if not keep[i]]
            if not self.fixed.rest:
                out += [(i, -c) for c in (3, 2, 1)]
        return out

    def residual(self, tangents: np.ndarray, vertex: np.ndarray) -> np.ndarray:
        x = tangents.reshape(self.frames, self.bones, 6)
        turn = Rotation.from_rotvec(x[..., :3].reshape(-1, 3)).as_matrix()
        m = self.model.transforms
        moved = np.empty_like(m)
        moved[..., :3] = m[..., :3] @ turn.reshape(self.frames, self.bones, 3, 3)
        moved[..., 3] = m[..., 3] + np.einsum("tjab,tjb->tja", m[..., :3], x[..., 3:])
        rest, weights = self.model.rest.copy(), self.model.weights.copy()
        for value, (i, variable) in zip(vertex, self.freedoms(), strict=True):
            if variable > 0:
                weights[i, variable] += value
                weights[i, 0] -= value
            else:
                rest[i, variable] += value
        inner = np.stack([self.data.frame(t) for t in range(self.frames)])
        gap = motions.blend(rest, self.model.indices, weights, moved) - inner
        gap *= np.sqrt(self.data.importance)[None, :, None]
        gap *= self.data.frame_scale[:, None, None]
        return gap.ravel()

    def jacobians(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residual and its derivatives by the tangents and by the vertices' freedoms."""
        m0, v0 = np.zeros(self.frames * self.bones * 6), np.zeros(len(self.freedoms()))
        step = 1e-5

        def column(k: int, first: bool) -> np.ndarray:
            e = np.zeros(len(m0 if first else v0))
            e[k] = step
            if first:
                return (self.residual(e, v0) - self.residual(-e, v0)) / (2 * step)
            return (self.residual(m0, e) - self.residual(m0, -e)) / (2 * step)

        j_m = np.stack([column(k, True) for k in range(len(m0))], axis=1)
        if len(v0) == 0:
            return self.residual(m0, v0), j_m, np.zeros((len(j_m), 0))
        j_v = np.stack([column(k, False) for k in range(len(v0))], axis=1)
        return self.residual(m0, v0), j_m, j_v
