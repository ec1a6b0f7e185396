"""Caches that Blender writes, read by alembic3d and by Blender, and our caches read by Blender."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers.blender_scene import needs_blender, run_blender

_HEAD = """
import math, os, sys
import bpy
from mathutils import Matrix, Vector

def fresh(fps=24, base=1.0, start=1, end=6):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = fps, base
    scene.frame_start, scene.frame_end = start, end

def put(name, points, faces, parent=None):
    mesh = bpy.data.meshes.new(name + "_mesh")
    mesh.from_pydata(points, [], faces)
    item = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(item)
    item.parent = parent
    return item

def grid(name, n=4, uv=True, parent=None, wave=True):
    points = [(x / n, y / n, 0.1 * x * y / n) for y in range(n + 1) for x in range(n + 1)]
    rows = n + 1
    faces = [(a, a + 1, a + rows + 1, a + rows)
             for a in (y * rows + x for y in range(n) for x in range(n))]
    item = put(name, points, faces, parent)
    if uv:
        layer = item.data.uv_layers.new(name="map")
        for loop in item.data.loops:
            p = points[loop.vertex_index]
            layer.data[loop.index].uv = (p[0] * 0.9, p[1] * 0.7 + 0.1)
    if wave:
        ripple(item)
    return item

def ripple(item):
    # shape keys driven by the frame, so that every frame is another shape
    item.shape_key_add(name="rest")
    for k, axis in enumerate(((0, 0, 1), (0.3, 0.2, 0))):
        key = item.shape_key_add(name=f"k{k}")
        for n, point in enumerate(key.data):
            point.co = point.co + Vector(axis) * math.sin(1.7 * n + k)
        scene = bpy.context.scene
        for n, frame in enumerate(range(scene.frame_start, scene.frame_end + 1)):
            key.value = (0.17 * n * (k + 1)) % 1
            key.keyframe_insert("value", frame=frame)

def move(item, turn=True, frames=None):
    scene = bpy.context.scene
    item.rotation_mode = "XYZ"
    for n, frame in enumerate(frames or range(scene.frame_start, scene.frame_end + 1)):
        item.location = (0.1 * n, 0.05 * n * n, 0.3)
        item.keyframe_insert("location", frame=frame)
        if turn:
            item.rotation_euler = (0.1 * n, 0.2 * n, 0.3 + 0.1 * n)
            item.keyframe_insert("rotation_euler", frame=frame)

def empty(name, parent=None):
    item = bpy.data.objects.new(name, None)
    bpy.context.scene.collection.objects.link(item)
    item.parent = parent
    return item

def save(name, **options):
    scene = bpy.context.scene
    settings = dict(start=scene.frame_start, end=scene.frame_end, as_background_job=False)
    path = os.path.join(sys.argv[-1], name + ".abc")
    bpy.ops.wm.alembic_export(filepath=path, **(settings | options))
"""

SCENES = {
    "film": "fresh(24); grid('a')",
    "television": "fresh(24, 1.001); grid('a')",
    "late": "fresh(24, start=1001, end=1006); grid('a')",
    "early": "fresh(30, start=-7, end=2); grid('a')",
    "two": "fresh(25); move(grid('b')); grid('a', n=3)",
    "still": "fresh(24); grid('a', wave=False)",
    "one frame": "fresh(24, start=3, end=3); grid('a')",
    "parents": "fresh(24); e = empty('top'); move(e); f = empty('f', e); f.scale = (1, 2, 0.5); "
    "move(f); grid('low', parent=f); grid('high', parent=e, wave=False)",
    "mirrored": "fresh(24); i = grid('a'); i.scale = (-1, 1, 2); i.rotation_euler = (0.2, 0.1, 0)",
    "flat": "fresh(24); e = empty('top'); move(e); grid('a', parent=e); save(NAME, flatten=True)",
    "subdivision": "fresh(24); i = grid('a'); i.modifiers.new('s', 'SUBSURF'); "
    "save(NAME, subdiv_schema=True)",
    "materials": "fresh(24); grid('b'); m = bpy.data.materials.new('red'); "
    "grid('a').data.materials.append(m); save(NAME, face_sets=True)",
    "polygons": "fresh(24); ripple(put('a', [(0, 0, 0), (2, 0, 0), (3, 2, 0), (1, 3, 0), "
    "(-1, 2, 0), (1, 1, 2)], [(0, 1, 2, 3, 4), (0, 5, 1), (2, 1, 5)]))",
    "edges": "fresh(24); i = grid('a'); i.data.edges.foreach_set('use_edge_sharp', "
    "[k % 3 == 0 for k in range(len(i.data.edges))]); i.data.shade_smooth(); ",
    "shutter": "fresh(24); move(grid('a')); save(NAME, xsamples=2, gsamples=2, sh_open=0.0, "
    "sh_close=1.0)",
    "instances": "fresh(24); i = grid('a', wave=False); j = bpy.data.objects.new('b', i.data); "
    "bpy.context.scene.collection.objects.link(j); move(j); save(NAME, use_instancing=True)",
    "names": "fresh(24); grid('ü b/c.d'); grid('ü b/c.d', n=2); grid('Z', n=3)",
}
"""Code of each scene, by the name of its file."""


def write_caches(folder: Path) -> dict[str, Path]:
    """Caches of all scenes, written by Blender; their files by name."""
    lines = []
    for name, code in SCENES.items():
        lines.append(f"NAME = {name!r}; " + code)
        if "save(" not in code:
            lines.append(f"save({name!r})")
    run_blender(folder / "write.py", _HEAD + "\n".join(lines), folder)
    return {path.stem: path for path in folder.glob("*.abc")}


pytestmark = [pytest.mark.slow, needs_blender]
RATES = {"television": 24000 / 1001, "two": 25, "early": 30, "shutter": 48}

_LOOK = """
import os, sys
import bpy
import numpy as np
path, out, first, rate, count = sys.argv[-5:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.alembic_import(filepath=path, as_background_job=False)
scene = bpy.context.scene
tempo = scene.render.fps / scene.render.fps_base
items = sorted((o for o in scene.objects if o.type == "MESH"), key=lambda o: o.name)
frames = []
for k in range(int(count)):
    time = tempo * (float(first) + k / float(rate))
    whole = int(np.floor(time + 1e-6))
    part = min(max(time - whole, 0.0), 0.999999)
    scene.frame_set(whole, subframe=part if part > 1e-6 else 0.0)
    graph, points = bpy.context.evaluated_depsgraph_get(), []
    for item in items:
        shown = item.evaluated_get(graph)
        place = np.array(shown.matrix_world)
        mesh = shown.to_mesh()
        flat = np.empty(3 * len(mesh.vertices), dtype=np.float32)
        mesh.vertices.foreach_get("co", flat)
        points.append(flat.reshape(-1, 3) @ place[:3, :3].T + place[:3, 3])
    frames.append(np.concatenate(points))
surface = {}
for n, item in enumerate(items):
    mesh = item.data
    for polygon in mesh.polygons:
        for k in range(polygon.loop_start, polygon.loop_start + polygon.loop_total):
            corner = n, mesh.loops[k].vertex_index, polygon.index
            uv = mesh.uv_layers.active.data[k].uv if mesh.uv_layers.active else (0, 0)
            surface[corner] = (*uv, *mesh.corner_normals[k].vector, polygon.material_index)
names = [[m.name for m in item.data.materials] for item in items]
np.savez(out, vertices=np.array(frames), corners=np.array(list(surface)),
         values=np.array(list(surface.values())), names=np.array(repr(names)))
"""


@pytest.fixture(scope="module")
def caches(tmp_path_factory):
    return write_caches(tmp_path_factory.mktemp("caches"))


@pytest.fixture
def blender(tmp_path):
    """What Blender shows of a cache at the frames of a sequence, the first at a time in seconds."""

    def look(path, sequence, first):
        out = tmp_path / "seen.npz"
        numbers = first, repr(sequence.fps), len(sequence)
        run_blender(tmp_path / "look.py", _LOOK, path, out, *numbers)
        with np.load(out) as seen:
            arrays = dict(seen)
        arrays["vertices"] = arrays["vertices"][..., [0, 2, 1]] * [1, 1, -1]  # of Blender, z is up
        arrays["values"][:, 2:5] = arrays["values"][:, [2, 4, 3]] * [1, 1, -1]
        return arrays

    return look


@pytest.mark.parametrize("name", SCENES)
def test_caches_of_blender_are_read_as_it_shows_them(caches, blender, name):
    pytest.importorskip("alembic3d", reason="alembic3d is not installed")
    ours = ssdr.load(caches[name])
    assert ours.fps == pytest.approx(RATES.get(name, 24), rel=1e-9)
    assert len(ours) == {"still": 1, "one frame": 1, "early": 3, "shutter": 12}.get(name, 6)
    start = {"late": 1001, "early": 0, "one frame": 3}.get(name, 1)
    seen = blender(caches[name], ours, start / (ours.fps / (2 if name == "shutter" else 1)))
    np.testing.assert_allclose(ours.vertices, seen["vertices"], atol=1e-6)
    if name in ("subdivision", "polygons", "edges"):  # the cage has no normals, fans differ
        return
    of_vertex = {}
    for (_, vertex, _), row in zip(seen["corners"], seen["values"], strict=True):
        of_vertex.setdefault(int(vertex), []).append(row)
    if ours.surface.uv is not None and len(set(seen["corners"][:, 0])) == 1:
        for vertex, uv in zip(ours.faces.ravel(), ours.surface.uv.reshape(-1, 2), strict=True):
            assert min(np.abs(row[:2] - uv).max() for row in of_vertex[vertex]) < 1e-6


def test_blender_plays_what_is_written(tmp_path, blender, seam):
    pytest.importorskip("alembic3d", reason="alembic3d is not installed")
    path = ssdr.save(seam, tmp_path / "a.abc").path
    ours, seen = ssdr.load(path), blender(path, seam, 0.0)
    np.testing.assert_array_equal(seen["vertices"], seam.vertices)
    assert sorted(eval(str(seen["names"]))[0]) == ["red", "skin"]
    for vertex, polygon, row in zip(*seen["corners"].T[1:], seen["values"], strict=True):
        corner = int(np.flatnonzero(seam.faces[polygon] == vertex)[0])
        np.testing.assert_allclose(row[:2], seam.surface.uv[polygon, corner], atol=1e-6)
        np.testing.assert_allclose(row[2:5], ours.surface.normals[polygon, corner], atol=1e-4)
