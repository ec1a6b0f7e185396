"""Files of other programs: Blender exports scenes that tests read, and shows what is written."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from ssdr.common.errors import SsdrError
from ssdr.io.blender.finder import command, run

try:
    command("")
    _WHY_NOT = ""
except SsdrError as error:
    _WHY_NOT = str(error)
needs_blender = pytest.mark.skipif(bool(_WHY_NOT), reason=_WHY_NOT)

_HEAD = """
import os, sys
import bpy
from mathutils import Matrix, Quaternion, Vector

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene

def rig(name="rig", bones=3, place=(0, 0, 0), scale=(1, 1, 1), prefix="bone"):
    data = bpy.data.armatures.new(name)
    item = bpy.data.objects.new(name, data)
    scene.collection.objects.link(item)
    bpy.context.view_layer.objects.active = item
    bpy.ops.object.mode_set(mode="EDIT")
    for k in range(bones):
        bone = data.edit_bones.new(f"{prefix}_{k}")
        bone.head, bone.tail = (0.1 * k, 0, k), (0.1 * k, 0, k + 1)
        bone.parent = data.edit_bones.get(f"{prefix}_{k - 1}")
    bpy.ops.object.mode_set(mode="OBJECT")
    item.location, item.scale = place, scale
    return item

def strip(name, armature, bones=3, weights=None, place=(0, 0, 0), rows=9):
    # two columns of vertices along z; weights(height, bone)
    points = [(x, 0.05 * k, 3.0 * k / (rows - 1)) for k in range(rows) for x in (-0.3, 0.3)]
    faces = [(2 * k, 2 * k + 1, 2 * k + 3, 2 * k + 2) for k in range(rows - 1)]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    item = bpy.data.objects.new(name, mesh)
    scene.collection.objects.link(item)
    item.location = place
    if armature is not None:
        weights = weights or (lambda z, b: max(0.0, 1 - abs(z - b - 0.5)))
        for b, bone in enumerate(armature.data.bones):
            group = item.vertex_groups.new(name=bone.name)
            for k, point in enumerate(points):
                if weights(point[2], b) > 0:
                    group.add((k,), weights(point[2], b), "REPLACE")
        item.parent = armature
        item.modifiers.new("skin", "ARMATURE").object = armature
    return item

def turn(armature, name, bones, frames=(0, 4, 8), angle=0.5, scale=None):
    # an action that turns the named bones, pushed down to a track of its own
    armature.animation_data_create()
    armature.animation_data.action = bpy.data.actions.new(name)
    for bone in armature.pose.bones:
        bone.rotation_mode = "QUATERNION"
        bone.matrix_basis = Matrix()
    for k in bones:
        bone = armature.pose.bones[k]
        for n, frame in enumerate(frames):
            bone.rotation_quaternion = Quaternion((1, 0.3 * k, 0), angle * n)
            bone.location = (0.1 * n, 0, 0.05 * n * k)
            bone.keyframe_insert("rotation_quaternion", frame=frame)
            bone.keyframe_insert("location", frame=frame)
            if scale is not None:
                bone.scale = [1 + n * (s - 1) for s in scale]
                bone.keyframe_insert("scale", frame=frame)

def save(**options):
    settings = dict(bake_anim_simplify_factor=0.0, add_leaf_bones=False, path_mode="STRIP")
    bpy.ops.export_scene.fbx(filepath=sys.argv[-1], **(settings | options))
"""
_TAIL = """
sys.stdout.flush()
os._exit(0)
"""


def run_blender(script: Path, code: str, *arguments: Path) -> str:
    """Run code in Blender; what it prints."""
    script.write_text(code + _TAIL, encoding="utf-8")
    words = command(script, *map(str, arguments))
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def export(path: Path, code: str) -> Path:
    """Run a scene's code in Blender; its ``save()`` writes the FBX file at `path`."""
    run_blender(path.with_suffix(".scene.py"), _HEAD + code, path)
    assert path.is_file()
    return path


def blender_shows(
    path: Path, frames: int, fps: float = 24.0, clip: str | None = None
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Vertices (F, V, 3) with y up as Blender's own importer shows a file, and further arrays."""
    job = {"path": str(path.resolve()), "frames": frames, "fps": fps, "clip": clip}
    arrays = run(Path(__file__).with_name("blender_player.py"), job)
    return arrays["vertices"][..., [0, 2, 1]] * [1, 1, -1], arrays
