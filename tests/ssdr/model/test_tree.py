"""Operations on trees of bones against sets of edges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssdr.model.transforms import parents_first
from ssdr.model.tree import Tree, root_at_centroids


@st.composite
def trees(draw):
    n = draw(st.integers(2, 12))
    parents = np.array([-1, *[draw(st.integers(0, b - 1)) for b in range(1, n)]])
    names = np.array(draw(st.permutations(range(n))))
    shuffled = np.empty(n, dtype=np.int64)
    shuffled[names] = np.where(parents >= 0, names[parents], -1)
    return Tree(shuffled, np.arange(3.0 * n).reshape(n, 3), rigid=True)


def _joints(tree):
    """Every joint as the two bones that it joins, and its point."""
    return {frozenset((k, int(tree.parents[k]))): tuple(tree.points[k]) for k in tree.non_roots}


def _reached(edges, first):
    seen = {first}
    while grown := {k for e in edges if e & seen for k in e} - seen:
        seen |= grown
    return seen


@given(trees(), st.data())
def test_one_edge_replaces_another(tree, data):
    edge = data.draw(st.sampled_from(tree.non_roots.tolist()))
    part = tree.subtree(edge)
    a = data.draw(st.sampled_from(part))
    b = data.draw(st.sampled_from([k for k in range(len(tree.parents)) if k not in part]))
    other = tree.replace_edge(edge, a, b, np.full(3, 7.0))
    expected = _joints(tree)
    del expected[frozenset((edge, int(tree.parents[edge])))]
    expected[frozenset((a, b))] = (7.0, 7.0, 7.0)
    assert _joints(other) == expected
    assert sorted(parents_first(other.parents).tolist()) == list(range(len(tree.parents)))
    assert not other.rigid


@given(trees(), st.data())
def test_contracting_an_edge(tree, data):
    n = len(tree.parents)
    bone = data.draw(st.integers(0, n - 1))
    near = tree.neighbours(bone)
    into = data.draw(st.sampled_from(near))
    points = {k: np.full(3, float(k)) for k in near if k != into}
    smaller = tree.contract(bone, into, points)
    rank = {k: k - (k > bone) for k in range(n)}
    expected = {
        frozenset(rank[k] for k in joint): point
        for joint, point in _joints(tree).items()
        if bone not in joint
    }
    expected |= {frozenset((rank[k], rank[into])): tuple(p) for k, p in points.items()}
    assert _joints(smaller) == expected
    assert (smaller.parents < 0).sum() == 1


@given(trees(), st.data())
def test_the_path_between_two_bones(tree, data):
    bones = st.integers(0, len(tree.parents) - 1)
    a, b = data.draw(bones), data.draw(bones)
    up, down = tree.path(a, b)
    joints = [frozenset((k, int(tree.parents[k]))) for k in up + down]
    assert len(set(joints)) == len(joints)
    assert b in _reached(joints, a)
    for gone in range(len(joints)):  # without one of them there is no way
        assert b not in _reached(joints[:gone] + joints[gone + 1 :], a) or a == b
    for k in up:
        assert a in tree.subtree(k)
        assert b not in tree.subtree(k)


@given(trees())
def test_subtrees_and_sums_over_them(tree):
    mass = np.arange(1.0, 1.0 + len(tree.parents))
    for k, total in enumerate(tree.subtree_sums(mass)):
        assert total == pytest.approx(mass[tree.subtree(k)].sum())


@given(trees(), st.integers(1, 3))
def test_a_root_balances_its_tree(tree, copies):
    n = len(tree.parents)
    mass = np.random.default_rng(n).random(n)
    edges = np.zeros((copies * n, copies * n), dtype=bool)
    for c in range(copies):
        for k in tree.non_roots:
            a, b = c * n + k, c * n + tree.parents[k]
            edges[a, b] = edges[b, a] = True
    parents = root_at_centroids(edges, np.tile(mass, copies))
    assert {frozenset((k, int(p))) for k, p in enumerate(parents) if p >= 0} == {
        frozenset(e.tolist()) for e in np.argwhere(edges)
    }
    assert (parents < 0).sum() == copies

    def heaviest(bone):
        left = [frozenset(e.tolist()) for e in np.argwhere(edges[:n, :n]) if bone not in e]
        return max(mass[list(_reached(left, k))].sum() for k in range(n) if k != bone)

    root = int(np.flatnonzero(parents[:n] < 0)[0])
    assert heaviest(root) == pytest.approx(min(heaviest(k) for k in range(n)))
