"""Shapes of a rest pose: how they are skinned, kept, counted, and refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers import naive
from helpers.rig_model import largest_distance, tube
from ssdr.io import in_space


def shaped(count=3, still=slice(0, 0)):
    model, rng = tube(), np.random.default_rng(0)
    moved = 0.05 * rng.normal(size=(count, model.n_vertices, 3))
    moved[still] = 0
    moved[0, 5:] = 0
    names = [f"s{k}" for k in range(count)]
    amounts = rng.random((model.n_frames, count))
    return ssdr.ShapedSkinning(model, ssdr.Shapes(moved, amounts, names=names))


def test_skin_adds_shapes_before_bones():
    model = shaped()
    for t in (0, 7):
        rest, bones = model.skinning.rest.copy(), model.skinning
        for s in range(3):
            rest += model.shapes.amounts[t, s] * model.shapes.displacements[s]
        moves = bones.transforms[t : t + 1]
        expected = naive.skin(rest, bones.indices, bones.weights, moves)
        np.testing.assert_allclose(model.skin([t]), expected, atol=1e-12)
    assert model.skin([], dtype=np.float32).shape == (0, model.n_vertices, 3)
    assert "S=3" in repr(model)


def test_npz_keeps_all(tmp_path):
    model = shaped()
    ssdr.save(model, tmp_path / "a.npz")
    back = ssdr.load_skinning(tmp_path / "a.npz")
    assert back.shapes.names == ("s0", "s1", "s2")
    np.testing.assert_array_equal(back.shapes.displacements, model.shapes.displacements)
    np.testing.assert_array_equal(back.skin(), model.skin())
    np.testing.assert_array_equal(ssdr.load(tmp_path / "a.npz").vertices, model.skin())
    arrays = dict(np.load(tmp_path / "a.npz"))
    bad = {
        "shape_vertices": arrays["shape_vertices"] + 300,
        "shape_displacements": arrays["shape_displacements"][1:],
        "shape_amounts": arrays["shape_amounts"][1:],
    }
    for name, values in bad.items():
        np.savez(tmp_path / "b.npz", **{**arrays, name: values})
        with pytest.raises(ssdr.FormatError, match="shape"):
            ssdr.load_skinning(tmp_path / "b.npz")
    for name in bad:
        np.savez(tmp_path / "b.npz", **{k: v for k, v in arrays.items() if k != name})
        with pytest.raises(ssdr.FormatError, match=f"shapes without {name}"):
            ssdr.load_skinning(tmp_path / "b.npz")


def test_usd_blend_shapes(tmp_path):
    pytest.importorskip("pxr")
    from helpers.rig_model import baked_by_usd

    model = shaped(still=2)
    ssdr.save(model, tmp_path / "a.usda")
    back = ssdr.load_skinning(tmp_path / "a.usda")
    assert back.shapes.names == ("s0", "s1", "s2")
    assert largest_distance(back.skin(), model.skin()) < 1e-5
    np.testing.assert_array_equal(back.shapes.moved, model.shapes.moved)
    truth = baked_by_usd(tmp_path / "a.usda", range(model.n_frames))
    assert largest_distance(model.skin(), truth) < 1e-5


def test_other_space():
    bones = dataclasses.replace(tube(), space=ssdr.Space(1.0, "y"))
    model = dataclasses.replace(shaped(), skinning=bones)
    moved = in_space(model, ssdr.Space(0.01, "z"))
    expected = 100 * model.skin()[..., [0, 2, 1]] * [1, -1, 1]
    np.testing.assert_allclose(moved.skin(), expected, atol=1e-9)
    assert moved.space == ssdr.Space(0.01, "z")


def test_clips_are_taken_out_with_their_amounts():
    model = shaped()
    clips = ssdr.Clip("a", 0, 5, 24), ssdr.Clip("b", 5, 20, 24)
    model = dataclasses.replace(model, skinning=dataclasses.replace(model.skinning, clips=clips))
    np.testing.assert_array_equal(model.select("b").skin(), model.skin()[5:])
