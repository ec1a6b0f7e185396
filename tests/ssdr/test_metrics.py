"""Metrics against loops, analytic cases, invariances and another library."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import naive
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import directed_hausdorff
from scipy.spatial.transform import Rotation

import ssdr
from ssdr import InputError, MeshSequence
from ssdr.metrics import compare, distances, hausdorff, rmse, sted

seeds = st.integers(0, 10**6)
DATA = Path(
    os.environ.get("SSDR_TEST_DATA", Path(__file__).resolve().parents[3] / "shared" / "data")
)


def sphere(subdivisions=1):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32)


def animation(seed=0, *, F=5, noise=0.1, subdivisions=1):
    rng = np.random.default_rng(seed)
    vertices, faces = sphere(subdivisions)
    frames = vertices + np.cumsum(noise * rng.normal(size=(F, len(vertices), 3)), axis=0)
    return frames, faces


# ----------------------------------------------------------------------------- distances


@given(seed=seeds, F=st.integers(1, 4), V=st.integers(1, 6))
@settings(max_examples=30, deadline=None)
def test_distances_equal_naive_loops(seed, F, V):
    a, b = np.random.default_rng(seed).normal(size=(2, F, V, 3))
    table = [[math.dist(a[t, i], b[t, i]) for i in range(V)] for t in range(F)]
    square = [[d * d for d in row] for row in table]
    total = sum(map(sum, square))
    d = distances(a, b)
    assert d.rmse == pytest.approx(math.sqrt(total / (F * V)))
    assert rmse(a, b) == pytest.approx(d.rmse)
    assert d.coordinate_rmse == pytest.approx(math.sqrt(total / (3 * F * V)))
    assert pytest.approx(1000 * np.linalg.norm((a - b).ravel()) / math.sqrt(3 * F * V)) == d.E
    assert d.mean == pytest.approx(sum(map(sum, table)) / (F * V))
    assert d.max == pytest.approx(max(map(max, table)))
    assert table[d.max_frame][d.max_vertex] == pytest.approx(d.max)
    np.testing.assert_allclose(d.per_frame, [math.sqrt(sum(row) / V) for row in square])
    np.testing.assert_allclose(
        d.per_vertex, [math.sqrt(sum(row[i] for row in square) / F) for i in range(V)]
    )
    assert d.diagonal == pytest.approx(MeshSequence(a).diagonal())
    if d.diagonal:
        assert d.percent_of_diagonal == pytest.approx(100 * d.rmse / d.diagonal)


def test_a_shift_by_hand():
    a = np.zeros((2, 3, 3))
    a[:, 1] = [3, 0, 0]
    a[:, 2] = [0, 4, 0]
    b = a + np.array([0, 0, 0.5])
    d = distances(a, b)
    assert d.rmse == d.mean == d.max == 0.5
    assert pytest.approx(500 / math.sqrt(3)) == d.E
    assert (d.diagonal, d.percent_of_diagonal) == (5.0, pytest.approx(10))
    assert distances(a, a).rmse == 0
    point = np.zeros((1, 1, 3))
    assert distances(point, point).percent_of_diagonal == 0
    assert distances(point, point + 1).percent_of_diagonal == math.inf


def test_float32_is_summed_in_float64():
    a = np.full((50, 40, 3), 1000, dtype=np.float32)
    b = a + np.float32(0.125)
    assert rmse(a, b) == pytest.approx(0.125 * math.sqrt(3), rel=1e-14)


def test_chunks_and_files_give_the_same(monkeypatch, tmp_path):
    a, faces = animation(F=12)
    b, _ = animation(1, F=12)
    whole = compare(a, b, faces).as_dict(arrays=True)
    np.save(tmp_path / "a.npy", a)
    mapped = MeshSequence(np.load(tmp_path / "a.npy", mmap_mode="r"), faces)
    assert mapped.is_lazy
    monkeypatch.setattr("ssdr.metrics.inputs._CHUNK_BYTES", 1)
    parts = compare(mapped, b).as_dict(arrays=True)

    def same(x, y):
        if isinstance(x, dict):
            assert x.keys() == y.keys()
            for key in x:
                same(x[key], y[key])
        else:
            np.testing.assert_allclose(x, y, rtol=1e-12)

    same(parts, whole)


# ----------------------------------------------------------------------------- Hausdorff


@given(seed=seeds, n=st.integers(1, 80), m=st.integers(1, 80))
@settings(max_examples=30, deadline=None)
def test_vertex_hausdorff_equals_loops_and_scipy(seed, n, m):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(n, 3)), rng.normal(size=(m, 3))
    got = hausdorff(a[None], b[None]).vertex_max
    assert got == pytest.approx(naive.vertex_hausdorff(a, b))
    assert got == pytest.approx(max(directed_hausdorff(a, b)[0], directed_hausdorff(b, a)[0]))


@given(seed=seeds, size=st.sampled_from([1e-3, 0.1, 3.0]))
@settings(max_examples=30, deadline=None)
def test_vertex_hausdorff_with_correspondence(seed, size):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(150, 3))
    b = a + size * rng.normal(size=a.shape)
    assert hausdorff(a[None], b[None]).vertex_max == pytest.approx(naive.vertex_hausdorff(a, b))


@given(seed=seeds, T=st.integers(1, 30), broken=st.booleans())
@settings(max_examples=40, deadline=None)
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


def test_surface_hausdorff_equals_trimesh():
    (a, faces), (b, _) = (animation(s, F=1, subdivisions=2, noise=0.05) for s in (0, 1))
    expected = 0.0
    for points, others in ((a[0], b[0]), (b[0], a[0])):
        mesh = trimesh.Trimesh(others, faces, process=False)
        _, away, _ = trimesh.proximity.closest_point_naive(mesh, points)
        expected = max(expected, away.max())
    assert hausdorff(a, b, faces).surface_max == pytest.approx(expected)


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
    n = 9
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    points = np.stack([x, y, 0 * x], axis=-1).reshape(1, -1, 3)
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    lifted = hausdorff(points, points + np.array([0, 0, 0.3]), faces)
    assert lifted.surface_max == pytest.approx(0.3)
    # Vertices that slide within the surface: the vertex sets differ, the surfaces do not.
    slid = points.copy()
    inner = index[1:-1, 1:-1].ravel()
    slid[0, inner, 0] += 0.04
    result = hausdorff(points, slid, faces)
    assert result.vertex_max == pytest.approx(0.04)
    assert result.surface_max == pytest.approx(0, abs=1e-9)


def test_samples_see_what_vertices_miss():
    # A triangle against its three corners: all vertices of each lie on the other.
    whole = np.array([[[0.0, 0, 0], [3, 0, 0], [0, 3, 0]]])
    corners = np.array(
        [
            [
                [0.0, 0, 0],
                [1, 0, 0],
                [0, 1, 0],
                [3, 0, 0],
                [2, 1, 0],
                [2, 0, 0],
                [0, 3, 0],
                [0, 2, 0],
                [1, 2, 0],
            ]
        ]
    )
    options = {"faces": [[0, 1, 2]], "other_faces": np.arange(9).reshape(3, 3)}
    assert hausdorff(whole, corners, **options).surface_max == pytest.approx(0, abs=1e-12)
    # The centroid, a probe of the triangle cut into nine, is farthest away.
    fine = hausdorff(whole, corners, **options, subdivisions=3)
    assert fine.surface_max == pytest.approx(math.sqrt(0.5))
    assert fine.vertex_max == pytest.approx(math.sqrt(2))


def test_subdivided_probes_are_on_the_surface():
    from ssdr.metrics.hausdorff_distance import _probes

    vertices, faces = sphere()
    for n in (1, 2, 3, 5):
        matrix = _probes(faces, len(vertices), n)
        np.testing.assert_allclose(matrix.sum(axis=1), 1)
        assert matrix.data.min() >= 0
        expected = len(vertices) + len(faces) * ((n + 1) * (n + 2) // 2 - 3)
        assert matrix.shape == (expected, len(vertices))
        points = matrix @ vertices
        gap = hausdorff(points[None], vertices[None], surface=False).vertex_max
        assert gap <= 0.7


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
    result = hausdorff(a, far, faces, other_faces=faces)
    assert result.vertex_max > 40
    assert result.surface_max == 0


# ----------------------------------------------------------------------------- STED


@given(
    seed=seeds,
    F=st.integers(1, 6),
    neighbourhood=st.integers(1, 3),
    window=st.sampled_from([1, 3, 5]),
    dt=st.floats(0.05, 3),
    signed=st.booleans(),
)
@settings(max_examples=25, deadline=None)
def test_sted_equals_naive_loops(seed, F, neighbourhood, window, dt, signed):
    rng = np.random.default_rng(seed)
    vertices, faces = sphere(0)
    vertices = np.concatenate([vertices, [[9.0, 9, 9]]])  # with a loose vertex
    a = vertices + np.cumsum(0.2 * rng.normal(size=(F, 13, 3)), axis=0)
    b = a + 0.05 * rng.normal(size=a.shape)
    result = sted(
        a,
        b,
        faces,
        neighbourhood=neighbourhood,
        window=window,
        dt=dt,
        c=0.7,
        normaliser=0.3,
        signed=signed,
    )
    spatial, temporal = naive.sted(
        a,
        b,
        faces,
        neighbourhood=neighbourhood,
        window=window,
        dt=dt,
        normaliser=0.3,
        signed=signed,
    )
    assert result.spatial == pytest.approx(spatial, rel=1e-9, abs=1e-12)
    assert result.temporal == pytest.approx(temporal if F > 2 else 0.0, rel=1e-9, abs=1e-12)
    assert result.value == pytest.approx(math.sqrt(spatial**2 + (0.7 * result.temporal) ** 2))
    assert result.spatial_per_frame.mean() == pytest.approx(result.spatial)


def test_normalisers():
    a, faces = animation(F=6)
    b, _ = animation(1, F=6)
    speed = np.linalg.norm(np.diff(a, axis=0), axis=2).mean()
    assert sted(a, b, faces).normaliser == pytest.approx(speed)
    diagonal = sted(a, b, faces, normaliser="diagonal")
    assert diagonal.normaliser == pytest.approx(MeshSequence(a).diagonal())
    assert diagonal.temporal < sted(a, b, faces).temporal
    still = np.repeat(a[:1], 4, axis=0)
    assert sted(still, b[:4], faces).normaliser == pytest.approx(MeshSequence(still).diagonal())
    assert sted(np.zeros((3, 4, 3)), np.ones((3, 4, 3))).value == 0


def motions(count, seed, size=1.0):
    rng = np.random.default_rng(seed)
    return Rotation.random(count, rng=rng).as_matrix(), size * rng.normal(size=(count, 1, 3))


def test_sted_is_zero_for_equal_and_for_rigidly_moved():
    a, faces = animation(F=6)
    assert sted(a, a, faces).value == 0
    rotation, shift = motions(6, 0)
    apart = a @ rotation.transpose(0, 2, 1) + shift
    assert sted(a, apart, faces).spatial < 1e-14  # edge lengths do not move
    assert sted(a, apart, faces).temporal > 0.01
    once = a @ rotation[0].T + shift[0]
    assert sted(a, once, faces).value < 1e-13
    # A uniform scale changes all edges of a neighbourhood alike: no deviation.
    assert sted(a, 1.1 * a, faces).spatial < 1e-13


def test_sted_does_not_depend_on_the_scale():
    a, faces = animation(F=6)
    b = a + 0.02 * np.random.default_rng(2).normal(size=a.shape)
    base = sted(a, b, faces)
    for scale in (1e-5, 1e5):
        other = sted(scale * a, scale * b, faces)
        assert other.spatial == pytest.approx(base.spatial, rel=1e-9)
        assert other.temporal == pytest.approx(base.temporal, rel=1e-9)


def test_sted_tells_jitter_from_a_smooth_shift():
    # The same RMSE, in space and in time: noise is seen, a smooth displacement is not.
    vertices, faces = sphere(2)
    time = np.linspace(0, 1, 12)[:, None, None]
    a = vertices + time * [1.0, 0.5, 0]
    noise = 0.01 * np.random.default_rng(3).normal(size=a.shape)
    smooth = np.full_like(a, 0.01)
    assert rmse(a, a + noise) == pytest.approx(rmse(a, a + smooth), rel=0.05)
    noisy, smoothed = sted(a, a + noise, faces), sted(a, a + smooth, faces)
    assert noisy.spatial > 100 * smoothed.spatial
    assert noisy.temporal > 100 * smoothed.temporal


def test_sted_with_edges_of_no_length():
    a, faces = animation(F=4)
    a[:, faces[0, 1]] = a[:, faces[0, 0]]
    b = a + 0.01 * np.random.default_rng(4).normal(size=a.shape)
    result = sted(a, b, faces)
    assert np.isfinite(result.value)
    assert result.value > 0


# ----------------------------------------------------------------------------- all together


def test_compare_has_them_all():
    a, faces = animation(F=5)
    b, _ = animation(1, F=5)
    result = compare(MeshSequence(a, faces), b)
    assert (result.n_frames, result.n_vertices) == a.shape[:2]
    d, h, s = distances(a, b), hausdorff(a, b, faces), sted(a, b, faces)
    for name in ("rmse", "coordinate_rmse", "E", "percent_of_diagonal", "mean", "max"):
        assert getattr(result, name) == getattr(d, name)
    assert result.hausdorff.surface_max == h.surface_max
    assert result.sted.value == s.value
    plain = json.loads(json.dumps(result.as_dict()))
    assert plain["rmse"] == d.rmse
    assert plain["hausdorff"]["vertex_mean"] == h.vertex_mean
    assert plain["sted"]["temporal"] == s.temporal
    assert "per_frame" not in plain
    full = json.loads(json.dumps(result.as_dict(arrays=True)))
    np.testing.assert_allclose(full["per_vertex"], d.per_vertex)
    np.testing.assert_allclose(full["hausdorff"]["surface_per_frame"], h.surface_per_frame)
    table = str(result)
    for text in (f"{d.rmse:.6g}", f"{h.surface_max:.6g}", f"{s.value:.4g}", "5 frames"):
        assert text in table


def test_no_share_of_a_diagonal_of_zero_in_json():
    result = compare(np.zeros((3, 4, 3)), np.ones((3, 4, 3)))
    assert result.percent_of_diagonal == math.inf
    assert json.loads(json.dumps(result.as_dict(), allow_nan=False))["percent_of_diagonal"] is None


def test_compare_of_parts_and_options():
    a, faces = animation(F=5)
    b, _ = animation(1, F=5)
    bare = compare(a, b, hausdorff=False, sted=False)
    assert bare.hausdorff is None
    assert bare.sted is None
    assert set(bare.as_dict()) == {
        "n_frames",
        "n_vertices",
        "rmse",
        "coordinate_rmse",
        "E",
        "percent_of_diagonal",
        "mean",
        "max",
        "max_frame",
        "max_vertex",
        "diagonal",
    }
    assert "STED" not in str(bare)
    cloud = compare(a, b)
    assert cloud.hausdorff.surface_max is None
    assert cloud.sted.spatial == 0
    assert "surfaces" not in str(cloud)
    options = compare(
        a, b, faces, hausdorff_options={"subdivisions": 2}, sted_options={"window": 3}
    )
    assert (options.hausdorff.subdivisions, options.sted.window) == (2, 3)


def test_same_bits_for_any_number_of_threads():
    a, faces = animation(F=30, subdivisions=2)
    b, _ = animation(1, F=30, subdivisions=2)
    try:
        results = []
        for threads in (1, 2, 3):
            ssdr.set_threads(threads)
            results.append(json.dumps(compare(a, b, faces).as_dict(arrays=True)))
    finally:
        ssdr.set_threads(None)
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize(
    ("function", "change", "argument"),
    [
        (compare, {"other": np.zeros((5, 41, 3))}, "other"),
        (compare, {"other": np.zeros((4, 42, 3))}, "other"),
        (compare, {"other": np.zeros((42, 3))}, "other"),
        (compare, {"reference": np.full((5, 42, 3), np.nan)}, "reference"),
        (compare, {"other": np.full((5, 42, 3), np.inf)}, "other"),
        (compare, {"reference": "abc"}, "reference"),
        (compare, {"faces": [[0, 1, 42]]}, "faces"),
        (rmse, {"other": np.zeros((5, 41, 3))}, "other"),
        (distances, {"other": np.zeros((5, 41, 3))}, "other"),
        (hausdorff, {"other": np.zeros((4, 42, 3))}, "other"),
        (hausdorff, {"subdivisions": 0}, "subdivisions"),
        (hausdorff, {"subdivisions": 1.5}, "subdivisions"),
        (hausdorff, {"other_faces": [[0, 1, 42]]}, "faces"),
        (sted, {"neighbourhood": 0}, "neighbourhood"),
        (sted, {"neighbourhood": True}, "neighbourhood"),
        (sted, {"window": 4}, "window"),
        (sted, {"window": 0}, "window"),
        (sted, {"dt": 0}, "dt"),
        (sted, {"dt": np.nan}, "dt"),
        (sted, {"c": -1}, "c"),
        (sted, {"normaliser": "size"}, "normaliser"),
        (sted, {"normaliser": 0.0}, "normaliser"),
    ],
)
def test_bad_input(function, change, argument):
    arguments = {"reference": np.zeros((5, 42, 3)), "other": np.zeros((5, 42, 3))} | change
    with pytest.raises(InputError) as error:
        function(**arguments)
    assert error.value.argument == argument


@pytest.mark.skipif(
    not (DATA / "reference").is_dir(), reason="no real sequences (SSDR_TEST_DATA, ../shared/data)"
)
@pytest.mark.parametrize(("bones", "published"), [(5, 0.0268619), (10, 0.0155799), (20, 0.0098871)])
def test_published_results_have_their_published_error(bones, published):
    data = np.load(DATA / "ea_bone.npz", allow_pickle=False)
    model = np.load(DATA / "reference" / f"ea_ref_Decomposition_{bones:02}.npz", allow_pickle=False)
    points = np.c_[model["rest"], np.ones(len(model["rest"]))]
    frames = np.einsum("vb,fbxy,vy->fvx", model["weights"], model["transforms"], points)
    assert rmse(data["vertices"], frames) == pytest.approx(published, rel=1e-4)
