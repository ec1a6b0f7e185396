"""Machines with and without Blender, as far as the package can tell."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

import pytest


def no_blender(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Hide every Blender of this machine; the user's cache is in `folder`."""
    real = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if name == "bpy" else real(name, *a)
    )
    monkeypatch.delenv("SSDR_BLENDER", raising=False)
    monkeypatch.delenv("SSDR_BLENDER_PYTHON", raising=False)
    for variable in ("XDG_CACHE_HOME", "LOCALAPPDATA", "HOME", "USERPROFILE"):
        monkeypatch.setenv(variable, str(folder))
    (folder / "empty").mkdir(exist_ok=True)
    monkeypatch.setenv("PATH", str(folder / "empty"))


def program(path: Path, code: str) -> Path:
    """A program of this name that runs Python code."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!{sys.executable}\n{code}", encoding="utf-8")
    os.chmod(path, 0o755)
    return path
