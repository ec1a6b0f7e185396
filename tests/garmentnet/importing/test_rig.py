"""Skeleton and body of a rig from a file."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from garmentnet.importing.rig import rig_of
from garmentnet.importing.scene_files import Source, read_rig
from helpers.measures import largest_gap
from helpers.walking_rig import FRAMES, JOINTS, NAMES, PARENTS, cloth, motion, rig


def test_a_prop_of_one_joint_is_a_rig():
    one = {"bone_names": NAMES[:1], "parents": [-1], "joint_positions": JOINTS[:1]}
    pole = dataclasses.replace(rig(), indices=0 * rig().indices, transforms=motion()[:, :1], **one)
    assert rig_of(pole).skeleton.names == ("hips",)


def test_a_joint_that_a_mesh_has_anew_is_one():
    """As in glTF, where every mesh has a skin of its own."""
    anew = rig(
        motion()[:, [0, 1, 2, 2]],
        bone_names=("hips", "leg_l", "leg_r_1", "leg_r"),
        parents=[*PARENTS, -1],
        joint_positions=JOINTS[[0, 1, 2, 2]],
    )
    indices = np.where(rig().indices == 2, 3, rig().indices)
    found = rig_of(dataclasses.replace(anew, indices=indices))
    assert (found.skeleton.names, found.body.n_vertices) == (NAMES, 18)
    # Another joint of the same place and motion is another joint.
    twist = rig(
        motion()[:, [0, 1, 2, 2, 2]],
        bone_names=("hips", "leg_l", "leg_r_twist", "leg_r", "leg_r_1"),
        parents=[*PARENTS, 0, -1],
        joint_positions=JOINTS[[0, 1, 2, 2, 2]],
    )
    found = rig_of(dataclasses.replace(twist, indices=np.where(indices == 3, 4, indices)))
    assert found.skeleton.names == twist.names()[:4]
    assert set(found.body.indices[found.body.weights > 0]) == {0, 1, 3}


def test_pieces_of_the_body_face_outwards():
    faces, sizes = np.array(rig().faces), []
    for _ in range(2):
        body = rig_of(rig(faces=faces)).body
        sizes.append(np.linalg.det(body.rest[body.faces]).sum())
        faces[8:16] = faces[8:16, ::-1]
    assert sizes[0] == pytest.approx(sizes[1]) != 0


def test_triangles_of_either_winding_are_turned():
    body, rest, mixed = rig_of(rig()), cloth().vertices[0], np.array(cloth().faces)
    before = body.facing(rest, mixed)
    mixed[:10] = mixed[:10, ::-1]
    np.testing.assert_array_equal(np.flatnonzero(body.facing(rest, mixed) != before), range(10))


def test_blend_shapes_that_are_held_are_added_and_others_named(tmp_path):
    moved, amounts = np.zeros((2, 18, 3)), np.ones((FRAMES, 2))
    moved[:, :6], amounts[:, 1] = 0.1, np.linspace(0, 1, FRAMES)
    ssdr.save(ssdr.ShapedSkinning(rig(), ssdr.Shapes(moved, amounts)), tmp_path / "a.glb")
    said: list[str] = []
    found = rig_of(read_rig(tmp_path / "a.glb", Source(), None, "a", said.append)).body
    assert "a.glb: 2 blend shapes left out" in said[0]
    assert largest_gap(found.rest, rig().rest + moved[0]) < 1e-6
