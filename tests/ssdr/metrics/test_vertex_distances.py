"""Distances and RMSE against loops and published figures."""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ssdr
from ssdr import MeshSequence
from ssdr.metrics import distances, rmse

seeds = st.integers(0, 10**6)


DATA = Path(
    os.environ.get("SSDR_TEST_DATA", Path(__file__).resolve().parents[4] / "shared" / "data")
)


@given(seed=seeds, F=st.integers(1, 4), V=st.integers(1, 6))
@settings(max_examples=30)
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


def test_a_mesh_without_a_diagonal():
    point = np.zeros((1, 1, 3))
    assert distances(point, point).percent_of_diagonal == 0
    assert distances(point, point + 1).percent_of_diagonal == math.inf


def test_float32_is_summed_in_float64():
    a = np.full((50, 40, 3), 1000, dtype=np.float32)
    b = a + np.float32(0.125)
    assert rmse(a, b) == pytest.approx(0.125 * math.sqrt(3), rel=1e-14)


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


def test_what_was_welded_is_compared_at_the_vertices_that_are_left(seam):
    welded, _ = seam.weld()
    moved = dataclasses.replace(welded, vertices=welded.vertices + np.float32([0, 0.5, 0]))
    expected = distances(welded, moved)
    assert expected.rmse == pytest.approx(0.5)
    for pair in ((seam, moved), (moved, seam)):
        found = distances(*pair)
        assert found.rmse == pytest.approx(0.5)
        assert found.per_vertex.shape == (welded.n_vertices,) != (seam.n_vertices,)
    still = np.tile(np.eye(3, 4), (seam.n_frames, 1, 1, 1))
    bone = np.zeros((welded.n_vertices, 1), int), np.ones((welded.n_vertices, 1)), still
    kept = {"faces": welded.faces, "surface": welded.surface, "vertex_map": welded.vertex_map}
    model = ssdr.Skinning(welded.vertices[0], *bone, **kept)
    here, there = (ssdr.metrics.normals(truth, model).per_vertex for truth in (welded, seam))
    np.testing.assert_allclose(there, here, atol=1e-9)
    rows = welded.vertex_map
    whole = {"faces": seam.faces, "surface": seam.surface}
    before = ssdr.Skinning(model.rest[rows], bone[0][rows], bone[1][rows], still, **whole)
    errors = distances(welded, before)  # at the vertices before the welding of the reference
    np.testing.assert_array_equal(errors.per_vertex, distances(seam, before).per_vertex)
    with pytest.raises(ssdr.InputError, match="of 7 vertices, as the reference has"):
        distances(ssdr.MeshSequence(seam.vertices[:, :7]), moved)
