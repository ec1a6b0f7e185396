"""Run as ``python script.py job.json`` or ``blender --python script.py -- job.json``.

It knows NumPy and Blender alone: the package itself need not be installed
there.  What it finds goes into an archive of arrays, what goes wrong to stderr.
"""

import importlib
import json
import os
import sys
from typing import Any

import bpy
import numpy as np

# Blender puts neither this folder nor the package on the path.
sys.path.append(os.path.dirname(os.path.abspath(__file__)))
skins: Any = importlib.import_module("skins")
surfaces: Any = importlib.import_module("surfaces")
takes: Any = importlib.import_module("takes")


def reset(fps: float) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    takes.set_rate(fps)


def load(path: str, **options: Any) -> None:
    if path.lower().endswith(".abc"):
        bpy.ops.wm.alembic_import(filepath=path, as_background_job=False, set_frame_range=True)
    elif path.lower().endswith(".fbx"):
        bpy.ops.import_scene.fbx(
            filepath=path, use_anim=True, ignore_leaf_bones=False, anim_offset=0.0
        )
        disconnect()
    elif path.lower().endswith((".glb", ".gltf")):
        bpy.ops.import_scene.gltf(filepath=path, merge_vertices=False, **options)
    else:
        known = bpy.ops.wm.usd_import.get_rna_type().properties.keys()
        as_is = {
            "apply_unit_conversion_scale": False
        }  # Blender 4.2 does not know it: it never does
        as_is = {key: value for key, value in as_is.items() if key in known}
        bpy.ops.wm.usd_import(filepath=path, set_frame_range=True, **as_is)


def disconnect() -> None:
    """Let bones slide that begin where another ends: the importer fixes them there."""
    for item in list(bpy.context.view_layer.objects):
        if item.type == "ARMATURE" and any(bone.use_connect for bone in item.data.bones):
            edit(item, lambda bone: setattr(bone, "use_connect", False))


def edit(item: Any, change: Any) -> None:
    """Change each bone of an armature at rest."""
    hidden, item.hide_viewport = item.hide_viewport, False
    bpy.context.view_layer.objects.active = item
    bpy.ops.object.mode_set(mode="EDIT")
    for bone in item.data.edit_bones:
        change(bone)
    bpy.ops.object.mode_set(mode="OBJECT")
    item.hide_viewport = hidden


def list_takes(job: dict[str, Any]) -> None:
    reset(job["fps"])
    load(job["path"])
    found = takes.listed(job["path"])
    clocks = [takes.clock(job, pairs) for _, pairs in found] or [takes.clock(job)]
    np.savez(
        job["out"],
        names=np.array(json.dumps([name for name, _ in found])),
        frames=np.array([clock.count for clock in clocks]),
        fps=np.array([clock.fps for clock in clocks]),
        left_out=np.array(json.dumps(surfaces.left_out(meshes()))),
    )


def meshes() -> list[Any]:
    """The meshes that are shown, in the order of their names."""
    objects = list(bpy.context.scene.objects)
    found = [o for o in objects if o.type == "MESH" and not (o.hide_render or o.hide_viewport)]
    found = [o for o in found if len(o.data.vertices)]
    found = [o for o in found if not is_bone_shape(o)] or found
    if not found:
        raise ValueError("no mesh that is shown, one at least was expected")
    return sorted(found, key=lambda o: o.name)


def is_bone_shape(item: Any) -> bool:
    """Whether it is the ball by which Blender's glTF importer draws bones, and then exports."""
    held = item.parent or item.modifiers or item.constraints
    alone = not (held or item.animation_data or item.material_slots)
    return item.name.startswith("Icosphere") and len(item.data.vertices) == 42 and alone


def world_points(item: Any, graph: Any) -> Any:
    shown = item.evaluated_get(graph)
    mesh = shown.to_mesh()
    points = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
    mesh.vertices.foreach_get("co", points)
    shown.to_mesh_clear()
    matrix = np.array(shown.matrix_world, dtype=np.float64)
    return points.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def read(job: dict[str, Any]) -> None:
    reset(job["fps"])
    load(job["path"])
    items = meshes()
    found = takes.listed(job["path"])
    names = [name for name, _ in found]
    arrays: dict[str, Any] = {"names": np.array(json.dumps(names)), **title(items)}
    take = 0 if job.get("take") is None else job["take"]
    if take in names:
        take = names.index(take)
    elif found and take not in range(len(found)):
        np.savez(job["out"], **arrays)  # the caller says what is wrong
        return
    clock = takes.play(job, found[take][1]) if found else takes.clock(job)
    counts = [len(item.data.vertices) for item in items]
    check_size(clock.count * sum(counts) * 12, "vertices", job)
    frames = np.empty((clock.count, sum(counts), 3), dtype=np.float32)
    for k in range(len(frames)):
        graph = clock.go(k)
        start = 0
        for item, size in zip(items, counts, strict=True):
            points = world_points(item, graph)
            if len(points) != size:
                raise ValueError(f"{item.name}: {size} vertices at first, {len(points)} later")
            frames[k, start : start + size] = points
            start += size
        if k == 0:
            surfaces.join(items, arrays, job["path"])
    if all("_VERTEX" in item.data.attributes for item in items):
        arrays["vertex"] = vertex_numbers(items)
    np.savez(job["out"], vertices=frames, fps=np.float64(clock.fps), **arrays)


def read_skinning(job: dict[str, Any]) -> None:
    reset(job["fps"])
    load(job["path"])
    items = meshes()
    found = takes.listed(job["path"])
    arrays: dict[str, Any] = {
        "names": np.array(json.dumps([name for name, _ in found])),
        **title(items),
    }
    pose = takes.pose()
    model = skins.Model(items, takes.clustered(job["path"]))
    clocks: list[Any] = []
    need = 0
    for _, pairs in found or [("", None)]:
        takes.restore(pose)
        clock = takes.clock(job) if pairs is None else takes.play(job, pairs)
        need += clock.count * model.n_bones * 96
        check_size(need, "transforms", job)
        if not clocks:
            model.show(False)
            model.read_rest(clock.go(0))
            surfaces.join(items, arrays, job["path"])
            model.show(True)
        for k in range(clock.count):
            model.sample(clock.go(k))
        clocks.append(clock)
    np.savez(
        job["out"],
        frames=np.array([clock.count for clock in clocks]),
        fps=np.array([clock.fps for clock in clocks]),
        **model.arrays(),
        **arrays,
    )


def title(items: list[Any]) -> dict[str, Any]:
    return {"title": np.array(items[0].name)} if len(items) == 1 else {}


def check_size(need: int, what: str, job: dict[str, Any]) -> None:
    if need > job["max_bytes"]:
        raise ValueError(f"its {what} need {need} bytes, max_bytes is {job['max_bytes']}")


def vertex_numbers(items: list[Any]) -> Any:
    """The package's number of each vertex, an attribute that its glTF carries."""
    found = []
    for item in items:
        data = item.data.attributes["_VERTEX"].data
        values = np.empty(len(data), dtype=np.float32)
        data.foreach_get("value", values)
        found.append(values.astype(np.int64))
    return np.concatenate(found)


def lay_out(clips: list[dict[str, Any]]) -> None:
    """A strip a clip: the exporter makes a take of each, called as it is."""
    for item in bpy.context.scene.objects:
        if item.type != "ARMATURE" or not item.animation_data:
            continue
        motion = item.animation_data
        motion.action = None
        # What the importer calls its actions differs between releases, its tracks do not.
        found = {track.name: track.strips[0] for track in motion.nla_tracks}
        held = {n: (s.action, getattr(s, "action_slot", None)) for n, s in found.items()}
        for track in list(motion.nla_tracks):
            motion.nla_tracks.remove(track)
        for clip in clips:
            action, slot = held[clip["action"]]
            track = motion.nla_tracks.new()
            strip = track.strips.new(clip["name"], 0, action)
            if slot is not None:
                strip.action_slot = slot
            strip.name = clip["name"]
            strip.action_frame_start, strip.action_frame_end = 0, clip["frames"] - 1
            strip.frame_start, strip.frame_end = 0, clip["frames"] - 1


def set_lengths(lengths: dict[str, float]) -> None:
    """How far the bones reach, by name."""
    for item in bpy.context.scene.objects:
        if item.type == "ARMATURE":
            edit(item, lambda b: setattr(b, "length", lengths.get(b.name, b.length)))


def sew(item: Any) -> None:
    """One vertex for each of the package's, where glTF needed one for each normal and UV.

    Normals and UVs are those of the corners, as FBX has them.  Blender keeps one triangle on the
    same three vertices, so that others there get copies of them.
    """
    old = item.data
    numbers, first, place = np.unique(
        vertex_numbers([item]), return_index=True, return_inverse=True
    )
    loops = np.empty(len(old.loops), dtype=np.int32)
    old.loops.foreach_get("vertex_index", loops)
    faces = place.ravel()[loops].reshape(-1, 3).astype(np.int64)
    solid = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    faces = faces[solid] + len(numbers) * copies(faces[solid])[:, None]
    used = np.union1d(np.arange(len(numbers)), faces)
    numbers, first = (values[used % len(numbers)] for values in (numbers, first))
    points = np.empty(len(old.vertices) * 3, dtype=np.float32)
    old.vertices.foreach_get("co", points)

    new = bpy.data.meshes.new(old.name)
    new.from_pydata(points.reshape(-1, 3)[first], [], np.searchsorted(used, faces))
    for layer in old.uv_layers:
        flat = np.empty(len(old.loops) * 2, dtype=np.float32)
        layer.data.foreach_get("uv", flat)
        flat = flat.reshape(-1, 6)[solid].ravel()
        new.uv_layers.new(name=layer.name).data.foreach_set("uv", flat)
    for material in old.materials:
        new.materials.append(material)
    slots = np.empty(len(old.polygons), dtype=np.int32)
    old.polygons.foreach_get("material_index", slots)
    new.polygons.foreach_set("material_index", slots[solid])
    normals = np.empty(len(old.loops) * 3, dtype=np.float32)
    old.corner_normals.foreach_get("vector", normals)
    known = new.attributes.new("_VERTEX", "FLOAT", "POINT")
    known.data.foreach_set("value", numbers.astype(np.float32))
    weights = [[(g.group, g.weight) for g in old.vertices[int(k)].groups] for k in first]
    groups = [group.name for group in item.vertex_groups]

    item.data = new
    new.normals_split_custom_set(normals.reshape(-1, 9)[solid].reshape(-1, 3))
    item.vertex_groups.clear()
    for name in groups:
        item.vertex_groups.new(name=name)
    for k, row in enumerate(weights):
        for group, weight in row:
            item.vertex_groups[group].add((k,), weight, "REPLACE")
    bpy.data.meshes.remove(old)


def copies(faces: Any) -> Any:
    """How many triangles before each are on the same three vertices."""
    rows = np.sort(faces, axis=1)
    order = np.lexsort(rows.T)
    sorted_rows, number = rows[order], np.arange(len(rows))
    differs = np.ones(len(rows), dtype=bool)
    differs[1:] = (sorted_rows[1:] != sorted_rows[:-1]).any(axis=1)
    result = np.empty(len(rows), dtype=np.int64)
    result[order] = number - np.maximum.accumulate(np.where(differs, number, 0))
    return result


def write(job: dict[str, Any]) -> None:
    reset(job["import_fps"])
    if job["lengths"] is None:
        load(job["source"])
    else:
        load(job["source"], bone_heuristic="BLENDER")  # bones lie along their own y axis
        set_lengths(job["lengths"])
    takes.set_rate(job["fps"])
    items = meshes()
    for item in items:
        sew(item)
    triangles = sum(len(item.data.polygons) for item in items)
    np.savez(job["out"], vertex=vertex_numbers(items), triangles=np.array(triangles))
    lay_out(job["clips"])
    for item in bpy.context.scene.objects:
        item.select_set(item in items or item.type == "ARMATURE")
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


def main() -> None:
    if bpy.app.version < (4, 2, 0):
        raise RuntimeError(f"Blender 4.2 or newer is needed, this is {bpy.app.version_string}")
    with open(sys.argv[-1], encoding="utf-8") as stream:
        job = json.load(stream)
    if job["action"] == "write":
        write(job)
    elif job["action"] == "list":
        list_takes(job)
    elif job["action"] == "read skinning":
        read_skinning(job)
    else:
        read(job)


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # some releases of bpy crash when they are torn down, the work being done
