"""The state that the solver's steps pass on, and the steps themselves in array form."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from .affine import leap_rigid, solve_affine
from .kernels.frames import bone_moments, sweep_bones
from .kernels.vertices import removal_cost, solve_vertices
from .parallel import chunk_bounds, run_chunks, serial_blas
from .skinning import BoneModel
from .trajectories import Array, Trajectories

__all__ = ["Fixed", "Model", "bone_costs", "bone_step", "bone_sums", "vertex_step"]

SLOTS = 12  # size of the unpruned support that stays warm
CHUNK = 512  # vertices a task
_MOMENT_TASKS = 16
_PAIR = np.array([[0, 3, 4, 6], [3, 1, 5, 7], [4, 5, 2, 8], [6, 7, 8, 9]])


@dataclasses.dataclass(eq=False)
class Model:
    """Transforms, rest pose and weights in normalised space; arrays are updated in place."""

    transforms: Array  # (F, B, 3, 4)
    rest: Array  # (V, 3)
    support: NDArray[np.int32]  # (V, SLOTS)
    share: Array  # (V, SLOTS)
    count: NDArray[np.int32]  # (V,)
    joints: NDArray[np.int32]  # (V, K)
    weights: Array  # (V, K)
    error: Array  # (V,) squared error of joints, weights, rest, transforms

    @property
    def n_bones(self) -> int:
        return int(self.transforms.shape[1])

    @property
    def n_influences(self) -> int:
        return int(self.joints.shape[1])

    def copy(self) -> Model:
        return Model(**{f.name: getattr(self, f.name).copy() for f in dataclasses.fields(self)})

    @staticmethod
    def start(transforms: Array, rest: Array, label: NDArray[np.intp], influences: int) -> Model:
        """One bone a vertex."""
        n = len(rest)
        slots = max(SLOTS, influences)
        support = np.zeros((n, slots), dtype=np.int32)
        share = np.zeros((n, slots))
        joints = np.zeros((n, influences), dtype=np.int32)
        weights = np.zeros((n, influences))
        support[:, 0] = joints[:, 0] = label
        share[:, 0] = weights[:, 0] = 1.0
        return Model(
            transforms=transforms, rest=rest.copy(), support=support, share=share,
            count=np.ones(n, dtype=np.int32), joints=joints, weights=weights,
            error=np.full(n, np.inf),
        )  # fmt: skip

    def objective(self, data: Trajectories) -> float:
        return float(data.importance @ self.error)

    def widen(self) -> None:
        """Let the unpruned support restart from the kept weights."""
        k = self.n_influences
        self.support[:] = 0
        self.share[:] = 0.0
        self.support[:, :k] = self.joints
        self.share[:, :k] = self.weights
        self.count[:] = np.maximum((self.weights > 0).sum(axis=1), 1)

    def widened(self) -> Model:
        """A copy whose unpruned support restarts from the kept weights."""
        model = self.copy()
        model.widen()
        return model

    def with_influences(self, count: int) -> Model:
        """A copy with room for `count` influences a vertex, the largest kept where they were more.

        The error is that of before.
        """
        k = self.n_influences
        joints, weights = self.joints, self.weights
        if count < k:
            # in the order they stand, and to the bit where nothing is lost
            largest = np.sort(np.argsort(-weights, axis=1, kind="stable")[:, :count], axis=1)
            joints = np.take_along_axis(joints, largest, axis=1)
            weights = np.take_along_axis(weights, largest, axis=1)
            total = weights.sum(axis=1, keepdims=True)
            lost = np.count_nonzero(weights, axis=1) < np.count_nonzero(self.weights, axis=1)
            weights = np.where(lost[:, None], weights / total, weights)
        room = ((0, 0), (0, max(0, count - k)))
        wide = ((0, 0), (0, max(0, count - self.support.shape[1])))
        model = Model(
            transforms=self.transforms.copy(), rest=self.rest.copy(),
            support=np.pad(self.support, wide), share=np.pad(self.share, wide),
            count=self.count.copy(),
            joints=np.ascontiguousarray(np.pad(joints, room)),
            weights=np.ascontiguousarray(np.pad(weights, room)),
            error=self.error.copy(),
        )  # fmt: skip
        model.widen()
        return model

    def without(self, bones: NDArray[np.intp]) -> Model:
        """A copy that has lost some bones; vertices keep what is left of their support."""
        keep = np.setdiff1d(np.arange(self.n_bones), bones)
        rank = np.full(self.n_bones, -1, dtype=np.int32)
        rank[keep] = np.arange(len(keep))
        slots = np.arange(self.support.shape[1])
        share = np.where(slots < self.count[:, None], self.share, 0.0)
        share[rank[self.support] < 0] = 0.0
        order = np.argsort(-share, axis=1, kind="stable")
        share = np.take_along_axis(share, order, axis=1)
        support = np.take_along_axis(np.maximum(rank[self.support], 0), order, axis=1)
        empty = share[:, 0] <= 0
        share[empty, 0] = 1.0
        support[empty, 0] = 0
        count = np.maximum((share > 0).sum(axis=1), 1).astype(np.int32)
        share /= share.sum(axis=1, keepdims=True)
        support[share <= 0] = 0
        k = self.n_influences
        weights = share[:, :k] / share[:, :k].sum(axis=1, keepdims=True)
        return Model(
            transforms=np.ascontiguousarray(self.transforms[:, keep]), rest=self.rest.copy(),
            support=np.ascontiguousarray(support, dtype=np.int32), share=share, count=count,
            # a copy also where all of the support is kept: steps write to both
            joints=np.array(support[:, :k], dtype=np.int32, order="C"), weights=weights,
            error=self.error.copy(),
        )  # fmt: skip

    def with_bone(self, transform: Array) -> Model:
        """A copy with one bone more, (F, 3, 4), that nothing uses yet."""
        grown = self.copy()
        grown.transforms = np.ascontiguousarray(
            np.concatenate([self.transforms, transform[:, None]], axis=1)
        )
        return grown


@dataclasses.dataclass(frozen=True, eq=False)
class Fixed:
    """What a caller wants left alone, and what bones may do."""

    rest: bool = False
    weights: NDArray[np.bool_] | None = None  # (V,) vertices whose weights stay
    bones: NDArray[np.bool_] | None = None  # (B,) bones whose transforms stay
    bone_model: BoneModel = "rigid"

    def keep_weights(self, n: int) -> NDArray[np.bool_]:
        return np.zeros(n, dtype=bool) if self.weights is None else self.weights

    def locked(self, n: int) -> NDArray[np.bool_]:
        if self.bones is None:
            return np.zeros(n, dtype=bool)
        return np.concatenate([self.bones, np.zeros(n - len(self.bones), dtype=bool)])


FREE = Fixed()


def gram_tables(gram: Array, n_bones: int) -> tuple[Array, Array]:
    """G = hatᵀhat (4B, 4B) as (B, 10, B) coefficients and as (B, B, 4, 4) blocks."""
    g = gram.reshape(4, n_bones, 4, n_bones)
    blocks = np.ascontiguousarray(g.transpose(1, 3, 0, 2))
    table = np.empty((n_bones, 10, n_bones))
    for d in range(4):
        for e in range(d, 4):
            both = g[d, :, e] if d == e else g[d, :, e] + g[e, :, d]
            table[:, _PAIR[d, e]] = both
    return table, blocks


def transform_sums(data: Trajectories, transforms: Array) -> tuple[Array, Array, Array, Array]:
    """What every vertex needs of the transforms.

    The stacked matrix (3F, 4B), both tables of :func:`gram_tables`, and Qᵀ times the matrix.
    """
    hat = data.hat(transforms)
    gram, gram4 = gram_tables(hat.T @ hat, transforms.shape[1])
    return hat, gram, gram4, data.reduce(hat)


def vertex_step(
    data: Trajectories,
    model: Model,
    *,
    fixed: Fixed = FREE,
    pull: Array | None = None,
    stiff: Array | None = None,
) -> None:
    """Weights, then rest pose, then the error, of every vertex (in place)."""
    n_bones = model.n_bones
    keep = fixed.keep_weights(data.n_vertices)
    with serial_blas():
        _, gram, _, reduced = transform_sums(data, model.transforms)
        pairs = np.ascontiguousarray(gram.transpose(0, 2, 1))
        none, none1 = np.zeros((0, 0)), np.zeros(0)

        def work(_: int, i: int, k: int) -> None:
            y = (data.z[i:k] @ reduced).reshape(k - i, 4, n_bones)
            solve_vertices(
                y, data.x2[i:k], gram, pairs,
                none if pull is None else pull[i:k], none1 if stiff is None else stiff[i:k],
                model.rest[i:k], model.support[i:k], model.share[i:k], model.count[i:k],
                model.joints[i:k], model.weights[i:k], model.error[i:k],
                keep[i:k], not fixed.rest, 0, k - i,
            )  # fmt: skip

        run_chunks(work, chunk_bounds(data.n_vertices, CHUNK))
    # differences of large numbers: what is below rounding is zero
    np.maximum(model.error, 0.0, out=model.error)


def bone_sums(
    data: Trajectories,
    joints: NDArray[np.int32],
    weights: Array,
    rest: Array,
    n_bones: int,
) -> tuple[Array, Array]:
    """Σ w_j w_k p̃p̃ᵀ as (B, B, 4, 4) and Σ v w_j p̃ of every frame as (F, 3, 4, B)."""
    n = data.n_vertices
    bounds = chunk_bounds(n, max(CHUNK, -(-n // _MOMENT_TASKS)))
    r = data.z.shape[1]

    def work(_: int, i: int, k: int) -> tuple[Array, Array]:
        u = np.zeros((n_bones, n_bones, 10))
        az = np.zeros((4, n_bones, r))
        bone_moments(
            joints[i:k], weights[i:k], rest[i:k], data.importance[i:k], data.z[i:k], u, az, 0, k - i
        )
        return u, az

    parts = run_chunks(work, bounds)
    u, az = parts[0]
    for more_u, more_az in parts[1:]:
        u += more_u
        az += more_az
    lower = np.tril_indices(n_bones, -1)
    u[lower] = u[lower[1], lower[0]]
    with serial_blas():
        c = data.expand(az)
    return np.ascontiguousarray(u[:, :, _PAIR]), c


def neighbours(u: Array) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Which bones share vertices, as compressed rows."""
    shared = u[:, :, 3, 3] > 0
    np.fill_diagonal(shared, False)
    start = np.concatenate([[0], np.cumsum(shared.sum(axis=1))]).astype(np.int32)
    return start, np.nonzero(shared)[1].astype(np.int32)


def bone_step(
    data: Trajectories, model: Model, *, sweeps: int = 3, fixed: Fixed = FREE, leaps: int = 0
) -> tuple[Array, Array]:
    """Transforms of every frame under the weights and rest pose (in place); returns the sums.

    Gauss–Seidel sweeps over the bones where they are rotations, scaled or not;
    one linear solve for all bones of all frames where they are affine.  `leaps`,
    each with its sweeps, are for rigid bones that may be far from where they belong.
    """
    u, c = bone_sums(data, model.joints, model.weights, model.rest, model.n_bones)
    locked = fixed.locked(model.n_bones)
    if fixed.bone_model == "affine":
        solve_affine(model.transforms, u, c, locked)
        return u, c
    start, neighbour = neighbours(u)
    scaled = fixed.bone_model == "similarity"
    work_size = max(1, -(-data.n_frames // 16))

    def work(_: int, i: int, k: int) -> None:
        sweep_bones(
            model.transforms[i:k], c[i:k], u, start, neighbour, locked, scaled, sweeps, 0, k - i
        )

    for k in range(max(1, leaps)):
        if k < leaps and not scaled:
            leap_rigid(model.transforms, u, c, locked)
        run_chunks(work, chunk_bounds(data.n_frames, work_size))
    return u, c


def bone_costs(data: Trajectories, model: Model) -> Array:
    """(B,) how much the objective would rise, to first order, without each bone."""
    n_bones = model.n_bones
    with serial_blas():
        _, gram, _, reduced = transform_sums(data, model.transforms)

        def work(_: int, i: int, k: int) -> Array:
            cost = np.zeros(n_bones)
            y = (data.z[i:k] @ reduced).reshape(k - i, 4, n_bones)
            removal_cost(
                y, data.x2[i:k], gram, model.rest[i:k], model.support[i:k], model.share[i:k],
                model.count[i:k], data.importance[i:k], cost, 0, k - i,
            )  # fmt: skip
            return cost

        parts = run_chunks(work, chunk_bounds(data.n_vertices, CHUNK))
    return np.asarray(np.sum(parts, axis=0))
