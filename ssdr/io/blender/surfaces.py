"""Faces, UVs, normals and materials as Blender has them, and what is not read of a scene.

It runs inside Blender beside ``script.py`` and, like it, knows NumPy and Blender alone.
"""

import json
import os
from typing import Any

import bpy
import numpy as np


def join(items: list[Any], arrays: dict[str, Any], path: str) -> None:
    """Faces, UVs, normals and materials of all meshes one behind the other, into `arrays`."""
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
        arrays["materials"] = np.array(json.dumps([describe(m, arrays, path) for m in materials]))


def number_of(material: Any, materials: list[Any]) -> int:
    if material not in materials:
        materials.append(material)
    return materials.index(material)


def describe(material: Any, arrays: dict[str, Any], path: str) -> dict[str, Any]:
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
                attach(color.links[0].from_node, record, arrays, path)
    return record


def attach(node: Any, record: dict[str, Any], arrays: dict[str, Any], path: str) -> None:
    image = getattr(node, "image", None)
    if image is None:
        return
    data = bytes(image.packed_file.data) if image.packed_file else b""
    if not data:
        file = os.path.realpath(bpy.path.abspath(image.filepath))
        if not os.path.isfile(file):
            return
        folder = os.path.join(os.path.dirname(os.path.realpath(path)), "")
        if not file.startswith(folder):
            arrays["outside"] = np.array([*arrays.get("outside", []), image.filepath])
            return
        with open(file, "rb") as stream:
            data = stream.read()
    kinds = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}
    for magic, kind in kinds.items():
        if data.startswith(magic):
            key = f"texture_{sum(k.startswith('texture_') for k in arrays)}"
            arrays[key] = np.frombuffer(data, dtype=np.uint8)
            record.update(texture=key, texture_type=kind, base_color=[1.0, 1.0, 1.0, 1.0])


def left_out(items: list[Any]) -> list[str]:
    """What the scene has and a sequence or skinning that is read from it has not."""
    found = []
    if len(items) > 1:
        found.append("names and number of the meshes")
    if any(bone.parent for rig in bpy.data.armatures for bone in rig.bones):
        found.append("orientations of the joints")
    if any(len(item.data.uv_layers) > 1 for item in items):
        found.append("further sets of UVs")
    if any(len(item.data.color_attributes) for item in items):
        found.append("vertex colours")
    materials = {slot.material for item in items for slot in item.material_slots} - {None}
    if any(map(further_textures, materials)):
        found.append("textures but those of the base colour")
    kinds = {item.type for item in bpy.context.scene.objects}
    found += [what for kind, what in (("CAMERA", "cameras"), ("LIGHT", "lights")) if kind in kinds]
    return found


def further_textures(material: Any) -> bool:
    nodes = material.node_tree.nodes if material.node_tree else []
    links = [link for node in nodes if node.type == "TEX_IMAGE" for link in node.outputs[0].links]
    return any(link.to_socket.name != "Base Color" for link in links)
