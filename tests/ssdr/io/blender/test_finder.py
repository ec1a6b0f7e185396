"""Which Blender is taken, and what is said where there is none; programs stand in for Blender."""

from __future__ import annotations

import json
import os
import runpy
import shlex
import sys
import tomllib
import types
from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers.blender import no_blender, program
from helpers.rig_model import tube
from ssdr.io.blender.finder import command, environment

ROOT = Path(__file__).resolve().parents[4]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="programs here are scripts")


@pytest.fixture(autouse=True)
def bare(monkeypatch, tmp_path):
    no_blender(monkeypatch, tmp_path)


@pytest.fixture
def clip(tmp_path):
    return tmp_path / "a.fbx"


def own_environment(folder, *, module=True):
    python = program(folder / "bin" / "python", "")
    if module:
        (folder / "lib" / "python3.11" / "site-packages" / "bpy").mkdir(parents=True)
    return python


def test_the_package_asks_for_no_bpy_which_would_downgrade_numpy():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for asked in (project["dependencies"], *project["optional-dependencies"].values()):
        assert not [name for name in asked if name.startswith("bpy")]


def test_a_blender_on_the_path_writes(tmp_path, clip, monkeypatch):
    code = """import json, sys
options, (script, _, name) = sys.argv[1:-3], sys.argv[-3:]
assert options == ["--background", "--factory-startup", "--python-exit-code", "1", "--python"]
assert script.endswith("write_script.py") and _ == "--"
sys.exit(json.load(open(name, encoding="utf-8"))["path"])
"""
    blender = program(tmp_path / "programs" / "blender", code)
    monkeypatch.setenv("PATH", str(blender.parent))
    words = command("script.py", "job.json")
    assert words[0] == str(blender)
    assert words[-4:] == ["--python", "script.py", "--", "job.json"]
    with pytest.raises(ssdr.SsdrError, match=rf"Blender failed \(1\): {tmp_path}"):
        ssdr.save(tube(frames=2), clip)


def test_the_nearer_blender_comes_first(tmp_path, monkeypatch):
    on_path = program(tmp_path / "programs" / "blender", "")
    monkeypatch.setenv("PATH", str(on_path.parent))
    assert environment() == tmp_path / "ssdr" / "blender" or sys.platform == "darwin"
    own_environment(environment(), module=False)
    assert command("s")[0] == str(on_path)  # an environment that was never finished
    own = own_environment(environment())
    assert command("s", "a") == [str(own), "s", "a"]
    python = own_environment(tmp_path / "other")
    monkeypatch.setenv("SSDR_BLENDER_PYTHON", str(python))
    assert command("s", "a") == [str(python), "s", "a"]
    named = program(tmp_path / "blender-5" / "blender", "")
    monkeypatch.setenv("SSDR_BLENDER", str(named))
    assert command("s")[0] == str(named)


def test_without_blender_one_line_says_how_to_get_it(clip):
    with pytest.raises(ssdr.MissingDependencyError, match="SSDR_BLENDER") as caught:
        ssdr.save(tube(frames=2), clip)
    text = str(caught.value)
    assert "\n" not in text
    make = text.partition("with: ")[2].partition(" (bpy")[0]
    venv, pip = (shlex.split(part) for part in make.split(" && "))
    assert venv == ["python3.11", "-m", "venv", str(environment())]
    assert pip == [str(environment() / "bin" / "pip"), "install", "bpy"]
    assert not clip.exists()


@pytest.mark.parametrize("variable", ["SSDR_BLENDER", "SSDR_BLENDER_PYTHON"])
def test_a_variable_that_names_nothing_is_refused(clip, tmp_path, monkeypatch, variable):
    (tmp_path / "file").write_text("no program")
    for name in (tmp_path / "nothing", tmp_path / "file"):
        monkeypatch.setenv(variable, str(name))
        with pytest.raises(ssdr.InputError, match=f"{variable}: expected a .*'{name}'"):
            ssdr.save(tube(frames=2), clip)


@pytest.mark.parametrize(
    ("code", "text"),
    [
        ("raise RuntimeError('Blender 4.2 or newer is needed, this is 3.4.1')", "this is 3.4.1"),
        ("import bpy_is_missing", "Blender failed"),
        ("raise ModuleNotFoundError(\"No module named 'bpy'\")", "No module named 'bpy'"),
        ("", "Blender failed"),
    ],
)
def test_a_blender_that_does_not_do_it_is_named(clip, tmp_path, monkeypatch, code, text):
    blender = program(tmp_path / "old" / "blender", code)
    monkeypatch.setenv("SSDR_BLENDER", str(blender))
    lacks = "failed" not in text
    kind = ssdr.MissingDependencyError if lacks else ssdr.SsdrError
    with pytest.raises(kind, match=text) as caught:
        ssdr.save(tube(frames=2), clip)
    assert not lacks or str(blender) in str(caught.value)


def test_a_blender_that_cannot_be_started_is_named(clip, tmp_path, monkeypatch):
    blender = program(tmp_path / "broken" / "blender", "")
    blender.write_text("#!/no/such/interpreter\n")
    monkeypatch.setenv("SSDR_BLENDER", str(blender))
    with pytest.raises(ssdr.MissingDependencyError, match="could not be started"):
        ssdr.save(tube(frames=2), clip)


def test_of_a_traceback_in_blender_the_last_line_is_told(tmp_path, monkeypatch):
    app = types.SimpleNamespace(version=(4, 2, 0))
    monkeypatch.setitem(sys.modules, "bpy", types.SimpleNamespace(app=app))
    monkeypatch.setattr(os, "_exit", lambda code: None)
    (tmp_path / "job.json").write_text(json.dumps({"out": str(tmp_path / "out.npz")}))
    monkeypatch.setattr(sys, "argv", ["script.py", str(tmp_path / "job.json")])

    def act(job):
        raise RuntimeError("Error: Python: Traceback\n  File 'a.py', line 1\nKeyError: 'bone'")

    runpy.run_path(str(ROOT / "ssdr/io/blender/write_script.py"))["run"](act)
    assert str(np.load(tmp_path / "out.npz")["error"]) == "Blender says: KeyError: 'bone'"
