"""Reading of faces, UVs, normals and materials from Blender.

This module runs inside Blender beside ``script.py`` and needs only NumPy and Blender.
"""

import importlib
import json
import os
from typing import Any

import bpy
import numpy as np

values: Any = importlib.import_module("in_blender").values


def senses(items: list[Any]) -> Any:
    """Sign of the determinant of each object's matrix: -1 where the object mirrors its mesh."""
    return np.sign([np.linalg.det(np.array(item.matrix_world)[:3, :3]) for item in items])


def join(items: list[Any], arrays: dict[str, Any], path: str, mirrored: Any) -> None:
    """Add the faces, UVs, normals and materials of all meshes, one after another, to `arrays`.

    `path` is the file that Blender has loaded; textures are read only from its folder. The
    orientation of triangles of `mirrored` objects is reversed, since their normals are not.
    """
    names = ("faces", "surface_uv", "surface_normals", "surface_material_index")
    found: dict[str, list[Any]] = {name: [] for name in names}
    materials: list[Any] = []
    start = 0
    for item, turned in zip(items, mirrored, strict=True):
        mesh = item.data
        mesh.calc_loop_triangles()
        loops = values(mesh.loop_triangles, "loops", np.int32)
        if turned:
            loops = loops.reshape(-1, 3)[:, ::-1].ravel()
        corner = values(mesh.loops, "vertex_index", np.int32)
        found["faces"].append(corner[loops].reshape(-1, 3) + start)
        start += len(mesh.vertices)
        if mesh.uv_layers.active:
            uv = values(mesh.uv_layers.active.data, "uv", np.float32, 2)
            found["surface_uv"].append(uv[loops].reshape(-1, 3, 2))
        if mesh.corner_normals:
            normals = values(mesh.corner_normals, "vector", np.float32, 3)[loops]
            normals = normals @ np.linalg.pinv(np.array(item.matrix_world)[:3, :3])
            length = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
            found["surface_normals"].append((normals / length).reshape(-1, 3, 3))
        slots = [slot.material for slot in item.material_slots] or [None]
        materials += [m for m in dict.fromkeys(slots) if m not in materials]
        numbers = np.array([materials.index(m) for m in slots])
        index = values(mesh.loop_triangles, "material_index", np.int32)
        found["surface_material_index"].append(numbers[index * (len(numbers) > 1)])
    if any(m is not None for m in materials):
        records = [describe(k, m, arrays, path) for k, m in enumerate(materials)]
        arrays["materials"] = np.array(json.dumps(records))
    else:
        del found["surface_material_index"]
    for name, blocks in found.items():
        if len(blocks) == len(items):
            arrays[name] = np.concatenate(blocks)


def describe(number: int, material: Any, arrays: dict[str, Any], path: str) -> dict[str, Any]:
    """Read the fields of a `Material` of this package from a material of Blender.

    The bytes of its texture are added to `arrays` under the key ``texture_<number>``.
    """
    if material is None:
        return {"name": "default"}
    record: dict[str, Any] = {
        "name": material.name,
        "base_color": [float(c) for c in material.diffuse_color],
        "double_sided": not material.use_backface_culling,
    }
    for node in material.node_tree.nodes if material.node_tree else []:
        if node.type == "BSDF_PRINCIPLED":
            color = node.inputs["Base Color"]
            record["base_color"] = [float(c) for c in color.default_value]
            record["metallic"] = float(node.inputs["Metallic"].default_value)
            record["roughness"] = float(node.inputs["Roughness"].default_value)
            image = getattr(color.links[0].from_node, "image", None) if color.is_linked else None
            data = b"" if image is None else picture(image, arrays, path)
            for magic, kind in ((b"\x89PNG", "image/png"), (b"\xff\xd8\xff", "image/jpeg")):
                if data.startswith(magic):
                    arrays[f"texture_{number}"] = np.frombuffer(data, dtype=np.uint8)
                    record |= {"texture_type": kind, "base_color": [1.0] * 4}
    return record


def picture(image: Any, arrays: dict[str, Any], path: str) -> bytes:
    """Read the bytes of an image; empty unless it is packed or in the folder of the file `path`.

    The path of an image in another folder is added to ``arrays["outside"]``.
    """
    if image.packed_file:
        return bytes(image.packed_file.data)
    file = os.path.realpath(bpy.path.abspath(image.filepath))
    if not os.path.isfile(file):
        return b""
    if not file.startswith(os.path.join(os.path.dirname(os.path.realpath(path)), "")):
        arrays["outside"] = np.array([*arrays.get("outside", []), image.filepath])
        return b""
    with open(file, "rb") as stream:
        return stream.read()
