"""What Blender shows after the extension ran is what ssdr computes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers.blender_scene import needs_blender


def _agrees(folder: Path) -> ssdr.Skinning:
    """The model of a run, whose own vertices are those that Blender shows, in the same place."""
    model = ssdr.io.in_space(ssdr.load_skinning(folder / "model.glb"), ssdr.Space(up="z"))
    with np.load(folder / "shown.npz") as held:
        shown, place, before, origin = (held[k] for k in ("shown", "place", "before", "from_"))
    diagonal = np.linalg.norm(np.ptp(before.reshape(-1, 3), axis=0))
    distance = np.linalg.norm(model.skin(dtype=np.float64) - shown, axis=2).max() / diagonal
    print(f"largest distance {distance:.2e} of the diagonal")
    # Blender multiplies single-precision matrices along a chain of bones, rounding by 2^-24 each.
    assert distance < (1e-6 if model.parents is None else 3e-6)
    # An independent witness of axes and place: the error against the animation, through the world.
    was = np.einsum("fij,fvj->fvi", origin[:, :3, :3], before) + origin[:, None, :3, 3]
    now = np.einsum("fij,fvj->fvi", place[:, :3, :3], shown) + place[:, None, :3, 3]
    off = (now - was) @ np.linalg.inv(origin[0, :3, :3]).T
    rmse = np.sqrt(np.square(off).sum(axis=2).mean())
    with np.load(folder / "frames.npz") as held:
        assert rmse == pytest.approx(ssdr.metrics.rmse(held["vertices"], model), rel=2e-2)
    return model


@needs_blender
def test_a_simulated_cloth_becomes_bones_and_one_undo_brings_it_back(
    blender: Any, tmp_path: Path
) -> None:
    said = blender("""
item = grid()
item.vertex_groups.new(name="pin").add((0, 19), 1.0, "ADD")
cloth = item.modifiers.new("Cloth", "CLOTH")
cloth.settings.vertex_group_mass = "pin"
item.modifiers.new("Subdivision", "SUBSURF")
uv = [list(one.uv) for one in item.data.uv_layers[0].data]
before = points(item)
scene.frame_set(7)
bpy.ops.ed.undo_push(message="before")
was = state()
result = bpy.ops.ssdr.decompose("EXEC_DEFAULT", True)
save(item, before)
scene.frame_set(7)
kept = dict(
    result=list(result), modifiers=[one.type for one in item.modifiers],
    materials=[one.name for one in item.data.materials],
    groups=[one.name for one in item.vertex_groups],
    uv=bool(np.allclose(uv, [list(one.uv) for one in item.data.uv_layers[0].data])),
    objects=sorted(o.name for o in bpy.data.objects), frame=scene.frame_current,
    actions=[one.name for one in bpy.data.actions],
)
bpy.ops.ed.undo()
scene = bpy.context.scene
kept["undone"] = state() == was
print("SAID " + json.dumps(kept))
""")
    model = _agrees(tmp_path)
    assert said == {
        "result": ["FINISHED"],
        "modifiers": ["ARMATURE", "SUBSURF"],
        "materials": ["red"],
        "groups": ["pin", *model.names()],
        "uv": True,
        "objects": ["Grid", "Grid bones"],
        "frame": 7,
        "actions": ["Grid"],
        "undone": True,
    }


@needs_blender
def test_shape_keys_of_a_moving_object_become_a_tree(blender: Any, tmp_path: Path) -> None:
    said = blender("""
item = bending()
item.rotation_euler, item.scale = (0.5, 0.2, 1), (1, 2, 1)
item.location = (3, 0, 0)
item.keyframe_insert("location", frame=1)
item.location = (3, 1, 2)
item.keyframe_insert("location", frame=30)
scene.frame_set(1)
options.joints, options.bones = "RIGID", 6
before = points(item)
bpy.ops.ssdr.decompose()
target = bpy.context.object
save(target, before)
bones = target.parent.data.bones
print("SAID " + json.dumps(dict(
    names=[bone.name for bone in bones],
    parents={bone.name: bone.parent and bone.parent.name for bone in bones},
    alone=item.data.shape_keys is None and item.animation_data is None,
)))
""")
    model = _agrees(tmp_path)
    names = model.names()
    parents = {n: None if p < 0 else names[p] for n, p in zip(names, model.parents, strict=True)}
    assert said["parents"] == parents
    assert said["alone"]


@needs_blender
def test_an_alembic_cache_becomes_bones_within_a_tolerance(blender: Any, tmp_path: Path) -> None:
    said = blender("""
bending().rotation_euler.x = 0.3
cache = str(FOLDER / "bar.abc")
bpy.ops.wm.alembic_export(filepath=cache, as_background_job=False, start=1, end=30)
bpy.ops.object.delete()
bpy.ops.wm.alembic_import(filepath=cache, as_background_job=False, set_frame_range=True)
item = bpy.context.scene.objects[0]
bpy.context.view_layer.objects.active = item
kinds = [one.type for one in item.modifiers]
before = points(item)
options.size, options.tolerance, options.measure = "TOLERANCE", 0.5, "MAX"
bpy.ops.ssdr.decompose()
save(item, before)
print("SAID " + json.dumps([kinds, [one.type for one in item.modifiers], len(item.constraints)]))
""")
    assert said == [["MESH_SEQUENCE_CACHE"], ["ARMATURE"], 0]
    model = _agrees(tmp_path)
    with np.load(tmp_path / "frames.npz") as held:
        found = ssdr.metrics.distances(held["vertices"], model)
    assert found.max <= 0.005 * found.diagonal


@needs_blender
def test_the_bones_of_an_armature_are_kept(blender: Any, tmp_path: Path) -> None:
    said = blender("""
item = bending()
data = bpy.data.armatures.new("old")
old = bpy.data.objects.new("old", data)
scene.collection.objects.link(old)
bpy.context.view_layer.objects.active = old
bpy.ops.object.mode_set(mode="EDIT")
for k, name in enumerate(("hips", "control", "chest", "head")):
    bone = data.edit_bones.new(name)
    bone.head, bone.tail = (0.3 * k, 0, 0), (0.3 * k + 0.3, 0, 0)
    bone.parent = data.edit_bones[k - 1] if k else None
    bone.use_deform = name != "control"
bpy.ops.object.mode_set(mode="OBJECT")
bpy.context.view_layer.objects.active = item
before = points(item)
options.joints, options.armature = "ARMATURE", old
bpy.ops.ssdr.decompose()
save(item, before)
bones = item.parent.data.bones
print("SAID " + json.dumps([[bone.name, bone.parent and bone.parent.name] for bone in bones]))
""")
    _agrees(tmp_path)
    assert sorted(said) == [["chest", "hips"], ["head", "chest"], ["hips", None]]


@needs_blender
def test_markers_name_clips_which_play_where_they_were_and_are_exported(
    blender: Any, tmp_path: Path
) -> None:
    said = blender("""
item = bending()
for frame, name in ((21, "up again"), (0, "before"), (12, "bend"), (4, "idle"), (31, "after")):
    scene.timeline_markers.new(name, frame=frame)
scene.frame_start = 4
before = points(item)
scene.frame_start = 1
scene.frame_set(15)
bpy.ops.ed.undo_push(message="before")
was = state()
options.clips = True
bpy.ops.ssdr.decompose("EXEC_DEFAULT", True)
at_once = seen(item)
scene.frame_start = 4
save(item, before)
for frame in (30, 22, 15):  # in any order, too
    scene.frame_set(frame)
motion = item.parent.animation_data
kept = dict(
    same=seen(item) == at_once, action=motion.action,
    tracks=[
        [track.name, *((s.name, s.action.name, s.frame_start, s.frame_end) for s in track.strips)]
        for track in motion.nla_tracks
    ],
    keys=[list(track.strips[0].action.frame_range) for track in motion.nla_tracks],
)
for mode in ("ACTIONS", "NLA_TRACKS"):
    bpy.ops.export_scene.gltf(filepath=str(FOLDER / f"{mode}.glb"), export_animation_mode=mode)
bpy.ops.ed.undo()
scene = bpy.context.scene
kept["undone"] = state() == was
print("SAID " + json.dumps(kept))
""")
    model = _agrees(tmp_path)
    frames = {"idle": (4, 11), "bend": (12, 20), "up again": (21, 30)}
    assert [(c.name, c.n_frames) for c in model.clips] == [
        (name, last - first + 1) for name, (first, last) in frames.items()
    ]
    assert said == {
        "same": True,
        "action": None,
        "tracks": [[name, [name, name, *ends]] for name, ends in frames.items()],
        "keys": [[0, 7], [0, 8], [0, 9]],
        "undone": True,
    }
    for mode in ("ACTIONS", "NLA_TRACKS"):
        exported = ssdr.load_skinning(tmp_path / f"{mode}.glb")
        assert {clip.name for clip in exported.clips} == set(frames)
        for clip in model.clips:
            given = exported.select(clip.name)
            # The exporter leaves out weights, and motion, below 1e-4.
            heights = np.ptp(given.skin(dtype=np.float64)[..., 1], axis=1)
            own = np.ptp(model.skin(clip.frames, dtype=np.float64)[..., 2], axis=1)
            np.testing.assert_allclose(heights, own, atol=1e-3)
