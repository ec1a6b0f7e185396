"""The Blender extension, installed from its zip into a fresh Blender."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import ssdr
from helpers.blender_scene import run_blender

ROOT = Path(__file__).resolve().parents[4]

_HEAD = """
import importlib, json, os, shutil, sys
from pathlib import Path
import bpy
import addon_utils
import numpy as np

FOLDER, ZIP, PYTHON = map(Path, sys.argv[-3:])
NAME = "bl_ext.user_default.ssdr"
bpy.ops.wm.read_factory_settings(use_empty=True)
addon_utils.enable("bl_pkg")
bpy.ops.extensions.package_install_files(
    filepath=str(ZIP), repo="user_default", enable_on_install=True
)
job, process, ui = (importlib.import_module(f"{NAME}.{one}") for one in ("job", "process", "ui"))
remove = shutil.rmtree
def keep(folder, **options):  # what the job exchanged with the solver
    for file in Path(folder).glob("*.[gnj]*"):
        shutil.copy(file, FOLDER)
    remove(folder, **options)
job.shutil = type("shutil", (), {"rmtree": staticmethod(keep)})
preferences = bpy.context.preferences.addons[NAME].preferences
preferences.python = str(PYTHON)
scene, options = bpy.context.scene, bpy.context.scene.ssdr
scene.frame_start, scene.frame_end = 1, 30
options.bones, options.effort = 8, "FAST"

def grid(cells=19):
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=cells, y_subdivisions=cells, size=2)
    item = bpy.context.object
    item.data.materials.append(bpy.data.materials.new("red"))
    return item

def bending(frames=(1, 15, 30)):
    # a bar with two shape keys, which bends one way and the other
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=24, y_subdivisions=4, size=2)
    item = bpy.context.object
    item.shape_key_add(name="Basis")
    for name, sign in (("up", 1), ("down", -1)):
        key = item.shape_key_add(name=name)
        for k, vertex in enumerate(item.data.vertices):
            angle = sign * max(0.0, vertex.co.x)
            key.data[k].co.z = vertex.co.z + np.sin(angle) * abs(vertex.co.x)
            key.data[k].co.x = vertex.co.x * np.cos(angle)
        for n, frame in enumerate(frames):
            key.value = n % 2 if sign > 0 else (n // 2) % 2
            key.keyframe_insert("value", frame=frame)
    return item

def points(item):
    # world vertices of every frame, without the modifiers that only add detail
    behind = [one for one in item.modifiers if one.type == "SUBSURF"]
    for one in behind:
        one.show_viewport = False
    found, place = [], []
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        shown = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
        mesh = shown.to_mesh()
        flat = np.empty(3 * len(mesh.vertices), dtype=np.float32)
        mesh.vertices.foreach_get("co", flat)
        found.append(flat.reshape(-1, 3))
        place.append(np.array(shown.matrix_world))
        shown.to_mesh_clear()
    for one in behind:
        one.show_viewport = True
    return np.array(found), np.array(place)

def seen(item):
    shown = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    found = [[round(x, 5) for x in vertex.co] for vertex in shown.to_mesh().vertices]
    shown.to_mesh_clear()
    return found

def state():
    # what a user could see of the scene
    def of(item):
        mesh = item.data if item.type == "MESH" else None
        return [
            item.name, item.type, item.parent and item.parent.name, item.data and item.data.name,
            [list(row) for row in item.matrix_world],
            [[one.name, one.type, one.show_viewport] for one in item.modifiers],
            [one.name for one in item.constraints],
            [one.name for one in item.vertex_groups],
            [one.name for one in item.material_slots],
            mesh and [list(vertex.co) for vertex in mesh.vertices],
            mesh and mesh.shape_keys and [key.name for key in mesh.shape_keys.key_blocks],
            mesh and [one.name for one in mesh.color_attributes],
            item.select_get(), item.hide_viewport, item.hide_render, mesh and seen(item),
        ]
    held = [sorted(one.name for one in group) for group in (
        bpy.data.objects, bpy.data.meshes, bpy.data.armatures, bpy.data.actions)]
    active = bpy.context.object and bpy.context.object.name
    return json.dumps([scene.frame_current, active, held, [of(o) for o in scene.objects]])

def left_behind():
    return [one.name for one in Path(bpy.app.tempdir).glob("ssdr_*")]

def save(target, before):
    shown, place = points(target)
    np.savez(FOLDER / "shown.npz", shown=shown, place=place, before=before[0], from_=before[1])

def error(run=bpy.ops.ssdr.decompose):
    try:
        run()
    except RuntimeError as found:
        return str(found).strip()
    except process.AddonError as found:
        return f"Error: {found}"
    return "none"
"""


@pytest.fixture(scope="session")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The extension's zip, built by Blender's own tool."""
    folder = tmp_path_factory.mktemp("extension")
    words = [sys.executable, str(ROOT / ".ci" / "extension.py"), str(folder)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / f"ssdr-{ssdr.__version__}.zip"


@pytest.fixture
def blender(archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Function that runs code in a fresh Blender with the extension; the JSON that it printed."""
    monkeypatch.setenv("BLENDER_USER_RESOURCES", str(tmp_path / "user"))
    python = tmp_path / "python"  # the extension hides this process's PYTHONPATH from it
    python.write_text(f'#!/bin/sh\nPYTHONPATH="{ROOT}" exec "{sys.executable}" "$@"\n')
    python.chmod(0o755)

    def run(code: str) -> Any:
        arguments = tmp_path, archive, python
        out = run_blender(tmp_path / "scene.py", _HEAD + code, *arguments)
        said = [line for line in out.splitlines() if line.startswith("SAID ")]
        assert "Traceback" not in out
        return json.loads(said[-1].removeprefix("SAID "))

    return run
