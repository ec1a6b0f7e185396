"""Laplacians and masses against loops, hand calculation and analysis."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import ssdr
from helpers import naive
from helpers.surfaces import grid, sphere
from ssdr.laplacian.operators import cotangent_laplacian, mass_matrix, uniform_laplacian


@st.composite
def soups(draw):
    """Random triangles on few vertices: non-manifold, open, repeated, in several pieces."""
    n = draw(st.integers(3, 9))
    count = draw(st.integers(1, 14))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    faces = np.stack([rng.permutation(n)[:3] for _ in range(count)])
    return rng.normal(size=(n, 3)), faces.astype(np.int32)


def test_one_triangle_by_hand():
    # 3-4-5: cot at the right angle is 0, at the others 4/3 and 3/4; half of each is the weight.
    vertices, faces = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0]]), [[0, 1, 2]]
    # The edge 0-1 (length 4) is opposite to vertex 2, whose cotangent is 3/4; 0-2 to vertex 1.
    expected = [[3 / 8 + 4 / 6, -3 / 8, -4 / 6], [-3 / 8, 3 / 8, 0.0], [-4 / 6, 0.0, 4 / 6]]
    np.testing.assert_allclose(cotangent_laplacian(vertices, faces).toarray(), expected, atol=1e-15)
    for kind, mass in (("barycentric", [2, 2, 2]), ("voronoi", [3, 1.5, 1.5])):
        np.testing.assert_allclose(mass_matrix(vertices, faces, kind=kind).diagonal(), mass)
    np.testing.assert_array_equal(
        uniform_laplacian(faces, 3).toarray(), [[2, -1, -1], [-1, 2, -1], [-1, -1, 2]]
    )


@given(soups())
def test_matrices_equal_naive_loops(soup):
    vertices, faces = soup
    n = len(vertices)
    uniform = uniform_laplacian(faces, n).toarray()
    np.testing.assert_array_equal(uniform, naive.uniform_laplacian(faces, n))
    cotangent, expected = (
        cotangent_laplacian(vertices, faces).toarray(),
        naive.cotangent_laplacian(vertices, faces),
    )
    largest = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(cotangent, expected, atol=1e-8 * largest**2)
    for matrix in (uniform, cotangent):
        size = np.abs(matrix).max()
        np.testing.assert_array_equal(matrix, matrix.T)
        np.testing.assert_allclose(matrix.sum(axis=1), 0, atol=1e-13 * size)
        assert np.linalg.eigvalsh(matrix).min() >= -1e-12 * size
    used = np.unique(faces)
    for kind, twin in (("barycentric", naive.barycentric_mass), ("voronoi", naive.voronoi_mass)):
        got = mass_matrix(vertices, faces, kind=kind).diagonal()
        np.testing.assert_allclose(got[used], twin(vertices, faces)[used], rtol=1e-6)
        assert got.min() > 0


def test_linear_precision_on_a_flat_patch():
    vertices, faces = grid(7, 6, jitter=0.04, rng=np.random.default_rng(0))
    inner = np.ones((8, 7), dtype=bool)
    inner[[0, -1]] = inner[:, [0, -1]] = False
    linear = vertices @ np.array([[1.0, -2.0], [0.5, 3.0], [0, 0]]) + 5
    residual = cotangent_laplacian(vertices, faces) @ linear
    np.testing.assert_allclose(residual[inner.ravel()], 0, atol=1e-13)
    assert np.abs(residual[~inner.ravel()]).max() > 0.01  # a boundary has a flux


def test_area_of_the_mesh_is_shared_out():
    vertices, faces = sphere()
    area = trimesh.Trimesh(vertices, faces, process=False).area
    for kind in ("barycentric", "voronoi"):
        assert mass_matrix(vertices, faces, kind=kind).diagonal().sum() == pytest.approx(area)


def test_slivers_keep_the_matrix_semi_definite():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0], [0.5, 1e-12, 0], [0.3, 1e-5, 0]])
    for third in (2, 3, 4):
        matrix = cotangent_laplacian(points, [[0, 1, third]]).toarray()
        assert np.isfinite(matrix).all()
        assert np.linalg.eigvalsh(matrix).min() >= -1e-10 * np.abs(matrix).max()
        assert np.abs(matrix).max() <= 2e6


@pytest.mark.parametrize("size", [1e6, 1e60, 1e99, 1e150, 1e200, 1e307])
def test_the_cotangent_laplacian_of_any_size_place_and_turn_is_the_same(size: float) -> None:
    dancer = ssdr.samples.load("dancer_small")
    points = dancer.vertices[0].astype(np.float64)
    plain = cotangent_laplacian(points, dancer.faces)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    large = cotangent_laplacian(size * (points @ turn + 3), dancer.faces)
    assert abs(large - plain).max() < 1e-9 * abs(plain).max()


def test_masses_of_large_meshes_are_numbers() -> None:
    dancer = ssdr.samples.load("dancer_small")
    points = dancer.vertices[0].astype(np.float64)
    for kind in ("barycentric", "voronoi"):
        plain = mass_matrix(points, dancer.faces, kind=kind).diagonal()
        for size in (1e60, 1e98):
            large = mass_matrix(points * size, dancer.faces, kind=kind).diagonal()
            np.testing.assert_allclose(large / size**2, plain, rtol=1e-9)
