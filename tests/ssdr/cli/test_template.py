"""What is no skin passes through `ssdr decompose` and `ssdr convert`."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers.gltf_asset import make_asset
from helpers.gltf_difference import NEW_SKIN, difference, tree

FAST = ("--bones", 3, "--effort", "fast")
STRICT = ("--write", "strict=true")
DATA = Path(os.environ.get("SSDR_TEST_DATA", "missing")) / "gltf"


@pytest.fixture
def everything(tmp_path):
    return make_asset(tmp_path / "all.gltf")


def test_decompose_keeps_all_but_the_skin(done, everything, tmp_path):
    chosen = ("--read", 'meshes=["Body","Coat"]', "--clip", "Dance")
    document = done("decompose", everything, *chosen, "-o", tmp_path / "o.glb", *FAST, *STRICT)
    assert document["warnings"] == []
    found = [p for p in difference(everything, tmp_path / "o.glb") if not NEW_SKIN.match(p)]
    assert all(p.startswith("animations/Dance/") for p in found)


def test_a_template_can_be_declined(run, everything, tmp_path):
    plain = ("--write", "glb:template=null")
    code, _, _ = run("decompose", everything, "-o", tmp_path / "o.glb", *FAST, *plain)
    assert code == 0
    assert len(tree(tmp_path / "o.glb")["drawn"]) == 1


needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="no files in SSDR_TEST_DATA")


@needs_data
@pytest.mark.filterwarnings("ignore:.*lie between its frames:ssdr.SsdrWarning")
@pytest.mark.parametrize("name", ["Fox.glb", "Llama.gltf"])
def test_skinned_files_get_a_new_skin_alone(run, tmp_path, name):
    source, out = DATA / name, tmp_path / "o.glb"
    code, _, err = run("decompose", source, "-o", out, *FAST, "--clip", "all")
    assert code == 0, err
    found = [p for p in difference(source, out) if not NEW_SKIN.match(p)]
    clips = "|".join(c.name for c in ssdr.list_clips(source))
    # Old joints are gone, and their tracks.
    assert all(p.startswith(("animations/", "scenes/0/")) for p in found)
    assert all("-" in p or "_skeleton" in p or p.endswith("+ssdr") or "extras" in p for p in found)
    assert ssdr.list_clips(out) == ssdr.list_clips(source), clips
    model = ssdr.load_skinning(out)
    for clip in model.clips:
        seen = ssdr.load(out, clip=clip.name).vertices
        truth = model.select(clip.name).skin()
        assert np.abs(seen - truth).max() < 1e-5 * np.abs(truth).max()
