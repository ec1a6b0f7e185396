"""`ssdr info`."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.command import model_of
from helpers.rig_tree import PARENTS, creature, flat


def test_info_counts_what_is_there(run, done, tmp_path):
    # Two triangles sharing an edge, a degenerate one, a loose vertex and a doubled one.
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [5, 5, 5], [0, 0, 0.0]])
    faces = [[0, 1, 2], [0, 2, 3], [1, 1, 2]]
    clip = ssdr.MeshSequence(np.stack([points, points + 1]), faces, 10.0)
    ssdr.save(clip, tmp_path / "a.npz")
    d = done("info", tmp_path / "a.npz")
    assert (d["kind"], d["frames"], d["vertices"], d["triangles"]) == ("sequence", 2, 6, 3)
    assert (d["components"], d["loose_vertices"]) == (1, 2)
    assert (d["degenerate_triangles"], d["seams"]) == (1, 1)
    assert d["duration"] == pytest.approx(0.2)
    assert d["diagonal"] == pytest.approx(np.sqrt(75))
    assert d["memory"] == 2 * 6 * 3 * 8
    out = run("info", tmp_path / "a.npz")[1]
    assert "--read weld=true" in out
    assert "1 degenerate" in out


def test_info_of_a_skinning(run, done, wave, tmp_path):
    model = model_of(wave, bones=3)
    weights = model.weights.copy()
    weights[0, :2] = 0.5
    indices = model.indices.copy()
    indices[0, 1] = 1
    model = dataclasses.replace(model, weights=weights, indices=indices)
    ssdr.save(model, tmp_path / "m.npz")
    d = done("info", tmp_path / "m.npz")
    assert d["kind"] == "skinning"
    assert d["influence_histogram"] == [11, 1, 0, 0]
    assert d["bones_without_vertices"] == 1
    assert d["orthonormality_error"] == 0
    assert "3 (rigid), 1 move nothing" in run("info", tmp_path / "m.npz")[1]


def test_info_of_a_scaled_static_node_says_scale_not_off_orthonormal(run, done, wave, tmp_path):
    model = model_of(wave, bones=1)
    model.transforms[..., :3] *= 0.01
    model = dataclasses.replace(model, bone_model="similarity")
    ssdr.save(model, tmp_path / "m.npz")
    d = done("info", tmp_path / "m.npz")
    assert d["orthonormality_error"] < 1e-12
    assert d["smallest_stretch"] == pytest.approx(0.01)
    assert d["largest_stretch"] == pytest.approx(0.01)
    model.transforms[1:, :, 0] *= 3
    ssdr.save(dataclasses.replace(model, bone_model="affine"), tmp_path / "a.npz")
    assert "stretch 0.01 to 0.03, determinant from 1e-06" in run("info", tmp_path / "a.npz")[1]


def test_info_of_a_skinning_counts_seams(run, done, seam, tmp_path):
    model = model_of(seam)
    ssdr.save(model, tmp_path / "m.npz")
    welded, report = ssdr.MeshSequence(model.skin(), model.faces).weld()
    assert report.before > report.after
    d = done("info", tmp_path / "m.npz")
    assert d["seams"] == report.before - report.after
    assert "--read weld=true merges them" in run("info", tmp_path / "m.npz")[1]
    # Vertices at one place that bones pull apart are no seam.
    rest = model.rest
    same = [np.flatnonzero((rest == point).all(axis=1)) for point in rest]
    indices = model.indices.copy()
    indices[next(k for k in same if len(k) > 1)[0], 0] = 1
    ssdr.save(dataclasses.replace(model, indices=indices), tmp_path / "m.npz")
    assert done("info", tmp_path / "m.npz")["seams"] == d["seams"] - 1
    ssdr.save(model_of(welded), tmp_path / "w.npz")
    assert done("info", tmp_path / "w.npz")["seams"] == 0


def test_info_of_a_hierarchy(run, done, tmp_path):
    ssdr.save(creature(), tmp_path / "m.npz")
    tree = done("info", tmp_path / "m.npz")["hierarchy"]
    assert tree["roots"] == ["hip", "ball"]
    assert (tree["joints"], tree["depth"], tree["rigid"]) == (7, 3, True)
    assert tree["parents"] == list(PARENTS)
    assert "7 joints, 3 deep, roots: hip, ball" in run("info", tmp_path / "m.npz")[1]
    loose = creature(loose=True)
    ssdr.save(loose, tmp_path / "m.npz")
    tree = done("info", tmp_path / "m.npz")["hierarchy"]
    assert tree["largest_gap"] == pytest.approx(loose.joint_gaps().max())
    assert not tree["rigid"]
    assert f"at {tree['joint_of_largest_gap']}" in run("info", tmp_path / "m.npz")[1]
    ssdr.save(flat(loose), tmp_path / "m.npz")
    assert done("info", tmp_path / "m.npz")["hierarchy"] is None
    assert "\nhierarchy" not in run("info", tmp_path / "m.npz")[1]
