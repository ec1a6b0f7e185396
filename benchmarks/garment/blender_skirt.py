"""A skirt on a moving body, simulated by Blender: an Alembic of the cloth and an FBX of its rig.

``python benchmarks/garment/blender_skirt.py FOLDER [SEED ...]`` with a Python that has ``bpy``
writes ``FOLDER/skirt_SEED.abc`` and ``FOLDER/skirt_SEED.fbx`` for every seed; nothing else of this
repository is needed.
"""

import math
import random
import sys
from pathlib import Path

import bpy
from mathutils import Euler, Vector

FRAMES, FPS, SETTLE = 300, 30, 20
# name: parent, head, tail, radius; metres, z up as in Blender
BONES = {
    "pelvis": (None, (0, 0, 0.95), (0, 0, 1.1), 0.14),
    "spine": ("pelvis", (0, 0, 1.1), (0, 0, 1.45), 0.13),
    "thigh_l": ("pelvis", (0.09, 0, 0.9), (0.09, 0, 0.5), 0.075),
    "shin_l": ("thigh_l", (0.09, 0, 0.5), (0.09, 0, 0.08), 0.05),
    "thigh_r": ("pelvis", (-0.09, 0, 0.9), (-0.09, 0, 0.5), 0.075),
    "shin_r": ("thigh_r", (-0.09, 0, 0.5), (-0.09, 0, 0.08), 0.05),
}
# rotation of the bones about the axes of the world, radians: amplitude and cycles a second
SWINGS = {
    "pelvis": ((0.12, 0.6), (0.12, 0.5), (0.9, 0.25)),
    "spine": ((0.15, 0.5), (0.15, 0.7), (0.3, 0.4)),
    "thigh_l": ((0.5, 0.8), (0.12, 0.5), (0, 0)),
    "thigh_r": ((0.5, 0.8), (0.12, 0.5), (0, 0)),
    "shin_l": ((0.3, 0.8), (0, 0), (0, 0)),
    "shin_r": ((0.3, 0.8), (0, 0), (0, 0)),
}


def link(name, data):
    item = bpy.data.objects.new(name, data)
    bpy.context.collection.objects.link(item)
    return item


def armature():
    item = link("rig", bpy.data.armatures.new("rig"))
    bpy.context.view_layer.objects.active = item
    bpy.ops.object.mode_set(mode="EDIT")
    for name, (parent, head, tail, _) in BONES.items():
        bone = item.data.edit_bones.new(name)
        bone.head, bone.tail = head, tail
        bone.parent = item.data.edit_bones[parent] if parent else None
    bpy.ops.object.mode_set(mode="OBJECT")
    return item


def skinned(name, points, faces, groups, rig):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    item = link(name, mesh)
    for group, indices in groups.items():
        item.vertex_groups.new(name=group).add(indices, 1.0, "REPLACE")
    item.modifiers.new("armature", "ARMATURE").object = rig
    item.parent = rig
    return item


def body(rig):
    """A closed capsule around every bone."""
    points, faces, groups, around, rings = [], [], {}, 16, 10
    for name, (_, head, tail, radius) in BONES.items():
        top, bottom = sorted((Vector(head), Vector(tail)), key=lambda p: -p.z)
        start = len(points)
        for i in range(1, rings):
            angle = math.pi * i / rings
            middle = top if i <= rings // 2 else bottom
            for k in range(around):
                turn = 2 * math.pi * k / around
                out = Vector((math.cos(turn), math.sin(turn), 0)) * math.sin(angle)
                points.append(middle + radius * (out + Vector((0, 0, math.cos(angle)))))
        points += [top + Vector((0, 0, radius)), bottom - Vector((0, 0, radius))]
        for k in range(around):
            n = (k + 1) % around
            faces.append((len(points) - 2, start + k, start + n))
            last = start + (rings - 2) * around
            faces.append((len(points) - 1, last + n, last + k))
            for i in range(rings - 2):
                row = start + i * around
                faces.append((row + k, row + around + k, row + around + n, row + n))
        groups[name] = list(range(start, len(points)))
    item = skinned("body", points, faces, groups, rig)
    item.modifiers.new("collision", "COLLISION")
    item.collision.thickness_outer = 0.01
    return item


def skirt(rig, around=48, rings=20):
    """A flared tube whose two upper rings follow the pelvis."""
    points = [
        ((0.16 + 0.16 * i / rings) * math.cos(a), (0.16 + 0.16 * i / rings) * math.sin(a), z)
        for i in range(rings)
        for z in [1.06 - 0.6 * i / rings]
        for a in (2 * math.pi * k / around for k in range(around))
    ]
    faces = [
        (i * around + k, (i + 1) * around + k, (i + 1) * around + n, i * around + n)
        for i in range(rings - 1)
        for k in range(around)
        for n in [(k + 1) % around]
    ]
    held = list(range(2 * around))
    item = skinned("skirt", points, faces, {"pelvis": held, "pinned": held}, rig)
    cloth = item.modifiers.new("cloth", "CLOTH")
    cloth.settings.vertex_group_mass = "pinned"
    cloth.settings.quality, cloth.settings.mass, cloth.settings.bending_stiffness = 8, 0.1, 0.05
    cloth.collision_settings.distance_min = 0.008
    cloth.point_cache.frame_start, cloth.point_cache.frame_end = 1, FRAMES
    return item


def move(rig, seed):
    """Keys of sines with random phases; the first frames are the rest pose."""
    chance = random.Random(seed)
    for name, swings in SWINGS.items():
        bone = rig.pose.bones[name]
        bone.rotation_mode = "QUATERNION"
        to_bone = rig.data.bones[name].matrix_local.to_3x3()
        waves = [(a, f * chance.uniform(0.7, 1.3), chance.uniform(0, 6.28)) for a, f in swings]
        for frame in range(1, FRAMES + 1):
            ease = min(1, max(0, (frame - SETTLE) / 20))
            angles = [ease * a * math.sin(6.28 * f * frame / FPS + p) for a, f, p in waves]
            turn = to_bone.inverted() @ Euler(angles).to_matrix() @ to_bone
            bone.rotation_quaternion = turn.to_quaternion()
            bone.keyframe_insert("rotation_quaternion", frame=frame)
            if name == "pelvis":
                place = Vector((0.3 * angles[2], 0.2 * angles[1], 0.15 * angles[0]))
                bone.location = to_bone.inverted() @ place
                bone.keyframe_insert("location", frame=frame)


def select(*items):
    bpy.ops.object.select_all(action="DESELECT")
    for item in items:
        item.select_set(True)
    bpy.context.view_layer.objects.active = items[0]


def main(folder, seeds):
    folder.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = bpy.context.scene
        scene.render.fps, scene.frame_start, scene.frame_end = FPS, 1, FRAMES
        rig = armature()
        solid, cloth = body(rig), skirt(rig)
        move(rig, seed)
        for frame in range(1, FRAMES + 1):  # the cloth is simulated as the frames pass
            scene.frame_set(frame)
        select(cloth)
        bpy.ops.wm.alembic_export(
            filepath=str(folder / f"skirt_{seed}.abc"), selected=True, as_background_job=False
        )
        select(rig, solid)
        bpy.ops.export_scene.fbx(
            filepath=str(folder / f"skirt_{seed}.fbx"),
            use_selection=True,
            add_leaf_bones=False,
            bake_anim_simplify_factor=0.0,
        )


main(Path(sys.argv[1]).resolve(), [int(n) for n in sys.argv[2:]] or [0])
