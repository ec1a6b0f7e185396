"""Caches that Blender writes, read by alembic3d and by Blender: the same meshes and times."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.alembic_cache import moving, one_mesh, uniform
from helpers.alembic_scenes import SCENES, write_caches
from helpers.blender_scene import needs_blender
from ssdr.io.alembic import reader

pytestmark = [pytest.mark.slow, needs_blender]
RATES = {"television": 24000 / 1001, "pal": 25, "thirty": 30, "sixty": 60, "slow": 5, "two": 25}
RATES |= {"early": 30, "shutter": 48}


@pytest.fixture(scope="module")
def caches(tmp_path_factory):
    return write_caches(tmp_path_factory.mktemp("caches"))


@pytest.fixture
def blender(monkeypatch):
    """Read a file by Blender."""

    def load(path, **options):
        with monkeypatch.context() as without:
            without.setattr(reader, "_installed", lambda: False)
            return ssdr.load(path, **options)

    return load


@pytest.mark.parametrize("name", SCENES)
def test_caches_of_blender_are_read_alike(caches, blender, name):
    pytest.importorskip("alembic3d", reason="alembic3d is not installed")
    ours, theirs = ssdr.load(caches[name]), blender(caches[name])
    assert ours.fps == pytest.approx(RATES.get(name, 24), rel=1e-9)
    assert (ours.fps, ours.name, ours.clip) == (theirs.fps, theirs.name, theirs.clip)
    assert len(ours) == {"still": 1, "one frame": 1, "early": 3, "shutter": 12}.get(name, 6)
    assert ours.vertices.shape == theirs.vertices.shape
    np.testing.assert_allclose(ours.vertices, theirs.vertices, atol=1e-6)
    if name == "polygons":  # Blender cuts a pentagon otherwise
        assert len(ours.faces) == len(theirs.faces)
        return
    np.testing.assert_array_equal(ours.faces, theirs.faces)
    own, other = ours.surface, theirs.surface
    assert [m.name for m in own.materials] == [m.name for m in other.materials]
    for field in ("uv", "normals", "material_index"):
        found, truth = getattr(own, field), getattr(other, field)
        if truth is not None and (name, field) != ("subdivision", "normals"):  # the cage has none
            np.testing.assert_allclose(found, truth, atol=1e-6)


def test_names_of_meshes_are_listed_alike(caches, monkeypatch):
    pytest.importorskip("alembic3d", reason="alembic3d is not installed")
    for name in ("two", "parents", "instances"):
        ours = ssdr.io.list_meshes(caches[name])
        with monkeypatch.context() as without:
            without.setattr(reader, "_installed", lambda: False)
            assert ssdr.io.list_meshes(caches[name]) == ours
        assert len(ours) == 2


def test_a_changing_topology_is_refused_both_ways(caches, blender):
    pytest.importorskip("alembic3d", reason="alembic3d is not installed")
    with pytest.raises(ssdr.FormatError, match=r"/melt/melt_mesh: .*in frame 3 \(0\.166667 s\)"):
        ssdr.load(caches["changing"])
    with pytest.raises(ssdr.FormatError, match="melt: 3 vertices at first, 12 in frame 3"):
        blender(caches["changing"])


def test_blender_resamples_with_a_word(tmp_path, blender):
    points = moving(4)
    path = one_mesh(tmp_path / "a.abc", points, (None, [0.3, 0.37, 0.5, 0.77]))
    with pytest.warns(ssdr.SsdrWarning, match="3 keys of the clip a lie between") as said:
        theirs = blender(path)
    with pytest.warns(ssdr.SsdrWarning) as own:
        ours = ssdr.load(path)
    assert str(own[0].message) == str(said[0].message)
    assert (len(ours), ours.fps) == (len(theirs), theirs.fps)
    np.testing.assert_allclose(ours.vertices, theirs.vertices, atol=1e-5)


@pytest.mark.parametrize("fps", [24000 / 1001, 25.0, 30.0, 60.0])
def test_blender_shows_every_sample_from_frame_1001_on(tmp_path, blender, fps):
    points = moving(5)
    theirs = blender(one_mesh(tmp_path / "a.abc", points, uniform(fps, 1001 / fps)))
    assert theirs.fps == pytest.approx(fps, rel=1e-9)
    np.testing.assert_array_equal(theirs.vertices, points)


def test_blender_plays_what_is_written(tmp_path, blender, seam):
    pytest.importorskip("alembic3d", reason="alembic3d is not installed")
    path = ssdr.save(seam, tmp_path / "a.abc").path
    ours, theirs = ssdr.load(path), blender(path)
    assert (len(theirs), theirs.fps) == (4, 25.0)
    np.testing.assert_array_equal(theirs.vertices, seam.vertices)
    np.testing.assert_array_equal(theirs.faces, seam.faces)
    np.testing.assert_allclose(theirs.surface.uv, seam.surface.uv, atol=1e-6)
    np.testing.assert_allclose(theirs.surface.normals, ours.surface.normals, atol=1e-4)
    assert {m.name for m in theirs.surface.materials} == {"red", "skin"}
