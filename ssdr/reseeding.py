"""Bones in better places: merging down, re-seeding, influences to spare, search around a model."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .initialization import fit_patches
from .model import Fixed, Model, bone_costs, bone_step, vertex_step
from .skinning import BoneModel
from .stretching import normalise_gauge, polish_of
from .trajectories import Array, Trajectories

__all__ = [
    "alternate",
    "grow_and_shed",
    "kick",
    "loosen",
    "merge_step",
    "polish_steps",
    "relax",
    "reseed_step",
    "tighten",
]

_CANDIDATES = 32  # places where a new bone is tried by their error alone
_CHEAPEST = 3  # bones that may be given up
_MOST_KICKS, _MOST_GROWN, _MOST_LOOSENED = 5, 3, 2
_FEWEST_STEPS = 3  # of the polish at each number of influences
_PATCH_SIZES = (0.25, 0.5, 1.0)  # of the vertices that a bone has on average


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
    if not float(data.importance @ model.error) > 0:
        return None
    cost = _costs(data, model, fixed)
    order = np.argsort(cost, kind="stable")
    free = order[np.isfinite(cost[order])]
    if len(free) == 0:
        return None
    drop = free[int(rng.integers(min(_CHEAPEST, len(free))))]
    members = _worst_patch(data, model, rng, 0.5)
    smaller = model.without(np.array([drop]))
    grown = with_patch(data, smaller, members, fixed.bone_model)
    vertex_step(data, grown, fixed=fixed)
    alternate(data, grown, alternations, fixed)
    return grown


def kick(data: Trajectories, model: Model, rng: np.random.Generator, fixed: Fixed) -> Model:
    """A copy after a few alternations, which keep the largest weights whether that pays or not."""
    moved = model.copy()
    moved.widen()
    for _ in range(int(rng.integers(1, _MOST_KICKS + 1))):
        bone_step(data, moved, fixed=fixed)
        vertex_step(data, moved, fixed=fixed)
        normalise_gauge(moved, data.importance, fixed)
    return moved


def grow_and_shed(
    data: Trajectories, model: Model, rng: np.random.Generator, fixed: Fixed
) -> Model:
    """A copy that got up to three bones more, settled, and gave up as many again.

    Bones change places so that a single exchange would not find: the new ones
    have taken over what they can before it is asked which can go.
    """
    grown = model.copy()
    grown.widen()
    count = int(rng.integers(1, _MOST_GROWN + 1))
    for _ in range(count):
        members = _worst_patch(data, grown, rng, float(rng.choice(_PATCH_SIZES)))
        grown = with_patch(data, grown, members, fixed.bone_model)
        vertex_step(data, grown, fixed=fixed)
    alternate(data, grown, 3, fixed)
    polish_steps(data, grown, 3, fixed)
    for _ in range(count):
        grown.widen()
        vertex_step(data, grown, fixed=fixed)
        cost = _costs(data, grown, fixed)
        grown = grown.without(np.argsort(cost, kind="stable")[:1])
        vertex_step(data, grown, fixed=fixed)
        alternate(data, grown, 2, fixed)
    return grown


def relax(data: Trajectories, model: Model, fixed: Fixed, *, extra: int, steps: int) -> Model:
    """A copy that got `extra` influences more, settled, and gave them up one by one.

    Which bones move a vertex matters more than how, and with few influences each choice
    bars the others: the objective has many poor minima.  It has fewer with more
    influences, and the bones that serve those are most of the way to good ones.
    `steps` of the polish are taken at each number of influences above the model's.
    """
    most = min(model.n_influences + extra, model.n_bones)
    relaxed = model.with_influences(most)
    for _ in range(most - model.n_influences):
        relaxed = tighten(data, relaxed, fixed, steps=steps)
    return relaxed


def tighten(data: Trajectories, model: Model, fixed: Fixed, *, steps: int) -> Model:
    """`steps` of the polish (in place), then a copy with one influence a vertex less."""
    polish_steps(data, model, steps, fixed)
    smaller = model.with_influences(model.n_influences - 1)
    # solved on all bones, of which the largest weights stay
    vertex_step(data, smaller, fixed=fixed)
    return smaller


def loosen(data: Trajectories, model: Model, rng: np.random.Generator, fixed: Fixed) -> Model:
    """A copy that had one or two influences more for a while."""
    extra = int(rng.integers(1, _MOST_LOOSENED + 1))
    steps = int(rng.integers(_FEWEST_STEPS, 2 * _FEWEST_STEPS + 1))
    return relax(data, model, fixed, extra=extra, steps=steps)


def polish_steps(data: Trajectories, model: Model, count: int, fixed: Fixed) -> None:
    """`count` steps of the polish (in place), every third of which lets bones enter."""
    polish = polish_of(data, model, fixed=fixed)
    for k in range(count):
        polish.step(entering=3 if k % 3 == 0 else 0)
    normalise_gauge(model, data.importance, fixed)


def _worst_patch(
    data: Trajectories, model: Model, rng: np.random.Generator, share: float
) -> NDArray[np.intp]:
    """The neighbourhood of `share`·V/B vertices that holds the most error, of some drawn by it."""
    n = data.n_vertices
    # drawn by their place in the order of motion, so that numbering plays no part
    order = np.argsort(data.x2, kind="stable")
    error = model.error * data.importance
    total = float(error.sum())
    chance = None if not total > 0 else error[order] / total
    seeds = order[rng.choice(n, size=min(_CANDIDATES, n), p=chance)]
    size = min(n, max(4, int(share * n / model.n_bones)))
    _, near = cKDTree(model.rest).query(model.rest[seeds], k=size)
    near = np.asarray(near).reshape(len(seeds), size)
    return np.asarray(near[error[near].sum(axis=1).argmax()])


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
