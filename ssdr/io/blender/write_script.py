"""Script that writes a model as FBX in Blender, given as glTF.

It runs as ``python write_script.py job.json`` or ``blender --python write_script.py -- job.json``.
It needs only NumPy and Blender, not the package. It writes its results to an archive of arrays and
errors to stderr.
"""

import fractions
import json
import os
import sys
from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

_LARGEST_RATE = 32767  # of Blender's integer for the frame rate


def run(act: Callable[[dict[str, Any]], None]) -> None:
    """Run a script's function on its job, and end the process."""
    if bpy.app.version < (4, 2, 0):
        raise RuntimeError(f"Blender 4.2 or newer is needed, this is {bpy.app.version_string}")
    with open(sys.argv[-1], encoding="utf-8") as stream:
        job = json.load(stream)
    try:
        act(job)
    except RuntimeError as error:  # of Blender, which may hold a traceback
        said = (str(error).strip().splitlines() or [""])[-1].removeprefix("Error: ")
        np.savez(job["out"], error=np.array(f"Blender says: {' '.join(said.split())}"))
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # some releases of bpy crash at exit, after all work is done


def set_rate(fps: float) -> None:
    """Set the scene's frame rate, which Blender stores as an integer divided by a float32."""
    render, ratio = bpy.context.scene.render, fractions.Fraction(fps).limit_denominator(1001)
    if 0 < ratio.numerator <= _LARGEST_RATE and float(ratio) == fps:
        render.fps, render.fps_base = ratio.numerator, ratio.denominator
    else:
        render.fps = max(1, min(round(fps), _LARGEST_RATE))
        render.fps_base = render.fps / fps


def values(data: Any, name: str, dtype: Any, width: int = 1) -> Any:
    """Values of the attribute `name` of all elements of a Blender collection, in rows of `width`.

    If `width` is 1, the array has one dimension.
    """
    size = len(data) * (np.size(getattr(data[0], name)) if len(data) else 1)
    flat = np.empty(size, dtype=dtype)
    data.foreach_get(name, flat)
    return flat if width == 1 else flat.reshape(-1, width)


def vertex_numbers(items: list[Any]) -> Any:
    """Model vertex index (n,) of each vertex of all meshes, one mesh after the other.

    It is read from the mesh attribute ``_VERTEX``, which ssdr writes to its glTF files.
    """
    attributes = [item.data.attributes["_VERTEX"].data for item in items]
    found = [values(data, "value", np.float32) for data in attributes]
    return np.concatenate(found).astype(np.int64)


def put_strips(item: Any, clips: list[dict[str, Any]]) -> None:
    """Give an armature an NLA strip for each clip; the exporter makes a take of each strip."""
    motion = item.animation_data
    motion.action = None
    # The importer's names of actions differ between releases of Blender; those of tracks do not.
    found = {track.name: track.strips[0] for track in motion.nla_tracks}
    held = {n: (s.action, getattr(s, "action_slot", None)) for n, s in found.items()}
    for track in list(motion.nla_tracks):
        motion.nla_tracks.remove(track)
    for clip in clips:
        action, slot = held[clip["action"]]
        strip = motion.nla_tracks.new().strips.new(clip["name"], 0, action)
        if slot is not None:
            strip.action_slot = slot
        strip.name = clip["name"]
        strip.action_frame_start, strip.action_frame_end = 0, clip["frames"] - 1
        strip.frame_start, strip.frame_end = 0, clip["frames"] - 1


def merge_copies(item: Any) -> None:
    """Merge the copies of vertices that glTF needs where normals or UVs differ.

    Normals and UVs are then stored per corner, as in FBX. Blender keeps only one triangle on any
    three vertices, so each further triangle on the same three gets copies of them.
    """
    old = item.data
    numbers, first, place = np.unique(
        vertex_numbers([item]), return_index=True, return_inverse=True
    )
    loops = values(old.loops, "vertex_index", np.int32)
    faces = place.ravel()[loops].reshape(-1, 3).astype(np.int64)
    solid = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    faces = faces[solid] + len(numbers) * copies(faces[solid])[:, None]
    used = np.union1d(np.arange(len(numbers)), faces)
    numbers, first = (array[used % len(numbers)] for array in (numbers, first))

    new = bpy.data.meshes.new(old.name)
    points = values(old.vertices, "co", np.float32, 3)[first]
    new.from_pydata(points, [], np.searchsorted(used, faces))
    for layer in old.uv_layers:
        flat = values(layer.data, "uv", np.float32, 6)[solid].ravel()
        new.uv_layers.new(name=layer.name).data.foreach_set("uv", flat)
    for material in old.materials:
        new.materials.append(material)
    slots = values(old.polygons, "material_index", np.int32)
    new.polygons.foreach_set("material_index", slots[solid])
    normals = values(old.corner_normals, "vector", np.float32, 9)[solid]
    known = new.attributes.new("_VERTEX", "FLOAT", "POINT")
    known.data.foreach_set("value", numbers.astype(np.float32))
    weights = [[(g.group, g.weight) for g in old.vertices[int(k)].groups] for k in first]
    groups = [group.name for group in item.vertex_groups]

    item.data = new
    new.normals_split_custom_set(normals.reshape(-1, 3))
    item.vertex_groups.clear()
    for name in groups:
        item.vertex_groups.new(name=name)
    for k, row in enumerate(weights):
        for group, weight in row:
            item.vertex_groups[group].add((k,), weight, "REPLACE")
    bpy.data.meshes.remove(old)


def copies(faces: Any) -> Any:
    """Count, for each triangle, of the earlier triangles on the same three vertices."""
    rows = np.sort(faces, axis=1)
    order = np.lexsort(rows.T)
    sorted_rows, number = rows[order], np.arange(len(rows))
    differs = np.ones(len(rows), dtype=bool)
    differs[1:] = (sorted_rows[1:] != sorted_rows[:-1]).any(axis=1)
    result = np.empty(len(rows), dtype=np.int64)
    result[order] = number - np.maximum.accumulate(np.where(differs, number, 0))
    return result


def write(job: dict[str, Any]) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    set_rate(job["import_fps"])
    bpy.ops.import_scene.gltf(filepath=job["source"], merge_vertices=False, **job["options"])
    set_rate(job["fps"])
    found = list(bpy.context.scene.objects)
    # without the sphere that the importer adds to draw bones
    items = [o for o in found if o.type == "MESH" and "_VERTEX" in o.data.attributes]
    for item in items:
        merge_copies(item)
    triangles = sum(len(item.data.polygons) for item in items)
    np.savez(job["out"], vertex=vertex_numbers(items), triangles=np.array(triangles))
    armatures = [item for item in found if item.type == "ARMATURE"]
    for item in armatures:
        if item.animation_data:
            put_strips(item, job["clips"])
    bpy.context.scene.unit_settings.scale_length = job["unit"]
    for item in found:
        item.select_set(item in items or item in armatures)
    bpy.ops.export_scene.fbx(
        filepath=job["path"],
        use_selection=True,
        object_types={"ARMATURE", "MESH"},
        add_leaf_bones=False,
        bake_anim=True,
        bake_anim_use_all_bones=True,
        bake_anim_use_nla_strips=True,
        bake_anim_use_all_actions=False,
        bake_anim_simplify_factor=0.0,
        bake_anim_step=1.0,
        path_mode="COPY",
        embed_textures=True,
        mesh_smooth_type="OFF",
    )


if __name__ == "__main__":
    run(write)
