"""Changes of the edges and bones of a model whose bones are attached at joints.

Each change returns a copy of the model, with its bones attached to their joints again.  The caller
polishes the copy and keeps it if its objective is lower.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial import cKDTree

from ...model.tree import Tree
from ...solver.alternation import bone_costs, vertex_step
from ...solver.initialization import fit_patches
from ...solver.model import Constraints, Model
from ...solver.trajectories import Array, Trajectories
from ..moves import patch_of_most_error, polish_steps
from .mirror import edges_with_image, find_mirror
from .placement import find_contacts, fit_joint, fit_joints, snap_to_joints, step_with_joint_penalty

# Last stiffness of the joints, relative to the lighter bone's mass: it leaves next to no gap.
_HARD = 100.0
_MOST_EDGES = 3  # most edges that change at once; their number is drawn
_FIRST_STIFFNESS = -2.5, 0.0  # powers of ten between which the first stiffness is drawn
_STEPS = 10  # number of steps in which the stiffness grows after a change
_CHEAPEST = 12  # number of edges with the smallest gaps, among which a change draws one
_WEAKEST = 0.7  # probability that the dropped edge is the one whose bones share the least weights
_PATCH_SIZES = (0.25, 0.5, 1.0)  # vertex counts of a patch, relative to V/B


def attach_by_stiffness(
    data: Trajectories, model: Model, constraints: Constraints, *, start: float, steps: int
) -> None:
    """Pull bones to their joints with growing stiffness, then attach them (in place).

    The stiffness grows from `start` in `steps` steps.
    """
    for stiffness in np.geomspace(start, _HARD, steps):
        step_with_joint_penalty(data, model, float(stiffness), constraints)
    snap_to_joints(data, model, constraints)


def _attach_changed(
    data: Trajectories, model: Model, rng: np.random.Generator, constraints: Constraints
) -> None:
    """Attach the bones in ten steps from a random first stiffness (in place)."""
    start = 10 ** rng.uniform(*_FIRST_STIFFNESS)
    attach_by_stiffness(data, model, constraints, start=start, steps=_STEPS)


def add_edge_between_skin_neighbours(
    data: Trajectories, model: Model, rng: np.random.Generator, constraints: Constraints
) -> Model:
    """Connect two bones that share weights and drop one edge of the cycle, one to three times."""
    changed = model.with_restarted_support()
    for _ in range(int(rng.integers(1, _MOST_EDGES + 1))):
        tree = changed.hierarchy
        meet = find_contacts(changed)
        chance = np.triu(meet.overlap, 1)
        children = tree.non_roots
        chance[children, tree.parents[children]] = chance[tree.parents[children], children] = 0.0
        if not chance.sum() > 0:
            break
        n = changed.n_bones
        a, b = divmod(int(rng.choice(n * n, p=chance.ravel() / chance.sum())), n)
        up, down = tree.path(a, b)
        edges = sorted(up + down, key=lambda k: (meet.overlap[k, tree.parents[k]], k))
        edge = edges[0] if rng.random() < _WEAKEST else edges[int(rng.integers(len(edges)))]
        point, _ = fit_joint(changed, a, b, meet.points[a, b])
        a, b = (a, b) if edge in up else (b, a)
        changed.tree = tree.replace_edge(edge, a, b, point)
    _attach_changed(data, changed, rng, constraints)
    return changed


def reparent(
    data: Trajectories, model: Model, rng: np.random.Generator, constraints: Constraints
) -> Model:
    """Replace one edge of the tree by a random one whose joint would have a small gap."""
    changed = model.with_restarted_support()
    tree, n = changed.hierarchy, changed.n_bones
    meet = find_contacts(changed)
    points, gap = fit_joints(changed.transforms, meet.points)
    beyond = tree.subtree_sums(changed.bone_masses())
    lighter = np.minimum(beyond, beyond.max() - beyond)
    ways = []
    for edge in tree.non_roots.tolist():
        part = tree.subtree(edge)
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
    changed.tree = tree.replace_edge(edge, a, b, points[a, b])
    attach_by_stiffness(data, changed, constraints, start=1.0, steps=4)
    return changed


def mirror_edge(
    data: Trajectories, model: Model, rng: np.random.Generator, constraints: Constraints
) -> Model:
    """Add the mirror image of an edge that has none and drop one edge of the resulting cycle.

    If the cycle has edges without a mirror image, one of these is dropped.  If the rest pose is not
    symmetric, or the tree is already symmetric, :func:`reparent` is called instead.
    """
    mirror = find_mirror(model.rest, model.indices, model.weights, model.n_bones)
    if mirror is None:
        return reparent(data, model, rng, constraints)
    changed, tree, other = model.with_restarted_support(), model.hierarchy, mirror.partners
    alone = [b for b, has_image in edges_with_image(mirror, tree.parents).items() if not has_image]
    if not alone:
        return reparent(data, model, rng, constraints)
    edge = alone[int(rng.integers(len(alone)))]
    a, b = int(other[edge]), int(other[tree.parents[edge]])
    up, down = tree.path(a, b)
    overlap = find_contacts(changed).overlap
    gone = min(up + down, key=lambda k: (k not in alone, overlap[k, tree.parents[k]], k))
    a, b = (a, b) if gone in up else (b, a)
    changed.tree = tree.replace_edge(gone, a, b, mirror.image(tree.points[edge]))
    _attach_changed(data, changed, rng, constraints)
    return changed


def move_bone_to_error(
    data: Trajectories, model: Model, rng: np.random.Generator, constraints: Constraints
) -> Model:
    """Refit a bone near the patch of largest error to the patch, which it then moves alone."""
    members = patch_of_most_error(data, model, rng, float(rng.choice(_PATCH_SIZES)))
    tree = model.hierarchy
    away = np.linalg.norm(tree.points - model.rest[members].mean(axis=0), axis=1)
    chance = 1.0 / (away + 0.1 * away.mean() + 1e-12) ** 2
    bone = int(rng.choice(model.n_bones, p=chance / chance.sum()))
    changed = model.with_restarted_support()
    label = np.full(data.n_vertices, -1, dtype=np.intp)
    label[members] = 0
    changed.transforms[:, bone] = fit_patches(data, model.rest, label, 1)[:, 0]
    changed.tree = dataclasses.replace(tree, rigid=False)
    changed.assign_to_bone(members[~constraints.vertex_mask(data.n_vertices)[members]], bone)
    vertex_step(data, changed, constraints=constraints)
    _attach_changed(data, changed, rng, constraints)
    return changed


def replace_bone(
    data: Trajectories, model: Model, rng: np.random.Generator, constraints: Constraints
) -> Model:
    """Split the bone with the patch of largest error, and polish; then remove a bone.

    The removed bone is the one whose removal costs least.
    """
    grown = split_bone(data, model.with_restarted_support(), rng)
    polish_steps(data, grown, int(rng.integers(3, 7)), constraints)
    return remove_cheapest_bone(data, grown, constraints)


def split_bone(
    data: Trajectories,
    model: Model,
    rng: np.random.Generator,
    *,
    leaf: bool = False,
    parent: int = -1,
) -> Model:
    """A copy in which the bone that moves the patch of largest error is split in two.

    The new bone has the transforms of the old one, so that no vertex moves.  It takes over the
    patch.  Unless `leaf` is true, it also takes over the old bone's joints that are nearer to the
    patch than to the vertices that the old bone keeps.

    Parameters
    ----------
    leaf : bool
        Make the new bone a child without children.
    parent : int
        Index of the bone to split, from whose vertices the patch is chosen.  −1 stands for the bone
        that moves the patch most.
    """
    size = float(rng.choice(_PATCH_SIZES))
    main = model.indices[np.arange(data.n_vertices), model.weights.argmax(axis=1)]
    members = patch_of_most_error(data, model, rng, size, among=main == parent)
    skin = model.indices[members].ravel(), model.weights[members].ravel()
    share = np.bincount(*skin, minlength=model.n_bones)
    bone = int(share.argmax()) if parent < 0 else parent
    tree, twin = model.hierarchy, model.n_bones
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


def remove_cheapest_bone(data: Trajectories, model: Model, constraints: Constraints) -> Model:
    """A copy without the bone whose removal costs least.

    The neighbours of that bone are attached to one among them, its successor.  The cost is the rise
    of the objective from the bone's vertices and from closing its neighbours' gaps.
    """
    tree, mass = model.hierarchy, model.bone_masses()
    beyond, total = tree.subtree_sums(mass), float(mass.sum())
    least, bone, heir, joints = np.inf, 0, -1, {}
    for j, cost in enumerate(bone_costs(data, model).tolist()):
        for successor in tree.neighbours(j):
            points: dict[int, Array] = {}
            price = cost
            for k in tree.neighbours(j):
                if k == successor:
                    continue
                points[k], gap = fit_joint(model, k, successor, tree.joint(j, k))
                mass_beyond = beyond[k] if tree.parents[k] == j else total - beyond[j]
                price += min(mass_beyond, total - mass_beyond) * gap
            if price < least:
                least, bone, heir, joints = price, j, successor, points
    smaller = model.without(np.array([bone]))
    smaller.tree = tree.contract(bone, heir, joints)
    snap_to_joints(data, smaller, constraints)
    return smaller
