"""Script for Blender: what its own importers show of a glTF, USD or FBX file, frame by frame.

The job holds the path, frames per second, number of frames and the name of a clip, which may be
None.  Vertices and matrices are Blender's, with z up.
"""

import importlib
import json
import os
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2] / "ssdr" / "io" / "blender"))
write_script: Any = importlib.import_module("write_script")


def load(path: str, fps: float) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    write_script.set_rate(fps)
    suffix = os.path.splitext(path)[1]
    if suffix == ".fbx":
        bpy.ops.import_scene.fbx(filepath=path, ignore_leaf_bones=False, anim_offset=0.0)
    elif suffix == ".glb":
        bpy.ops.import_scene.gltf(filepath=path, merge_vertices=False)
    else:
        known = bpy.ops.wm.usd_import.get_rna_type().properties.keys()
        option = "apply_unit_conversion_scale"  # Blender 4.2 never applies it
        options = {option: False} if option in known else {}
        bpy.ops.wm.usd_import(filepath=path, set_frame_range=True, **options)


def play(clip: str | None) -> int:
    """Give every object its action of a clip; the first frame."""
    moved = [o for o in bpy.data.objects if o.animation_data]
    for item in moved:
        tracks = {t.name: t.strips[0].action for t in item.animation_data.nla_tracks}
        named = {part: a for a in bpy.data.actions for part in a.name.split("|")}
        if clip in tracks or clip in named:
            item.animation_data.action = tracks.get(clip) or named[clip]
    starts = [o.animation_data.action.frame_range[0] for o in moved if o.animation_data.action]
    return round(min(starts)) if starts else bpy.context.scene.frame_start


def look(job: dict[str, Any]) -> None:
    load(job["path"], job["fps"])
    found = sorted(bpy.context.scene.objects, key=lambda o: o.name)
    # without the sphere that the glTF importer adds to draw bones
    items = [o for o in found if o.type == "MESH" and not o.name.startswith("Icosphere")]
    armature = next((o for o in found if o.type == "ARMATURE"), None)
    bones = list(armature.data.bones) if armature else []
    first, points, poses = play(job["clip"]), [], []
    for k in range(job["frames"]):
        bpy.context.scene.frame_set(first + k)
        graph = bpy.context.evaluated_depsgraph_get()
        shown = [item.evaluated_get(graph) for item in items]
        blocks = []
        for item in shown:
            place = np.array(item.matrix_world)
            own = write_script.values(item.to_mesh().vertices, "co", np.float32, 3)
            blocks.append(own @ place[:3, :3].T + place[:3, 3])
            item.to_mesh_clear()
        points.append(np.concatenate(blocks))
        if armature:
            rest, posed = np.array(armature.matrix_world), armature.evaluated_get(graph).pose.bones
            unrest = [np.linalg.inv(rest @ np.array(bone.matrix_local)) for bone in bones]
            moves = [
                rest @ np.array(posed[b.name].matrix) @ u
                for b, u in zip(bones, unrest, strict=True)
            ]
            poses.append(moves)
    slots = [write_script.values(i.data.polygons, "material_index", np.int32) for i in items]
    pictures = [i.packed_file.data for i in bpy.data.images if i.packed_file]
    arrays: dict[str, Any] = {"vertices": np.array(points), "materials": np.concatenate(slots)}
    arrays["pictures"] = np.array(pictures)
    if all("_VERTEX" in item.data.attributes for item in items):
        arrays["vertex"] = write_script.vertex_numbers(items)
    if armature:
        names = [bone.name for bone in bones]
        above = [names.index(b.parent.name) if b.parent else -1 for b in bones]
        place = np.array(armature.matrix_world)
        heads = [place[:3, :3] @ b.matrix_local.translation + place[:3, 3] for b in bones]
        arrays |= {"bones": np.array(json.dumps(names)), "parents": np.array(above)}
        arrays |= {"joints": np.array(heads), "transforms": np.array(poses)[:, :, :3]}
    np.savez(job["out"], **arrays)


if __name__ == "__main__":
    write_script.run(look)
