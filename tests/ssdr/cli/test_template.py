"""What is no skin passes through `ssdr decompose` and `ssdr convert`."""

from __future__ import annotations

import json
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


@pytest.mark.filterwarnings("always::ssdr.SsdrWarning")
def test_what_is_lost_is_named_and_strict_refuses_it(done, refused, everything, tmp_path):
    document = done("decompose", everything, "-o", tmp_path / "o.glb", *FAST)
    (said,) = document["warnings"]  # not once more on saving
    assert "has 2 clips (Dance, Spin): Dance is taken" in said
    chosen = done(
        "decompose", everything, "-o", tmp_path / "q.glb", *FAST, *STRICT, "--clip", "Dance"
    )
    assert chosen["warnings"] == []
    assert [clip.name for clip in ssdr.list_clips(tmp_path / "q.glb")] == ["Dance"]
    strictly = ("decompose", everything, *FAST, *STRICT)
    assert "Spin" in refused(*strictly, "-o", tmp_path / "p.glb")
    err = refused(*strictly, "-o", tmp_path / "p.npz")
    for what in (
        "vertex colours",
        "normal maps",
        "metallic-roughness maps",
        "emissive maps",
        "further sets of UVs",
        "names and number of the meshes",
        "the attribute _TEMPERATURE",
        "material extension KHR_materials_clearcoat",
        "cameras",
        "lights",
        "extras",
    ):
        assert what in err
    assert not list(tmp_path.glob("p.*"))


def test_a_template_can_be_declined(run, everything, tmp_path):
    plain = ("--write", "glb:template=null")
    code, _, err = run("decompose", everything, "-o", tmp_path / "o.glb", *FAST, *plain)
    assert code == 0
    assert "vertex colours" in err
    assert len(tree(tmp_path / "o.glb")["drawn"]) == 1


@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_convert_passes_the_whole_file_through(run, everything, tmp_path, ending):
    code, _, err = run("convert", everything, tmp_path / f"o.{ending}")
    assert (code, err) == (0, "")
    assert difference(everything, tmp_path / f"o.{ending}") == []
    again = tmp_path / "again.glb"
    assert run("convert", tmp_path / f"o.{ending}", again)[0] == 0
    assert difference(everything, again) == []
    code, _, err = run("convert", everything, tmp_path / f"one.{ending}", "--clip", "Spin")
    assert (code, err) == (0, "")
    places = difference(everything, tmp_path / f"one.{ending}")
    assert places == ["animations/-Dance"]


def test_a_still_file_that_passes_through_is_called_as_it_was(done, everything, tmp_path):
    document = json.loads(everything.read_text())
    del document["animations"]
    everything.write_text(json.dumps(document))
    (clip,) = ssdr.list_clips(everything)
    assert clip.name == everything.stem
    document = done("convert", everything, tmp_path / "after.glb")
    assert [c["name"] for c in document["clips"]] == [clip.name]


needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="no files in SSDR_TEST_DATA")


@needs_data
@pytest.mark.parametrize("name", ["Fox.glb", "Llama.gltf", "Duck.glb", "IridescenceSuzanne.glb"])
def test_convert_keeps_clips_and_the_hierarchy_of_joints(run, tmp_path, name):
    for ending in ("glb", "gltf"):
        assert run("convert", DATA / name, tmp_path / f"o.{ending}")[0] == 0
        assert difference(DATA / name, tmp_path / f"o.{ending}") == []


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
