"""Hausdorff distances against loops, SciPy and trimesh."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import directed_hausdorff

from helpers import naive
from helpers.surfaces import animation, grid
from ssdr import MeshSequence
from ssdr.metrics import hausdorff

seeds = st.integers(0, 10**6)


@given(seed=seeds, n=st.integers(1, 80), m=st.integers(1, 80))
@settings(max_examples=30)
def test_vertex_hausdorff_equals_loops_and_scipy(seed, n, m):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(n, 3)), rng.normal(size=(m, 3))
    got = hausdorff(a[None], b[None]).vertex_max
    assert got == pytest.approx(naive.vertex_hausdorff(a, b))
    assert got == pytest.approx(max(directed_hausdorff(a, b)[0], directed_hausdorff(b, a)[0]))


@given(seed=seeds, size=st.sampled_from([1e-3, 0.1, 3.0]))
@settings(max_examples=30)
def test_vertex_hausdorff_with_correspondence(seed, size):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(150, 3))
    b = a + size * rng.normal(size=a.shape)
    assert hausdorff(a[None], b[None]).vertex_max == pytest.approx(naive.vertex_hausdorff(a, b))


@given(seed=seeds, T=st.integers(1, 30), broken=st.booleans())
def test_surface_hausdorff_equals_loops(seed, T, broken):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 12, 3))
    faces = (
        rng.integers(0, 12, (T, 3))
        if broken
        else np.array([rng.permutation(12)[:3] for _ in range(T)])
    )
    got = hausdorff(a[None], b[None], faces)
    assert got.surface_max == pytest.approx(naive.surface_hausdorff(a, faces, b, faces))


def test_frames_do_not_influence_each_other():
    # The search starts from the frame before: its results must not.
    a, faces = animation(F=20, noise=0.3)
    b, _ = animation(1, F=20, noise=0.3)
    together = hausdorff(a, b, faces)
    for t in (0, 3, 11, 19):
        alone = hausdorff(a[t : t + 1], b[t : t + 1], faces)
        assert together.vertex_per_frame[t] == pytest.approx(alone.vertex_max, rel=1e-12)
        assert together.surface_per_frame[t] == pytest.approx(alone.surface_max, rel=1e-12)
    assert together.surface_mean == pytest.approx(together.surface_per_frame.mean())
    assert together.vertex_mean == pytest.approx(together.vertex_per_frame.mean())


def test_parallel_planes_and_sliding():
    points, faces = grid(8, 8)
    points, index = points[None], np.arange(81).reshape(9, 9)
    lifted = hausdorff(points, points + np.array([0, 0, 0.3]), faces)
    assert lifted.surface_max == pytest.approx(0.3)
    # Vertices that slide within the surface: the vertex sets differ, the surfaces do not.
    slid = points.copy()
    inner = index[1:-1, 1:-1].ravel()
    slid[0, inner, 0] += 0.04
    result = hausdorff(points, slid, faces)
    assert result.vertex_max == pytest.approx(0.04)
    assert result.surface_max == pytest.approx(0, abs=1e-9)


def test_hausdorff_symmetry_scale_and_faces():
    (a, faces), (b, _) = (animation(s) for s in (0, 1))
    one, two = hausdorff(a, b, faces), hausdorff(b, a, faces)
    np.testing.assert_allclose(one.surface_per_frame, two.surface_per_frame, rtol=1e-12)
    np.testing.assert_allclose(one.vertex_per_frame, two.vertex_per_frame, rtol=1e-12)
    large = hausdorff(1e6 * a, 1e6 * b, faces)
    np.testing.assert_allclose(large.surface_per_frame, 1e6 * one.surface_per_frame, rtol=1e-9)
    assert (one.surface_per_frame <= one.vertex_per_frame + 1e-12).all()
    assert hausdorff(a, a, faces).surface_max == 0
    assert hausdorff(a, b).surface_max is None
    assert hausdorff(a, b, faces, surface=False).surface_mean is None
    for pair in ((MeshSequence(a, faces), b), (a, MeshSequence(b, faces))):
        np.testing.assert_array_equal(hausdorff(*pair).surface_per_frame, one.surface_per_frame)


def test_unreferenced_vertices_are_no_surface():
    a, faces = animation(F=1)
    far = np.concatenate([a, [[[50.0, 0, 0]]]], axis=1)
    result = hausdorff(MeshSequence(a, faces), MeshSequence(far, faces))
    assert result.vertex_max > 40
    assert result.surface_max == 0
