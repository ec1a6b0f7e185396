"""A small fitted model with dense Jacobians by finite differences, for tests of Gauss–Newton."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

import ssdr
from helpers import motions, terms
from helpers.stretches import stretched
from ssdr.model.transforms import parents_first
from ssdr.model.tree import Tree
from ssdr.search.trees.placement import snap_to_joints
from ssdr.solver.alternation import vertex_step
from ssdr.solver.gauss_newton import GaussNewton
from ssdr.solver.initialization import with_rest_normals
from ssdr.solver.model import FREE, Constraints, Model
from ssdr.solver.objective import normal_length, rest_strength
from ssdr.solver.rest_surface import RestSurface
from ssdr.solver.trajectories import Trajectories, gather

_SOME, _ALL = np.arange(8) % 2 == 0, np.ones(8, dtype=bool)
CASES = {
    "free": FREE,
    "rest": Constraints(lock_rest=True),
    "weights": Constraints(weights=_SOME),
    "all weights": Constraints(weights=_ALL),
    "rest and weights": Constraints(lock_rest=True, weights=_ALL),
    "joints": Constraints(lock_joints=True),
    "motion alone": Constraints(lock_rest=True, weights=_ALL, lock_joints=True),
}
KINDS = {"rigid": 6, "similarity": 7, "affine": 12}  # unknowns of a bone
TREES = {"tree": [1, -1, 1], "forest": [-1, 0, -1], "roots alone": [-1, -1, -1]}


class Tiny:
    """A small fitted model, its residual as a function of all unknowns, and the Jacobian.

    `kind` is a bone model or a tree's name, `more` says what there is beyond positions: a "surface"
    that the rest pose resembles, "normals", a "slack" beside them.
    """

    n, bones, frames, k = 8, 3, 4, 3

    def __init__(
        self, kind: str = "rigid", case: str = "free", more: str = "", seed: int = 3
    ) -> None:
        rng = np.random.default_rng(seed)
        self.kind, tree = kind, TREES.get(kind)
        rest = rng.standard_normal((self.n, 3))
        indices, weights = motions.weights_of(rng, self.n, self.bones, self.k)
        truth = motions.motions(rng, self.frames, self.bones)
        if kind in ("similarity", "affine"):
            truth = stretched(truth, kind, amount=0.2)
        frames = motions.blend(rest, indices, weights, truth)
        frames += 0.1 * rng.standard_normal(frames.shape)
        self.data: Trajectories = gather(
            [ssdr.MeshSequence(frames, (np.arange(self.n)[:, None] + np.arange(3)) % self.n)],
            bones=99,
            vertex_importance=0.5 + rng.random(self.n),
            frame_importance=0.5 + rng.random(self.frames),
        )
        assert self.data.q is None
        inner, start = motions.in_solver(self.data, rest, truth)
        start[..., 3] += 0.05 * rng.standard_normal(start[..., 3].shape)
        self.model = Model.with_weights(start, inner, indices, weights, self.k)
        model_of = "rigid" if tree else kind
        self.constraints = dataclasses.replace(CASES[case], bone_model=model_of)  # type: ignore[arg-type]
        vertex_step(self.data, self.model, constraints=self.constraints)
        if tree:
            points = np.random.default_rng(5).normal(size=(3, 3))
            self.model.tree = Tree(np.array(tree, dtype=np.int64), points, rigid=False)
            snap_to_joints(self.data, self.model, self.constraints)
        if "surface" in more:
            pose = inner + 0.3 * rng.standard_normal(inner.shape)
            surface = RestSurface.build(self.data.faces, pose)
            self.data = dataclasses.replace(self.data, surface=surface)
        if "normals" in more:
            inner = np.stack([self.data.frame(t) for t in range(self.frames)])
            self.truth = terms.frame_normals(inner, self.data.faces)
            self.data = self.data.with_normals()
            self.model = with_rest_normals(self.data, self.model)
        if "slack" in more:
            self.data = dataclasses.replace(self.data, slack=self.model.weighted_error(self.data))
        self.newton = self.gauss_newton()
        if more:  # once more, so that pulls and length are those of the model
            self.newton = self.gauss_newton(damping=self.newton.damping)

    def gauss_newton(self, **options: object) -> GaussNewton:
        """Gauss–Newton whose conjugate gradients go on until they are exact."""
        newton = GaussNewton(self.data, self.model, constraints=self.constraints, **options)  # type: ignore[arg-type]
        newton.tangent.conjugate_steps = 3000
        return newton

    @property
    def unknowns(self) -> int:
        """How many the tangent has."""
        tree = self.model.tree
        if tree is None:
            return self.frames * self.bones * KINDS[self.kind]
        joints = 0 if self.constraints.lock_joints else len(tree.non_roots)
        return 3 * (self.frames * (self.bones + len(tree.roots)) + joints)

    def shaped(self, x: np.ndarray) -> np.ndarray:
        """Unknowns as the tangent takes them."""
        return x if self.model.tree else x.reshape(self.frames, self.bones, -1)

    def moved(self, x: np.ndarray) -> np.ndarray:
        """Transforms after a step."""
        m = self.model.transforms
        if self.model.tree is not None:
            return self._moved_chain(x)
        x = x.reshape(self.frames, self.bones, -1)
        if self.kind == "affine":
            return m + x.reshape(m.shape)
        out = m.copy()
        out[..., :3] = m[..., :3] @ _rotations(x[..., :3])
        out[..., 3] += np.einsum("tjab,tjb->tja", m[..., :3], x[..., 3:6])
        if self.kind == "similarity":
            out[..., :3] *= np.exp(x[..., 6])[..., None, None]
        return out

    def _moved_chain(self, x: np.ndarray) -> np.ndarray:
        """Forward kinematics of a tree."""
        tree, out = self.model.tree, self.model.transforms.copy()
        points = tree.points.copy()
        size = 3 * (self.bones + len(tree.roots))
        of_frames = x[: self.frames * size].reshape(self.frames, size)
        if not self.constraints.lock_joints:
            points[tree.non_roots] += x[self.frames * size :].reshape(-1, 3)
        turns = _rotations(of_frames[:, : 3 * self.bones].reshape(self.frames, self.bones, 3))
        shifts = of_frames[:, 3 * self.bones :].reshape(self.frames, -1, 3)
        for j in parents_first(tree.parents):
            k = tree.parents[j]
            old = out[:, j, :, :3].copy()
            out[:, j, :, :3] = old @ turns[:, j]
            if k < 0:
                shift = shifts[:, list(tree.roots).index(j)]
                out[:, j, :, 3] += np.einsum("tab,tb->ta", old, shift)
            else:
                at = out[:, k, :, :3] @ points[j] + out[:, k, :, 3]
                out[:, j, :, 3] = at - out[:, j, :, :3] @ points[j]
        return out

    def freedoms(self) -> list[tuple[int, int]]:
        """(vertex, variable): weights of the support but the first, rest position, normal."""
        keep = self.constraints.vertex_mask(self.n)
        out = []
        for i in range(self.n):
            used = int((self.model.weights[i] > 0).sum())
            out += [(i, q) for q in range(1, used) if not keep[i]]
            if not self.constraints.lock_rest:
                out += [(i, -c) for c in (3, 2, 1)]
            if self.data.normals is not None:
                out += [(i, -c) for c in (6, 5, 4)]
        return out

    def residual(self, x: np.ndarray, vertex: np.ndarray) -> np.ndarray:
        rest, weights = self.model.rest.copy(), self.model.weights.copy()
        normals, length = self.model.normals.copy(), normal_length(self.data, self.model)
        for value, (i, variable) in zip(vertex, self.freedoms(), strict=True):
            if variable > 0:
                weights[i, variable] += value
                weights[i, 0] -= value
            elif variable >= -3:
                rest[i, variable] += value
            else:
                normals[i, 0, variable + 3] += value / length
        inner = np.stack([self.data.frame(t) for t in range(self.frames)])
        moves = self.moved(x)
        gaps = [motions.blend(rest, self.model.indices, weights, moves) - inner]
        if self.data.normals is not None:
            turns = np.concatenate([moves[..., :3], np.zeros((*moves.shape[:3], 1))], axis=-1)
            turned = motions.blend(normals[:, 0], self.model.indices, weights, turns)
            gaps.append(length * (turned - self.truth))
        root = np.sqrt(self.data.importance)[:, None]
        rows = [root * gap * self.data.frame_scale[:, None, None] for gap in gaps]
        strength = rest_strength(self.data, self.model, self.constraints)
        if strength > 0:
            rows.append(np.sqrt(strength) * self._changed_edges(rest))
        return np.concatenate([row.ravel() for row in rows])

    def _changed_edges(self, rest: np.ndarray) -> np.ndarray:
        """Changes of all edges, times the roots of their weights."""
        surface = self.data.surface
        moved, weights = rest - surface.pose, surface.edges.toarray()
        i, j = np.nonzero(np.triu(weights))
        return np.sqrt(weights[i, j])[:, None] * (moved[i] - moved[j])

    def jacobians(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residual, and its derivatives by the bones' unknowns and the vertices' freedoms."""
        n_m, n_v, step = self.unknowns, len(self.freedoms()), 1e-5
        r = self.residual(np.zeros(n_m), np.zeros(n_v))
        columns = np.zeros((n_m + n_v, len(r)))
        for j, e in enumerate(step * np.eye(n_m + n_v)):
            ends = [self.residual(s * e[:n_m], s * e[n_m:]) for s in (1, -1)]
            columns[j] = (ends[0] - ends[1]) / (2 * step)
        return r, columns[:n_m].T, columns[n_m:].T


def _rotations(vectors: np.ndarray) -> np.ndarray:
    turns = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix()
    return turns.reshape(*vectors.shape, 3)
