"""Caches that Blender writes, read by alembic3d and by Blender, and our caches read by Blender."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.alembic_scenes import SCENES, write_caches
from helpers.blender_scene import needs_blender, run_blender

pytestmark = [pytest.mark.slow, needs_blender]
RATES = {"television": 24000 / 1001, "pal": 25, "thirty": 30, "sixty": 60, "slow": 5, "two": 25}
RATES |= {"early": 30, "shutter": 48}

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


def test_names_of_meshes_are_listed(caches):
    pytest.importorskip("alembic3d", reason="alembic3d is not installed")
    for name in ("two", "parents", "instances"):
        assert len(ssdr.io.list_meshes(caches[name])) == 2


def test_a_changing_topology_is_refused(caches):
    pytest.importorskip("alembic3d", reason="alembic3d is not installed")
    with pytest.raises(ssdr.FormatError, match=r"/melt/melt_mesh: .*in frame 3 \(0\.166667 s\)"):
        ssdr.load(caches["changing"])


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
