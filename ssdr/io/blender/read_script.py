"""Script that reads a file in Blender, according to a job in a JSON file; see ``in_blender.py``."""

import importlib
import json
import os
import sys
from typing import Any

import bpy
import numpy as np

# Blender puts neither this folder nor the package on the path; above lies frame_rates.py.
_HERE = os.path.dirname(os.path.abspath(__file__))
sys.path += [_HERE, os.path.dirname(_HERE)]
in_blender: Any = importlib.import_module("in_blender")
skins: Any = importlib.import_module("skins")
surfaces: Any = importlib.import_module("fbx_surfaces")
takes: Any = importlib.import_module("takes")


def load(path: str, fps: float) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    in_blender.set_rate(fps)
    suffix = os.path.splitext(path)[1].lower()
    if suffix == ".fbx":
        bpy.ops.import_scene.fbx(
            filepath=path, use_anim=True, ignore_leaf_bones=False, anim_offset=0.0
        )
        # The importer attaches a bone that begins where another ends; detached, it can slide.
        for item in list(bpy.context.view_layer.objects):
            if item.type == "ARMATURE" and any(bone.use_connect for bone in item.data.bones):
                edit(item, lambda bone: setattr(bone, "use_connect", False))
    elif suffix in (".glb", ".gltf"):
        bpy.ops.import_scene.gltf(filepath=path, merge_vertices=False)
    else:
        options: dict[str, Any] = {}
        known = bpy.ops.wm.usd_import.get_rna_type().properties.keys()
        if "apply_unit_conversion_scale" in known:  # Blender 4.2 never applies it
            options["apply_unit_conversion_scale"] = False
        bpy.ops.wm.usd_import(filepath=path, set_frame_range=True, **options)


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


def is_bone_shape(item: Any) -> bool:
    """Whether a mesh is the sphere that Blender's glTF importer adds to draw bones."""
    held = item.parent or item.modifiers or item.constraints
    alone = not (held or item.animation_data or item.material_slots)
    return item.name.startswith("Icosphere") and len(item.data.vertices) == 42 and alone


def edit(item: Any, change: Any) -> None:
    """Apply a function to each bone of an armature in edit mode."""
    hidden, item.hide_viewport = item.hide_viewport, False
    bpy.context.view_layer.objects.active = item
    bpy.ops.object.mode_set(mode="EDIT")
    for bone in item.data.edit_bones:
        change(bone)
    bpy.ops.object.mode_set(mode="OBJECT")
    item.hide_viewport = hidden


def names_of(item: Any) -> list[str]:
    """Names of an object, its mesh and the objects above it."""
    names = [item.name, item.data.name]
    while item.parent is not None:
        item = item.parent
        names.append(item.name)
    return names


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
            arrays["vertex"] = in_blender.vertex_numbers(self.items)
        return arrays


def read(job: dict[str, Any]) -> None:
    """Read a file and write an archive with what the job's action asks for.

    The actions are "list" (takes and names of meshes), "read" (vertices of one take)
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
    if job["action"] == "read":
        model = Vertices(items)
        take = job.get("take") or 0
        take = names.index(take) if take in names else take
        if found and take not in range(len(found)):
            np.savez(job["out"], **arrays)  # the caller reports that there is no such take
            return
        found = found[take : take + 1] if found else []
    elif job["action"] == "read skinning" and items:
        model = skins.SkinnedMeshes(items, takes.skin_bone_names(job["path"]))
    elif job["action"] == "read skinning":
        model = skins.BareArmatures(armatures)
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


if __name__ == "__main__":
    in_blender.run(read)
