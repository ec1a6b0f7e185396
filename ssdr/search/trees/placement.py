"""Places of joints, the tree of bones that they connect, and bones moved onto their joints.

The joint of two bones a, b is the point c of the rest pose that minimises the gap
Σ_t |M_a c − M_b c|².  If the bones do not rotate relative to each other, or only about one axis, c
is not determined, and the joint is put where the skin of the bones meets.  Bones that were fitted
freely have large gaps in any tree.  A penalty on the gaps closes them: it is made stiffer step by
step, while bones, joints and weights are solved in turns.

References
----------
Le and Deng, "Robust and accurate skeletal rigging from mesh sequences", 2014 (joints as points
that two bones move alike).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from ...kernels.chains import chain_move
from ...model.tree import Tree, root_at_centroids
from ...solver.alternation import sweep, vertex_step
from ...solver.model import Constraints, Model
from ...solver.moments import bone_sums
from ...solver.objective import normal_length
from ...solver.trajectories import Array, Trajectories

# Weights, per frame, of what an edge costs beside its gap: the joint's squared distance from the
# contact of its bones, which decides where motion does not, and the squared distance of their skin.
_AWAY, _APART = 1e-3, 1e-2
_TIE = 1e-6  # factor of both weights if they are only to decide between equal gaps
# Largest distance of the skin and gap of the joint of bones that may be connected, in the mesh's
# size (its root mean square distance from the centroid).  Three pairs, of which one must hold: for
# touching skin, for skin nearby, and for skin that moves together.  Nearby is as far as from one
# ring of vertices to the next on a game character (the tail of glTF's fox: 0.37).
_DISTANCES, _GAPS = (0.1, 0.5, np.inf), (np.inf, 0.1, 0.03)
_STAY = 1e-4  # weight, per frame, of a joint's squared move, which decides what gaps leave open
_SWEEPS = 3
_MEMBER = 0.5  # weight from which a vertex belongs to a bone
_TOUCH = 12  # number of nearest vertices of two bones whose mean is their contact
_SHARED = 1e-3  # overlap of weights from which the shared weights place the contact instead


def fit_joints(transforms: Array, prior: Array, *, away: float = _AWAY) -> tuple[Array, Array]:
    """Fit a joint to every pair of bones, so that its gap is smallest.

    Parameters
    ----------
    transforms : (F, B, 3, 4) array
    prior : (B, B, 3) array
        Positions that decide where the motion leaves a joint open.
    away : float
        Weight, per frame, of the squared distance from `prior`.

    Returns
    -------
    points : (B, B, 3) array
        The joints c.
    gaps : (B, B) array
        Σ_t |M_a c − M_b c|² of each joint.
    """
    n_frames, n_bones = transforms.shape[:2]
    rotation, shift = transforms[..., :3], transforms[..., 3]
    stack = rotation.transpose(0, 2, 1, 3).reshape(3 * n_frames, 3 * n_bones)
    both = (stack.T @ stack).reshape(n_bones, 3, n_bones, 3).transpose(0, 2, 1, 3)
    matrix = 2.0 * n_frames * np.eye(3) - both - both.transpose(0, 1, 3, 2)
    moved = shift.transpose(0, 2, 1).reshape(3 * n_frames, n_bones)
    cross = (stack.T @ moved).reshape(n_bones, 3, n_bones).transpose(0, 2, 1)  # Σ R_aᵀ T_b
    index = np.arange(n_bones)
    own = cross[index, index]
    right = cross + cross.transpose(1, 0, 2) - own[:, None] - own[None]
    square = moved.T @ moved
    distance_squares = square[index, index][:, None] + square[index, index] - 2.0 * square
    pull = away * n_frames
    points = np.linalg.solve(matrix + pull * np.eye(3), (right + pull * prior)[..., None])[..., 0]
    gaps = np.einsum("abi,abij,abj->ab", points, matrix, points)
    gaps += distance_squares - 2.0 * np.einsum("abi,abi->ab", points, right)
    return points, np.maximum(gaps, 0.0)


def fit_joint(model: Model, a: int, b: int, prior: Array) -> tuple[Array, float]:
    """The joint (3,) of two bones that :func:`fit_joints` fits, and its gap."""
    points, gaps = fit_joints(model.transforms[:, [a, b]], np.broadcast_to(prior, (2, 2, 3)))
    return points[0, 1], float(gaps[0, 1])


@dataclasses.dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of every two bones: where and how closely their skin meets.

    Attributes
    ----------
    points : (B, B, 3) array
        A point between the vertices that the two bones move.
    distances : (B, B) array
        Distance between the skin of the two bones; 0 if one of them moves nothing.
    overlap : (B, B) array
        Overlap of their weights, Σ_i w_ia w_ib / sqrt(Σ_i w_ia² · Σ_i w_ib²).
    """

    points: Array
    distances: Array
    overlap: Array


def find_contacts(model: Model) -> Contacts:
    """Find the contacts of every two bones.

    Bones whose weights overlap meet at the vertices that they share, other bones at their nearest
    vertices.
    """
    n_bones, weights = model.n_bones, model.dense_weights()
    overlap = weights.T @ weights
    places = np.einsum("ia,ib,id->abd", weights, weights, model.rest, optimize=True)
    most = weights.max(axis=0)
    members = [
        model.rest[weights[:, j] >= min(_MEMBER, 0.9 * most[j])] if most[j] > 0 else model.rest
        for j in range(n_bones)
    ]
    trees = [cKDTree(points) for points in members]
    point, apart = np.zeros((n_bones, n_bones, 3)), np.zeros((n_bones, n_bones))
    for a in range(n_bones):
        for b in range(a):
            to_b, to_a = (np.asarray(trees[k].query(members[j])[0]) for j, k in ((a, b), (b, a)))
            of_a = np.argsort(to_b, kind="stable")[:_TOUCH]
            of_b = np.argsort(to_a, kind="stable")[:_TOUCH]
            meeting = 0.5 * (members[a][of_a].mean(axis=0) + members[b][of_b].mean(axis=0))
            if overlap[a, b] > _SHARED:
                meeting = places[a, b] / overlap[a, b]
            point[a, b] = point[b, a] = meeting
            if most[a] > 0 and most[b] > 0:
                apart[a, b] = apart[b, a] = np.sort(to_b)[max(0, len(to_b) // 20 - 1)]
    own = np.sqrt(np.maximum(np.diag(overlap), 1e-12))
    return Contacts(point, apart, overlap / own[:, None] / own[None])


def spanning_tree(
    model: Model, *, by_gap: bool = False, parts: NDArray[np.intp] | None = None
) -> Tree:
    """Find the minimum spanning tree over the bones, where an edge costs the gap of its joint.

    Gaps are weighted by the masses of their bones.  If parts of the mesh are far apart and move
    independently, the result is a forest.

    Parameters
    ----------
    model : Model
    by_gap : bool
        Whether costs are gaps alone, without masses; contacts then decide between equal gaps.
    parts : (V,) int array, optional
        Connected part of the mesh of each vertex, or None if all are in one.  Bones of different
        parts are not connected because their skin touches, but only if a joint is possible.
    """
    meet = find_contacts(model)
    n_frames = len(model.transforms)
    point, gap = fit_joints(model.transforms, meet.points, away=_TIE if by_gap else _AWAY)
    mass = model.bone_masses()
    away = ((point - meet.points) ** 2).sum(axis=-1)
    extra = n_frames * (_AWAY * away + _APART * meet.distances**2)
    if by_gap:
        cost = gap + _TIE * extra
    else:
        pair = mass[:, None] * mass / np.maximum(mass[:, None] + mass, 1e-12)
        cost = pair * (gap + extra)
    connected = meet.overlap > 0
    for distance, gap_size in zip(_DISTANCES, _GAPS, strict=True):
        near = (meet.distances <= distance) & (gap <= gap_size**2 * n_frames)
        if parts is not None and gap_size == np.inf:
            index = np.unique(parts, return_inverse=True)[1]
            member = np.zeros((model.n_bones, index.max() + 1), dtype=bool)
            member[model.indices[:, 0], index] = True
            near &= member @ member.T
        connected |= near
    _, group = connected_components(connected, directed=False)
    # SciPy treats costs below 1e-8 as no edge, so ranks replace costs: only their order matters
    above = np.triu_indices(model.n_bones, 1)
    order = np.zeros_like(cost)
    order[above] = 1 + cost[above].argsort(kind="stable").argsort()
    edges = minimum_spanning_tree(order * (group[:, None] == group)).toarray() > 0
    parents = root_at_centroids(edges | edges.T, mass)
    index = np.arange(model.n_bones)
    points = np.where((parents >= 0)[:, None], point[index, np.maximum(parents, 0)], 0.0)
    return Tree(parents, np.ascontiguousarray(points), rigid=False)


def step_with_joint_penalty(
    data: Trajectories, model: Model, stiffness: float, constraints: Constraints
) -> None:
    """Solve bones under a penalty on their joints' gaps, then joints, then vertices (in place).

    The penalty on a squared gap is `stiffness` times the mass of the lighter bone.
    """
    tree = model.hierarchy
    u, c = bone_sums(data, model, length=normal_length(data, model))
    mass = model.bone_masses()
    for j in tree.non_roots:
        k = tree.parents[j]
        place = np.append(tree.points[j], 1.0)
        # 1e-9 holds bones together that move nothing
        block = (stiffness * min(mass[j], mass[k]) + 1e-9) * np.outer(place, place)
        u[j, j] += block
        u[k, k] += block
        u[j, k] -= block
        u[k, j] -= block
    sweep(model.transforms, u, c, sweeps=_SWEEPS)
    if not constraints.lock_joints:
        model.tree = refit_joints(model.transforms, tree)
    vertex_step(data, model, constraints=constraints)


def refit_joints(transforms: Array, tree: Tree) -> Tree:
    """A copy of the tree with the joints of smallest gaps.

    Where the motion leaves a joint open, the new position is the one nearest to the old.
    """
    points = tree.points.copy()
    for j in tree.non_roots:
        relative = transforms[:, j] - transforms[:, tree.parents[j]]
        rotation, shift = relative[..., :3], relative[..., 3]
        stay = _STAY * len(rotation)
        matrix = np.einsum("tab,tac->bc", rotation, rotation) + stay * np.eye(3)
        right = stay * points[j] - np.einsum("tab,ta->b", rotation, shift)
        points[j] = np.linalg.solve(matrix, right)
    return dataclasses.replace(tree, points=points, rigid=False)


def move_onto_joints(transforms: Array, tree: Tree) -> None:
    """Translate every bone so that the gap of its joint closes (in place)."""
    still = np.zeros((*transforms.shape[:2], 3))
    chain_move(transforms, tree.order, tree.parents, tree.points, still, still)


def snap_to_joints(data: Trajectories, model: Model, constraints: Constraints) -> None:
    """Translate every bone so that the gap of its joint closes, then solve the vertices (in place).

    Rotations are kept.
    """
    tree = model.hierarchy
    move_onto_joints(model.transforms, tree)
    model.tree = dataclasses.replace(tree, rigid=True)
    vertex_step(data, model, constraints=constraints)
