"""Run as ``python script.py job.json`` or ``blender --python script.py -- job.json``.

It knows NumPy and Blender alone: the package itself need not be installed
there.  What it finds goes into an archive of arrays, what goes wrong to stderr.
"""

import json
import math
import os
import sys
from typing import Any

import bpy
import numpy as np


def reset(fps: float) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    render = bpy.context.scene.render
    render.fps = max(1, round(fps))
    render.fps_base = render.fps / fps


def rate() -> float:
    render = bpy.context.scene.render
    return float(render.fps / render.fps_base)


def load(path: str) -> None:
    if path.lower().endswith(".abc"):
        bpy.ops.wm.alembic_import(filepath=path, as_background_job=False, set_frame_range=True)
    elif path.lower().endswith(".fbx"):
        bpy.ops.import_scene.fbx(
            filepath=path, use_anim=True, ignore_leaf_bones=True, anim_offset=0.0
        )
    elif path.lower().endswith((".glb", ".gltf")):
        bpy.ops.import_scene.gltf(filepath=path, merge_vertices=False)
    else:
        bpy.ops.wm.usd_import(
            filepath=path, set_frame_range=True, apply_unit_conversion_scale=False
        )


def actions_range() -> Any:
    spans = [action.frame_range for action in bpy.data.actions]
    if not spans:
        return None
    return min(s[0] for s in spans), max(s[1] for s in spans)


def frames_of(path: str) -> tuple[int, int]:
    scene = bpy.context.scene
    if path.lower().endswith((".abc", ".usd", ".usda", ".usdc")):
        moving = bpy.data.cache_files or bpy.data.actions
        return (scene.frame_start, scene.frame_end) if moving else (scene.frame_start,) * 2
    first, last = actions_range() or (1, 1)
    return math.floor(first + 1e-3), math.ceil(last - 1e-3)


def stacks(path: str) -> list[tuple[str, str]]:
    """Names of the animation stacks and their layers in an FBX file, in its order."""
    from io_scene_fbx import parse_fbx

    def names(kind: bytes) -> list[tuple[int, str]]:
        return [
            (e.props[0], e.props[1].split(b"\0")[0].decode("utf-8", "replace"))
            for e in objects.elems
            if e.id == kind
        ]

    root = parse_fbx.parse(path)[0]
    parts = {e.id: e for e in root.elems}
    if b"Objects" not in parts:
        return []
    objects = parts[b"Objects"]
    layers = dict(names(b"AnimationLayer"))
    links = [e.props[1:3] for e in getattr(parts.get(b"Connections"), "elems", ())]
    return [
        (name, next((layers[a] for a, b in links if b == number and a in layers), name))
        for number, name in names(b"AnimationStack")
    ]


def cut(name: str) -> str:
    return name.encode()[:63].decode("utf-8", "ignore")


def takes(path: str) -> list[tuple[str, list[tuple[Any, Any]]]]:
    """The clips of an FBX or glTF file that was loaded: what acts on what."""
    moved = [o for o in (*bpy.data.objects, *bpy.data.shape_keys) if o.animation_data]
    if path.lower().endswith((".glb", ".gltf")):
        tracks: dict[str, list[tuple[Any, Any]]] = {}
        for item in moved:
            for track in item.animation_data.nla_tracks:
                tracks.setdefault(track.name, []).append((item, track.strips[0].action))
        return list(tracks.items())
    if not path.lower().endswith(".fbx"):
        return []
    found: list[tuple[str, list[tuple[Any, Any]]]] = []
    for name, layer in stacks(path):
        tail = name if layer == name else f"{name}|{layer}"
        # as Blender's importer calls them, cut to what its names may have
        pairs = [(o, bpy.data.actions.get(cut(f"{o.name}|{tail}"))) for o in moved]
        if any(action for _, action in pairs):
            names = [other for other, _ in found]
            known = [name, *(f"{name}_{k}" for k in range(1, len(names) + 1))]
            found.append((next(n for n in known if n not in names), pairs))
    return found


def span(pairs: list[tuple[Any, Any]]) -> tuple[int, int]:
    ranges = [action.frame_range for _, action in pairs if action]
    first, last = min(r[0] for r in ranges), max(r[1] for r in ranges)
    return math.floor(first + 1e-3), math.ceil(last - 1e-3)


def count_frames(first: int, last: int, step: float) -> int:
    return math.floor((last - first) / step + 1e-3) + 1


def list_takes(job: dict[str, Any]) -> None:
    reset(job["fps"])
    load(job["path"])
    step = rate() / job["fps"] if job["resample"] else 1.0
    found = takes(job["path"])
    spans = [span(pairs) for _, pairs in found] or [frames_of(job["path"])]
    np.savez(
        job["out"],
        names=np.array(json.dumps([name for name, _ in found])),
        frames=np.array([count_frames(*one, step) for one in spans]),
        fps=np.float64(rate() / step),
    )


def meshes() -> list[Any]:
    found = [o for o in bpy.context.scene.objects if o.type == "MESH"]
    # Bones are drawn as balls by some importers; what renders is what counts.
    found = [o for o in found if not o.hide_render and not o.name.startswith("Icosphere")]
    return sorted(found, key=lambda o: o.name)


def world_points(item: Any, graph: Any) -> Any:
    shown = item.evaluated_get(graph)
    mesh = shown.to_mesh()
    points = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
    mesh.vertices.foreach_get("co", points)
    shown.to_mesh_clear()
    matrix = np.array(shown.matrix_world, dtype=np.float64)
    return points.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def surface_of(items: list[Any], arrays: dict[str, Any]) -> None:
    faces: list[Any] = []
    uv: list[Any] = []
    normals: list[Any] = []
    index: list[Any] = []
    materials: list[Any] = []
    start = 0
    for item in items:
        mesh = item.data
        mesh.calc_loop_triangles()
        count = len(mesh.loop_triangles)
        loops = np.empty(count * 3, dtype=np.int32)
        mesh.loop_triangles.foreach_get("loops", loops)
        corner = np.empty(len(mesh.loops), dtype=np.int32)
        mesh.loops.foreach_get("vertex_index", corner)
        faces.append(corner[loops].reshape(-1, 3) + start)
        start += len(mesh.vertices)
        if mesh.uv_layers.active:
            flat = np.empty(len(mesh.loops) * 2, dtype=np.float32)
            mesh.uv_layers.active.data.foreach_get("uv", flat)
            uv.append(flat.reshape(-1, 2)[loops].reshape(-1, 3, 2))
        if mesh.corner_normals:
            flat = np.empty(len(mesh.loops) * 3, dtype=np.float32)
            mesh.corner_normals.foreach_get("vector", flat)
            matrix = np.array(item.matrix_world, dtype=np.float64)[:3, :3]
            turned = flat.reshape(-1, 3)[loops] @ np.linalg.pinv(matrix)
            length = np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-30)
            normals.append((turned / length).reshape(-1, 3, 3))
        slots = np.empty(count, dtype=np.int32)
        mesh.loop_triangles.foreach_get("material_index", slots)
        numbers = [number_of(slot.material, materials) for slot in item.material_slots]
        index.append(np.array(numbers or [number_of(None, materials)])[slots * bool(numbers)])
    arrays["faces"] = np.concatenate(faces)
    if uv and len(uv) == len(items):
        arrays["uv"] = np.concatenate(uv)
    if normals and len(normals) == len(items):
        arrays["normals"] = np.concatenate(normals)
    if any(m is not None for m in materials):
        arrays["material_index"] = np.concatenate(index)
        arrays["materials"] = np.array(json.dumps([describe(m, arrays) for m in materials]))


def number_of(material: Any, materials: list[Any]) -> int:
    if material not in materials:
        materials.append(material)
    return materials.index(material)


def describe(material: Any, arrays: dict[str, Any]) -> dict[str, Any]:
    if material is None:
        return {"name": "default"}
    record: dict[str, Any] = {
        "name": material.name,
        "base_color": [float(c) for c in material.diffuse_color],
    }
    record["double_sided"] = not material.use_backface_culling
    nodes = material.node_tree.nodes if material.node_tree else []
    for node in nodes:
        if node.type == "BSDF_PRINCIPLED":
            color = node.inputs["Base Color"]
            record["base_color"] = [float(c) for c in color.default_value]
            record["metallic"] = float(node.inputs["Metallic"].default_value)
            record["roughness"] = float(node.inputs["Roughness"].default_value)
            if color.is_linked:
                attach(color.links[0].from_node, record, arrays)
    return record


def attach(node: Any, record: dict[str, Any], arrays: dict[str, Any]) -> None:
    image = getattr(node, "image", None)
    if image is None:
        return
    data = bytes(image.packed_file.data) if image.packed_file else b""
    if not data:
        try:
            with open(bpy.path.abspath(image.filepath), "rb") as stream:
                data = stream.read()
        except OSError:
            return
    kinds = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}
    for magic, kind in kinds.items():
        if data.startswith(magic):
            key = f"texture_{sum(k.startswith('texture_') for k in arrays)}"
            arrays[key] = np.frombuffer(data, dtype=np.uint8)
            record.update(texture=key, texture_type=kind, base_color=[1.0, 1.0, 1.0, 1.0])


def read(job: dict[str, Any]) -> None:
    reset(job["fps"])
    load(job["path"])
    items = meshes()
    if not items:
        raise ValueError("the scene holds no mesh")
    scene, graph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    first, last = frames_of(job["path"])
    found = takes(job["path"])
    names = [name for name, _ in found]
    arrays: dict[str, Any] = {"names": np.array(json.dumps(names))}
    take = 0 if job.get("take") is None else job["take"]
    if take in names:
        take = names.index(take)
    elif found and take not in range(len(found)):
        np.savez(job["out"], **arrays)  # the caller says what is wrong
        return
    if len(found) > 1:
        pairs = found[take][1]
        for item, action in pairs:
            item.animation_data.action = action
        first, last = span(pairs)
    counts = [len(item.data.vertices) for item in items]
    step = rate() / job["fps"] if job["resample"] else 1.0
    count = count_frames(first, last, step)
    need = count * sum(counts) * 12
    if need > job["max_bytes"]:
        raise ValueError(f"its vertices need {need} bytes, max_bytes is {job['max_bytes']}")
    frames = np.empty((count, sum(counts), 3), dtype=np.float32)
    for k in range(len(frames)):
        whole = math.floor(first + k * step + 1e-6)
        scene.frame_set(whole, subframe=min(max(first + k * step - whole, 0.0), 0.999999))
        graph = bpy.context.evaluated_depsgraph_get()
        start = 0
        for item, size in zip(items, counts, strict=True):
            points = world_points(item, graph)
            if len(points) != size:
                raise ValueError(f"{item.name}: {size} vertices at first, {len(points)} later")
            frames[k, start : start + size] = points
            start += size
        if k == 0:
            surface_of(items, arrays)
    if all("_VERTEX" in item.data.attributes for item in items):
        arrays["vertex"] = vertex_numbers(items)
    np.savez(job["out"], vertices=frames, fps=np.float64(rate() / step), **arrays)


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
        for track in list(motion.nla_tracks):
            motion.nla_tracks.remove(track)
        for clip in clips:
            name = cut(f"{clip['action']}_{item.name}")
            track = motion.nla_tracks.new()
            strip = track.strips.new(clip["name"], 0, bpy.data.actions[name])
            strip.name = clip["name"]
            strip.action_frame_start, strip.action_frame_end = 0, clip["frames"] - 1
            strip.frame_start, strip.frame_end = 0, clip["frames"] - 1


def write(job: dict[str, Any]) -> None:
    reset(job["fps"])
    load(job["source"])
    items = meshes()
    np.savez(job["out"], vertex=vertex_numbers(items))
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
    else:
        read(job)


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # some releases of bpy crash when they are torn down, the work being done
