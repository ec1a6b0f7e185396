"""Fewer bones, and bones in better places: merging down and re-seeding."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .initialization import fit_patches
from .model import Fixed, Model, bone_costs, bone_step, vertex_step
from .skinning import BoneModel
from .trajectories import Array, Trajectories

__all__ = ["alternate", "merge_step", "reseed_step"]

_CANDIDATES = 32  # places where a new bone is tried by their error alone
_CHEAPEST = 3  # bones that may be given up


def alternate(data: Trajectories, model: Model, count: int, fixed: Fixed) -> None:
    """`count` alternations of bones, weights and rest pose (in place)."""
    for _ in range(count):
        bone_step(data, model, fixed=fixed)
        vertex_step(data, model, fixed=fixed)


def merge_step(
    data: Trajectories, model: Model, bones: int, alternations: int, fixed: Fixed
) -> Model:
    """Give up the cheapest third of the bones beyond `bones`, then alternate."""
    excess = model.n_bones - bones
    cost = _costs(data, model, fixed)
    drop = np.argsort(cost, kind="stable")[: max(1, -(-excess // 3))]
    smaller = model.without(drop)
    vertex_step(data, smaller, fixed=fixed)
    alternate(data, smaller, alternations, fixed)
    return smaller


def reseed_step(
    data: Trajectories,
    model: Model,
    rng: np.random.Generator,
    alternations: int,
    fixed: Fixed,
) -> Model | None:
    """Move one of the cheapest bones to where the error is; None if nothing could move.

    The new bone is the Kabsch fit of the neighbourhood, of V/2B vertices, that
    holds the most error.  The caller keeps the outcome only if it is better.
    """
    n, bones = data.n_vertices, model.n_bones
    error = model.error * data.importance
    total = float(error.sum())
    cost = _costs(data, model, fixed)
    order = np.argsort(cost, kind="stable")
    free = order[np.isfinite(cost[order])]
    if not total > 0 or len(free) == 0:
        return None
    drop = free[int(rng.integers(min(_CHEAPEST, len(free))))]
    seeds = rng.choice(n, size=min(_CANDIDATES, n), p=error / total)
    size = min(n, max(4, n // (2 * bones)))
    _, near = cKDTree(model.rest).query(model.rest[seeds], k=size)
    near = np.asarray(near).reshape(len(seeds), size)
    members = near[error[near].sum(axis=1).argmax()]
    smaller = model.without(np.array([drop]))
    grown = with_patch(data, smaller, members, fixed.bone_model)
    vertex_step(data, grown, fixed=fixed)
    alternate(data, grown, alternations, fixed)
    return grown


def with_patch(
    data: Trajectories, model: Model, members: NDArray[np.intp], bone_model: BoneModel = "rigid"
) -> Model:
    """A copy with one bone more, that moves `members` as they move themselves."""
    label = np.full(data.n_vertices, -1, dtype=np.intp)
    label[members] = 0
    grown = model.with_bone(fit_patches(data, model.rest, label, 1, bone_model)[:, 0])
    grown.support[members] = 0
    grown.share[members] = 0.0
    grown.support[members, 0] = grown.n_bones - 1
    grown.share[members, 0] = 1.0
    grown.count[members] = 1
    return grown


def _costs(data: Trajectories, model: Model, fixed: Fixed) -> Array:
    cost = bone_costs(data, model)
    if fixed.bones is not None:
        # all bones that the caller gave: locked ones are known by their place among them
        cost[: len(fixed.bones)] = np.inf
    return cost
