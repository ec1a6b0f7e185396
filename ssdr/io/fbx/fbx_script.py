"""Script that reads an FBX file by ufbx: its meshes, and its motion at given times.

``reading_process.py`` runs it, in a process of its own because ufbx crashes where an object is used
after its scene, and may crash at the interpreter's end. It needs only NumPy and ufbx, not the
package.
"""

import ctypes
import gc
import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import ufbx

_MOVES = {"Lcl Translation", "Lcl Rotation", "Lcl Scaling", "DeformPercent", "Weight"}
# lists of what no mesh is, and nothing here reads
_OTHERS = (
    *("lights", "cameras", "stereo_cameras", "line_curves", "nurbs_curves", "nurbs_surfaces"),
    *("procedural_geometries", "constraints", "characters", "audio_clips", "textures"),
)
# what ufbx repairs so that another shape results
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


def matrices(values: Any) -> Any:
    """Matrices (N, 4, 4) for column vectors."""
    turned = np.array([*values], dtype=np.float64).reshape(-1, 4, 3).swapaxes(1, 2)
    return np.concatenate([turned, np.tile([[[0.0, 0, 0, 1]]], (len(turned), 1, 1))], axis=1)


def rows(values: Any, width: int) -> Any:
    """Copy (N, `width`) of an array of ufbx, which must not outlive its scene."""
    found = np.array(memoryview(kept(values))) if len(values) else np.zeros((0, width))
    return found.reshape(-1, width)


def whole(values: Any) -> Any:
    return np.array(list(values), dtype=np.int64)


def targets(mesh: Any) -> list[tuple[str, Any]]:
    """Channel's name and target of each shape of a mesh; in-betweens are targets of their own."""
    channels = [one for blend in each(mesh.blend_deformers) for one in each(blend.channels)]
    return [(channel.name, target) for channel in channels for target in channel.keyframes]


class Reader:
    """An open file, and the arrays of its meshes, whose names end in the mesh's number."""

    def __init__(self, job: dict[str, Any]) -> None:
        self.job, self.arrays = job, dict[str, Any]()
        self.scene = self.load()
        files = each(self.scene.cache_files)
        for name in {name for one in files for name in (one.filename, one.absolute_filename)}:
            self.check_inside(name)
        if files:
            self.scene = self.load(load_external_files=True, evaluate_caches=True)
        self.nodes = each(self.scene.nodes)
        for warning in self.scene.metadata.warnings:
            if ufbx.WarningType(warning.type).name in _DAMAGED:
                raise RuntimeError(warning.description)

    def load(self, **options: Any) -> Any:
        options["file_format"] = ufbx.FileFormat.FBX
        options["index_error_handling"] = ufbx.IndexErrorHandling.ABORT_LOADING
        options |= {"target_axes": ufbx.axes_right_handed_y_up, "target_unit_meters": 1.0}
        return ufbx.load_file(self.job["path"], **options)

    def check_inside(self, name: str) -> None:
        """Refuse a cache outside the folders of the job; its parts have its name's beginning."""
        folder, stem = os.path.dirname(name), os.path.splitext(os.path.basename(name))[0]
        for other in os.listdir(folder) if os.path.isfile(name) else ():
            place = os.path.realpath(os.path.join(folder, other))
            inside = any(place.startswith(os.path.join(one, "")) for one in self.job["folders"])
            if other.startswith(stem) and not inside:
                raise Refused(f"its geometry cache {name} {self.job['outside']}")

    def walk(self, nodes: list[Any], keyed: set[int]) -> Iterator[tuple[Any, list[str], bool]]:
        """Yield each node, the names down to it, and whether it is hidden, as an outliner does.

        `nodes` are those of a scene, of which the `keyed` ones hide nothing by themselves.
        """
        layers = [one for one in each(self.scene.display_layers) if not one.visible]
        off = [node.typed_id for layer in layers for node in each(layer.nodes)]
        groups = [node for group in each(self.scene.lod_groups) for node in each(group.instances)]
        off += [level.typed_id for group in groups for level in each(group.children)[1:]]
        waiting: list[Any] = [(nodes[0], [], False)]
        while waiting:
            node, names, hidden = waiting.pop()
            names, props = [*names, node.name], node.props
            shown = node.visible or props.find_real("Visibility", 0.0) > 0  # a share in old files
            hidden &= props.find_bool("Visibility Inheritance", True)
            hidden |= not (shown or node.typed_id in keyed) or node.typed_id in off
            yield node, names, hidden
            waiting += [(child, names, hidden) for child in each(node.children)[::-1]]

    def read(self) -> dict[str, Any]:
        """Names, stacks and materials of the file and, if frames are wanted, records of meshes."""
        layers = [layer for stack in each(self.scene.anim_stacks) for layer in each(stack.layers)]
        props = [prop for layer in layers for prop in layer.anim_props]
        seen = [kept(prop.element) for prop in props if prop.prop_name == "Visibility"]
        self.keyed = {one.typed_id for one in seen if one.type == ufbx.ElementType.NODE}
        walked = list(self.walk(self.nodes, self.keyed))
        wanted, moments = self.job["meshes"], self.job["moments"]
        held = [one for one in walked if kept(one[0].mesh) and one[0].mesh.num_vertices]
        shown = [(node, [*names, node.mesh.name]) for node, names, hidden in held if not hidden]
        chosen = [node for node, names in shown if wanted is None or {*names} & {*wanted}]
        meshes = [self.mesh(k, node) for k, node in enumerate(chosen if moments else ())]
        if moments and not shown and self.job["joints_alone"]:
            meshes = [self.joints([node for node, *_ in walked])]
        for number, (stack, times) in enumerate(moments):
            self.motion(number, stack, times, meshes)
        rate, mode = float(self.scene.settings.frames_per_second), self.scene.settings.time_mode
        television = round(rate * 1.001) / 1.001  # of which ufbx gives few digits
        custom = mode == ufbx.TimeMode.CUSTOM or abs(rate - television) > 1e-4
        caches = [kept(one.external_cache) for one in each(self.scene.cache_files)]
        above = [kept(node.parent) for node in self.nodes]
        return {
            "names": [names for _, names in shown],
            "hidden": [node.name for node, _, hidden in held if hidden],
            "nodes": [
                (n.name, a.typed_id if a else -1) for n, a in zip(self.nodes, above, strict=True)
            ],
            "meshes": meshes,
            "others": {kind: len(getattr(self.scene, kind)) for kind in _OTHERS},
            "materials": [one.name for one in each(self.scene.materials)],
            "stacks": [self.stack(one) for one in each(self.scene.anim_stacks)],
            "fps": rate if custom else television,
            "cached": sorted({frame.time for one in caches if one for frame in one.frames}),
            "bytes": 128 * len(self.nodes) + 12 * sum(node.mesh.num_vertices for node, _ in shown),
        }

    def stack(self, stack: Any) -> tuple[str, list[float], list[float]]:
        """Name, range in seconds and times of the keys of a stack."""
        props = [prop for layer in each(stack.layers) for prop in layer.anim_props]
        values = [kept(prop.anim_value) for prop in props if prop.prop_name in _MOVES]
        curves = [kept(one) for value in values for one in value.curves if one is not None]
        times = {key.time for curve in curves for key in curve.keyframes}
        return stack.name, [stack.time_begin, stack.time_end], sorted(times)

    def put(self, number: int, **values: Any) -> None:
        self.arrays |= {f"{key}_{number}": value for key, value in values.items()}

    def mesh(self, number: int, node: Any) -> dict[str, Any]:
        """Record of a mesh, whose arrays are kept."""
        mesh = kept(node.mesh)
        skins, count = each(mesh.skin_deformers), mesh.num_vertices
        curved = any(vertex.dq_weight > 0 for one in skins for vertex in one.vertices)
        baked = bool(mesh.cache_deformers) or len(skins) > 1 or curved
        faces, slots = rows(mesh.faces, 2).astype(np.int64), whole(mesh.face_material)
        hole = whole(mesh.face_hole) if len(mesh.face_hole) else np.zeros(len(faces))
        drawn = (faces[:, 1] > 2) & (hole == 0)
        first, sizes = faces[drawn].T
        corner = np.repeat(first - np.cumsum(sizes) + sizes, sizes) + np.arange(sizes.sum())
        known = [one.typed_id for one in each(node.materials) or each(mesh.materials)]
        slots = np.minimum(slots[drawn], len(known)) if len(slots) else np.zeros(len(first), int)
        self.put(number, points=rows(mesh.vertices, 3), counts=sizes)
        self.put(number, indices=whole(mesh.vertex_indices)[corner])
        self.put(number, material=np.array([*known, -1])[slots])
        own = ("uv", mesh.vertex_uv, 2), ("normals", mesh.vertex_normal, 3)
        for name, held, width in (*own, ("colors", mesh.vertex_color, 4)):
            if held.exists and not (name == "normals" and mesh.generated_normals):
                self.put(number, **{name: rows(held.values, width)[whole(held.indices)[corner]]})
        shapes = [] if baked else targets(mesh)
        for k, shape in enumerate(kept(target.shape) for _, target in shapes):
            share = rows(shape.offset_weights, 1) if len(shape.offset_weights) else 1.0
            self.put(number, **{f"moved_{k}": share * rows(shape.position_offsets, 3)})
            self.put(number, **{f"rows_{k}": whole(shape.offset_vertices)})
        bones = [-1 if baked else node.typed_id]
        place = node.geometry_to_world if baked else node.geometry_to_node
        self.put(number, to_bone=matrices([place]), bind=np.tile(np.eye(4), (int(baked), 1, 1)))
        self.put(number, joint=np.zeros((count, 1), np.int64), weights=np.ones((count, 1)))
        if skins and not baked:
            bones = self.skin(number, node, skins[0])
        names = [kept(target.shape).name or name for name, target in shapes]
        return {"node": node.typed_id, "baked": baked, "bones": bones, "shapes": names}

    def skin(self, number: int, node: Any, skin: Any) -> list[int]:
        """Bones of a skin; last comes the node itself, which moves what none of them does."""
        clusters = each(skin.clusters)
        held = [kept(one.bone_node) is not None for one in clusters]
        first, count = np.array([one[:2] for one in skin.vertices], dtype=np.int64).T
        place = np.arange(max(1, count.max()))
        stored = np.array([*skin.weights, (0, 0)], dtype=np.float64)
        entry = np.where(place < count[:, None], first[:, None] + place, -1)
        cluster = stored[entry, 0].astype(np.int64)
        weights = np.where(np.array([*held, False])[cluster], stored[entry, 1], 0.0)
        bare = ~(weights != 0).any(axis=1)
        joint = np.where(bare[:, None], sum(held), (np.cumsum([*held, False]) - 1)[cluster])
        weights[bare, 0] = 1.0
        bound = [one for one, usable in zip(clusters, held, strict=True) if usable]
        own = [node.geometry_to_node] * int(bare.any())
        self.put(number, to_bone=matrices([*(one.geometry_to_bone for one in bound), *own]))
        self.put(number, bind=matrices(one.bind_to_world for one in bound))
        self.put(number, joint=np.maximum(joint, 0), weights=weights)
        return [*(one.bone_node.typed_id for one in bound), *([node.typed_id] * len(own))]

    def joints(self, nodes: list[Any]) -> dict[str, Any]:
        """Record of a cloud with a point at each joint, where it was bound or else stands."""
        nodes = [one for one in nodes if kept(one.bone)] or nodes[1:]
        stands = {one.typed_id: one.node_to_world for one in nodes}
        poses = [
            one for pose in each(self.scene.poses) if pose.is_bind_pose for one in pose.bone_poses
        ]
        stands |= {kept(one.bone_node).typed_id: one.bone_to_world for one in poses
                   if kept(one.bone_node).typed_id in stands}  # fmt: skip
        if not stands:
            raise Refused("the scene holds no mesh and no joint")
        binds, none, count = matrices(stands.values()), np.zeros(0, np.int64), len(stands)
        self.put(0, points=binds[:, :3, 3], bind=binds, to_bone=np.linalg.pinv(binds))
        self.put(0, counts=none, indices=none, material=none)
        self.put(0, joint=np.arange(count)[:, None], weights=np.ones((count, 1)))
        return {"node": nodes[0].typed_id, "baked": False, "bones": list(stands), "shapes": []}

    def motion(self, number: int, stack: int, times: list[float], meshes: list[Any]) -> None:
        """Add arrays of evaluated frames: matrices of nodes, amounts of shapes, baked points."""
        anim = kept(self.scene.anim_stacks[stack]).anim if stack >= 0 else self.scene.anim
        used = sorted({node for one in meshes for node in one["bones"]} - {-1})
        baked = any(one["baked"] for one in meshes)
        worlds = np.tile(np.eye(4), (len(times), len(used) + 1, 1, 1))  # the last is of no node
        shown = np.ones((len(times), len(self.nodes)), dtype=bool)
        values: dict[str, list[Any]] = {}
        options = dict.fromkeys(
            ("evaluate_skinning", "evaluate_caches", "load_external_files"), baked
        )
        for k, time in enumerate(times):
            scene = self.scene.evaluate(anim, time, **options)
            nodes = each(scene.nodes)
            for node, _, hidden in self.walk(nodes, set()) if self.keyed else ():
                shown[k, node.typed_id] = not hidden
            worlds[k, :-1] = matrices(nodes[one].node_to_world for one in used)
            for part, one in enumerate(meshes):
                node, mesh = nodes[one["node"]], kept(nodes[one["node"]].mesh)
                if one["baked"]:
                    found = rows(mesh.skinned_position.values, 3)
                    if mesh.skinned_is_local:
                        place = matrices([node.geometry_to_world])[0]
                        found = found @ place[:3, :3].T + place[:3, 3]
                    values.setdefault(f"frames_{number}_{part}", []).append(np.float32(found))
                elif one["shapes"]:
                    amounts = [target.effective_weight for _, target in targets(mesh)]
                    values.setdefault(f"amounts_{number}_{part}", []).append(amounts)
            scene.free()
        self.arrays |= {key: np.array(found) for key, found in values.items()}
        self.arrays |= {f"worlds_{number}": worlds, "used": np.array([*used, -1])}
        self.arrays[f"shown_{number}"] = shown[:, [one["node"] for one in meshes]]


def read(job: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Record and arrays for the package, which checks them."""
    gc.disable()  # a collection crashes in ufbx
    try:
        reader = Reader(job)
        return reader.read(), reader.arrays
    except ufbx.ExternalFileNotFoundError as error:
        raise Refused(f"its geometry cache is missing: {error}") from error
    except ufbx.UfbxError as error:
        raise RuntimeError(" ".join(str(error).split())) from error
