"""Normals of written files, as engines turn them, against those of the input's surface.

The files are read, and their normals turned, by code that is not the package's.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers import drawn, naive
from helpers.rig_model import tube


@pytest.fixture
def bent(rng):
    """A noisy tube with seams and hard edges, which bends."""
    model = tube(rings=13, sides=10)
    frames = model.skin() + 0.02 * rng.normal(size=(20, model.n_vertices, 3))
    return ssdr.MeshSequence(frames, model.faces, surface=model.surface)


def groups_of(sequence):
    """Numbers of equal (vertex, normal of the surface) at corners."""
    return drawn.groups_of(sequence.faces, sequence.surface and sequence.surface.normals)


def error_in(path, sequence):
    """Mean angle over frames and normals between a file and the sequence that it is a model of."""
    ((_, normals, faces, vertex),) = drawn.from_gltf(path)
    groups = groups_of(sequence)
    expected = drawn.vertex_normals(sequence.vertices, sequence.faces, groups)
    order = np.lexsort(vertex[faces].T), np.lexsort(sequence.faces.T)
    np.testing.assert_array_equal(vertex[faces][order[0]], sequence.faces[order[1]])
    _, first = np.unique(groups[order[1]], return_index=True)
    found = normals[:, faces[order[0]]].reshape(len(normals), -1, 3)[:, first]
    return drawn.mean_angle(found, expected[:, order[1]].reshape(len(normals), -1, 3)[:, first])


def test_gltf_is_drawn_as_measured_and_better_than_geometric_normals(tmp_path, bent):
    result = ssdr.decompose(bent, bones=5, effort="fast", rig="rigid")
    ssdr.save(result, tmp_path / "a.glb")
    error = error_in(tmp_path / "a.glb", bent)
    assert error == pytest.approx(result.normals.mean, rel=1e-3)
    surface = dataclasses.replace(result.skinning.surface, normals=None)
    ssdr.save(dataclasses.replace(result.skinning, surface=surface), tmp_path / "b.glb")
    smooth = dataclasses.replace(bent, surface=None)
    assert error < error_in(tmp_path / "b.glb", smooth)


def test_usd_is_drawn_as_measured(tmp_path, bent):
    pytest.importorskip("pxr")
    result = ssdr.decompose(bent, bones=5, effort="fast")
    ssdr.save(result, tmp_path / "a.usda")
    found = drawn.from_usd(tmp_path / "a.usda", range(20))
    groups = groups_of(bent)
    expected = drawn.vertex_normals(bent.vertices, bent.faces, groups)
    _, first = np.unique(groups, return_index=True)
    one, two = (x.reshape(20, -1, 3)[:, first] for x in (found, expected))
    assert drawn.mean_angle(one, two) == pytest.approx(result.normals.mean, rel=1e-3)


def test_the_first_numbered_mesh_has_the_normals_of_its_frame(tmp_path, bent):
    model = ssdr.decompose(bent, bones=5, effort="fast").skinning
    ssdr.save(model, tmp_path / "a_%02d.obj")
    one = ssdr.load(tmp_path / "a_00.obj")
    expected = drawn.vertex_normals(model.skin()[:1], model.faces, groups_of(bent))[0]
    assert naive.angles(one.surface.normals, expected).max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(("name", "most"), [("horse_gallop", 3.6), ("ea_bone", 5)])
def test_real_animations(tmp_path, real, name, most):
    sequence = real(name)
    result = ssdr.decompose(sequence, bones=20, effort="fast")
    ssdr.save(result, tmp_path / "a.glb")
    error = error_in(tmp_path / "a.glb", sequence)
    assert error < most
    assert error == pytest.approx(result.normals.mean, abs=0.01)
