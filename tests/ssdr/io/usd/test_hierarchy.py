"""UsdSkel: joints hang on each other by their paths, and come back as they were."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.rig_model import baked_by_usd
from helpers.rig_tree import NAMES, PARENTS, creature, differences, flat, tree_of

pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")


def _skeleton(path):
    from pxr import Usd, UsdSkel

    stage = Usd.Stage.Open(str(path))
    return stage, next(UsdSkel.Skeleton(p) for p in stage.Traverse() if p.IsA(UsdSkel.Skeleton))


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
@pytest.mark.parametrize("kind", [{}, {"loose": True}])
def test_the_tree_comes_back(tmp_path, kind, suffix):
    model = creature(**kind)
    path = tmp_path / f"a{suffix}"
    ssdr.save(model, path)
    back = ssdr.load_skinning(path)
    assert back.names() == NAMES
    assert back.parents.tolist() == list(PARENTS)
    assert max(differences(model, back).values()) < 1e-6
    seen = baked_by_usd(path, range(model.n_frames))
    assert np.abs(seen - model.skin()).max() < 1e-6 * 3.2


def test_scales_cost_half_precision(tmp_path):
    model = creature(scaled=True)
    report = ssdr.save(model, tmp_path / "a.usda")
    back = ssdr.load_skinning(tmp_path / "a.usda")
    assert back.parents.tolist() == list(PARENTS)
    assert differences(model, back)["vertices"] < 2e-3
    assert report.max_error < 2e-3 * 3.2


def test_joints_are_paths_with_local_transforms(tmp_path):
    from pxr import UsdSkel

    model = creature()
    ssdr.save(model, tmp_path / "a.usda")
    _, skeleton = _skeleton(tmp_path / "a.usda")
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


def test_local_transforms_are_those_that_usd_computes(tmp_path):
    from pxr import Usd, UsdSkel

    model = creature(loose=True)
    ssdr.save(model, tmp_path / "a.usda")
    stage, skeleton = _skeleton(tmp_path / "a.usda")
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(stage.GetDefaultPrim()), Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(skeleton)
    names = [str(n) for n in skeleton.GetJointNamesAttr().Get()]
    local = model.local_transforms()
    for t in (0, 4, 9):
        found = np.swapaxes(np.array(query.ComputeJointLocalTransforms(t)), 1, 2)[:, :3]
        order = [NAMES.index(n) for n in names]
        np.testing.assert_allclose(found, local[t, order], atol=1e-6)


def test_parents_that_come_first_need_no_order_of_the_mesh(tmp_path):
    ssdr.save(creature(), tmp_path / "a.usda")
    assert "skel:joints" in (tmp_path / "a.usda").read_text()
    model = creature()
    chain = dataclasses.replace(model, parents=[-1, 0, 1, 0, 2, -1, 4])
    ssdr.save(chain, tmp_path / "b.usda")
    assert "skel:joints" not in (tmp_path / "b.usda").read_text()
    back = ssdr.load_skinning(tmp_path / "b.usda")
    assert back.parents.tolist() == chain.parents.tolist()
    assert max(differences(chain, back).values()) < 1e-6


def test_names_that_are_no_identifiers_or_repeat(tmp_path):
    names = ("a b", "a b", "1", "", "ü", "x/y", "a b")
    ssdr.save(dataclasses.replace(creature(), bone_names=names), tmp_path / "a.usda")
    back = ssdr.load_skinning(tmp_path / "a.usda")
    assert len(set(back.names())) == len(names)
    assert back.parents.tolist() == list(PARENTS)


def test_a_flat_model_has_no_hierarchy_when_it_comes_back(tmp_path):
    ssdr.save(flat(creature()), tmp_path / "a.usda")
    assert ssdr.load_skinning(tmp_path / "a.usda").parents is None


def test_a_joint_that_no_mesh_names_is_passed_over(tmp_path):
    """The mesh's own list of joints leaves the leg out: the foot hangs on the hip."""
    from pxr import Usd, UsdGeom, UsdSkel, Vt

    model = creature()
    dense = model.dense_weights()
    dense[:, 6] += dense[:, 4]
    dense[:, 4] = 0
    order = np.argsort(-dense, axis=1, kind="stable")[:, :2]
    model = dataclasses.replace(
        model, indices=order, weights=np.take_along_axis(dense, order, axis=1)
    )
    ssdr.save(model, tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    mesh = next(p for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
    binding = UsdSkel.BindingAPI(mesh)
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


def test_into_a_template_the_tree_goes_too(tmp_path):
    model = creature()
    ssdr.save(model, tmp_path / "a.usda")
    read = ssdr.load_skinning(tmp_path / "a.usda")
    ssdr.save(read, tmp_path / "b.usda", template=tmp_path / "a.usda")
    back = ssdr.load_skinning(tmp_path / "b.usda")
    assert tree_of(back) == tree_of(model)
    assert max(differences(model, back).values()) < 1e-6
    ssdr.save(flat(read), tmp_path / "c.usda", template=tmp_path / "a.usda")
    assert ssdr.load_skinning(tmp_path / "c.usda").parents is None


def test_the_up_axis_turns_joints_too(tmp_path):
    model = creature()
    ssdr.save(model, tmp_path / "a.usda", up="z")
    back = ssdr.load_skinning(tmp_path / "a.usda", up="y")
    assert back.joint_gaps().max() < 1e-5
    np.testing.assert_allclose(
        back.joint_positions, model.joint_positions[:, [0, 2, 1]] * [1, 1, -1], atol=1e-6
    )
