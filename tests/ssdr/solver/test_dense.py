"""Dense products and inverses over threads, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from ssdr.solver.dense import cross_product, inverse_of, product


@pytest.mark.parametrize("rows", [1, 95, 96, 300])
def test_products_are_numpys_and_the_same_whatever_the_threads(
    rng: np.random.Generator, rows: int
) -> None:
    left, right = rng.standard_normal((rows, 40)), rng.standard_normal((40, 150))
    other = rng.standard_normal((rows, 150))
    before, found = ssdr.get_threads(), []
    try:
        for threads in (1, 2):
            ssdr.set_threads(threads)
            found.append((product(left, right), cross_product(left, other)))
    finally:
        ssdr.set_threads(before)
    np.testing.assert_allclose(found[0][0], left @ right, atol=1e-12)
    np.testing.assert_allclose(found[0][1], left.T @ other, atol=1e-12)
    for one, two in zip(*found, strict=True):
        assert np.array_equal(one, two)


def test_products_keep_single_precision(rng: np.random.Generator) -> None:
    left, right = (rng.standard_normal((130, 7)).astype(np.float32) for _ in "ab")
    for got, want in (
        (product(left, right.T), left @ right.T),
        (cross_product(left, right), left.T @ right),
    ):
        assert got.dtype == np.float32
        np.testing.assert_allclose(got, want, atol=1e-5)


def test_an_inverse_is_symmetric_and_one_that_rounding_made_indefinite_is_found(
    rng: np.random.Generator,
) -> None:
    half = rng.standard_normal((30, 40))
    matrix = half @ half.T
    inverse = inverse_of(matrix.copy())
    np.testing.assert_allclose(inverse @ matrix, np.eye(30), atol=1e-9)
    assert np.array_equal(inverse, inverse.T)
    turned = matrix - 2 * np.outer(half[:, 0], half[:, 0]) * 30
    assert np.linalg.eigvalsh(turned).min() < 0
    np.testing.assert_allclose(inverse_of(turned.copy()) @ turned, np.eye(30), atol=1e-8)
