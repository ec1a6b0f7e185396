"""The extension's manifest, its imports, and its build."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import ssdr

ROOT = Path(__file__).resolve().parents[4]
SOURCE = ROOT / "ssdr" / "cli" / "blender"


def test_the_manifest_and_the_modules_promise_what_they_keep() -> None:
    manifest = tomllib.loads((SOURCE / "blender_manifest.toml").read_text())
    assert manifest["version"] == ssdr.__version__
    assert manifest["blender_version_min"] == "4.2.0"
    assert "blender" not in manifest["name"].lower()
    assert manifest["license"] == ["SPDX:MIT"]
    assert "MIT" in (ROOT / "LICENSE").read_text()
    for path in SOURCE.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [str(node.module)]
            for name in names:
                top = name.partition(".")[0]
                own = "ssdr" if path.name == "run_solver.py" else ""  # runs outside Blender
                assert top in {*sys.stdlib_module_names, "bpy", "mathutils", "numpy", own}, (
                    path.name
                )


def test_without_blender_the_build_says_what_is_missing(tmp_path: Path) -> None:
    hidden = {"SSDR_BLENDER", "SSDR_BLENDER_PYTHON"}
    empty = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path), "PATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, str(ROOT / ".ci" / "extension.py"), str(tmp_path)],
        env={k: v for k, v in os.environ.items() if k not in hidden} | empty,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 1
    assert "put it on the PATH" in done.stderr
    assert "Traceback" not in done.stderr
