"""What the extension does without Blender: stand-ins take its place."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

import ssdr

ADDONS = Path(__file__).resolve().parents[4] / "ssdr" / "cli"
_INHERITED = {"PYTHONPATH": "/host/modules", "PYTHONHOME": "/host", "VIRTUAL_ENV": "/host/env"}


@pytest.fixture
def extension(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """The modules of the Blender extension, with a Blender that only has what they import."""
    bpy = MagicMock()
    bpy.types = SimpleNamespace(
        **dict.fromkeys(
            ("AddonPreferences", "PropertyGroup", "Operator", "Panel", "Object"), object
        )
    )
    bpy.app = SimpleNamespace(tempdir=str(tmp_path), online_access=False)
    package = ModuleType("blender_extension")
    package.__path__ = [str(ADDONS / "blender")]
    stubs = {"bpy": bpy, "bpy.props": bpy.props, "mathutils": MagicMock()}
    for name, module in {**stubs, package.__name__: package}.items():
        monkeypatch.setitem(sys.modules, name, module)
    found = {}
    for name in ("process", "sample", "build", "job", "ui"):
        full = f"{package.__name__}.{name}"
        monkeypatch.delitem(sys.modules, full, raising=False)
        found[name] = importlib.import_module(full)
        monkeypatch.delitem(sys.modules, full)
        monkeypatch.setitem(sys.modules, full, found[name])
    return SimpleNamespace(bpy=bpy, **found)


def test_other_pythons_do_not_inherit_the_hosts_modules(
    extension: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in _INHERITED.items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("PYTHONHOME")  # this Python would not start with it
    code = "import json, os; print(json.dumps(dict(os.environ)))"
    run = extension.process.follow([sys.executable, "-c", code], tmp_path)
    try:
        while True:
            next(run)
    except StopIteration as end:
        seen = json.loads(end.value)
    assert not _INHERITED.keys() & seen.keys()
    assert "PATH" in seen


@pytest.fixture
def clerk(extension: Any) -> Any:
    """Function that makes the operator with steps of a test's own; `clerk.told` is what it said."""

    def make(steps: Callable[[], Any]) -> Any:
        class Clerk(extension.ui.SSDR_OT_decompose):  # type: ignore[misc, name-defined]
            def _start(self, context: Any) -> Any:
                return steps()

            def report(self, kind: set[str], text: str) -> None:
                make.told.append((kind, text))  # type: ignore[attr-defined]

        return Clerk()

    make.told = []  # type: ignore[attr-defined]
    return make


def put_away(context: MagicMock) -> bool:
    """Whether timer, progress and status are gone."""
    manager, status = context.window_manager, context.workspace.status_text_set
    ended = manager.event_timer_remove.call_count == manager.progress_end.call_count == 1
    return ended and status.call_args.args == (None,)


@pytest.mark.parametrize("error", [ValueError("no number"), KeyError("armature"), OSError("full")])
def test_any_error_of_a_step_ends_the_operator_in_words(clerk: Any, error: Exception) -> None:
    def failing() -> Any:
        yield 0.5, "working"
        raise error

    context, event = MagicMock(), SimpleNamespace(type="TIMER", value="NOTHING")
    one = clerk(failing)
    assert one.invoke(context, None) == {"RUNNING_MODAL"}
    assert one.modal(context, event) == {"CANCELLED"}
    assert put_away(context)
    assert clerk(failing).execute(context) == {"CANCELLED"}
    kinds, texts = zip(*clerk.told, strict=True)
    assert kinds == ({"ERROR"},) * 2
    assert all(str(error.args[0]) in text for text in texts)


def test_esc_ends_the_operator_and_its_steps_and_nothing_else_does(clerk: Any) -> None:
    closed: list[bool] = []

    def working() -> Any:
        try:
            for k in range(100):
                yield k / 100, "reading the frames"
        finally:
            closed.append(True)

    context, event = MagicMock(), SimpleNamespace(type="TIMER", value="PRESS")
    one = clerk(working)
    assert one.invoke(context, None) == {"RUNNING_MODAL"}
    ends = {}
    for event.type in ("TIMER", "A", "MIDDLEMOUSE", "TIMER"):
        ends[event.type] = one.modal(context, event)
    running = {"RUNNING_MODAL"}
    assert ends == {"TIMER": running, "A": running, "MIDDLEMOUSE": {"PASS_THROUGH"}}
    said = [call.args[0] for call in context.workspace.status_text_set.call_args_list]
    assert said == [f"{k} %  reading the frames  (Esc: cancel)" for k in (1, 2)]
    assert not closed
    event.type = "ESC"
    assert one.modal(context, event) == {"CANCELLED"}
    assert closed
    assert put_away(context)
    assert clerk.told == [({"INFO"}, "Cancelled: nothing has changed")]


JOINTS = {"names": ["hips", "head"], "parents": [-1, 0], "positions": [[0, 0, 0], [1, 0, 0.0]]}


def run_solver(folder: Path, wave: Any, joints: Any = None, **options: Any) -> Any:
    """The solver's process, which has been asked for a model of the wave."""
    asked = {
        "name": "sheet",
        "fps": 25,
        "clips": [("up", 0, 2), ("down", 2, 4)],
        "joints": joints,
        "options": {"effort": "fast", "influences": 2, **options},
    }
    (folder / "asked.json").write_text(json.dumps(asked))
    np.savez(folder / "frames.npz", vertices=wave.vertices, faces=wave.faces)
    words = [sys.executable, str(ADDONS / "blender" / "run_solver.py"), str(folder)]
    return subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)


ASKED = pytest.mark.parametrize(
    ("options", "joints"),
    [({"bones": 2}, None), ({"tolerance": "50%", "measure": "max"}, None), ({}, JOINTS)],
)


@ASKED
def test_the_solver_answers_with_a_file_and_the_skin(
    tmp_path: Path, wave: Any, options: Any, joints: Any
) -> None:
    done = run_solver(tmp_path, wave, joints, **options)
    assert done.returncode == 0, done.stderr
    assert float(done.stderr.splitlines()[0].split()[0]) <= 1
    said = json.loads(done.stdout)
    model = ssdr.load_skinning(tmp_path / "model.glb")
    assert said["text"].startswith(f"{model.n_bones} bones, RMSE ")
    assert [clip.name for clip in model.clips] == ["up", "down"]
    assert joints is None or model.names() == tuple(joints["names"])
    with np.load(tmp_path / "model.npz") as skin:
        assert skin["weights"].shape == skin["indices"].shape == (12, model.n_influences)
        upright = ssdr.io.in_space(model, ssdr.Space(up="z"))
        np.testing.assert_allclose(skin["rest"], upright.rest, atol=1e-6)


@ASKED
def test_what_it_cannot_do_is_its_last_line(
    tmp_path: Path, wave: Any, options: Any, joints: Any
) -> None:
    wrong = run_solver(tmp_path, wave, joints, **options, influences=0)
    assert wrong.returncode == 1
    assert wrong.stderr.splitlines()[-1].startswith("influences: expected")
