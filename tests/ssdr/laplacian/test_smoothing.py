"""Implicit smoothing against analysis, and on meshes that are broken."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from helpers.surfaces import sphere
from ssdr import MeshSequence
from ssdr.laplacian.operators import cotangent_laplacian, mass_matrix
from ssdr.laplacian.smoothing import LaplacianSmoother, split_frequencies

MISSING = importlib.util.find_spec("sksparse") is None
NEEDS = pytest.mark.skipif(MISSING, reason="scikit-sparse is not installed")
BACKENDS = ["scipy", pytest.param("cholmod", marks=NEEDS)]


@pytest.mark.parametrize("kind", ["cotangent", "uniform"])
@pytest.mark.parametrize("subdivisions", [3, 4])
def test_sphere_eigenfunctions_are_damped_by_theory_at_every_resolution(kind, subdivisions):
    # z is a spherical harmonic of eigenvalue 2, z^2 - 1/3 of eigenvalue 6.
    vertices, faces = sphere(subdivisions)
    length = 0.4
    smoother = LaplacianSmoother(vertices, faces, length, kind=kind)
    z = vertices[:, 2]
    for function, eigenvalue in ((z, 2.0), (z**2 - 1 / 3, 6.0)):
        expected = function / (1 + length**2 * eigenvalue)
        # An icosphere is only nearly regular; without the 1/sqrt(3) z^2 is off by a quarter.
        tolerance = 0.06 if kind == "uniform" else 0.02 / 4 ** (subdivisions - 3)
        error = np.abs(smoother.smooth(function) - expected).max()
        assert error < tolerance * np.abs(expected).max()


@pytest.mark.parametrize("backend", BACKENDS)
def test_backends_solve_the_stated_system(backend):
    vertices, faces = sphere()
    length = 0.3
    smoother = LaplacianSmoother(vertices, faces, length, backend=backend)
    assert smoother.backend == backend
    x = np.random.default_rng(2).normal(size=(4, len(vertices), 3))
    mass = mass_matrix(vertices, faces).toarray()
    system = mass + length**2 * cotangent_laplacian(vertices, faces).toarray()
    for frame, smoothed in zip(x, smoother.smooth(x), strict=True):
        np.testing.assert_allclose(smoothed, np.linalg.solve(system, mass @ frame), atol=1e-12)


def test_shapes_dtypes_and_batches(monkeypatch):
    vertices, faces = sphere()
    smoother = LaplacianSmoother(vertices, faces, 0.3)
    frames = np.random.default_rng(3).normal(size=(5, len(vertices), 3))
    smoothed = smoother.smooth(frames)
    np.testing.assert_allclose(smoother.smooth(frames[2]), smoothed[2], atol=1e-14)
    np.testing.assert_allclose(smoother.smooth(frames[2, :, 1]), smoothed[2, :, 1], atol=1e-14)
    single = smoother.smooth(frames.astype(np.float32))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, smoothed, atol=1e-6)
    assert smoother.smooth(np.empty((0, len(vertices), 3))).shape == (0, len(vertices), 3)
    wide = np.broadcast_to(frames[:1, :, :1], (1, len(vertices), 40))
    assert smoother.smooth(wide).shape == wide.shape
    assert np.isfinite(smoother.smooth(1e200 * frames)).all()
    monkeypatch.setattr("ssdr.laplacian.smoothing._BATCH_BYTES", 8 * 3 * len(vertices) * 2)
    np.testing.assert_allclose(smoother.smooth(frames), smoothed, atol=1e-14)


def test_length_zero_and_no_faces_change_nothing():
    vertices, faces = sphere()
    x = np.random.default_rng(6).normal(size=len(vertices))
    for triangles, length in ((faces, 0.0), (np.zeros((0, 3), dtype=np.int32), 9.0)):
        smoothed = LaplacianSmoother(vertices, triangles, length).smooth(x)
        np.testing.assert_allclose(smoothed, x, rtol=1e-14)


@pytest.mark.parametrize("kind", ["cotangent", "uniform"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_broken_meshes_stay_finite_and_loose_vertices_stay(kind, backend):
    vertices, faces = sphere()
    n = len(vertices)
    second = vertices + np.array([5.0, 0, 0])
    extra = np.array([[9.0, 9, 9], [0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 0, 0]])
    points = np.concatenate([vertices, second, extra])
    loose, a, b, c, d = range(2 * n, 2 * n + 5)
    broken = np.array(
        [
            [a, b, c],  # collinear
            [a, a, b],  # an edge
            [a, a, a],  # a point
            [b, d, c],  # two corners coincide
            [0, 1, n],  # joins the spheres by a sliver, non-manifold
            list(faces[0]),  # duplicated
            list(faces[1][::-1]),  # duplicated, turned over
        ]
    )
    triangles = np.concatenate([faces, faces + n, broken]).astype(np.int32)
    smoother = LaplacianSmoother(points, triangles, 0.5, kind=kind, backend=backend)
    x = np.random.default_rng(7).normal(size=(len(points), 3))
    smoothed = smoother.smooth(x)
    assert np.isfinite(smoothed).all()
    np.testing.assert_allclose(smoothed[loose], x[loose], rtol=1e-12)
    np.testing.assert_allclose(smoother.smooth(np.ones(len(points))), 1, rtol=1e-10)


def test_a_mesh_without_any_area():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 0]])
    faces = np.array([[0, 1, 2], [0, 0, 3]])
    for kind in ("cotangent", "uniform"):
        assert np.isfinite(LaplacianSmoother(points, faces, 1.0, kind=kind).smooth(points)).all()
    same = np.ones((4, 3))
    np.testing.assert_allclose(LaplacianSmoother(same, faces, 1.0).smooth(points), points)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_the_length_scales_with_the_mesh(scale):
    vertices, faces = sphere()
    x = np.random.default_rng(8).normal(size=len(vertices))
    expected = LaplacianSmoother(vertices, faces, 0.3).smooth(x)
    scaled = LaplacianSmoother(scale * vertices, faces, 0.3 * scale).smooth(x)
    np.testing.assert_allclose(scaled, expected, atol=1e-9)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_split_adds_up(dtype):
    vertices, faces = sphere()
    rng = np.random.default_rng(9)
    frames = (vertices + 0.1 * rng.normal(size=(6, len(vertices), 3)) + 20).astype(dtype)
    split = split_frequencies(frames, faces, length=0.3)
    assert split.low.dtype == split.high.dtype == dtype
    assert split.smoother.length == 0.3
    unit = np.spacing(np.maximum(np.abs(frames), np.abs(split.high)))
    assert (np.abs(split.low + split.high - frames) <= unit).all()
    # Far from the origin, low is within a factor of two of the input: exact (Sterbenz).
    np.testing.assert_array_equal(split.low + split.high, frames)
    assert np.std(split.high) < np.std(frames - frames.mean(axis=1, keepdims=True))
    np.testing.assert_allclose(
        split.smoother.smooth(frames[3]), split.low[3], atol=1e-12 if dtype == np.float64 else 1e-5
    )


def test_split_of_a_sequence_uses_the_named_rest():
    vertices, faces = sphere()
    frames = np.stack([vertices, vertices * [1, 1, 2.0], vertices * 3])
    sequence = MeshSequence(frames, faces)
    by_frame = split_frequencies(sequence, length=0.3, rest=-1)
    by_pose = split_frequencies(frames, faces, length=0.3, rest=frames[2])
    np.testing.assert_array_equal(by_frame.low, by_pose.low)
    assert not np.allclose(by_frame.low, split_frequencies(sequence, length=0.3).low)
