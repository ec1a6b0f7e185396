"""Positions and normals at the vertices of a .glb in some frames, as Blender shows them.

Run by lit.py inside Blender, with a job in a JSON file: path, out, fps, frames, and the vertex
behind each vertex of the file is its attribute _VERTEX.
"""

import json
import os
import sys

import bpy
import numpy as np


def values(data: object, name: str, width: int) -> np.ndarray:
    out = np.empty(len(data) * width, dtype=np.float32)
    data.foreach_get(name, out)
    return out.reshape(-1, width)


def main() -> None:
    with open(sys.argv[-1], encoding="utf-8") as stream:
        job = json.load(stream)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = round(job["fps"]), round(job["fps"]) / job["fps"]
    bpy.ops.import_scene.gltf(filepath=job["path"], merge_vertices=False)
    item = next(o for o in scene.objects if o.type == "MESH" and "_VERTEX" in o.data.attributes)
    number = values(item.data.attributes["_VERTEX"].data, "value", 1)[:, 0].astype(np.int64)
    points, normals = [], []
    for frame in job["frames"]:
        scene.frame_set(frame)
        shown = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
        mesh = shown.to_mesh()
        turn = np.array(shown.matrix_world)
        corner = np.empty(len(mesh.loops), dtype=np.int32)
        mesh.loops.foreach_get("vertex_index", corner)
        at = np.zeros((2, number.max() + 1, 3))
        at[0, number] = values(mesh.vertices, "co", 3) @ turn[:3, :3].T + turn[:3, 3]
        bent = values(mesh.corner_normals, "vector", 3) @ np.linalg.inv(turn[:3, :3])
        at[1, number[corner]] = bent
        at = np.stack([at[..., 0], at[..., 2], -at[..., 1]], axis=-1)  # y up
        points.append(at[0])
        normals.append(at[1])
        shown.to_mesh_clear()
    version = np.array(bpy.app.version_string)
    np.savez(job["out"], points=points, normals=normals, version=version)


main()
os._exit(0)  # some releases of bpy crash at exit, after all work is done
