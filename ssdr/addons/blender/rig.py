"""Conversion of a skinned model to armature, vertex groups and actions, and of an armature
to a skeleton file.
"""

import json
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from .process import AddonError
from .sample import SampledObject, replaced

ERROR = "ssdr_error"


def read(path: Path) -> dict[str, Any]:
    """Read the arrays of a model that ssdr wrote; ``names`` holds the names of its bones."""
    with np.load(path, allow_pickle=False) as archive:
        model = {name: archive[name] for name in archive.files}
    count = model["transforms"].shape[1]
    names = json.loads(str(model["bone_names"])) if "bone_names" in model else None
    return model | {"names": names or [f"bone_{k}" for k in range(count)]}


def skin(model: dict[str, Any], frame: int) -> Any:
    """Vertices (V, 3) of a model in a frame: linear blend skinning."""
    blended = np.einsum(
        "vk,vkij->vij", model["weights"], model["transforms"][frame][model["indices"]]
    )
    return np.einsum("vij,vj->vi", blended[:, :, :3], model["rest"]) + blended[:, :, 3]


def save_skeleton(armature: Any, place: Any, path: Path) -> None:
    """Write an armature in its present pose as a skeleton: the deforming bones and their parents.

    Positions are relative to `place`.  The file also has a mesh, with one vertex per bone.
    """
    bones = [bone for bone in armature.pose.bones if bone.bone.use_deform]
    if not bones:
        raise AddonError(f"{armature.name} has no bones that deform")
    number, parents = {bone.name: k for k, bone in enumerate(bones)}, []
    for bone in bones:
        above = bone.parent
        while above is not None and above.name not in number:
            above = above.parent
        parents.append(-1 if above is None else number[above.name])
    to_place = place.inverted() @ armature.matrix_world
    joints = np.array([to_place @ bone.head for bone in bones], dtype=np.float64)
    count = len(bones)
    np.savez(
        path,
        rest=joints,
        indices=np.arange(count, dtype=np.int32)[:, None],
        weights=np.ones((count, 1)),
        transforms=np.broadcast_to(np.eye(3, 4), (1, count, 3, 4)),
        faces=np.zeros((0, 3), dtype=np.int32),
        fps=np.array(24.0),
        format_version=np.array(2),
        parents=np.array(parents, dtype=np.int32),
        joint_positions=joints,
        bone_names=np.array(json.dumps(list(number))),
    )


def build(
    context: Any,
    source: Any,
    sample: SampledObject,
    model: dict[str, Any],
    errors: Any,
    *,
    beside: bool,
) -> Any:
    """Give an object, or with `beside` a copy of it, a model's mesh and bones; return this object.

    `errors` (V,) become a colour attribute unless they are None.
    """
    count = len(replaced(source))
    mesh = sample.mesh
    mesh.name = source.data.name
    mesh.vertices.foreach_set("co", model["rest"].astype(np.float32).ravel())
    mesh.update()
    if errors is not None:
        _color(mesh, errors)

    target = source.copy() if beside else source
    place = sample.place.copy()
    if beside:
        width = np.ptp([(place @ Vector(corner)).x for corner in source.bound_box])
        place.translation.x += 1.2 * width
        for collection in source.users_collection:
            collection.objects.link(target)
    target.data = mesh
    if sample.moves:
        target.animation_data_clear()
        world = context.scene.rigidbody_world
        if target.rigid_body and world and target.name in world.collection.objects:
            world.collection.objects.unlink(target)
    target.constraints.clear()
    for one in list(target.modifiers)[:count]:
        target.modifiers.remove(one)

    rig = _armature(context, source, model, place)
    _vertex_groups(target, model)
    target.parent, target.parent_type = rig, "OBJECT"
    target.matrix_parent_inverse.identity()
    target.matrix_basis.identity()
    modifier = target.modifiers.new(rig.name, "ARMATURE")
    modifier.object = rig
    target.modifiers.move(len(target.modifiers) - 1, 0)
    _actions(rig, source.name, sample, model)
    for item in context.selected_objects:
        item.select_set(False)
    rig.select_set(True)
    target.select_set(True)
    context.view_layer.objects.active = target
    context.view_layer.update()
    return target


def _color(mesh: Any, errors: Any) -> None:
    """Add the errors as a colour attribute, from blue (0) through green to red (the largest)."""
    old = mesh.color_attributes.get(ERROR)
    if old is not None:
        mesh.color_attributes.remove(old)
    part = errors / max(errors.max(), 1e-30)
    colors = np.stack([part, 1 - np.abs(2 * part - 1), 1 - part, np.ones_like(part)], axis=1)
    layer = mesh.color_attributes.new(ERROR, "FLOAT_COLOR", "POINT")
    layer.data.foreach_set("color", colors.astype(np.float32).ravel())
    mesh.color_attributes.active_color = layer


def _armature(context: Any, source: Any, model: dict[str, Any], place: Any) -> Any:
    """Create an armature in rest pose with the bones of `model`.

    The names in `model` are replaced by those that Blender gives the bones.
    """
    name = f"{source.name} bones"
    rig = bpy.data.objects.new(name, bpy.data.armatures.new(name))
    for collection in source.users_collection:
        collection.objects.link(rig)
    rig.matrix_world = place
    context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    bones = [rig.data.edit_bones.new(one) for one in model["names"]]
    for bone, head, tail in zip(bones, *_heads_and_tails(model), strict=True):
        bone.head, bone.tail = head, tail
    for bone, parent in zip(bones, model.get("parents", ()), strict=False):
        bone.parent = bones[parent] if parent >= 0 else None
    model["names"] = [bone.name for bone in bones]
    bpy.ops.object.mode_set(mode="OBJECT")
    for bone in rig.pose.bones:
        bone.rotation_mode = "QUATERNION"
    return rig


def _heads_and_tails(model: dict[str, Any]) -> tuple[Any, Any]:
    """Heads and tails of the bones, each (B, 3).

    A bone points from its joint to the mean of its child joints, if there are any.  Without joints,
    its head is the centroid of the vertices that it moves.  Blender's rest matrices deviate from
    rotations by 4e-5 if a bone points almost opposite to its parent, so such a bone is made to
    point exactly opposite.
    """
    rest, count = model["rest"], len(model["names"])
    length = 0.05 * np.linalg.norm(np.ptp(rest, axis=0))
    up = np.array([0, length, 0])  # the bone's own axes are then those of the mesh
    if "parents" not in model:
        sums, weights = np.zeros((count, 4)), model["weights"][..., None]
        np.add.at(sums, model["indices"], weights * np.insert(rest, 3, 1, axis=1)[:, None])
        total = sums[:, 3:]
        heads = np.where(total > 0, sums[:, :3] / np.maximum(total, 1e-30), rest.mean(axis=0))
        return heads, heads + up
    heads, parents = model["joint_positions"], model["parents"]
    tails = heads + up
    for k in _from_roots(parents):
        along, below = np.array([0.0, 1.0, 0.0]), np.flatnonzero(parents == k)
        if parents[k] >= 0:
            along = tails[parents[k]] - heads[parents[k]]
            along /= np.linalg.norm(along)
        way = heads[below].mean(axis=0) - heads[k] if len(below) else length * along
        if np.linalg.norm(way) <= 0.1 * length:
            way = up
        if -(way @ along) > 0.8 * np.linalg.norm(way):
            way = (way @ along) * along
        tails[k] = heads[k] + way
    return heads, tails


def _from_roots(parents: Any) -> list[int]:
    """Indices of the bones, parents before their children."""
    order: list[int] = []
    level = np.flatnonzero(parents < 0)
    while len(level):
        order += level.tolist()
        level = np.flatnonzero(np.isin(parents, level))
    return order


def _vertex_groups(target: Any, model: dict[str, Any]) -> None:
    for name in model["names"]:
        old = target.vertex_groups.get(name)
        if old is not None:
            target.vertex_groups.remove(old)
        target.vertex_groups.new(name=name)
    groups = [target.vertex_groups[name] for name in model["names"]]
    for vertex, slot in np.argwhere(model["weights"] > 0).tolist():
        group = groups[model["indices"][vertex, slot]]
        group.add((vertex,), float(model["weights"][vertex, slot]), "ADD")


def _actions(rig: Any, name: str, sample: SampledObject, model: dict[str, Any]) -> None:
    """Give the armature an action of all frames, or one for each clip.

    The action of a clip starts at frame 0.  A strip plays it at the frames where the clip was.
    Every strip has its own track, as exporters expect.
    """
    motion = rig.animation_data_create()
    if not sample.clips:
        _action(rig, model, slice(None), sample.first, name)
    for clip in sample.clips:
        _action(rig, model, sample.frames(clip), 0, clip.name)
        track = motion.nla_tracks.new()
        track.name = clip.name
        strip = track.strips.new(clip.name, clip.first, motion.action)
        if hasattr(strip, "action_slot"):
            strip.action_slot = motion.action_slot
        # A strip that also holds its first frame backwards would hide the tracks below.
        strip.extrapolation = "HOLD" if clip is sample.clips[0] else "HOLD_FORWARD"
        motion.action = None


def _action(rig: Any, model: dict[str, Any], part: slice, first: int, name: str) -> None:
    """Give the armature an action with a key of every bone in every frame of `part`.

    With L the rest matrix of a bone and T its transform, Blender has to show the bone at P = T L.
    Its channels hold (L_p⁻¹ L)⁻¹ P_p⁻¹ P, where p is its parent.  P_p is computed from the rounded
    channels, as Blender does, so that rounding does not add up along a chain of bones.
    """
    names, transforms = model["names"], model["transforms"][part].astype(np.float64)
    count = len(names)
    parents = model.get("parents", np.full(count, -1))
    rest = np.array([rig.data.bones[one].matrix_local for one in names], dtype=np.float64)
    poses = np.zeros((len(transforms), count, 4, 4))
    poses[:, :, :3], poses[:, :, 3, 3] = transforms, 1
    poses = poses @ rest
    curves = _curves(rig, name)
    group = "group_name" if "group_name" in curves.new.__doc__ else "action_group"
    frames = first + np.arange(len(poses))
    for k in _from_roots(parents):
        above = rest[k]
        if parents[k] >= 0:
            above = poses[:, parents[k]] @ np.linalg.inv(rest[parents[k]]) @ rest[k]
        basis = np.linalg.inv(above) @ poses[:, k]
        place = basis[:, :3, 3].astype(np.float32)
        turn = _quaternions(basis).astype(np.float32)
        basis[:, :3, :3], basis[:, :3, 3] = _rotations(turn), place
        poses[:, k] = above @ basis
        path = f'pose.bones["{bpy.utils.escape_identifier(names[k])}"].'
        for channel, values in (("location", place), ("rotation_quaternion", turn)):
            for axis in range(values.shape[1]):
                curve = curves.new(path + channel, index=axis, **{group: names[k]})
                curve.keyframe_points.add(len(frames))
                keys = np.stack([frames, values[:, axis]], axis=1).astype(np.float32)
                curve.keyframe_points.foreach_set("co", keys.ravel())
                curve.keyframe_points.foreach_set("interpolation", np.ones(len(frames), np.int32))
                curve.update()


def _curves(rig: Any, name: str) -> Any:
    """Create an action of the armature, and return its curves."""
    action = bpy.data.actions.new(name)
    motion = rig.animation_data
    motion.action = action
    if not hasattr(action, "slots"):  # before Blender 4.4
        return action.fcurves
    slot = motion.action_slot = action.slots.new("OBJECT", rig.name)
    strip = action.layers.new("Layer").strips.new(type="KEYFRAME")
    return strip.channelbag(slot, ensure=True).fcurves


def _quaternions(matrices: Any) -> Any:
    """Quaternions wxyz (F, 4) of rotations, with signs that do not jump from frame to frame."""
    r = matrices[:, :3, :3]
    x, y, z = r[:, 0, 0], r[:, 1, 1], r[:, 2, 2]
    a, b, c = r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]
    d, e, f = r[:, 1, 0] + r[:, 0, 1], r[:, 0, 2] + r[:, 2, 0], r[:, 2, 1] + r[:, 1, 2]
    # Four times the outer product of the quaternion with itself: the row of largest norm is best.
    products = np.array(
        [
            [1 + x + y + z, a, b, c],
            [a, 1 + x - y - z, d, e],
            [b, d, 1 - x + y - z, f],
            [c, e, f, 1 - x - y + z],
        ]
    ).transpose(2, 0, 1)
    best = np.argmax(np.einsum("fii->fi", products), axis=1)
    found = products[np.arange(len(r)), best]
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    turned = np.einsum("fi,fi->f", found[1:], found[:-1]) < 0
    found[1:] *= np.where(np.cumsum(turned) % 2 == 1, -1.0, 1.0)[:, None]
    return found


def _rotations(quaternions: Any) -> Any:
    """Rotations (F, 3, 3) of quaternions wxyz."""
    exact = quaternions.astype(np.float64)
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    w, cross = exact[:, 0, None, None], np.cross(np.eye(3), exact[:, None, 1:])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross
