"""UsdSkel: joints hang on each other by their paths; usd-core computes the same from them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.rig_model import baked_by_usd
from helpers.rig_tree import NAMES, PARENTS, creature, tree_of
from helpers.stages import items

pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")
from pxr import Usd, UsdGeom, UsdSkel, Vt


def opened(path, **kind):
    model = creature(**kind)
    ssdr.save(model, path)
    stage = Usd.Stage.Open(str(path))
    return model, stage, items(stage, UsdSkel.Skeleton)[0]


def test_joints_are_paths_with_local_transforms(tmp_path):
    model, _, skeleton = opened(tmp_path / "a.usda")
    joints = [str(j) for j in skeleton.GetJointsAttr().Get()]
    assert set(joints) == {
        *("hip", "hip/chest", "hip/chest/arm_L", "hip/chest/arm_R", "hip/leg", "hip/leg/foot"),
        "ball",
    }
    valid = UsdSkel.Topology(joints).Validate()
    assert valid[0] if isinstance(valid, tuple) else valid, valid
    number = {str(n): k for k, n in enumerate(skeleton.GetJointNamesAttr().Get())}
    binds = np.array(skeleton.GetBindTransformsAttr().Get())[:, 3, :3]
    rests = np.array(skeleton.GetRestTransformsAttr().Get())[:, 3, :3]
    for bone, above in enumerate(PARENTS):
        k = number[NAMES[bone]]
        np.testing.assert_allclose(binds[k], model.joint_positions[bone], atol=1e-6)
        start = model.joint_positions[above] if above >= 0 else 0
        expected = model.joint_positions[bone] - start
        np.testing.assert_allclose(rests[k], expected, atol=1e-6)


def test_usd_computes_the_same_local_transforms_and_vertices(tmp_path):
    model, stage, skeleton = opened(tmp_path / "a.usda", loose=True)
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(stage.GetDefaultPrim()), Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(skeleton)
    order = [NAMES.index(str(n)) for n in skeleton.GetJointNamesAttr().Get()]
    local = model.local_transforms()
    for t in (0, 4, 9):
        found = np.swapaxes(np.array(query.ComputeJointLocalTransforms(t)), 1, 2)[:, :3]
        np.testing.assert_allclose(found, local[t, order], atol=1e-6)
    seen = baked_by_usd(tmp_path / "a.usda", range(model.n_frames))
    assert np.abs(seen - model.skin()).max() < 1e-6 * 3.2


def test_a_joint_that_no_mesh_names_is_passed_over(tmp_path):
    """The mesh's own list of joints leaves the leg out: the foot hangs on the hip."""
    dense = creature().dense_weights()
    dense[:, 6] += dense[:, 4]
    dense[:, 4] = 0
    order = np.argsort(-dense, axis=1, kind="stable")[:, :2]
    weights = np.take_along_axis(dense, order, axis=1)
    model = dataclasses.replace(creature(), indices=order, weights=weights)
    ssdr.save(model, tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    binding = UsdSkel.BindingAPI(items(stage, UsdGeom.Mesh)[0])
    joints = [str(j) for j in binding.GetJointsAttr().Get()]
    kept = [j for j in joints if not j.endswith("/leg")]
    index = np.array(binding.GetJointIndicesPrimvar().Get())
    binding.GetJointIndicesPrimvar().Set(
        Vt.IntArray([kept.index(joints[k]) if joints[k] in kept else 0 for k in index])
    )
    binding.GetJointsAttr().Set(kept)
    stage.GetRootLayer().Save()
    back = ssdr.load_skinning(tmp_path / "a.usda")
    assert tree_of(back)["foot"] == "hip"
    assert np.abs(back.skin() - model.skin()).max() < 1e-5
