"""Rigs through glTF and USD: skeleton, weights, motion and surface come back as they were."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.blender_scene import needs_blender
from helpers.rig_model import tube
from helpers.rig_tree import NAMES, PARENTS, creature, differences, flat, tree_of
from helpers.stages import items
from ssdr.io.file_errors import SceneBudget

FILES = ["a model.glb", "a.gltf", "a.usda", "a.usdc"]
FBX = pytest.param("a.fbx", marks=[pytest.mark.slow, needs_blender])


@pytest.fixture(params=FILES)
def path(request, tmp_path):
    if "usd" in request.param:
        pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")
    return tmp_path / request.param


with_fbx = pytest.mark.parametrize("path", [*FILES, FBX], indirect=True)


@with_fbx
@pytest.mark.parametrize("kind", [{}, {"loose": True}, {"scaled": True}])
def test_the_tree_comes_back(path, kind):
    model = creature(**kind)
    report = ssdr.save(model, path)
    back = ssdr.load_skinning(path)
    assert tree_of(back) == tree_of(model)
    assert path.suffix == ".fbx" or back.names() == NAMES
    bound = 2e-3 if "scaled" in kind and path.suffix.startswith(".usd") else 1e-6
    got = differences(model, back)
    assert max(got["joints"], got["vertices"]) < bound
    # FBX holds angles as float32 degrees
    assert max(got.values()) < (8e-6 if path.suffix == ".fbx" else bound)
    assert report.max_error < bound * (5 if path.suffix == ".fbx" else 3.2)


@with_fbx
def test_a_flat_model_has_no_hierarchy_when_it_comes_back(path):
    ssdr.save(flat(creature()), path)
    assert ssdr.load_skinning(path).parents is None


@with_fbx
@pytest.mark.parametrize("names", [("a",) * 7, ("a b", "a b", "1", "", "ü", "x/y", "a b")])
def test_names_that_repeat_or_are_odd_are_made_different(path, names):
    ssdr.save(dataclasses.replace(creature(), bone_names=names), path)
    back = ssdr.load_skinning(path)
    assert len(set(back.names())) == len(names)
    assert np.sum(back.parents < 0) == 2
    assert path.suffix == ".fbx" or back.parents.tolist() == list(PARENTS)


@with_fbx
def test_bones_without_length(path):
    model = creature()
    at = model.joint_positions.copy()
    at[4] = at[2]  # the leg begins where the hip does
    model = dataclasses.replace(model, joint_positions=at)
    ssdr.save(model, path)
    got = differences(model, ssdr.load_skinning(path))
    assert max(got["joints"], got["vertices"]) < 1e-6


def test_into_a_template_the_tree_goes_too(tmp_path):
    model, path, other = creature(), tmp_path / "a.glb", tmp_path / "b.glb"
    ssdr.save(model, path)
    read = ssdr.load_skinning(path)
    ssdr.save(read, other, template=path)
    back = ssdr.load_skinning(other)
    assert tree_of(back) == tree_of(model)
    assert max(differences(model, back).values()) < 1e-6
    ssdr.save(flat(read), other, template=path)
    assert ssdr.load_skinning(other).parents is None


def test_keyframes_alone_are_written(path):
    model = tube(frames=21)
    keys = np.zeros((21, 5), dtype=bool)
    keys[[0, 20]] = True
    keys[::4, 1] = True
    report = ssdr.save(dataclasses.replace(model, keyframes=keys), path)
    back = ssdr.load_skinning(path)
    assert (back.n_frames, back.fps) == (21, 24)
    kept = back.transforms[::4, 1], model.transforms[::4, 1]
    np.testing.assert_allclose(*kept, atol=2e-6)
    gap = back.skin(dtype=np.float64) - model.skin()
    assert report.error == pytest.approx(np.sqrt((gap**2).sum(axis=2).mean()), rel=1e-4)
    assert report.error > 1e-3
    if path.suffix.startswith(".usd"):  # all joints of a frame at once: a key of one is one of all
        from pxr import Usd, UsdSkel

        stage = Usd.Stage.Open(str(path))
        (animation,) = items(stage, UsdSkel.Animation)
        stored = animation.GetRotationsAttr().GetTimeSamples()
        assert stored == [0, 4, 8, 12, 16, 20]


def test_a_budget_grows_with_the_file_and_ends_at_its_limit():
    budget = SceneBudget("a.glb", 10)
    assert budget.most == 1 << 30
    budget.grow(1 << 22)
    assert budget.most == 1000 << 22
    budget.spend(1 << 31, "half")
    with pytest.raises(ssdr.FormatError, match=r"a\.glb: the rest needs 4294967296 bytes"):
        budget.spend(1 << 31, "the rest")
    fixed = SceneBudget("a.glb", 1 << 30, 100)
    fixed.grow(1 << 30)
    assert fixed.most == 100
