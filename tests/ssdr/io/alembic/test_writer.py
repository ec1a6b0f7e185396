"""Alembic caches that the package writes, read back."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest

import ssdr
from ssdr.normals import corner_normals

pytest.importorskip("alembic3d", reason="alembic3d is not installed")


@pytest.mark.parametrize("fps", [24000 / 1001, 25.0, 30.0, 60.0])
def test_a_sequence_comes_back(tmp_path, wave, fps):
    wave = dataclasses.replace(wave, fps=fps)
    report = ssdr.save(wave, tmp_path / "a.abc")
    assert (report.error, report.bytes) == (None, report.path.stat().st_size)
    back = ssdr.load(report.path)
    np.testing.assert_array_equal(back.vertices, wave.vertices)
    np.testing.assert_array_equal(back.faces, wave.faces)
    assert back.fps == pytest.approx(fps, rel=1e-12)
    assert (back.name, back.surface) == ("sheet", None)


def test_uvs_normals_and_names_of_materials_come_back(tmp_path, seam):
    back = ssdr.load(ssdr.save(seam, tmp_path / "a.abc").path)
    np.testing.assert_array_equal(back.surface.uv, seam.surface.uv)
    truth = corner_normals(seam.vertices[0], seam.faces, seam.surface)
    np.testing.assert_allclose(back.surface.normals, truth, atol=1e-6)
    names = [m.name for m in back.surface.materials]
    own = [seam.surface.materials[k].name for k in seam.surface.material_index]
    assert [names[k] for k in back.surface.material_index] == own
    one = dataclasses.replace(seam.surface, material_index=None)
    ssdr.save(dataclasses.replace(seam, surface=one), tmp_path / "a.abc")
    assert [m.name for m in ssdr.load(tmp_path / "a.abc").surface.materials] == ["red"]


def test_a_model_is_baked(tmp_path, skinned):
    clips = (ssdr.Clip("walk", 0, 4, 30.0), ssdr.Clip("jump", 4, 6, 30.0))
    report = ssdr.save(dataclasses.replace(skinned, clips=clips), tmp_path / "a.abc")
    assert "clips are not kept apart: walk from frame 0, jump from frame 4" in report.note
    back = ssdr.load(report.path).vertices
    np.testing.assert_array_equal(back, skinned.skin().astype(np.float32))


def test_points_and_names_of_any_kind(tmp_path):
    cloud = ssdr.MeshSequence(np.random.default_rng(0).normal(size=(3, 5, 3)), name="a/b ü")
    report = ssdr.save(cloud, tmp_path / "a.abc")
    assert 0 < report.error < 1e-7
    back = ssdr.load(report.path)
    np.testing.assert_array_equal(back.vertices, cloud.vertices.astype(np.float32))
    assert (back.name, len(back.faces)) == ("a_b ü", 0)


def test_a_coordinate_beyond_float32_leaves_no_file(tmp_path, wave):
    far = ssdr.MeshSequence(wave.vertices.astype(np.float64) * 1e39, wave.faces)
    with pytest.raises(ssdr.InputError, match="float32"):
        ssdr.save(far, tmp_path / "a.abc")
    assert not list(tmp_path.iterdir())


def test_the_extra_is_named_before_any_work(tmp_path, wave, monkeypatch):
    monkeypatch.setitem(sys.modules, "alembic3d", None)
    with pytest.raises(ssdr.MissingDependencyError, match=r"pip install \"alembic3d"):
        ssdr.save(wave, tmp_path / "a.abc")
    assert not list(tmp_path.iterdir())
