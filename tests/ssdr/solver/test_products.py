"""Dense products and inverses over threads, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from ssdr.solver.tangents.tangent import inverse_of
from ssdr.solver.vertex_elimination import cross_product, product


@pytest.mark.parametrize("rows", [1, 95, 96, 300])
@pytest.mark.parametrize(("dtype", "rounding"), [(np.float64, 1e-12), (np.float32, 1e-4)])
def test_products_are_numpys_and_the_same_whatever_the_threads(
    rng: np.random.Generator, rows: int, dtype: type, rounding: float
) -> None:
    shapes = ((rows, 40), (40, 150), (rows, 150))
    left, right, other = (rng.standard_normal(shape).astype(dtype) for shape in shapes)
    before, found = ssdr.get_threads(), []
    try:
        for threads in (1, 2):
            ssdr.set_threads(threads)
            found.append((product(left, right), cross_product(left, other)))
    finally:
        ssdr.set_threads(before)
    for one, two, want in zip(*found, (left @ right, left.T @ other), strict=True):
        assert one.dtype == dtype
        np.testing.assert_allclose(one, want, atol=rounding)
        assert np.array_equal(one, two)


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
