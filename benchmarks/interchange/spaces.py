"""Do models keep their size and way up through formats with other units and axes?

    SSDR_BLENDER_PYTHON=... python benchmarks/interchange/spaces.py

A USD in centimetres with z up, an FBX that Blender has written and numbered OBJ files, which state
nothing, are written as glTF, USD and FBX.  Blender opens each with the default options of its own
importers, three.js (which needs node and npm) the glTF; the vertices that they show are compared
with those of the source, in metres with z up.  Then the file is read and written back to the
source's unit and axis.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.interchange import programs
from helpers.blender_scene import run_blender
from helpers.rig_model import tube

FRAMES = (0, 4, 9)
SHOWN = """
import os, sys
import bpy
import numpy as np
path, out = sys.argv[-2:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 24
if path.endswith(".glb"):
    bpy.ops.import_scene.gltf(filepath=path, merge_vertices=False)
elif path.endswith(".usdc"):
    bpy.ops.wm.usd_import(filepath=path)
else:
    bpy.ops.import_scene.fbx(filepath=path, anim_offset=0.0)
first = min([a.frame_range[0] for a in bpy.data.actions], default=0) if path[-3:] == "fbx" else 0
found = []
for frame in FRAMES:
    bpy.context.scene.frame_set(int(first) + frame)
    graph, points = bpy.context.evaluated_depsgraph_get(), []
    for item in bpy.context.scene.objects:
        if item.type == "MESH" and not item.name.startswith("Icosphere"):
            seen = item.evaluated_get(graph)
            flat = np.empty(3 * len(seen.data.vertices), np.float32)
            seen.data.vertices.foreach_get("co", flat)
            world = np.array(seen.matrix_world)
            points.append(flat.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3])
    found.append(np.concatenate(points))
np.save(out, np.stack(found))
"""


def in_blender(path: Path) -> np.ndarray:
    """Vertices in metres with z up, as Blender imports the file."""
    out = path.with_suffix(".npy")
    code = SHOWN.replace("FRAMES", repr(FRAMES))
    run_blender(path.with_suffix(".scene.py"), code, path.resolve(), out)
    return np.load(out)


def in_three(path: Path, model: ssdr.Skinning) -> np.ndarray:
    """Vertices with z up, as three.js shows the first clip of a .glb."""
    points = next(iter(programs.in_three(path, model).points.values()))
    return points[list(FRAMES)][:, :, [0, 2, 1]] * [1, -1, 1]


def apart(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Largest distance of a vertex to its twin, in any frame, over the diagonal."""
    a, b = (np.moveaxis(one, 0, 1).reshape(one.shape[1], -1) for one in (ours, theirs))
    off = [cKDTree(x).query(y)[0].max() for x, y in ((a, b), (b, a))]
    return max(off) / float(np.linalg.norm(np.ptp(ours[0], axis=0)))


def sources(folder: Path) -> dict[str, tuple[ssdr.Skinning, np.ndarray]]:
    """Model of each source as it is read, and its vertices in metres with z up."""
    model = dataclasses.replace(tube(frames=10), fps=24, name="tube")
    metres = model.skin(dtype=np.float64)[:, :, [0, 2, 1]] * [1, -1, 1]
    ssdr.save(ssdr.io.in_space(dataclasses.replace(model, space=ssdr.Space(1.0, "y")),
                               ssdr.Space(0.01, "z")), folder / "cm.usdc")  # fmt: skip
    ssdr.save(model, folder / "metres.fbx")
    frames = ssdr.MeshSequence(model.skin(), model.faces, 24)
    ssdr.save(frames, folder / "f_%03d.obj")
    plain = ssdr.decompose(ssdr.load(folder / "f_%03d.obj", fps=24), bones=5).skinning
    plain = plain.prune(4, minimum=2e-5)  # Blender's USD importer leaves out weights below 1e-5
    return {
        "USD, centimetres, z up": (ssdr.load_skinning(folder / "cm.usdc"), metres),
        "FBX": (ssdr.load_skinning(folder / "metres.fbx"), metres),
        "OBJ": (plain, plain.skin(dtype=np.float64)[:, :, [0, 2, 1]] * [1, -1, 1]),
    }


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    print("| source | written as | Blender: size | vertices | three.js | written back: vertices |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for source, (model, truth) in sources(folder).items():
            for suffix in (".glb", ".usdc", ".fbx"):
                path = folder / f"out{suffix}"
                ssdr.save(model, path)
                seen, truth_seen = in_blender(path), truth[list(FRAMES)]
                size = np.ptp(seen[0], axis=0) / np.ptp(truth_seen[0], axis=0)
                # OBJ states nothing: its numbers are to come back as they were
                back = ssdr.io.in_space(ssdr.load_skinning(path), model.space)
                ssdr.save(back, folder / "back.usdc")
                again = ssdr.load(folder / "back.usdc").vertices
                drawn = suffix == ".glb" and f"{apart(truth_seen, in_three(path, model)):.1e}"
                print(f"| {source} | {suffix} | {np.abs(size - 1).max():.0e} off 1 "
                      f"| {apart(truth_seen, seen):.1e} | {drawn or ''} "
                      f"| {apart(model.skin(), again):.1e} |",
                      flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
