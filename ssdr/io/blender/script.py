"""Script that reads or writes a file in Blender, according to a job in a JSON file.

Run it as ``python script.py job.json`` or ``blender --python script.py -- job.json``. It needs only
NumPy and Blender, not the package. It writes its results to an archive of arrays and errors to
stderr.
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


def load(path: str, fps: float, **options: Any) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    takes.set_rate(fps)
    suffix = os.path.splitext(path)[1].lower()
    if suffix == ".abc":
        bpy.ops.wm.alembic_import(filepath=path, as_background_job=False, set_frame_range=True)
    elif suffix == ".fbx":
        bpy.ops.import_scene.fbx(
            filepath=path, use_anim=True, ignore_leaf_bones=False, anim_offset=0.0
        )
        # The importer attaches a bone that begins where another ends; detached, it can slide.
        for item in list(bpy.context.view_layer.objects):
            if item.type == "ARMATURE" and any(bone.use_connect for bone in item.data.bones):
                edit(item, lambda bone: setattr(bone, "use_connect", False))
    elif suffix in (".glb", ".gltf"):
        bpy.ops.import_scene.gltf(filepath=path, merge_vertices=False, **options)
    else:
        known = bpy.ops.wm.usd_import.get_rna_type().properties.keys()
        if "apply_unit_conversion_scale" in known:  # Blender 4.2 never applies it
            options["apply_unit_conversion_scale"] = False
        bpy.ops.wm.usd_import(filepath=path, set_frame_range=True, **options)


def edit(item: Any, change: Any) -> None:
    """Apply a function to each bone of an armature in edit mode."""
    hidden, item.hide_viewport = item.hide_viewport, False
    bpy.context.view_layer.objects.active = item
    bpy.ops.object.mode_set(mode="EDIT")
    for bone in item.data.edit_bones:
        change(bone)
    bpy.ops.object.mode_set(mode="OBJECT")
    item.hide_viewport = hidden


def meshes(needed: bool = True) -> list[Any]:
    """Mesh objects that are shown in the scene, sorted by name.

    An error is raised if a mesh is `needed` and there is none.
    """
    found = [
        o
        for o in bpy.context.scene.objects
        if o.type == "MESH" and not (o.hide_render or o.hide_viewport) and len(o.data.vertices)
    ]
    found = [o for o in found if not is_bone_shape(o)] or found
    if not found and needed:
        raise ValueError("no mesh that is shown, one at least was expected")
    return sorted(found, key=lambda o: o.name)


def names_of(item: Any) -> list[str]:
    """Names of an object, its mesh and the objects above it."""
    names = [item.name, item.data.name]
    while item.parent is not None:
        item = item.parent
        names.append(item.name)
    return names


def is_bone_shape(item: Any) -> bool:
    """Whether a mesh is the sphere that Blender's glTF importer adds to draw bones."""
    held = item.parent or item.modifiers or item.constraints
    alone = not (held or item.animation_data or item.material_slots)
    return item.name.startswith("Icosphere") and len(item.data.vertices) == 42 and alone


class Vertices:
    """Evaluated vertices of all meshes, sampled frame by frame."""

    what = "vertices"

    def __init__(self, items: list[Any]) -> None:
        self.items = items
        self.counts = [len(item.data.vertices) for item in items]
        self.bytes_per_frame = 12 * sum(self.counts)
        self.frames: list[Any] = []

    def read_rest(self, timeline: Any) -> None:
        """Show the first frame; there is no rest pose to read."""
        timeline.go(0)

    def sample(self, graph: Any) -> None:
        found = [skins.world_points(item, graph)[0] for item in self.items]
        for item, size, points in zip(self.items, self.counts, found, strict=True):
            if len(points) != size:
                count = f"{size} vertices at first, {len(points)} in frame {len(self.frames)}"
                raise ValueError(f"{item.name}: {count}")
        self.frames.append(np.concatenate(found).astype(np.float32))

    def arrays(self) -> dict[str, Any]:
        arrays = {"vertices": np.stack(self.frames)}
        if all("_VERTEX" in item.data.attributes for item in self.items):
            arrays["vertex"] = vertex_numbers(self.items)
        return arrays


def read(job: dict[str, Any]) -> None:
    """Read a file and write an archive with what the job's action asks for.

    The actions are "list" (takes, and contents that are not read), "read" (vertices of one take)
    and "read skinning" (skins, with the bones' transforms in all takes).
    """
    load(job["path"], job["fps"])
    armatures = [o for o in bpy.context.scene.objects if o.type == "ARMATURE"]
    items = meshes(not (job.get("joints_alone") and armatures))
    known, wanted = [names_of(item) for item in items], job.get("meshes")
    if wanted is not None:
        pairs = zip(items, known, strict=True)
        items = [item for item, names in pairs if not set(names).isdisjoint(wanted)]
    found = takes.list_takes(job["path"])
    names = [name for name, _ in found]
    arrays: dict[str, Any] = {"names": np.array(json.dumps(names))}
    arrays["meshes"] = np.array(json.dumps(known))
    if not set(wanted or ()).issubset(name for own in known for name in own):
        np.savez(job["out"], **arrays)  # the caller reports that there is no such mesh
        return
    if len(items) == 1:
        arrays["title"] = np.array(items[0].name)
    model: Any = None
    if job["action"] == "list":
        pass  # names and numbers of frames are enough
    elif job["action"] == "read":
        model = Vertices(items)
        take = job.get("take") or 0
        take = names.index(take) if take in names else take
        if found and take not in range(len(found)):
            np.savez(job["out"], **arrays)  # the caller reports that there is no such take
            return
        found = found[take : take + 1] if found else []
    elif not items:
        model = skins.ArmaturePoints(armatures)
    else:
        model = skins.SkinnedMeshes(items, takes.skin_bone_names(job["path"]))
    pose, timelines, missed, need = takes.pose(), [], [], 0
    for _, actions in found or [("", None)]:
        takes.restore(pose)
        timeline = takes.play(job, actions)
        timelines.append(timeline)
        if model is None:
            continue
        need += timeline.count * model.bytes_per_frame
        if need > job["max_bytes"]:
            limit = job["max_bytes"]
            raise ValueError(f"its {model.what} need {need} bytes, max_bytes is {limit}")
        if len(timelines) == 1:
            model.read_rest(timeline)
        senses = np.zeros(len(items))
        for k in range(timeline.count):
            model.sample(timeline.go(k))
            senses += surfaces.senses(items)
        if items and len(timelines) == 1:
            timeline.go(0)
            surfaces.join(items, arrays, job["path"], senses < 0)
        if items:
            missed.append((len(timeline.missed), *skins.lost_between(items, timeline)))
    np.savez(
        job["out"],
        frames=np.array([timeline.count for timeline in timelines]),
        fps=np.array([timeline.fps for timeline in timelines]),
        missed=np.array(missed, dtype=float).reshape(-1, 3),
        **arrays,
        **({} if model is None else model.arrays()),
    )


def vertex_numbers(items: list[Any]) -> Any:
    """Model vertex index (n,) of each vertex of all meshes, one mesh after the other.

    It is read from the mesh attribute ``_VERTEX``, which ssdr writes to its glTF files.
    """
    attributes = [item.data.attributes["_VERTEX"].data for item in items]
    found = [surfaces.values(data, "value", np.float32) for data in attributes]
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
    old, values = item.data, surfaces.values
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
    lengths = job["lengths"]
    # with this heuristic the importer draws bones along their own y axis
    options = {} if lengths is None else {"bone_heuristic": "BLENDER"}
    load(job["source"], job["import_fps"], **options)
    takes.set_rate(job["fps"])
    items = meshes()
    for item in items:
        merge_copies(item)
    triangles = sum(len(item.data.polygons) for item in items)
    np.savez(job["out"], vertex=vertex_numbers(items), triangles=np.array(triangles))
    armatures = [item for item in bpy.context.scene.objects if item.type == "ARMATURE"]
    for item in armatures:
        if lengths is not None:
            edit(item, lambda bone: setattr(bone, "length", lengths.get(bone.name, bone.length)))
        if item.animation_data:
            put_strips(item, job["clips"])
    bpy.context.scene.unit_settings.scale_length = job["unit"]
    for item in bpy.context.scene.objects:
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


def main() -> None:
    if bpy.app.version < (4, 2, 0):
        raise RuntimeError(f"Blender 4.2 or newer is needed, this is {bpy.app.version_string}")
    with open(sys.argv[-1], encoding="utf-8") as stream:
        job = json.load(stream)
    try:
        (write if job["action"] == "write" else read)(job)
    except (ValueError, RuntimeError) as error:  # a problem of the file, found here or by Blender
        said = str(error).strip()
        if isinstance(error, RuntimeError):
            said = f"Blender says: {said.removeprefix('Error: ')}"
        np.savez(job["out"], error=np.array(" ".join(said.split())))


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # some releases of bpy crash at exit, after all work is done
