"""npz: everything goes round, and what is missing or wrong is named."""

from __future__ import annotations

import dataclasses
import zipfile

import numpy as np
import pytest

import ssdr
from helpers.rig_tree import creature
from ssdr import FormatError


def test_npz_stores_a_normal_a_vertex_where_that_is_enough(tmp_path, wave, seam):
    model = ssdr.initialize(wave, bones=2)
    ssdr.save(model, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as archive:
        assert archive["vertex_normals"].shape == (12, 3)
        assert "surface_normals" not in archive.files
        whole = {name: archive[name] for name in archive.files if name != "vertex_normals"}
    back = ssdr.load_skinning(tmp_path / "a.npz").surface.normals
    np.testing.assert_array_equal(back, model.surface.normals, strict=True)
    welded, _ = seam.weld()
    ssdr.save(welded, tmp_path / "c.npz")
    with np.load(tmp_path / "c.npz") as archive:  # vertices of the seam have two
        assert "vertex_normals" not in archive.files
    whole["faces"] = whole["faces"] + 4
    np.savez(tmp_path / "d.npz", vertex_normals=np.zeros((12, 3), np.float32), **whole)
    with pytest.raises(FormatError, match=r"d\.npz"):
        ssdr.load_skinning(tmp_path / "d.npz")


def test_npz_is_read_by_numpy_and_numpy_is_read(tmp_path, wave):
    ssdr.save(wave, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert {"vertices", "faces", "fps"} <= set(archive.files)
        np.testing.assert_array_equal(archive["vertices"], wave.vertices, strict=True)
    np.savez(
        tmp_path / "b.npz",
        vertices=np.asfortranarray(wave.vertices.astype(">f8")),
        faces=wave.faces.astype(np.uint16),
        fps=[12.5],
        names=["unrelated"],
    )
    back = ssdr.load(tmp_path / "b.npz")
    np.testing.assert_array_equal(back.vertices, wave.vertices)
    assert back.vertices.dtype == np.float64
    assert back.vertices.flags.c_contiguous
    assert not back.is_lazy
    assert (back.fps, back.name) == (12.5, "b")
    np.savez(tmp_path / "c.npz", vertices=wave.vertices, faces=wave.faces)
    assert ssdr.load(tmp_path / "c.npz").fps == 24


def test_npz_has_the_same_bytes_every_time(tmp_path, seam, skinned):
    for thing in (seam, skinned):
        for name in ("a.npz", "b.npz"):
            ssdr.save(thing, tmp_path / name)
        assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
        with zipfile.ZipFile(tmp_path / "a.npz") as archive:
            assert {i.date_time for i in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_npz_keeps_a_skinning(tmp_path, skinned, seam, dtype):
    keys = np.zeros((6, 5), dtype=bool)
    keys[[0, -1]] = True
    weights = skinned.weights.astype(dtype)
    full = dataclasses.replace(
        skinned,
        weights=weights,
        keyframes=keys,
        bone_names=("hip", "🦴", "knee", "toe", "ear"),
        vertex_map=np.arange(12).repeat(2),
        bone_model="affine",
        surface=ssdr.Surface(materials=seam.surface.materials),
    )
    for thing in (skinned, creature(frames=3), full):
        report = ssdr.save(thing, tmp_path / "s.npz")
        back = ssdr.load_skinning(tmp_path / "s.npz")
        assert report.error == 0
        for field in ("rest", "indices", "weights", "transforms", "faces", "keyframes",
                      "vertex_map", "parents", "joint_positions"):  # fmt: skip
            own, found = getattr(thing, field), getattr(back, field)
            assert (own is None) == (found is None)
            if own is not None:
                np.testing.assert_array_equal(found, own, strict=True)
        for field in ("bone_model", "bone_names", "name", "fps"):
            assert getattr(back, field) == getattr(thing, field)
    assert back.surface.materials[1].texture == seam.surface.materials[1].texture


def test_a_skinning_loads_as_its_vertices_and_at_another_size(tmp_path, skinned):
    ssdr.save(creature(frames=3), tmp_path / "a.npz")
    larger = ssdr.load_skinning(tmp_path / "a.npz", scale=2.0)
    np.testing.assert_array_equal(larger.joint_positions, 2 * creature().joint_positions)
    assert larger.joint_gaps().max() < 1e-12
    ssdr.save(skinned, tmp_path / "s.npz")
    baked = ssdr.load(tmp_path / "s.npz")
    assert baked.fps == 30
    np.testing.assert_array_equal(baked.vertices, skinned.skin(), strict=True)
    assert ssdr.load(tmp_path / "s.npz", fps=60).fps == 60


@pytest.mark.parametrize(("linear", "shift"), [(1, 1e308), (1e5, 0)])
def test_a_skinning_whose_vertices_are_no_numbers_is_refused(tmp_path, linear, shift):
    """Each of its own numbers is one."""
    transforms = np.tile(np.eye(3, 4) * linear, (2, 1, 1, 1))
    transforms[..., 3] = shift
    corner = np.full((4, 3), 1e308)
    model = ssdr.Skinning(corner, np.zeros((4, 1), int), np.ones((4, 1)), transforms,
                          bone_model="affine")  # fmt: skip
    ssdr.save(model, tmp_path / "a.npz")
    with pytest.raises(FormatError, match=r"a\.npz: vertices: expected finite numbers, got inf"):
        ssdr.load(tmp_path / "a.npz")
    with pytest.raises(ssdr.InputError, match="vertices: expected finite numbers, got inf"):
        ssdr.save(model, tmp_path / "a.npy")
    with pytest.raises(ssdr.InputError, match=r"model: expected numbers of less than 1e\+100"):
        ssdr.view(model, path=tmp_path / "a.html")
