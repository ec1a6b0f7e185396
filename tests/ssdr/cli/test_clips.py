"""Clips on the command line: several inputs, ``--clip``, and the options of each file."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from PIL import Image

import ssdr
from helpers.rig_model import largest_distance, tube
from ssdr import Clip, MeshSequence

CLIPS = (Clip("walk", 0, 9, 24.0), Clip("jump", 9, 19, 60.0))


def animated(clips=CLIPS):
    return dataclasses.replace(
        tube(bones=3, frames=19, rings=7, sides=6), clips=clips, surface=None, name="horse"
    )


@pytest.fixture
def rigged(tmp_path):
    ssdr.save(animated(), tmp_path / "rigged.glb")
    return tmp_path / "rigged.glb"


@pytest.fixture
def files(tmp_path):
    """Each clip in a file of another format."""
    model = animated()
    walk, jump = (
        MeshSequence(model.skin(c.frames), model.faces, c.fps, name=c.name) for c in CLIPS
    )
    ssdr.save(walk, tmp_path / "walk.npz")
    ssdr.save(jump, tmp_path / "jump.npy")
    return tmp_path / "walk.npz", tmp_path / "jump.npy"


FAST = ("--bones", 3, "--effort", "fast")


def test_the_command_takes_several_files_as_clips_of_one_model(run, files, tmp_path):
    out = tmp_path / "horse.glb"
    picture = tmp_path / "sheet.png"
    code, text, err = run(
        "decompose", *files, "-o", out, *FAST, "--picture", picture, "--json", "--fps", 60
    )
    assert code == 0, err
    document = json.loads(text)
    assert document["input"] == [str(f) for f in files]
    assert document["frames"] == 19
    assert [(c["name"], c["start"], c["stop"]) for c in document["clips"]] == [
        ("walk", 0, 9),
        ("jump", 9, 19),
    ]
    back = ssdr.load_skinning(out)
    assert back.clips == (Clip("walk", 0, 9, 60.0), Clip("jump", 9, 19, 60.0))
    assert back.name == "horse"  # the file, no longer a clip
    with Image.open(picture) as image:
        assert image.width == 1600


def test_clips_of_24_and_60_frames_a_second_keep_their_pace(run, rigged, tmp_path):
    code, text, err = run("decompose", rigged, "--clip", "all", "-o", tmp_path / "a.glb", *FAST)
    assert code == 0, err
    assert "walk (9 at 24 a second), jump (10 at 60 a second)" in text
    assert ssdr.list_clips(tmp_path / "a.glb") == CLIPS
    assert ssdr.load_skinning(tmp_path / "a.glb").name == "horse"


def test_a_clip_is_chosen_by_name_and_others_are_told_of(run, rigged, tmp_path):
    code, _, err = run("decompose", rigged, "-o", tmp_path / "a.npz", *FAST, "-q")
    assert code == 0
    assert "2 clips (walk, jump): walk is taken" in err
    assert [c.name for c in ssdr.list_clips(tmp_path / "a.npz")] == ["walk"]
    code, _, err = run("decompose", rigged, "--clip", "jump", "-o", tmp_path / "b.npz", *FAST, "-q")
    assert (code, err) == (0, "")
    assert ssdr.list_clips(tmp_path / "b.npz") == (Clip("jump", 0, 10, 60.0),)
    code, _, err = run("decompose", rigged, "--clip", "jmup", "-o", tmp_path / "c.npz", *FAST)
    assert code == 2
    assert "--clip: expected a clip of" in err
    assert "walk, jump" in err


def test_clips_of_several_rates_are_refused_before_the_work(run, rigged, tmp_path, monkeypatch):
    monkeypatch.setitem(vars(ssdr), "decompose", None)
    for name in ("a.pc2", "a.npy"):
        code, _, err = run(
            "decompose", rigged, "--clip", "all", "-o", tmp_path / name, "--bones", 3
        )
        assert code == 2
        assert "--output: expected a format that holds clips of several frame rates" in err
        assert "walk at 24, jump at 60" in err


def test_a_clip_named_twice_is_read_once(run, rigged, tmp_path):
    flags = ("--clip", "jump", "--clip", "jump")
    for command in (("convert", rigged), ("decompose", rigged, *FAST, "-o")):
        out = tmp_path / f"{command[0]}.npz"
        assert run(*command, out, *flags)[0] == 0
        assert ssdr.list_clips(out) == (Clip("jump", 0, 10, 60.0),)
    out = tmp_path / "b.npz"
    assert run("convert", rigged, out, "--clip", "jump", "--clip", "all")[0] == 0
    assert ssdr.list_clips(out) == CLIPS


def test_compare_takes_the_frames_of_all_clips_in_one_file(run, rigged, tmp_path):
    model = animated()
    ssdr.save(MeshSequence(model.skin(), model.faces), tmp_path / "all.npz")
    for pair in ((rigged, tmp_path / "all.npz"), (tmp_path / "all.npz", rigged)):
        code, out, err = run("compare", *pair, "--json", "--no-hausdorff")
        assert code == 0, err
        assert json.loads(out)["rmse"] < 1e-6


def test_clips_of_one_name_are_told_apart_by_their_files(run, tmp_path):
    paths = []
    for k, stem in enumerate(("trot", "run")):
        one = dataclasses.replace(
            animated().select(k), clips=[Clip("mixamo", 0, 9 + k, (24, 60)[k])], fps=(24, 60)[k]
        )
        paths.append(tmp_path / f"{stem}.glb")
        ssdr.save(one, paths[-1])
    code, _, err = run("decompose", *paths, "-o", tmp_path / "a.glb", *FAST, "-q")
    assert code == 0, err
    assert [(c.name, c.fps) for c in ssdr.list_clips(tmp_path / "a.glb")] == [
        ("trot", 24.0),
        ("run", 60.0),
    ]


def test_files_of_other_meshes_are_refused_by_name(run, files, clip, tmp_path, wave):
    code, _, err = run("decompose", files[0], clip, "-o", tmp_path / "a.glb", *FAST)
    assert code == 2
    assert "clip.npz: expected the 44 vertices of" in err
    walk = ssdr.load(files[0])
    ssdr.save(dataclasses.replace(walk, faces=walk.faces[::-1]), tmp_path / "turned.npz")
    code, _, err = run(
        "decompose", files[0], tmp_path / "turned.npz", "-o", tmp_path / "a.glb", *FAST
    )
    assert code == 2
    assert "turned.npz: expected the triangles of" in err


def test_vertices_are_welded_where_they_coincide_in_every_clip(run, tmp_path):
    vertices = np.zeros((4, 4, 3))
    vertices[:, 1:3, 0] = 1
    vertices[:, 3, 1] = np.arange(1, 5)
    vertices[3, 2, 2] = 1  # the seam opens in the second clip alone
    for name, part in (("a", vertices[:2]), ("b", vertices[2:])):
        ssdr.save(MeshSequence(part, [[0, 1, 3], [0, 2, 3]]), tmp_path / f"{name}.npz")
    paths = tmp_path / "a.npz", tmp_path / "b.npz"
    code, _, err = run(
        "decompose", *paths, "-o", tmp_path / "m.npz", "--weld", "-q", "-b", 1, "-e", "fast"
    )
    assert code == 0, err
    assert ssdr.load_skinning(tmp_path / "m.npz").n_vertices == 4


def test_one_frame_has_no_motion(run, wave, tmp_path):
    ssdr.save(wave, tmp_path / "frame_%02d.obj")
    code, _, err = run("decompose", tmp_path / "frame_00.obj", "-o", tmp_path / "a.npz", *FAST)
    assert code == 2
    assert "no motion: did you mean a pattern?" in err
    assert not (tmp_path / "a.npz").exists()


@pytest.mark.parametrize("command", ["info", "convert", "render", "decompose", "compare"])
def test_a_mistyped_option_of_the_format_is_refused(run, rigged, tmp_path, command):
    rest = {
        "info": (),
        "convert": (tmp_path / "o.npz",),
        "render": ("-o", tmp_path / "o.png"),
        "decompose": ("-o", tmp_path / "o.npz", *FAST),
        "compare": (rigged,),
    }[command]
    code, _, err = run(command, rigged, *rest, "--read", "anim=1")
    assert code == 2
    assert "--read: expected one of animation, fps, max_bytes, meshes, weld" in err
    assert "got anim" in err
    assert not list(tmp_path.glob("o.*"))


def test_options_go_to_the_files_that_know_them(run, rigged, files, tmp_path):
    jump = files[1]
    (tmp_path / "jump.faces.npy").rename(tmp_path / "f.npy")
    code, _, err = run("compare", rigged, jump, "--clip", "jump", "--no-sted")
    assert code == 2
    pair = ("compare", rigged, jump, "--clip", "jump", "--no-sted", "--no-hausdorff", "--json")
    code, out, err = run(*pair, "--read", f"faces={tmp_path / 'f.npy'}")
    assert code == 0, err
    assert json.loads(out)["rmse"] < 1e-6
    for name, expected in (("B", 0), ("npy", 0), ("A", 2), ("obj", 2), ("C", 2)):
        code, out, err = run(*pair, "--read", f"{name}:faces={tmp_path / 'f.npy'}")
        assert code == expected, (name, err)
    # both are glTF: the letter says which
    code, out, err = run(
        "compare", rigged, rigged, "--json", "--read", "A:animation=1", "--read", "B:animation=1"
    )
    assert code == 0, err
    code, out, err = run("compare", rigged, rigged, "--json", "--read", "B:animation=1")
    assert code == 2
    assert "as many clips of A as of B" in out


def test_info_says_which_clips_a_file_has(run, rigged, files, tmp_path):
    code, out, err = run("info", rigged)
    assert code == 0, err
    assert "walk (9 at 24 a second), jump (10 at 60 a second)" in out
    _, out, _ = run("info", rigged, "--json")
    document = json.loads(out)
    assert document["clips"] == [
        {"name": "walk", "start": 0, "stop": 9, "fps": 24.0, "frames": 9, "duration": 0.375},
        {"name": "jump", "start": 9, "stop": 19, "fps": 60.0, "frames": 10, "duration": 10 / 60},
    ]
    assert (document["name"], document["frames"]) == ("horse", 19)
    assert document["duration"] == pytest.approx(0.375 + 10 / 60)
    _, out, _ = run("info", rigged, "--json", "--clip", "jump")
    assert [c["name"] for c in json.loads(out)["clips"]] == ["jump"]
    _, out, _ = run("info", files[0], "--json")
    assert json.loads(out)["clips"] == [document["clips"][0]]
    code, _, err = run("info", rigged, "--clip", "run")
    assert code == 2
    assert "--clip: expected one of walk, jump" in err


@pytest.mark.parametrize("suffix", [".glb", ".npz", ".usda"])
def test_convert_keeps_all_clips(run, rigged, tmp_path, suffix):
    if suffix == ".usda":
        pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")
    out = tmp_path / f"out{suffix}"
    code, text, err = run("convert", rigged, out, "--json")
    assert code == 0, err
    assert [c["name"] for c in json.loads(text)["clips"]] == ["walk", "jump"]
    back = ssdr.load_skinning(out)
    assert (back.clips, back.name) == (CLIPS, "horse")
    assert largest_distance(back.skin(), animated().skin()) < 1e-5
    code, _, err = run("convert", rigged, out, "--clip", "jump", "--force")
    assert code == 0, err
    assert ssdr.list_clips(out) == (Clip("jump", 0, 10, 60.0),)


def test_vertices_are_those_of_one_clip(run, rigged, tmp_path):
    code, _, err = run("convert", rigged, tmp_path / "a.npz", "--bake")
    assert code == 0
    assert "walk is taken" in err
    assert len(ssdr.load(tmp_path / "a.npz")) == 9
    code, _, err = run("convert", rigged, tmp_path / "b.npz", "--bake", "--clip", "jump")
    assert (code, err) == (0, "")
    assert len(ssdr.load(tmp_path / "b.npz")) == 10
    code, _, err = run("convert", rigged, tmp_path / "c.npz", "--bake", "--clip", "all")
    assert code == 2
    assert "one clip where vertices are read, of walk, jump" in err
    code, _, err = run("convert", rigged, tmp_path / "c.pc2")
    assert code == 2
    assert "one frame rate" in err
    assert not list(tmp_path.glob("c.*"))


def test_compare_walks_through_the_clips(run, rigged, tmp_path):
    model = animated()
    moved = model.transforms.copy()
    moved[9:, ..., 2, 3] += 0.5
    ssdr.save(dataclasses.replace(model, transforms=moved), tmp_path / "b.npz")
    code, out, err = run("compare", rigged, tmp_path / "b.npz", "--json")
    assert code == 0, err
    document = json.loads(out)
    walk, jump = document["clips"]
    assert (walk["name"], jump["name"]) == ("walk", "jump")
    assert walk["rmse"] < 1e-6
    assert jump["rmse"] == pytest.approx(0.5, rel=1e-5)
    assert document["rmse"] == pytest.approx(0.5 * np.sqrt(10 / 19), rel=1e-5)
    _, out, _ = run("compare", rigged, tmp_path / "b.npz")
    assert "walk: 9 frames" in out
    assert "all clips: 19 frames" in out
    _, out, _ = run("compare", rigged, tmp_path / "b.npz", "--clip", "walk", "--json")
    assert json.loads(out)["rmse"] < 1e-6
    ssdr.save(model.select("jump", "walk"), tmp_path / "c.npz")
    _, out, _ = run("compare", rigged, tmp_path / "c.npz", "--json")
    assert json.loads(out)["rmse"] < 1e-6
    renamed = dataclasses.replace(
        model, clips=[CLIPS[0], dataclasses.replace(CLIPS[1], name="run")]
    )
    ssdr.save(renamed, tmp_path / "d.npz")
    code, _, err = run("compare", rigged, tmp_path / "d.npz")
    assert code == 2
    assert "the clips of A, jump too" in err
    code, _, err = run("compare", tmp_path / "a.npz", tmp_path / "a.npz")
    assert code == 2


def test_compare_refuses_a_clip_that_neither_file_has(run, clip):
    code, _, err = run("compare", clip, clip, "--clip", "walk")
    assert code == 2
    assert "--clip: expected one of sheet" in err
    assert run("compare", clip, clip, "--clip", "sheet")[0] == 0


def test_render_draws_a_clip(run, rigged, files, tmp_path):
    code, _, err = run(
        "render", rigged, "-o", tmp_path / "a.png", "--clip", "walk", "-r", files[0], "-q"
    )
    assert code == 0, err
    code, _, err = run(
        "render", rigged, "-o", tmp_path / "b.png", "-r", rigged, "-q", "--frames", 2
    )
    assert code == 0, err
    code, _, err = run("render", rigged, "-o", tmp_path / "c.gif", "-q")
    assert code == 2
    assert "one frame rate, for a film" in err
    assert "walk at 24, jump at 60" in err
    flags = ("--clip", "jump", "-q", "--frames", "0,5", "--width", 64)
    assert run("render", rigged, "-o", tmp_path / "c.gif", *flags)[0] == 0


def test_a_mesh_without_a_skin_may_have_clips(run, tmp_path):
    """A morph target moves it: vertices are read, of one clip."""
    point = np.eye(3, dtype=np.float32)
    times, amounts = np.float32([0, 1 / 24]), np.float32([0, 1])
    data = point.tobytes() + (2 * point).tobytes() + times.tobytes() + amounts.tobytes()
    view = [(0, 36), (36, 36), (72, 8), (80, 8)]
    kinds = [("VEC3", 3), ("VEC3", 3), ("SCALAR", 2), ("SCALAR", 2)]
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "targets": [{"POSITION": 1}]}]}],
        "animations": [
            {
                "name": name,
                "samplers": [{"input": 2, "output": 3}],
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
            }
            for name in ("grow", "shrink")
        ],
        "buffers": [{"uri": "a.bin", "byteLength": len(data)}],
        "bufferViews": [{"buffer": 0, "byteOffset": a, "byteLength": n} for a, n in view],
        "accessors": [
            {"bufferView": k, "componentType": 5126, "count": n, "type": kind}
            for k, (kind, n) in enumerate(kinds)
        ],
    }
    (tmp_path / "a.bin").write_bytes(data)
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    code, out, err = run("info", tmp_path / "a.gltf", "--json")
    assert code == 0, err
    assert [c["name"] for c in json.loads(out)["clips"]] == ["grow", "shrink"]
    code, _, err = run("convert", tmp_path / "a.gltf", tmp_path / "b.npz")
    assert code == 0
    assert "grow is taken" in err
    code, _, err = run("convert", tmp_path / "a.gltf", tmp_path / "c.npz", "--clip", "shrink")
    assert (code, err) == (0, "")
    assert ssdr.load(tmp_path / "c.npz").clip == "shrink"


@pytest.mark.parametrize("suffix", ["glb", "usdc", "npz"])
def test_skinned_inputs_take_the_frame_rate_that_is_asked_for(run, tmp_path, suffix):
    if suffix == "usdc":
        pytest.importorskip("pxr")
    model = animated()
    source = tmp_path / f"rigged.{suffix}"
    ssdr.save(model, source)
    out = tmp_path / "slower.glb"
    code, text, err = run("convert", source, out, "--fps", 12, "--json")
    assert code == 0, err
    # A file with times lasts as long as before; frames alone follow each other more slowly.
    counts = [9, 10] if suffix == "npz" else [5, 2]
    assert [(c["fps"], c["frames"]) for c in json.loads(text)["clips"]] == [
        (12.0, counts[0]),
        (12.0, counts[1]),
    ]
    back = ssdr.load_skinning(out)
    picked = np.arange(19) if suffix == "npz" else [0, 2, 4, 6, 8, 9, 14]
    assert [c.fps for c in back.clips] == [12.0, 12.0]
    assert largest_distance(back.skin(), model.skin(picked)) < 1e-5
    clips = ssdr.list_clips(source, fps=12)
    assert clips == back.clips == ssdr.load_skinning(source, fps=12).clips
    code, text, err = run("info", source, "--fps", 12, "--json")
    assert code == 0, err
    assert [(c["fps"], c["frames"]) for c in json.loads(text)["clips"]] == [
        (12.0, counts[0]),
        (12.0, counts[1]),
    ]
    # Clips of several rates make no film, unless all get one.
    film = tmp_path / "film.gif"
    code, _, err = run("render", source, "-o", film, "--width", 64)
    assert code == 2
    assert "of one frame rate" in err
    code, _, err = run("render", source, "-o", film, "--width", 64, "--fps", 12)
    assert code == 0, err
    with Image.open(film) as picture:
        assert picture.n_frames <= sum(counts)


@pytest.mark.parametrize("rate", [0, -3, "nan", "inf"])
def test_a_frame_rate_that_is_none_is_refused_of_skinned_inputs(run, rigged, tmp_path, rate):
    for command in (("info", rigged), ("convert", rigged, tmp_path / "o.npz")):
        code, _, err = run(*command, "--fps", rate)
        assert code == 2
        assert "fps: expected a positive number" in err
