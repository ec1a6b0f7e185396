"""`--for`, `--root-motion` and `ssdr check`."""

from __future__ import annotations

import dataclasses
import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers.command import fake_decompose
from ssdr.engines import ENGINES, findings

DOCS = Path(__file__).resolve().parents[3] / "docs"


@pytest.fixture
def solved(monkeypatch):
    """The waiting solver, with a result of the solver's type."""

    def solve(sequence, **options):
        found = fake_decompose(sequence, **options)
        model = dataclasses.replace(found.skinning, space=sequence.space)
        return ssdr.Decomposition(
            model, 0.25, "converged", found.history, np.array([0, len(sequence)]), 0.0
        )

    monkeypatch.setitem(vars(ssdr), "decompose", solve)


def blended(influences, bones=None, frames=5):
    """A model of equal weights whose bones rise by their number over the frames."""
    bones = bones or influences
    points = np.random.default_rng(1).normal(size=(7, 3))
    transforms = np.tile(np.eye(3, 4), (frames, bones, 1, 1))
    transforms[..., 1, 3] = np.linspace(0, 1, frames)[:, None] * np.arange(bones)
    return ssdr.Skinning(
        points,
        np.tile(np.arange(influences), (7, 1)),
        np.full((7, influences), 1 / influences),
        transforms,
        faces=[[0, 1, 2]],
        parents=np.arange(-1, bones - 1),
        joint_positions=np.zeros((bones, 3)),
        space=ssdr.Space(1.0, "y"),
    )


def gltf_json(path):
    data = path.read_bytes()
    return json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])


def test_a_preset_fills_in_what_is_open_and_says_so(run, done, solved, clip, tmp_path):
    document = done("decompose", clip, "-o", tmp_path / "a", "--for", "godot", "-b", 3)
    assert document["influences"] == 8
    assert document["for"].startswith("Godot: 8 influences, .glb, weights as uint16")
    json_of = gltf_json(tmp_path / "a.glb")
    weights = json_of["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]
    assert json_of["accessors"][weights]["componentType"] == 5123
    out = run("decompose", clip, "-o", tmp_path / "b.glb", "--for", "three", "-b", 3)[1]
    assert re.search(
        r"^for +three.js: 4 influences, .glb, weights as float32, once imported", out, re.M
    )


@pytest.mark.parametrize(
    ("arguments", "solved_for", "component"),
    [
        (("--for", "unreal"), "uint8", 5123),  # what 8 bits hold, 16 hold as well
        (("--for", "web"), "uint16", 5123),
        (("--for", "unity"), "float32", 5126),
        (("--for", "unreal", "-k", "8,float32"), "float32", 5126),
        (("-k", "4,uint8"), "uint8", 5121),
        (("-k", "4,uint8", "--write", "glb:weights=uint16"), "uint8", 5123),
    ],
)
def test_weights_are_solved_and_written_for(
    done, solved, clip, tmp_path, arguments, solved_for, component
):
    document = done("decompose", clip, "-o", tmp_path / "a.glb", "-b", 3, *arguments)
    assert document["storage"] == fake_decompose.options["storage"] == solved_for
    json_of = gltf_json(tmp_path / "a.glb")
    weights = json_of["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]
    assert json_of["accessors"][weights]["componentType"] == component


def test_a_preset_does_not_override_what_is_given(done, solved, clip, tmp_path):
    arguments = ("--for", "godot", "-b", 3, "-k", 2, "--write", "weights=float32")
    document = done(
        "decompose", clip, "-o", tmp_path / "a.glb", "-o", tmp_path / "a.npz", *arguments[:-2]
    )
    assert document["influences"] == 2
    assert "not read" not in str(document["warnings"])
    (said,) = document["warnings"]
    assert said == "Godot: refused: format .npz: reads .glb, .gltf, .fbx"
    document = done("decompose", clip, "-o", tmp_path / "b.glb", *arguments)
    assert "weights" not in document["for"]
    json_of = gltf_json(tmp_path / "b.glb")
    weights = json_of["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]
    assert json_of["accessors"][weights]["componentType"] == 5126
    document = done("decompose", clip, "-o", tmp_path / "c.glb", "--for", "bevy", "-b", 3, "-k", 6)
    assert document["influences"] == 6


def test_more_bones_than_an_engine_takes_are_said(done, solved, clip, tmp_path):
    document = done("decompose", clip, "-o", tmp_path / "a.glb", "--for", "bevy", "-b", 300)
    assert document["bones"] == 300
    assert any("Bevy: cut off: 300 bones: takes 256" in said for said in document["warnings"])


def test_root_motion_puts_a_root_above_all_bones(run, done, solved, clip, tmp_path):
    out = tmp_path / "a.glb"
    document = done("decompose", clip, "-o", out, "-b", 3, "--root-motion")
    assert document["root"].startswith("root, above all bones, carries the ground track")
    assert "y (not stated)" in document["root"]
    model = ssdr.load_skinning(out)
    root = model.names().index("root")
    assert (model.parents == root).sum() == 3
    assert document["bones"] == 4
    # One root is all that Unreal takes, so that its preset adds one that stands still.
    document = done("decompose", clip, "-o", tmp_path / "b.glb", "-b", 3, "--for", "unreal")
    assert "stands still" in document["root"]
    assert run("check", tmp_path / "b.glb", "--for", "unreal")[0] == 0


def test_check_says_what_is_cut_off_with_its_cost(done, run, tmp_path):
    weights = np.tile([0.3, 0.25, 0.2, 0.15, 0.06, 0.04], (7, 1))
    ssdr.save(dataclasses.replace(blended(6), weights=weights), tmp_path / "six.glb")
    document = done("check", tmp_path / "six.glb", "--for", "three")
    (found,) = document["findings"]
    assert (found["kind"], document["refused"]) == ("cut off", False)
    assert found["text"].startswith("6 influences, of 7 vertices more than 4: keeps 4")
    # Bone b rises by b, a vertex by 1.54; the first four alone lift it by 1.1 / 0.9.
    assert "a vertex moves by 0.318, " in found["text"]
    code, out, _ = run("check", tmp_path / "six.glb", "--for", "godot")
    assert code == 0
    assert re.search(r"^rounded +weights, to 16 bits, down: off by up to", out, re.M)
    ssdr.save(blended(4), tmp_path / "four.glb")
    code, out, _ = run("check", tmp_path / "four.glb", "--for", "web")
    assert code == 0
    assert re.search(r"^nothing +is refused, cut off, rounded or renamed$", out, re.M)


def test_check_rounds_as_the_engine_stores(done, tmp_path):
    model = blended(2)
    weights = np.tile([0.3, 0.7], (7, 1))
    ssdr.save(dataclasses.replace(model, weights=weights), tmp_path / "a.glb")
    (found,) = done("check", tmp_path / "a.glb", "--for", "unreal")["findings"]
    # 0.3 of 255 steps is 76.5: half a step is off, and the second bone rises by 1.
    assert found["text"].startswith(
        "weights, to 8 bits: off by up to 0.002; a vertex moves by 0.00196"
    )
    # Weights that were stored so are not rounded again.
    ssdr.save(model, tmp_path / "b.glb", weights="uint8")
    assert done("check", tmp_path / "b.glb", "--for", "unreal")["findings"] == []


def test_check_rounds_down_where_the_engine_does(done, tmp_path):
    # 0.3 and 0.7 are half a step above one. Steps whose sum in float32, in this order, is above 1
    # fall to the next lower ones. Weights lost draw a vertex to the origin and lift it less.
    for weights, lost in (
        (np.array([0.3, 0.7]), 0.5),
        (np.array([40349, 14207, 7609, 3370]) / 65535, 1.0),
    ):
        count = len(weights)
        model = dataclasses.replace(blended(count), weights=np.tile(weights, (7, 1)))
        path = tmp_path / f"{count}.glb"
        ssdr.save(model, path, weights="float32" if lost < 1 else "uint16")
        (found,) = done("check", path, "--for", "godot")["findings"]
        off = max(
            np.linalg.norm(count * model.rest + [0, t * sum(range(count)), 0], axis=1).max()
            for t in (0, 1)
        )
        assert f"16 bits, down: off by up to {lost / 65535:.2g}; " in found["text"]
        number = float(re.search(r"moves by (\S+),", found["text"])[1])
        assert number == pytest.approx(lost * off / 65535, rel=0.01)


def test_check_exits_with_1_where_something_is_refused(run, tmp_path):
    ssdr.save(blended(1, bones=300), tmp_path / "a.npz")
    code, out, err = run("check", tmp_path / "a.npz", "--for", "bevy")
    assert (code, err) == (1, "")
    assert re.search(r"^refused +format .npz: reads .glb, .gltf$", out, re.M)
    assert re.search(r"^cut off +300 bones: takes 256 ", out, re.M)
    code, out, _ = run("check", tmp_path / "a.npz", "--for", "bevy", "--json")
    assert (code, json.loads(out)["refused"]) == (1, True)


def test_check_wants_a_skin(refused, clip):
    assert "no skin weights" in refused("check", clip, "--for", "godot", code=3)
    assert "'nintendo'" in refused("check", clip, "--for", "nintendo")


def kinds(model, engine, suffix=".glb"):
    return [(f.kind, f.text) for f in findings(model, ENGINES[engine], suffix)]


def test_bones_that_move_nothing_count_where_the_engine_counts_joints():
    model = blended(1, bones=300)
    assert kinds(model, "bevy")[0][0] == "cut off"
    assert kinds(model, "unreal") == []
    spread = dataclasses.replace(
        blended(1, bones=257),
        **dict(
            zip(("rest", "indices"), (np.eye(257)[:, :3], np.arange(257)[:, None]), strict=True)
        ),
        weights=np.ones((257, 1)),
    )
    kind, text = kinds(spread, "unreal")[0]
    assert (kind, text[:22]) == ("refused", "257 bones: takes 256 (")


def test_names_that_an_engine_changes():
    model = dataclasses.replace(blended(4), bone_names=("hip", "arm.L", "rig:Head", "Hip"))
    assert kinds(model, "three") == [("renamed", "2 bones, as 'arm.L'")]
    assert ("renamed", "1 bones, as 'rig:Head'") in kinds(model, "godot")
    assert ("renamed", "2 bones whose names are the same, as 'hip'") in kinds(model, "unreal")
    assert kinds(model, "bevy") == []


def test_several_roots():
    model = dataclasses.replace(blended(2), parents=[-1, -1])
    assert kinds(model, "unreal")[0][0] == "refused"
    assert kinds(model, "unity") == []


def test_the_page_has_the_numbers_of_the_table():
    page = (DOCS / "engines.md").read_text()
    for name, engine in ENGINES.items():
        (row,) = re.findall(rf"^\| `{name}` \|(.*)$", page, re.M)
        cells = [cell.strip() for cell in row.split("|")]
        assert cells[0] == engine.title
        assert cells[1] == f"`{engine.suffixes[0]}`"
        assert cells[2] == str(engine.influences)
        assert cells[3] == (str(engine.bones) if engine.bones else "none known")
        assert cells[4] == f"{engine.storage}, {engine.write}"
        assert cells[5] == str(engine.space)
