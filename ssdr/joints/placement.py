"""Joints of a model: where bones would hang on each other, and bones brought there by degrees.

A joint of two bones a, b is the rest point c that minimises Σ_t |M_a c − M_b c|².  Where their
relative turn leaves it open (none at all, or about one axis), it is where their skin meets.
Bones that were fitted freely are far from any tree: a penalty on the gaps of the joints, made
stiffer step by step while bones, weights and joints are solved in turn, leads them there.

References
----------
Le and Deng, "Robust and accurate skeletal rigging from mesh sequences", 2014 (joints as points
that two bones carry alike).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from ..hierarchy.tree import Tree, rooted
from ..kernels.chains import chain_move
from ..solver.alternation import sweep, vertex_step
from ..solver.model import Fixed, Model
from ..solver.moments import bone_sums
from ..solver.trajectories import Array, Trajectories

__all__ = [
    "Contacts",
    "contacts",
    "hang",
    "joint_between",
    "masses",
    "move_onto_joints",
    "pair_joints",
    "settled",
    "soft_step",
    "spanning_tree",
]

# Of the mesh's size squared, per frame and unit of mass: what a joint away from where two bones'
# skin meets costs (it decides where motion does not), and what skin apart costs.
_AWAY, _APART = 1e-3, 1e-2
_HARDLY = 1e-6  # of either, where gaps alone shall decide
# Of the mesh's size, the root mean square distance from its centroid: parts that are further away
# from each other than one number, and would come apart by more than the other, share no joint.
# Three pairs of them: touching parts in any case, near ones, those that move together.  Near is
# what lies a ring of a game character apart (the tail of glTF's fox: 0.37).
_FAR, _LOOSE = (0.1, 0.5, np.inf), (np.inf, 0.1, 0.03)
_STAY = 1e-4  # of a joint's place, while bones are brought to it
_SWEEPS = 3
_MEMBER = 0.5  # weight from which a vertex is of a bone
_TOUCH = 12  # nearest vertices of two bones whose mean is where they meet
_SHARED = 1e-3  # overlap of weights from which it says where bones meet


def masses(model: Model) -> Array:
    """(B,) sums of squared weights: how much a bone's motion counts."""
    squares = (model.weights**2).ravel()
    sums = np.bincount(model.indices.ravel(), weights=squares, minlength=model.n_bones)
    return np.asarray(sums, dtype=np.float64)


def pair_joints(transforms: Array, prior: Array, *, away: float = _AWAY) -> tuple[Array, Array]:
    """Best joint (B, B, 3) of every two bones, and Σ_t |M_a c − M_b c|² there (B, B).

    `prior` (B, B, 3) decides what their motion leaves open, by a penalty `away` on the squared
    distance from it.
    """
    n_frames, n_bones = transforms.shape[:2]
    turn, shift = transforms[..., :3], transforms[..., 3]
    stack = turn.transpose(0, 2, 1, 3).reshape(3 * n_frames, 3 * n_bones)
    both = (stack.T @ stack).reshape(n_bones, 3, n_bones, 3).transpose(0, 2, 1, 3)
    matrix = 2.0 * n_frames * np.eye(3) - both - both.transpose(0, 1, 3, 2)
    moved = shift.transpose(0, 2, 1).reshape(3 * n_frames, n_bones)
    cross = (stack.T @ moved).reshape(n_bones, 3, n_bones).transpose(0, 2, 1)  # Σ R_aᵀ T_b
    index = np.arange(n_bones)
    own = cross[index, index]
    right = cross + cross.transpose(1, 0, 2) - own[:, None] - own[None]
    square = moved.T @ moved
    far = square[index, index][:, None] + square[index, index] - 2.0 * square
    pull = away * n_frames
    point = np.linalg.solve(matrix + pull * np.eye(3), (right + pull * prior)[..., None])[..., 0]
    gap = np.einsum("abi,abij,abj->ab", point, matrix, point)
    gap += far - 2.0 * np.einsum("abi,abi->ab", point, right)
    return point, np.maximum(gap, 0.0)


def joint_between(model: Model, a: int, b: int, prior: Array) -> tuple[Array, float]:
    """The same of two bones."""
    point, gap = pair_joints(model.transforms[:, [a, b]], np.broadcast_to(prior, (2, 2, 3)))
    return point[0, 1], float(gap[0, 1])


@dataclasses.dataclass(frozen=True, eq=False)
class Contacts:
    """Where the bones of a model meet.

    Attributes
    ----------
    point : (B, B, 3)
        Between what two bones move.
    apart : (B, B)
        Distance of what they move.
    overlap : (B, B)
        Σ_i w_ia w_ib, relative to the root of both bones' own sums.
    """

    point: Array
    apart: Array
    overlap: Array


def contacts(model: Model) -> Contacts:
    """Where bones meet, by the weights that they share, else by their nearest vertices."""
    n_bones, n = model.n_bones, len(model.rest)
    weights = np.zeros((n, n_bones))
    for joint, weight in zip(model.indices.T, model.weights.T, strict=True):
        np.add.at(weights, (np.arange(n), joint), weight)
    overlap = weights.T @ weights
    places = np.einsum("ia,ib,id->abd", weights, weights, model.rest, optimize=True)
    most = weights.max(axis=0)
    empty = ~(most > 0)
    members = [
        model.rest[weights[:, j] >= min(_MEMBER, 0.9 * most[j])] if most[j] > 0 else model.rest
        for j in range(n_bones)
    ]
    trees = [cKDTree(points) for points in members]
    point, apart = np.zeros((n_bones, n_bones, 3)), np.zeros((n_bones, n_bones))
    for a in range(n_bones):
        for b in range(a):
            there, back = (np.asarray(trees[k].query(members[j])[0]) for j, k in ((a, b), (b, a)))
            near = np.argsort(there, kind="stable")[:_TOUCH]
            far = np.argsort(back, kind="stable")[:_TOUCH]
            meeting = 0.5 * (members[a][near].mean(axis=0) + members[b][far].mean(axis=0))
            if overlap[a, b] > _SHARED:
                meeting = places[a, b] / overlap[a, b]
            point[a, b] = point[b, a] = meeting
            if not (empty[a] or empty[b]):
                apart[a, b] = apart[b, a] = np.sort(there)[max(0, len(there) // 20 - 1)]
    own = np.sqrt(np.maximum(np.diag(overlap), 1e-12))
    return Contacts(point, apart, overlap / own[:, None] / own[None])


def spanning_tree(model: Model, *, by_gap: bool = False) -> Tree:
    """The tree over the bones that costs least: gaps of its joints, weighted by what hangs there.

    A forest, where parts are apart from each other and no joint would hold them together.
    `by_gap`: the gaps alone decide, where they differ at all.
    """
    meet = contacts(model)
    n_frames = len(model.transforms)
    point, gap = pair_joints(model.transforms, meet.point, away=_HARDLY if by_gap else _AWAY)
    mass = masses(model)
    away = ((point - meet.point) ** 2).sum(axis=-1)
    extra = n_frames * (_AWAY * away + _APART * meet.apart**2)
    if by_gap:
        cost = gap + _HARDLY * extra
    else:
        pair = mass[:, None] * mass / np.maximum(mass[:, None] + mass, 1e-12)
        cost = pair * (gap + extra)
    # SciPy takes costs below 1e-8 for no edge at all, and only their order matters
    above = np.triu_indices(model.n_bones, 1)
    order = np.zeros_like(cost)
    order[above] = 1 + cost[above].argsort(kind="stable").argsort()
    edges = minimum_spanning_tree(order).toarray() > 0
    joined = meet.overlap > 0
    for far, loose in zip(_FAR, _LOOSE, strict=True):
        joined |= (meet.apart <= far) & (gap <= loose**2 * n_frames)
    _, part = connected_components(joined, directed=False)
    edges &= part[:, None] == part
    parents = rooted(edges | edges.T, mass)
    index = np.arange(model.n_bones)
    points = np.where((parents >= 0)[:, None], point[index, np.maximum(parents, 0)], 0.0)
    return Tree(parents, np.ascontiguousarray(points), rigid=False)


def soft_step(data: Trajectories, model: Model, stiffness: float, fixed: Fixed) -> None:
    """Bones under a penalty on their joints' gaps, then joints, then vertices (in place).

    The penalty of a joint is `stiffness` times the lighter bone's mass.
    """
    tree = model.tree
    assert tree is not None
    u, c = bone_sums(data, model.indices, model.weights, model.rest, model.n_bones)
    mass = masses(model)
    for j in tree.hung:
        k = tree.parents[j]
        place = np.append(tree.points[j], 1.0)
        # a joint between bones that move nothing still holds them together
        block = (stiffness * min(mass[j], mass[k]) + 1e-9) * np.outer(place, place)
        u[j, j] += block
        u[k, k] += block
        u[j, k] -= block
        u[k, j] -= block
    sweep(model.transforms, u, c, fixed.locked(model.n_bones), sweeps=_SWEEPS)
    if not fixed.joints:
        model.tree = settled(model, tree)
    vertex_step(data, model, fixed=fixed)


def settled(model: Model, tree: Tree) -> Tree:
    """A tree with joints where the gaps are least; where motion leaves it open they stay."""
    points = tree.points.copy()
    for j in tree.hung:
        apart = model.transforms[:, j] - model.transforms[:, tree.parents[j]]
        turn, shift = apart[..., :3], apart[..., 3]
        stay = _STAY * len(turn)
        matrix = np.einsum("tab,tac->bc", turn, turn) + stay * np.eye(3)
        right = stay * points[j] - np.einsum("tab,ta->b", turn, shift)
        points[j] = np.linalg.solve(matrix, right)
    return dataclasses.replace(tree, points=points, rigid=False)


def move_onto_joints(transforms: Array, tree: Tree) -> None:
    """Move every bone onto its joint, its rotation kept (in place)."""
    still = np.zeros((*transforms.shape[:2], 3))
    chain_move(transforms, tree.order, tree.parents, tree.points, still, still, 0, len(still))


def hang(data: Trajectories, model: Model, fixed: Fixed) -> None:
    """Move every bone onto its joint, its rotation kept, then solve the vertices (in place).

    Joints whose rotation is fixed get it.
    """
    tree = model.tree
    assert tree is not None
    for j, k, turn in fixed.kept_turns(tree):
        model.transforms[:, j, :, :3] = model.transforms[:, k, :, :3] @ turn
    move_onto_joints(model.transforms, tree)
    model.tree = dataclasses.replace(tree, rigid=True)
    vertex_step(data, model, fixed=fixed)
