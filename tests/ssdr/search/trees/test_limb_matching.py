"""Free bones matched with those of a skeleton, against all ways of matching them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import ssdr
from helpers import motions, trees
from ssdr.model.tree import Tree
from ssdr.search.trees.limb_matching import limb_distances, match_by_motion, matched_bones
from ssdr.solver.trajectories import gather


def _tree(parents) -> Tree:
    return Tree(np.asarray(parents), np.zeros((len(parents), 3)), rigid=False)


def _cost(own, place, gap, tree) -> float:
    """The sum, bone by bone and joint by joint."""
    total = sum(place[j, bone] for bone, j in enumerate(own) if j >= 0)
    for edge, bone in enumerate(tree.non_roots):
        a, b = own[bone], own[tree.parents[bone]]
        total += gap[edge, a, b] if a >= 0 and b >= 0 else 0.0
    return float(total)


def test_twins_are_told_apart_by_their_joints() -> None:
    # Two legs equally near to two limbs; each stays with the hip on its own side.
    tree = _tree([-1, -1, 0, 1])
    place = np.full((4, 4), 9.0)
    place[[0, 1], [0, 1]] = 0.0
    place[2:, 2:] = 1.0
    gap = np.full((2, 4, 4), 5.0)
    gap[0, 3, 0] = gap[1, 2, 1] = 0.0
    assert matched_bones(place, gap, tree).tolist() == [0, 1, 3, 2]


@pytest.mark.parametrize("seed", range(8))
def test_no_change_of_two_costs_less_and_places_alone_are_matched_best(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = _tree([-1, 0, 1, 1, 0])
    place, gap = rng.random((5, 5)), rng.random((4, 5, 5))
    own = matched_bones(place, gap, tree)
    assert sorted(own.tolist()) == list(range(5))
    least = _cost(own, place, gap, tree)
    for a, b in itertools.combinations(range(5), 2):
        other = own.copy()
        other[[a, b]] = other[[b, a]]
        assert _cost(other, place, gap, tree) >= least - 1e-12
    best = min(_cost(way, place, 0 * gap, tree) for way in itertools.permutations(range(5)))
    alone = matched_bones(place, 0 * gap, tree)
    assert _cost(alone, place, 0 * gap, tree) == pytest.approx(best)


def test_bones_too_few_or_too_many() -> None:
    tree = _tree([-1, 0, 1])
    place = np.array([[0.0, 5.0, 5.0], [5.0, 5.0, 0.0]])
    assert matched_bones(place, np.zeros((2, 2, 2)), tree).tolist() == [0, -1, 1]
    assert sorted(matched_bones(np.eye(5)[:, :3], np.zeros((2, 5, 5)), tree).tolist())[0] >= 0


def test_vertices_go_where_they_move_not_to_the_nearest_limb() -> None:
    made = trees.skeleton(9, 40, seed=2)
    own = made.indices[:, 0]
    data = gather([ssdr.MeshSequence(made.frames)], bones=9)
    rest, _ = motions.in_solver(data, made.rest, made.transforms)
    points, _ = motions.in_solver(data, made.points, made.transforms)
    shuffled = np.random.default_rng(0).permutation(9)
    tree = Tree(made.parents, points, rigid=False)
    found = match_by_motion(data, rest, shuffled[own].astype(np.intp), 9, tree)
    assert np.array_equal(found, own)


def test_limbs_end_at_children_and_go_on_beyond_the_last() -> None:
    arm = Tree(np.array([-1, 0, 1]), np.array([[0.0, 0, 0], [2, 0, 0], [3, 0, 0]]), rigid=False)
    points = np.array([[0.5, 1, 0], [1.9, 0.1, 0], [2.4, 1, 0], [3.6, 0, 0], [9, 0, 0]])
    assert limb_distances(points, arm).argmin(axis=1).tolist() == [0, 0, 1, 2, 2]
    alone = Tree(np.array([-1]), np.zeros((1, 3)), rigid=False)
    assert limb_distances(points, alone).argmin(axis=1).tolist() == [0] * 5
