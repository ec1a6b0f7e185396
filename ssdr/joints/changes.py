"""Changes of a model whose bones hang on joints: other edges, other bones.

Each gives a copy that hangs on its joints again and waits to be polished and judged.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial import cKDTree

from ..hierarchy.tree import Tree
from ..search.moves import patch_of_most_error, polish_steps
from ..solver.alternation import bone_costs, vertex_step
from ..solver.initialization import fit_patches
from ..solver.model import Fixed, Model
from ..solver.trajectories import Array, Trajectories
from .mirror import edges_with_image, mirror_of
from .placement import (
    contacts,
    hang,
    joint_between,
    masses,
    pair_joints,
    soft_step,
)

__all__ = [
    "add_edge_between_skin_neighbours",
    "attach_by_stiffness",
    "mirror_edge",
    "move_bone_to_error",
    "removal_losses",
    "remove_cheapest_bone",
    "reparent",
    "replace_bone",
    "split_bone",
]

_HARD = 100.0  # stiffness at the end of a ramp, of the lighter bone's mass: next to no gap is left
_MOST_JOINED = 3  # edges that change at once, drawn from 1 to this
_SOFTEST, _STIFFEST = -2.5, 0.0  # powers of ten between which a ramp begins, drawn
_RAMP = 10  # steps of a ramp after a change
_CHEAPEST = 12  # edges, by the gap that they would have, among which a change draws
_WEAKEST = 0.7  # how often the edge that goes is the one whose bones share least
_PATCH_SIZES = (0.25, 0.5, 1.0)  # of the vertices that a bone has on average


def attach_by_stiffness(
    data: Trajectories, model: Model, fixed: Fixed, *, start: float, steps: int
) -> None:
    """Bring bones to their joints by a ramp of stiffness, then hang them (in place)."""
    for stiffness in np.geomspace(start, _HARD, steps):
        soft_step(data, model, float(stiffness), fixed)
    hang(data, model, fixed)


def add_edge_between_skin_neighbours(
    data: Trajectories, model: Model, rng: np.random.Generator, fixed: Fixed
) -> Model:
    """Connect two bones that share weights and drop one edge of the resulting cycle."""
    changed = model.with_restarted_support()
    for _ in range(int(rng.integers(1, _MOST_JOINED + 1))):
        tree = _tree(changed)
        meet = contacts(changed)
        chance = np.triu(meet.overlap, 1)
        hung = tree.hung
        chance[hung, tree.parents[hung]] = chance[tree.parents[hung], hung] = 0.0
        if not chance.sum() > 0:
            break
        n = changed.n_bones
        a, b = divmod(int(rng.choice(n * n, p=chance.ravel() / chance.sum())), n)
        up, down = tree.way(a, b)
        edges = sorted(up + down, key=lambda k: (meet.overlap[k, tree.parents[k]], k))
        edge = edges[0] if rng.random() < _WEAKEST else edges[int(rng.integers(len(edges)))]
        point, _ = joint_between(changed, a, b, meet.point[a, b])
        a, b = (a, b) if edge in up else (b, a)
        changed.tree = tree.rehung(edge, a, b, point)
    attach_by_stiffness(
        data, changed, fixed, start=10 ** rng.uniform(_SOFTEST, _STIFFEST), steps=_RAMP
    )
    return changed


def reparent(data: Trajectories, model: Model, rng: np.random.Generator, fixed: Fixed) -> Model:
    """One joint elsewhere, drawn by the gap that it would have there."""
    changed = model.with_restarted_support()
    tree, n = _tree(changed), changed.n_bones
    meet = contacts(changed)
    points, gap = pair_joints(changed.transforms, meet.point)
    beyond = tree.beyond(masses(changed))
    lighter = np.minimum(beyond, beyond.max() - beyond)
    ways = []
    for edge in tree.hung.tolist():
        part = tree.part(edge)
        for a in part:
            others = np.setdiff1d(np.arange(n), part)
            ways += [
                (lighter[edge] * gap[a, b], edge, a, int(b))
                for b in others
                if (a, b) != (edge, tree.parents[edge])
            ]
    if not ways:
        return changed
    ways = sorted(ways)[:_CHEAPEST]
    costs = np.array([way[0] for way in ways])
    chance = 1.0 / (costs + 0.1 * costs.mean() + 1e-300)
    _, edge, a, b = ways[int(rng.choice(len(ways), p=chance / chance.sum()))]
    changed.tree = tree.rehung(edge, a, b, points[a, b])
    attach_by_stiffness(data, changed, fixed, start=1.0, steps=4)
    return changed


def mirror_edge(data: Trajectories, model: Model, rng: np.random.Generator, fixed: Fixed) -> Model:
    """A joint that one side of a symmetric rest pose has, on the other side, too.

    An edge of the circle that this closes goes, one without a mirror image where there is one.
    Where the rest pose is not symmetric, or the tree already is, a joint goes elsewhere instead.
    """
    mirror = mirror_of(model.rest, model.indices, model.weights, model.n_bones)
    if mirror is None:
        return reparent(data, model, rng, fixed)
    changed, tree, other = model.with_restarted_support(), _tree(model), mirror.partners
    alone = [b for b, there in edges_with_image(mirror, tree.parents).items() if not there]
    if not alone:
        return reparent(data, model, rng, fixed)
    edge = alone[int(rng.integers(len(alone)))]
    a, b = int(other[edge]), int(other[tree.parents[edge]])
    up, down = tree.way(a, b)
    overlap = contacts(changed).overlap
    gone = min(up + down, key=lambda k: (k not in alone, overlap[k, tree.parents[k]], k))
    a, b = (a, b) if gone in up else (b, a)
    changed.tree = tree.rehung(gone, a, b, mirror.image(tree.points[edge]))
    attach_by_stiffness(
        data, changed, fixed, start=10 ** rng.uniform(_SOFTEST, _STIFFEST), steps=_RAMP
    )
    return changed


def move_bone_to_error(
    data: Trajectories, model: Model, rng: np.random.Generator, fixed: Fixed
) -> Model:
    """A bone near the error lets go of what it moves and takes a patch with much error instead."""
    members = patch_of_most_error(data, model, rng, float(rng.choice(_PATCH_SIZES)))
    tree = _tree(model)
    away = np.linalg.norm(tree.points - model.rest[members].mean(axis=0), axis=1)
    chance = 1.0 / (away + 0.1 * away.mean() + 1e-12) ** 2
    bone = int(rng.choice(model.n_bones, p=chance / chance.sum()))
    changed = model.with_restarted_support()
    label = np.full(data.n_vertices, -1, dtype=np.intp)
    label[members] = 0
    changed.transforms[:, bone] = fit_patches(data, model.rest, label, 1)[:, 0]
    changed.tree = dataclasses.replace(tree, rigid=False)
    free = members[~fixed.keep_weights(data.n_vertices)[members]]
    changed.support[free], changed.support_weights[free] = 0, 0.0
    changed.support[free, 0], changed.support_weights[free, 0], changed.count[free] = bone, 1.0, 1
    vertex_step(data, changed, fixed=fixed)
    attach_by_stiffness(
        data, changed, fixed, start=10 ** rng.uniform(_SOFTEST, _STIFFEST), steps=_RAMP
    )
    return changed


def replace_bone(data: Trajectories, model: Model, rng: np.random.Generator, fixed: Fixed) -> Model:
    """A bone splits where the error is, and after some polish the cheapest bone goes."""
    grown = split_bone(data, model.with_restarted_support(), rng)
    polish_steps(data, grown, int(rng.integers(3, 7)), fixed)
    return remove_cheapest_bone(data, grown, fixed)


def split_bone(
    data: Trajectories,
    model: Model,
    rng: np.random.Generator,
    *,
    leaf: bool = False,
    parent: int = -1,
) -> Model:
    """A copy with one bone more, a twin of the bone that moves a patch; no vertex moves.

    The patch is of vertices that `parent` moves most, where there is one and it moves any.

    The twin takes over the patch and, unless it shall be a `leaf`, the joints that are nearer to
    it than to the rest.
    """
    size = float(rng.choice(_PATCH_SIZES))
    main = model.indices[np.arange(data.n_vertices), model.weights.argmax(axis=1)]
    members = patch_of_most_error(data, model, rng, size, among=main == parent)
    share = np.bincount(
        model.indices[members].ravel(),
        weights=model.weights[members].ravel(),
        minlength=model.n_bones,
    )
    bone = int(share.argmax()) if parent < 0 else parent
    tree, twin = _tree(model), model.n_bones
    grown = model.with_bone(model.transforms[:, bone])
    moved = (model.indices == bone) & (model.weights > 0)
    chosen = np.zeros(data.n_vertices, dtype=bool)
    chosen[members] = True
    grown.indices[moved & chosen[:, None]] = twin
    grown.restart_support()
    patch, rest = model.rest[members], model.rest[moved.any(axis=1) & ~chosen]
    parents, points = np.append(tree.parents, bone), np.vstack([tree.points, patch.mean(axis=0)])
    if len(rest):
        away, _ = cKDTree(rest).query(patch)
        border = np.argsort(away, kind="stable")[: max(3, len(patch) // 8)]
        points[twin] = patch[border].mean(axis=0)
        for k in () if leaf else tree.neighbours(bone):
            joint = tree.joint(bone, k)
            ours, theirs = (np.linalg.norm(p.mean(axis=0) - joint) for p in (patch, rest))
            if not ours < theirs:
                continue
            if k != tree.parents[bone]:
                parents[k] = twin
            else:
                between = points[twin].copy()
                parents[twin], points[twin] = k, joint
                parents[bone], points[bone] = twin, between
    grown.tree = Tree(parents, points, rigid=True)
    return grown


def remove_cheapest_bone(data: Trajectories, model: Model, fixed: Fixed) -> Model:
    """A copy without the bone that it costs least to lose, the others hung anew."""
    losses = removal_losses(data, model)
    bone = int(np.argmin([loss.cost for loss in losses]))
    loss = losses[bone]
    smaller = model.without(np.array([bone]))
    smaller.tree = _tree(model).without(bone, loss.heir, loss.points)
    hang(data, smaller, fixed)
    return smaller


@dataclasses.dataclass(frozen=True, eq=False)
class Loss:
    """What it would cost to give up a bone.

    Attributes
    ----------
    cost : float
        Of the objective: what its vertices lose, and the gaps by which its neighbours would move.
    heir : int
        The neighbour on which the others would hang; −1 where there is none.
    points : dict
        Their joints there.
    """

    cost: float
    heir: int
    points: dict[int, Array]


def removal_losses(data: Trajectories, model: Model) -> list[Loss]:
    """For every bone the cheapest way to do without it; infinite for one without neighbours."""
    tree = _tree(model)
    mass = masses(model)
    beyond, total = tree.beyond(mass), float(mass.sum())
    losses = []
    for bone, cost in enumerate(bone_costs(data, model)):
        near = tree.neighbours(bone)
        best = Loss(np.inf, -1, {})
        for heir in near:
            price, points = float(cost), {}
            for k in near:
                if k == heir:
                    continue
                points[k], gap = joint_between(model, k, heir, tree.joint(bone, k))
                there = beyond[k] if tree.parents[k] == bone else total - beyond[bone]
                price += min(there, total - there) * gap
            if price < best.cost:
                best = Loss(price, heir, points)
        losses.append(best)
    return losses


def _tree(model: Model) -> Tree:
    assert model.tree is not None
    return model.tree
