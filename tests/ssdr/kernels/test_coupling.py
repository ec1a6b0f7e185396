"""Rest positions solved with the edges between them, against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest

from helpers import motions
from ssdr.kernels.coupling import add_patches, begin_coupling, couple_vertices

N, LAM = 150, 0.7


def _graph(rng: np.random.Generator) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Symmetric weights (N, N) of a ring with chords; the same as compressed rows, times LAM."""
    weights = np.zeros((N, N))
    for step in (1, 2, 7):
        i = np.arange(N)
        weights[i, (i + step) % N] = weights[(i + step) % N, i] = 0.5 + rng.random(N)
    start = np.append(0, np.count_nonzero(weights, axis=1).cumsum())
    i, j = np.nonzero(weights)
    return weights, (start, j.astype(np.uint32), LAM * weights[i, j])


@pytest.mark.parametrize("real", [np.float64, np.float32])
def test_coupled_answer_is_that_of_the_dense_matrix(rng: np.random.Generator, real: type) -> None:
    weights, (start, ends, edges) = _graph(rng)
    degree, importance = weights.sum(axis=1), 0.2 + rng.random(N)
    hold = 2 * LAM * degree / importance
    column, size = rng.integers(0, 3, N), 6
    factors = rng.standard_normal((N, size, size))
    separable = factors @ factors.transpose(0, 2, 1) + 0.1 * np.eye(size)
    place = column[:, None] + np.arange(3)
    separable[np.arange(N)[:, None], place, place] += hold[:, None]
    # the whole matrix: importance times the blocks, with λL in place of the bound
    whole = np.zeros((N, size, N, size))
    for i in range(N):
        whole[i, :, i] = importance[i] * separable[i]
        for c in range(3):
            whole[i, place[i, c], i, place[i, c]] -= LAM * degree[i]
            for j in np.flatnonzero(weights[i]):
                whole[i, place[i, c], j, place[j, c]] -= LAM * weights[i, j]
    right = rng.standard_normal((N, size))
    want = np.linalg.solve(
        whole.reshape(N * size, N * size), (importance[:, None] * right).ravel()
    ).reshape(N, size)

    blocks = np.empty((3, 3, 3, N), dtype=real)
    inverse = np.linalg.inv(separable)
    begin_coupling(inverse, column, importance, hold, LAM * degree, *blocks)
    plain = np.einsum("vab,vb->va", inverse, right)
    order = rng.permutation(N)
    groups = np.array([0, 60, N]), np.array([[0, 1], [1, 2]]), np.array([2, 1])
    points, skin = rng.standard_normal((N, 1, 4)).astype(real), rng.random((N, 2)).astype(real)
    shift, change = (importance * hold - LAM * degree).astype(real), np.empty((N, 3), dtype=real)
    for size_of_guess in (0.0, 0.3):  # the answer does not depend on the guess
        guess = (size_of_guess * rng.standard_normal((3, 3, 4))).astype(real)
        couple_vertices(
            plain[order].astype(real), guess, *groups, points, skin, order, column, *blocks, shift,
            start, ends, edges.astype(real), 300, 1e-9, change,
        )  # fmt: skip
        got = plain.copy()
        for row, i in enumerate(order):
            got[i] += inverse[i][:, place[i]] @ change[row]
        np.testing.assert_allclose(got, want, atol=1e-8 if real is np.float64 else 2e-4)


def test_patches_cost_what_moving_them_does(rng: np.random.Generator) -> None:
    """Against the sums over vertices, with R_jᵀ R_k replaced by its trace as the kernel does."""
    weights, (start, ends, edges) = _graph(rng)
    bones, k = 4, 3
    indices, skin = motions.weights_of(rng, N, bones, k)
    importance, turns = rng.random(N), rng.standard_normal((bones, bones))
    turns = turns @ turns.T
    points = rng.standard_normal((N, 2, 4)) * [1, 1, 1, 0]
    points[:, 0, 3] = 1.0
    half = np.zeros((bones, bones, 4, 4))
    degree = LAM * weights.sum(axis=1)
    for i, j in ((0, 97), (97, N)):
        rows = points, indices, skin, importance, turns, degree
        add_patches(*rows, start, ends, edges, i, j, half)
    dense = np.zeros((N, bones))
    np.add.at(dense, (np.arange(N)[:, None], indices), skin)
    u = np.einsum("v,vj,vk,vpd,vpe->jkde", importance, dense, dense, points, points)
    total = half + half.transpose(1, 0, 3, 2) + turns[:, :, None, None] * u
    x = rng.standard_normal((bones, 3, 4))
    moved = np.einsum("jcd,vpd->vpjc", x, points)
    mean = np.einsum("vj,vpjc->vpc", dense, moved)
    away = moved - mean[:, :, None]
    want = np.einsum("v,vj,vk,jk,vpjc,vpkc->", importance, dense, dense, turns, away, away)
    want += 0.5 * LAM * (weights * ((mean[:, None, 0] - mean[None, :, 0]) ** 2).sum(axis=2)).sum()
    assert np.einsum("jcd,jkde,kce->", x, total, x) == pytest.approx(want, rel=1e-10)
