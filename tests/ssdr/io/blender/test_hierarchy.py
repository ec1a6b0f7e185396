"""FBX: joints hang on each other, lie along their bones, and come back as they were."""

from __future__ import annotations

import dataclasses
import json
import subprocess

import numpy as np
import pytest

import ssdr
from helpers.blender_scene import export
from helpers.rig_tree import NAMES, PARENTS, creature, differences, flat, tree_of
from ssdr.io.blender import command

try:
    command("")
except ssdr.SsdrError as error:
    WHY_NOT = str(error)
else:
    WHY_NOT = ""

pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT)]

_LOOK = """
import json, os, sys
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.fbx(filepath=sys.argv[-1])
item = next(o for o in bpy.data.objects if o.type == "ARMATURE")
found = {}
for bone in item.data.bones:
    head, tail = (item.matrix_world @ p for p in (bone.head_local, bone.tail_local))
    found[bone.name] = [bone.parent.name if bone.parent else None, list(head), list(tail)]
print("FOUND" + json.dumps(found))
sys.stdout.flush()
os._exit(0)
"""
_EDIT = """
import os, sys
import bpy
from mathutils import Quaternion
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 24
bpy.context.scene.frame_start, bpy.context.scene.frame_end = 0, 9
bpy.ops.import_scene.fbx(filepath=sys.argv[-1], anim_offset=0.0)
item = next(o for o in bpy.data.objects if o.type == "ARMATURE")
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
sys.stdout.flush()
os._exit(0)
"""


def _blender(folder, code, path):
    script = folder / "code.py"
    script.write_text(code, encoding="utf-8")
    done = subprocess.run(
        command(script, str(path)), capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.parametrize("kind", [{}, {"loose": True}, {"scaled": True}])
def test_the_tree_comes_back(tmp_path, kind):
    model = creature(**kind)
    report = ssdr.save(model, tmp_path / "a.fbx")
    back = ssdr.load_skinning(tmp_path / "a.fbx")
    assert tree_of(back) == tree_of(model)
    got = differences(model, back)
    assert got["joints"] < 1e-7
    assert max(got["transforms"], got["local"]) < 5e-6  # FBX holds angles as float32 degrees
    assert got["vertices"] < 1e-6
    assert report.max_error < 1e-6 * 3.2


def test_a_flat_model_has_no_hierarchy_when_it_comes_back(tmp_path):
    ssdr.save(flat(creature(frames=2)), tmp_path / "a.fbx")
    assert ssdr.load_skinning(tmp_path / "a.fbx").parents is None


def test_blender_draws_bones_from_joint_to_joint(tmp_path):
    model = creature(frames=2)
    ssdr.save(model, tmp_path / "a.fbx")
    said = _blender(tmp_path, _LOOK, tmp_path / "a.fbx")
    found = json.loads(said.split("FOUND")[1].splitlines()[0])
    assert {name: above for name, (above, _, _) in found.items()} == tree_of(model)
    y_up = {n: np.array([h, t])[:, [0, 2, 1]] * [1, 1, -1] for n, (_, h, t) in found.items()}
    for name, at in zip(NAMES, model.joint_positions, strict=True):
        np.testing.assert_allclose(y_up[name][0], at, atol=1e-5)
    np.testing.assert_allclose(y_up["leg"][1], y_up["foot"][0], atol=1e-3)
    middle = (y_up["arm.L"][0] + y_up["arm.R"][0]) / 2
    along, way = y_up["chest"][1] - y_up["chest"][0], middle - y_up["chest"][0]
    assert along @ way > 0.999 * np.linalg.norm(along) * np.linalg.norm(way)


def test_takes_of_a_tree(tmp_path):
    walk, jump = ssdr.Clip("walk", 0, 6, 24.0), ssdr.Clip("jump", 6, 10, 24.0)
    model = creature(clips=(walk, jump))
    ssdr.save(model, tmp_path / "a.fbx")
    back = ssdr.load_skinning(tmp_path / "a.fbx")
    assert back.clips == model.clips
    assert differences(model, back)["local"] < 5e-6


def test_a_rig_that_was_edited_in_blender_comes_back(tmp_path):
    """One joint renamed, one turned."""
    model = creature()
    ssdr.save(model, tmp_path / "a.fbx")
    before = ssdr.load_skinning(tmp_path / "a.fbx")
    _blender(tmp_path, _EDIT, tmp_path / "a.fbx")
    back = ssdr.load_skinning(tmp_path / "a.fbx")
    renamed = {"foot": "paw"}
    expected = {renamed.get(n, n): a for n, a in tree_of(before).items()}
    assert tree_of(back) == expected
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
    shown = ssdr.load(path)
    assert np.abs(back.skin() - shown.vertices).max() < 1e-5
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
    gaps = back.joint_gaps()
    np.testing.assert_allclose(
        gaps[-1, back.names().index("bone_1")], np.hypot(0.2, 0.1), atol=1e-4
    )
    assert np.abs(back.skin() - ssdr.load(path).vertices).max() < 1e-5


def test_names_that_repeat_are_made_different(tmp_path):
    model = dataclasses.replace(creature(frames=2), bone_names=("a",) * len(NAMES))
    ssdr.save(model, tmp_path / "a.fbx")
    back = ssdr.load_skinning(tmp_path / "a.fbx")
    assert len(set(back.names())) == len(NAMES)
    assert sorted(back.parents < 0) == sorted(np.array(PARENTS) < 0)


def test_bones_without_length(tmp_path):
    model = creature()
    at = model.joint_positions.copy()
    at[4] = at[2]  # the leg begins where the hip does
    model = dataclasses.replace(model, joint_positions=at)
    ssdr.save(model, tmp_path / "a.fbx")
    back = ssdr.load_skinning(tmp_path / "a.fbx")
    assert tree_of(back) == tree_of(model)
    got = differences(model, back)
    assert max(got["joints"], got["vertices"]) < 1e-6
