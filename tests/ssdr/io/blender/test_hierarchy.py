"""FBX: joints hang on each other, lie along their bones, and come back as they were edited."""

from __future__ import annotations

import json

import numpy as np
import pytest

import ssdr
from helpers.blender_scene import export, needs_blender, run_blender
from helpers.rig_tree import NAMES, creature, tree_of

pytest.importorskip("ufbx", reason="ufbx is not installed")
pytestmark = [pytest.mark.slow, needs_blender]

_OPEN = """
import json, os, sys
import bpy
from mathutils import Quaternion
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 24
bpy.context.scene.frame_start, bpy.context.scene.frame_end = 0, 9
bpy.ops.import_scene.fbx(filepath=sys.argv[-1], anim_offset=0.0)
item = next(o for o in bpy.data.objects if o.type == "ARMATURE")
"""
_LOOK = """
found = {}
for bone in item.data.bones:
    head, tail = (item.matrix_world @ p for p in (bone.head_local, bone.tail_local))
    found[bone.name] = [bone.parent.name if bone.parent else None, list(head), list(tail)]
print("FOUND" + json.dumps(found))
"""
_EDIT = """
item.data.bones["foot"].name = "paw"
bone = item.pose.bones["arm.L"]
for frame in range(10):
    bpy.context.scene.frame_set(frame)
    bone.rotation_quaternion = bone.rotation_quaternion @ Quaternion((0, 1, 0), 0.5)
    bone.keyframe_insert("rotation_quaternion", frame=frame)
bpy.ops.export_scene.fbx(
    filepath=sys.argv[-1], bake_anim_simplify_factor=0.0, add_leaf_bones=False,
    bake_anim_use_all_actions=False, bake_anim_use_nla_strips=False,
)
"""


def test_blender_draws_bones_from_joint_to_joint(tmp_path):
    model = creature(frames=2)
    ssdr.save(model, tmp_path / "a.fbx")
    said = run_blender(tmp_path / "look.py", _OPEN + _LOOK, tmp_path / "a.fbx")
    found = json.loads(said.split("FOUND")[1].splitlines()[0])
    assert {name: above for name, (above, _, _) in found.items()} == tree_of(model)
    y_up = {n: np.array([h, t])[:, [0, 2, 1]] * [1, 1, -1] for n, (_, h, t) in found.items()}
    for name, at in zip(NAMES, model.joint_positions, strict=True):
        np.testing.assert_allclose(y_up[name][0], at, atol=1e-5)
    np.testing.assert_allclose(y_up["leg"][1], y_up["foot"][0], atol=1e-3)
    middle = (y_up["arm.L"][0] + y_up["arm.R"][0]) / 2
    along, way = y_up["chest"][1] - y_up["chest"][0], middle - y_up["chest"][0]
    assert along @ way > 0.999 * np.linalg.norm(along) * np.linalg.norm(way)


def test_a_rig_that_was_edited_in_blender_comes_back(tmp_path):
    """One joint renamed, one turned."""
    ssdr.save(creature(), tmp_path / "a.fbx")
    before = ssdr.load_skinning(tmp_path / "a.fbx")
    run_blender(tmp_path / "edit.py", _OPEN + _EDIT, tmp_path / "a.fbx")
    back = ssdr.load_skinning(tmp_path / "a.fbx")
    renamed = {"foot": "paw"}
    assert tree_of(back) == {renamed.get(n, n): a for n, a in tree_of(before).items()}
    names = [renamed.get(n, n) for n in before.names()]
    order = [back.names().index(n) for n in names]
    old, new = before.local_transforms(), back.local_transforms()[:, order]
    arm = names.index("arm.L")
    others = np.arange(len(names)) != arm
    assert back.n_frames == before.n_frames
    np.testing.assert_allclose(new[:, others], old[:, others], atol=1e-5)
    turn = np.swapaxes(old[:, arm, :, :3], 1, 2) @ new[:, arm, :, :3]
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
    np.testing.assert_allclose(angle, 0.5, atol=1e-4)
    assert back.joint_gaps().max() < 1e-5


def test_bones_that_no_mesh_names_are_passed_over(tmp_path):
    path = export(
        tmp_path / "a.fbx",
        "arm = rig(bones=4)\nitem = strip('cloth', arm, bones=4)\n"
        "arm.data.bones['bone_1'].use_deform = False\n"
        "item.vertex_groups.remove(item.vertex_groups['bone_1'])\n"
        "turn(arm, 'walk', [0, 1, 2])\nsave()\n",
    )
    back = ssdr.load_skinning(path)
    tree = tree_of(back)
    assert np.abs(back.skin() - ssdr.load(path).vertices).max() < 1e-5
    assert tree["bone_2"] in ("bone_0", "bone_1")
    assert tree["bone_3"] == "bone_2"


def test_a_joint_that_slides_and_begins_where_another_bone_ends(tmp_path):
    """Blender's importer fixes it there and plays none of its translation."""
    path = export(
        tmp_path / "a.fbx",
        "arm = rig()\n"
        "bpy.context.view_layer.objects.active = arm\n"
        "bpy.ops.object.mode_set(mode='EDIT')\n"
        "for k, bone in enumerate(arm.data.edit_bones):\n"
        "    bone.head, bone.tail = (0, 0, k), (0, 0, k + 1)\n"
        "bpy.ops.object.mode_set(mode='OBJECT')\n"
        "strip('cloth', arm)\nturn(arm, 'walk', [1])\nsave()\n",
    )
    back = ssdr.load_skinning(path)
    gap = back.joint_gaps()[-1, back.names().index("bone_1")]
    np.testing.assert_allclose(gap, np.hypot(0.2, 0.1), atol=1e-4)
    assert np.abs(back.skin() - ssdr.load(path).vertices).max() < 1e-5
