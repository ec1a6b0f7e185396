"""The blocks of garmentnet's pages run, with small networks in place of trained ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from docs import snippets
from garmentnet.runtime.onnx_file import export_onnx
from helpers import cloth_scenes, live_garment

DOCS = Path(__file__).resolve().parents[2] / "docs"
_Given = tuple[dict[str, Any], dict[str, str]]


def _checkpoint(_: pytest.FixtureRequest) -> _Given:
    pytest.importorskip("onnxruntime")
    live_garment.saved(Path("checkpoint.safetensors"))
    export_onnx(live_garment.one(live_garment.network()), "dress.onnx")
    joints = live_garment.motion(0.2)
    return {"pose": joints[0], "poses": joints, "joints": joints}, {}


def _body(_: pytest.FixtureRequest) -> _Given:
    ball = trimesh.creation.uv_sphere(1.0, (12, 16))
    body = cloth_scenes.rigid(ball.vertices, ball.faces)
    vertices = np.array([[[0, 0, 0.9], [0, 0.7, 0], [0, 0, 3.0]]])
    pinned = np.array([False, False, True])
    given = {"body": body, "faces": [[0, 1, 2]], "pinned": pinned, "vertices": vertices}
    return given | {"joints": body.transforms}, {}


def _bones(request: pytest.FixtureRequest) -> _Given:
    bones, network = (request.getfixturevalue(f"toy_{name}") for name in ("bones", "network"))
    return {"bones": bones, "network": network}, {"base-dance-2000": "base-test-0"}


NEEDS: dict[str, Callable[[pytest.FixtureRequest], _Given]] = {
    "a trained checkpoint": _checkpoint,
    "the vertices of a garment, and its body as a skinning": _body,
    "the virtual bones of a data set, and a network trained on it": _bones,
}
BLOCKS = [
    pytest.param(need, text, id=f"{page.stem}-{k}")
    for page in sorted(DOCS.glob("garmentnet*.md"))
    for k, (need, text) in enumerate(snippets.needing(page))
]


@pytest.mark.slow
@pytest.mark.parametrize(("need", "text"), BLOCKS)
def test_blocks_run(
    need: str,
    text: str,
    request: pytest.FixtureRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    snippets.run_needing(text, *NEEDS[need](request))
