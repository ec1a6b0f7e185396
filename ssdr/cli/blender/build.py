"""An object's new bones: Blender's own importer makes the armature and its actions of a file."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .process import AddonError
from .sample import FrameRange, SampledObject, replaced


def joints_of(armature: Any, place: Any) -> dict[str, Any]:
    """Names, parents and positions of an armature's deforming bones in its present pose.

    Positions are relative to `place`.
    """
    bones = [bone for bone in armature.pose.bones if bone.bone.use_deform]
    if not bones:
        raise AddonError(f"{armature.name} has no bones that deform")
    number = {bone.name: k for k, bone in enumerate(bones)}
    above = [[one.name for one in bone.parent_recursive if one.name in number] for bone in bones]
    to_place = place.inverted() @ armature.matrix_world
    return {
        "names": list(number),
        "parents": [number[names[0]] if names else -1 for names in above],
        "positions": [list(to_place @ bone.head) for bone in bones],
    }


def build(
    context: Any, target: Any, sample: SampledObject, clips: list[FrameRange], folder: Path
) -> None:
    """Give an object the mesh and the bones of the model in a folder."""
    with np.load(folder / "model.npz") as held:
        model = dict(held)
    mesh, count = sample.mesh, len(replaced(target))
    mesh.name = target.data.name
    mesh.vertices.foreach_set("co", model["rest"].ravel())
    mesh.update()
    target.data = mesh
    if sample.moves:
        target.animation_data_clear()
        world = context.scene.rigidbody_world
        if target.rigid_body and world and target.name in world.collection.objects:
            world.collection.objects.unlink(target)
    target.constraints.clear()
    for one in list(target.modifiers)[:count]:
        target.modifiers.remove(one)
    rig, names = _imported(context, target, clips, folder / "model.glb")
    rig.matrix_world = sample.place
    for name in names:
        old = target.vertex_groups.get(name)
        if old is not None:
            target.vertex_groups.remove(old)
        target.vertex_groups.new(name=name)
    groups = [target.vertex_groups[name] for name in names]
    for vertex, slot in np.argwhere(model["weights"] > 0).tolist():
        weight = float(model["weights"][vertex, slot])
        groups[model["indices"][vertex, slot]].add((vertex,), weight, "ADD")
    target.parent, target.parent_type = rig, "OBJECT"
    target.matrix_parent_inverse.identity()
    target.matrix_basis.identity()
    modifier = target.modifiers.new(rig.name, "ARMATURE")
    modifier.object = rig
    target.modifiers.move(len(target.modifiers) - 1, 0)
    for item in context.selected_objects:
        item.select_set(False)
    rig.select_set(True)
    target.select_set(True)
    context.view_layer.objects.active = target
    context.view_layer.update()


def _imported(
    context: Any, source: Any, clips: list[FrameRange], file: Path
) -> tuple[Any, list[str]]:
    """The armature of a file, with its actions where the clips were, and the names of its bones."""
    known, render = set(bpy.data.objects), context.scene.render
    base, render.fps_base = render.fps_base, 1.0  # the file has a frame of the scene per frame
    try:
        bpy.ops.import_scene.gltf(filepath=str(file), disable_bone_shape=True)
    finally:
        render.fps_base = base
    rig, skin = sorted((one for one in bpy.data.objects if one not in known), key=lambda o: o.type)
    names, mesh = [group.name for group in skin.vertex_groups], skin.data
    bpy.data.objects.remove(skin)
    bpy.data.meshes.remove(mesh)
    for collection in rig.users_collection:
        collection.objects.unlink(rig)
    for collection in source.users_collection:
        collection.objects.link(rig)
    rig.name = rig.data.name = f"{source.name} bones"
    motion = rig.animation_data
    found = {track.name: track.strips[0].action for track in motion.nla_tracks}
    while motion.nla_tracks:
        motion.nla_tracks.remove(motion.nla_tracks[0])
    for clip in clips:
        found[clip.name].name = clip.name
    if len(clips) == 1:
        _shift(motion.action, clips[0].first)
        return rig, names
    motion.action = None
    for clip in clips:  # a later one lies above an earlier one
        track = motion.nla_tracks.new()
        track.name = clip.name
        strip = track.strips.new(clip.name, clip.first, found[clip.name])
        if hasattr(strip, "action_slot"):
            strip.action_slot = found[clip.name].slots[0]
        # A strip that also holds its first frame backwards would hide the tracks below.
        strip.extrapolation = "HOLD" if clip is clips[0] else "HOLD_FORWARD"
    return rig, names


def _shift(action: Any, frames: int) -> None:
    """Let an action start later by a number of frames."""
    held = action if hasattr(action, "fcurves") else action.layers[0].strips[0].channelbags[0]
    for curve in held.fcurves:
        keys = np.empty(2 * len(curve.keyframe_points), dtype=np.float32)
        curve.keyframe_points.foreach_get("co", keys)
        keys[::2] += frames
        curve.keyframe_points.foreach_set("co", keys)
        curve.update()
