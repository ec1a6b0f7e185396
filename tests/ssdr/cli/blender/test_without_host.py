"""What the extension does without Blender: stand-ins take its place."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
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


@pytest.mark.parametrize("error", [ValueError("no number"), KeyError("armature"), OSError("full")])
def test_any_error_of_a_step_ends_the_operator_in_words(extension: Any, error: Exception) -> None:
    def failing() -> Any:
        yield 0.5, "working"
        raise error

    class Clerk(extension.ui.SSDR_OT_decompose):  # type: ignore[misc, name-defined]
        def _start(self, context: Any) -> Any:
            return failing()

        def report(self, kind: set[str], text: str) -> None:
            told.append((kind, text))

    told: list[tuple[set[str], str]] = []
    context, event = MagicMock(), SimpleNamespace(type="TIMER", value="NOTHING")
    clerk = Clerk()
    assert clerk.invoke(context, None) == {"RUNNING_MODAL"}
    assert clerk.modal(context, event) == {"CANCELLED"}
    assert context.window_manager.event_timer_remove.call_count == 1
    assert context.window_manager.progress_end.call_count == 1
    assert Clerk().execute(context) == {"CANCELLED"}
    kinds, texts = zip(*told, strict=True)
    assert kinds == ({"ERROR"},) * 2
    assert all(str(error.args[0]) in text for text in texts)


JOINTS = {"names": ["hips", "head"], "parents": [-1, 0], "positions": [[0, 0, 0], [1, 0, 0.0]]}


@pytest.mark.parametrize(
    ("options", "joints"),
    [({"bones": 2}, None), ({"tolerance": "50%", "measure": "max"}, None), ({}, JOINTS)],
)
def test_the_solver_answers_with_a_file_and_the_skin(
    tmp_path: Path, wave: Any, options: Any, joints: Any
) -> None:
    asked = {
        "name": "sheet",
        "fps": 25,
        "clips": [("up", 0, 2), ("down", 2, 4)],
        "joints": joints,
        "options": {"effort": "fast", "influences": 2, **options},
    }
    (tmp_path / "asked.json").write_text(json.dumps(asked))
    np.savez(tmp_path / "frames.npz", vertices=wave.vertices, faces=wave.faces)
    words = [sys.executable, str(ADDONS / "blender" / "solve.py"), str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
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
    asked["options"]["influences"] = 0
    (tmp_path / "asked.json").write_text(json.dumps(asked))
    wrong = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
    assert wrong.returncode == 1
    assert wrong.stderr.splitlines()[-1].startswith("influences: expected")
