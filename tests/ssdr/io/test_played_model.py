"""The rig that engines play: weights in steps, rotations between frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

import ssdr
from helpers.glb import rebuild
from helpers.rig_model import tube
from helpers.rig_tree import PARENTS, creature, flat, tree_of
from ssdr.io.frame_rates import frame_rate, off_frames
from ssdr.io.played_model import as_played, quantise, weight_values
from ssdr.mesh.clips import unique_names
from ssdr.model.transforms import joint_gaps


@given(st.integers(0, 2**32 - 1), st.sampled_from(["float32", "uint16", "uint8"]))
def test_quantise_keeps_the_sum(seed, storage):
    rng = np.random.default_rng(seed)
    weights = -np.sort(-rng.dirichlet(np.full(6, 0.3), size=50), axis=1)
    weights[weights < 1e-3] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    _, stored = quantise(np.zeros(weights.shape, np.int32), weights, storage)
    np.testing.assert_allclose(weight_values(stored).sum(axis=1), 1, atol=1e-7)
    assert (stored[weights == 0] == 0).all()


def test_between_frames_against_scipy():
    model = tube(frames=12)
    rig = as_played(model)
    total = 0.0
    for frame in range(11):
        moved = np.empty((model.n_bones, 3, 4))
        for bone in range(model.n_bones):
            turns = Rotation.from_matrix(model.transforms[frame : frame + 2, bone, :, :3])
            middle = Slerp([0, 1], turns)(0.5).as_matrix()
            c = model.centroids()[bone]
            ends = model.transforms[frame : frame + 2, bone, :, :3] @ c
            ends = ends + model.transforms[frame : frame + 2, bone, :, 3]
            moved[bone, :, :3] = middle
            moved[bone, :, 3] = ends.mean(axis=0) - middle @ c
        shown = ssdr.skin(model.rest, model.indices, model.weights, moved)
        total += ((shown - model.skin([frame, frame + 1]).mean(axis=0)) ** 2).sum(axis=1).mean()
    assert rig.error(model, between=True)[0] == pytest.approx(np.sqrt(total / 11), rel=1e-4)
    assert as_played(tube(frames=1)).error(model, between=True)[0] == 0


def test_quaternions_do_not_flip():
    rig = as_played(tube(frames=60, bones=3))
    assert (np.sum(rig.rotations[1:] * rig.rotations[:-1], axis=-1) > 0).all()
    assert np.sum(rig.rotations[0] * rig.rotations[-1], axis=-1).min() < 0  # a flip was there


def test_frame_rate():
    ticks = np.arange(50)
    assert frame_rate((ticks / 24).astype(np.float32).astype(float)) == 24
    assert frame_rate(ticks * 1001 / 30000) == pytest.approx(30000 / 1001)
    assert frame_rate(np.array([0, 0.5, 1.25, 2.0])) == 24
    assert frame_rate(np.array([0.0, 0.2, 1.4])) == 25
    assert frame_rate(np.zeros(1)) is None
    # one odd gap among keys a frame apart: a rate that hits every key would be five times theirs
    fox = np.r_[np.arange(17), 20.8 + np.arange(8)] / 24
    assert frame_rate(fox) == 24
    assert len(off_frames(fox, 0.0, 24)) == 8
    # no such rate where keys follow each other at two
    assert frame_rate(np.unique(np.r_[np.arange(25) / 24, np.arange(31) / 30])) == 120
    assert unique_names(["a", "a", "", "a_1", "a"]) == ("a", "a_1", "bone", "a_1_1", "a_2")


def test_names_that_are_all_alike_are_each_made_once():
    """A file of 2 MB took minutes."""
    made = 0

    class Counted(str):
        def __format__(self, how):
            nonlocal made
            made += 1
            return str(self)

    assert unique_names([Counted("a")] * 3000)[-1] == "a_2999"
    assert made == 2999


def test_a_rigid_joint_stores_a_rotation_alone():
    rig = as_played(creature())
    roots = [a < 0 for a in PARENTS]
    assert rig.translating.tolist() == roots
    assert as_played(creature(loose=True)).translating.all()
    np.testing.assert_allclose(rig.centers, creature().joint_positions, atol=1e-7)
    still = creature().pose(np.tile(np.eye(3), (4, len(PARENTS), 1, 1)))
    assert not as_played(still).translating.any()  # roots that stay have no keys either


def test_between_frames_joints_stay_together():
    """Local interpolation, frame by frame and bone by bone, as an engine does it."""
    model = creature()
    rig = as_played(model)
    local = model.local_transforms()
    got = rig.matrices(np.array([3.5]))[0]
    frames = {}
    for b in (2, 5, 0, 4, 1, 3, 6):
        m = np.eye(4)
        m[:3, :3] = Slerp([0, 1], Rotation.from_matrix(local[3:5, b, :, :3]))(0.5).as_matrix()
        m[:3, 3] = local[3:5, b, :, 3].mean(axis=0)
        frames[b] = m if PARENTS[b] < 0 else frames[PARENTS[b]] @ m
        bind = np.eye(4)
        bind[:3, 3] = -model.joint_positions[b]
        np.testing.assert_allclose(got[b], (frames[b] @ bind)[:3], atol=1e-6)
    tree = model.parents, model.joint_positions
    assert joint_gaps(got, *tree).max() < 1e-6
    assert joint_gaps(as_played(flat(model)).matrices(np.array([3.5])), *tree).max() > 1e-3


def without_gltf_mesh(source, target):
    def strip(document, _):
        for node in document["nodes"]:
            node.pop("mesh", None)
            node.pop("skin", None)
        for part in ("meshes", "skins", "materials"):
            document.pop(part, None)

    rebuild(source, target, strip)


def without_usd_mesh(source, target):
    Usd = pytest.importorskip("pxr.Usd")
    stage = Usd.Stage.Open(str(source))
    stage.RemovePrim(stage.GetDefaultPrim().GetPath().AppendChild("Mesh"))
    stage.GetRootLayer().Export(str(target))


@pytest.mark.parametrize(
    ("suffix", "strip"), [("glb", without_gltf_mesh), ("usda", without_usd_mesh)]
)
def test_a_skeleton_without_a_mesh_has_a_vertex_at_each_joint(tmp_path, suffix, strip):
    if suffix == "usda":
        pytest.importorskip("pxr.UsdSkel")
    model, whole, path = creature(), tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
    ssdr.save(model, whole)
    strip(whole, path)
    bare = ssdr.load_skinning(path, joints_alone=True)
    order = [bare.names().index(name) for name in model.names()]
    np.testing.assert_allclose(bare.transforms[:, order], model.transforms, atol=1e-5)
    np.testing.assert_allclose(bare.rest[order], model.joint_positions, atol=1e-6)
    assert (bare.n_vertices, len(bare.faces), bare.clips) == (model.n_bones, 0, model.clips)
    assert tree_of(bare) == tree_of(model)
    with pytest.raises(ssdr.FormatError, match=r"holds no mesh|no visible mesh"):
        ssdr.load_skinning(path)
    read = ssdr.load_skinning(whole, joints_alone=True)
    assert read.n_vertices == model.n_vertices  # a mesh that is there is read
