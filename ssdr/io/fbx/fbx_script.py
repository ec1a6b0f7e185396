"""Script that reads the meshes of an FBX file, or evaluates its motion at given times.

Run it as ``python fbx_script.py job.json``. It needs only NumPy and ufbx, not the package. It runs
in a process of its own because ufbx crashes where an object is used after its scene, and may crash
at the interpreter's end. It writes its results, or the reason why the file is not read, to an
archive of arrays, which the package checks.
"""

import contextlib
import ctypes
import gc
import json
import os
import sys
from typing import Any

import numpy as np
import ufbx

_SPARE = 2 << 30  # bytes of address space beside the arrays: the library and NumPy
_MOVES = {"Lcl Translation", "Lcl Rotation", "Lcl Scaling", "DeformPercent", "Weight"}
# What ufbx repairs so that another shape results.
_DAMAGED = {"TRUNCATED_ARRAY", "MISSING_GEOMETRY_DATA", "INDEX_CLAMPED", "DUPLICATE_OBJECT_ID"}


class Refused(Exception):
    """A file is not read; the message is all that the user sees."""


def kept(thing: Any) -> Any:
    """The same element or list of a scene, which now lives as long as the scene.

    ufbx 0.0.5 gives away its own only reference to an element when it returns it, and that to a
    list when the list's buffer is released, so that a second use of either crashes.
    """
    if thing is not None:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(thing))
    return thing


def each(elements: Any) -> list[Any]:
    return [kept(elements[k]) for k in range(len(elements))]


def matrix(value: Any) -> Any:
    """Matrix (4, 4) for column vectors."""
    return np.vstack([np.array(value, dtype=np.float64).T, [0, 0, 0, 1]])


def numbers(values: Any, dtype: Any = np.int64) -> Any:
    return np.fromiter(values, dtype=dtype, count=len(values))


def rows(values: Any, width: int) -> Any:
    """Copy (N, `width`) of an array of ufbx, which must not outlive its scene."""
    found = np.array(memoryview(kept(values))) if len(values) else np.zeros((0, width))
    return found.reshape(-1, width)


class Reader:
    """An open file, and the arrays that are written to the archive.

    Attributes
    ----------
    nodes : list of ufbx.Node
        The root first, then in the order of the file, each after its parent.
    """

    def __init__(self, job: dict[str, Any]) -> None:
        self.job, self.arrays = job, dict[str, Any]()
        self.scene = self.load()
        files = [kept(self.scene.cache_files[k]) for k in range(len(self.scene.cache_files))]
        for name in {name for one in files for name in (one.filename, one.absolute_filename)}:
            self.check_inside(name)
        if files:
            self.scene = self.load(load_external_files=True, evaluate_caches=True)
        self.nodes = each(self.scene.nodes)
        for warning in self.scene.metadata.warnings:
            kind = ufbx.WarningType(warning.type).name
            if kind in _DAMAGED:
                raise Refused(f"truncated or damaged: {warning.description}")

    def load(self, **options: Any) -> Any:
        return ufbx.load_file(
            self.job["path"],
            file_format=ufbx.FileFormat.FBX,
            index_error_handling=ufbx.IndexErrorHandling.ABORT_LOADING,
            target_axes=ufbx.axes_right_handed_y_up,
            target_unit_meters=1.0,
            clean_skin_weights=True,
            **options,
        )

    def check_inside(self, name: str) -> None:
        """Refuse a cache outside the folders of the job; its parts have its name's beginning."""
        folder, stem = os.path.dirname(name), os.path.splitext(os.path.basename(name))[0]
        with contextlib.suppress(OSError, ValueError):
            for other in os.listdir(folder) if os.path.isfile(name) else ():
                place = os.path.realpath(os.path.join(folder, other))
                inside = any(place.startswith(os.path.join(f, "")) for f in self.job["folders"])
                if other.startswith(stem) and not inside:
                    raise Refused(f"its geometry cache {name} {self.job['outside']}")

    def put(self, values: Any) -> str:
        key = f"array_{len(self.arrays)}"
        self.arrays[key] = values
        return key

    def contents(self) -> dict[str, Any]:
        """Records of nodes, meshes and stacks of animation, and names of materials."""
        scene = self.scene
        hidden = {kept(node).typed_id for layer in each(scene.display_layers)
                  for node in (() if layer.visible else each(layer.nodes))}  # fmt: skip
        for group in each(scene.lod_groups):
            for node in each(group.instances):
                hidden.update(below.typed_id for below in each(node.children)[1:])
        nodes: list[dict[str, Any]] = []
        for node in self.nodes:
            above = kept(node.parent)
            hides = above is not None and nodes[above.typed_id]["hidden"]
            hides &= node.props.find_bool("Visibility Inheritance", True)
            # a percentage in old files
            shown = node.visible or node.props.find_real("Visibility", 0.0) > 0
            nodes.append({
                "name": node.name,
                "parent": -1 if above is None else above.typed_id,
                "bone": kept(node.bone) is not None,
                "hidden": hides or not shown or node.typed_id in hidden,
            })  # fmt: skip
        places = [np.asarray(matrix(node.node_to_world)) for node in self.nodes]
        for pose in each(scene.poses):
            for one in pose.bone_poses if pose.is_bind_pose else ():
                places[kept(one.bone_node).typed_id] = matrix(one.bone_to_world)
        return {
            "nodes": nodes,
            "binds": self.put(np.array(places)),
            "order": self.order(),
            "meshes": [self.mesh(node) for node in self.nodes if kept(node.mesh) is not None],
            "materials": [one.name for one in each(scene.materials)],
            "stacks": [self.stack(one) for one in each(scene.anim_stacks)],
            "fps": self.rate(),
            "caches": self.put(self.cache_times()),
        }

    def rate(self) -> float:
        """Frames per second; ufbx rounds those of television, such as 30 / 1.001."""
        settings = self.scene.settings
        rate = float(settings.frames_per_second)
        television = round(rate * 1.001) / 1.001
        custom = settings.time_mode == ufbx.TimeMode.CUSTOM
        return rate if custom or abs(rate - television) > 1e-4 else television

    def order(self) -> list[int]:
        """Indices of the nodes as an outliner shows them, each followed by those below it."""
        found, waiting = [], [self.nodes[0]]
        while waiting:
            node = waiting.pop()
            found.append(node.typed_id)
            waiting += each(node.children)[::-1]
        return found

    def cache_times(self) -> Any:
        files = [kept(one.external_cache) for one in each(self.scene.cache_files)]
        return np.unique([frame.time for one in files if one for frame in one.frames])

    def stack(self, stack: Any) -> dict[str, Any]:
        """Name, range in seconds and times of the keys of a stack."""
        times = set[float]()
        for layer in each(stack.layers):
            for prop in layer.anim_props:
                curves = kept(prop.anim_value).curves if prop.prop_name in _MOVES else ()
                for curve in (kept(one) for one in curves if one is not None):
                    times.update(key.time for key in curve.keyframes)
        keys = self.put(np.array(sorted(times), dtype=np.float64))
        span = [stack.time_begin, stack.time_end]
        return {"name": stack.name, "span": span, "keys": keys}

    def mesh(self, node: Any) -> dict[str, Any]:
        mesh = kept(node.mesh)
        skins, caches = each(mesh.skin_deformers), each(mesh.cache_deformers)
        curved = any(vertex.dq_weight > 0 for one in skins for vertex in one.vertices)
        faces = rows(mesh.faces, 2).astype(np.int64)
        hole = numbers(mesh.face_hole, bool) if len(mesh.face_hole) else np.zeros(len(faces), bool)
        drawn = np.flatnonzero((faces[:, 1] > 2) & ~hole)
        first, count = faces[drawn].T
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        corner = np.repeat(first, count) + within
        material = numbers(mesh.face_material)[drawn] if len(mesh.face_material) else drawn * 0
        known = [one.typed_id for one in each(node.materials) or each(mesh.materials)]

        def at_corners(vertex: Any, width: int) -> str | None:
            if not vertex.exists:
                return None
            return self.put(rows(vertex.values, width)[numbers(vertex.indices)[corner]])

        record: dict[str, Any] = {
            "node": node.typed_id,
            "mesh": mesh.typed_id,
            "name": mesh.name,
            "points": self.put(rows(mesh.vertices, 3)),
            "counts": self.put(count),
            "indices": self.put(numbers(mesh.vertex_indices)[corner]),
            "uv": at_corners(mesh.vertex_uv, 2),
            "normals": None if mesh.generated_normals else at_corners(mesh.vertex_normal, 3),
            "material": self.put(np.array([*known, -1])[np.minimum(material, len(known))]),
            "geometry": matrix(node.geometry_to_node).tolist(),
            "baked": bool(caches) or len(skins) > 1 or curved,
            "skin": None,
            "shapes": [],
        }
        if skins and not record["baked"]:
            record["skin"] = self.skin(skins[0])
        if not caches:
            record["shapes"] = [self.shape(*one) for one in frames_of(mesh)]
        return record

    def skin(self, skin: Any) -> dict[str, Any]:
        clusters = each(skin.clusters)
        bones = [kept(one.bone_node) for one in clusters]
        spans = np.array([one[:2] for one in skin.vertices], dtype=np.int64).reshape(-1, 2)
        weights = np.array(list(skin.weights), dtype=np.float64).reshape(-1, 2)
        return {
            "bones": [-1 if one is None else one.typed_id for one in bones],
            "to_bone": self.put(np.array([matrix(one.geometry_to_bone) for one in clusters])),
            "bind": self.put(np.array([matrix(one.bind_to_world) for one in clusters])),
            "spans": self.put(spans),
            "weights": self.put(weights),
        }

    def shape(self, channel: Any, frame: Any) -> dict[str, Any]:
        shape = kept(frame.shape)
        moved, share = rows(shape.position_offsets, 3), shape.offset_weights
        if len(share):
            moved = moved * rows(share, 1)
        where = self.put(numbers(shape.offset_vertices))
        return {"name": shape.name or channel.name, "rows": where, "moved": self.put(moved)}

    def motion(self, stack: int, times: list[float], n: int) -> None:
        """Add arrays of evaluated frames: matrices of nodes, amounts of shapes, baked points."""
        anim = kept(self.scene.anim_stacks[stack]).anim if stack >= 0 else self.scene.anim
        nodes, meshes = self.job["nodes"], self.job["meshes"]
        worlds = np.empty((len(times), len(nodes), 4, 4))
        amounts: dict[int, list[Any]] = {m: [] for _, m, _ in meshes}
        points: dict[int, list[Any]] = {k: [] for k, _, baked in meshes if baked}
        options = {"evaluate_skinning": bool(points), "evaluate_caches": bool(points)}
        for k, time in enumerate(times):
            scene = self.scene.evaluate(anim, time, load_external_files=bool(points), **options)
            held = each(scene.nodes)
            worlds[k] = [matrix(held[one].node_to_world) for one in nodes]
            found = {one.typed_id: one for one in each(scene.meshes)}
            for mesh, of_frames in amounts.items():
                of_frames.append([f.effective_weight for _, f in frames_of(found[mesh])])
            for node, of_node in points.items():
                mesh = kept(held[node].mesh)
                vertices = rows(mesh.skinned_position.values, 3)
                if mesh.skinned_is_local:
                    place = matrix(held[node].geometry_to_world)
                    vertices = vertices @ place[:3, :3].T + place[:3, 3]
                of_node.append(vertices.astype(np.float32))
            scene.free()
        self.arrays[f"worlds_{n}"] = worlds
        for mesh, values in amounts.items():
            self.arrays[f"amounts_{n}_{mesh}"] = np.array(values).reshape(len(times), -1)
        for node, frames in points.items():
            self.arrays[f"points_{n}_{node}"] = np.array(frames)


def frames_of(mesh: Any) -> list[tuple[Any, Any]]:
    """Channel and target of each shape of a mesh; in-betweens are targets of their own."""
    channels = [one for blend in each(mesh.blend_deformers) for one in each(blend.channels)]
    return [(channel, frame) for channel in channels for frame in channel.keyframes]


def main() -> None:
    gc.disable()  # a collection crashes in ufbx
    with open(sys.argv[1], encoding="utf-8") as stream:
        job = json.load(stream)
    with contextlib.suppress(ImportError, ValueError, OSError):  # Windows has none
        import resource

        most = 3 * int(job["max_bytes"]) + _SPARE
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    try:
        reader = Reader(job)
        if job["moments"]:
            for n, (stack, times) in enumerate(job["moments"]):
                reader.motion(stack, times, n)
        else:
            reader.arrays["found"] = np.array(json.dumps(reader.contents()))
        np.savez(job["out"], **reader.arrays)
    except (Refused, ufbx.UfbxError) as error:
        said = " ".join(str(error).split())
        if isinstance(error, ufbx.ExternalFileNotFoundError):
            said = f"its geometry cache is missing: {said}"
        elif not isinstance(error, Refused):
            said = f"truncated or damaged; ufbx says: {said}"
        np.savez(job["out"], error=np.array(said))
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # ufbx may crash at the interpreter's end


if __name__ == "__main__":
    main()
