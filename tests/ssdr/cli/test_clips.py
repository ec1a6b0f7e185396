"""Clips on the command line: several inputs, ``--clip``, and the options of each file."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from PIL import Image

import ssdr
from helpers.gltf_asset import make_asset
from helpers.page import Held
from helpers.rig_model import largest_distance, tube
from ssdr import Clip, MeshSequence

CLIPS = (Clip("walk", 0, 9, 24.0), Clip("jump", 9, 19, 60.0))
JUMP = (Clip("jump", 0, 10, 60.0),)
FAST = ("--bones", 3, "--effort", "fast")


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


def test_several_files_are_clips_of_one_model(done, files, tmp_path):
    out, picture = tmp_path / "horse.glb", tmp_path / "sheet.png"
    document = done("decompose", *files, "-o", out, *FAST, "-o", picture, "--read", "fps=60")
    assert document["input"] == [str(f) for f in files]
    assert document["frames"] == 19
    ranges = [(c["name"], c["start"], c["stop"]) for c in document["clips"]]
    assert ranges == [("walk", 0, 9), ("jump", 9, 19)]
    back = ssdr.load_skinning(out)
    assert back.clips == (Clip("walk", 0, 9, 60.0), Clip("jump", 9, 19, 60.0))
    assert back.name == "horse"  # the file, no longer a clip
    assert picture.exists()


def test_clips_of_24_and_60_frames_a_second_keep_their_pace(run, refused, rigged, tmp_path):
    line = ("decompose", rigged, "--clip", "all", *FAST, "-o")
    code, text, err = run(*line, tmp_path / "a.glb")
    assert code == 0, err
    assert "walk (9 at 24 a second), jump (10 at 60 a second)" in text
    assert ssdr.list_clips(tmp_path / "a.glb") == CLIPS
    assert ssdr.load_skinning(tmp_path / "a.glb").name == "horse"
    for name in ("a.pc2", "a.npy"):  # which have one rate
        err = refused(*line, tmp_path / name)
        assert "clips of one frame rate where vertices are stored" in err
        assert "walk at 24, jump at 60" in err


def test_a_clip_is_chosen_by_name(done, refused, rigged, tmp_path):
    out = tmp_path / "a.npz"
    line = ("decompose", rigged, "-o", out, *FAST)
    (warning,) = done(*line)["warnings"]
    assert "2 clips (walk, jump): walk is taken" in warning
    assert [c.name for c in ssdr.list_clips(out)] == ["walk"]
    assert done(*line, "--clip", "jump", "--clip", "jump")["warnings"] == []
    assert ssdr.list_clips(out) == JUMP
    assert "--clip: expected a clip of" in refused(*line, "--clip", "jmup")
    done("convert", rigged, out, "--clip", "jump", "--clip", "all")
    assert ssdr.list_clips(out) == CLIPS


def test_clips_of_one_name_are_told_apart_by_their_files(done, tmp_path):
    paths = []
    for k, stem in enumerate(("trot", "run")):
        rate = (24, 60)[k]
        one = animated().select(k)
        one = dataclasses.replace(one, clips=[Clip("mixamo", 0, 9 + k, rate)], fps=rate)
        paths.append(tmp_path / f"{stem}.glb")
        ssdr.save(one, paths[-1])
    done("decompose", *paths, "-o", tmp_path / "a.glb", *FAST)
    clips = ssdr.list_clips(tmp_path / "a.glb")
    assert [(c.name, c.fps) for c in clips] == [("trot", 24.0), ("run", 60.0)]


def test_files_of_other_meshes_are_refused_by_name(refused, files, clip, tmp_path):
    walk = ssdr.load(files[0])
    ssdr.save(dataclasses.replace(walk, faces=walk.faces[::-1]), tmp_path / "turned.npz")
    for other, text in (
        (clip, "clip.npz: expected the 44 vertices of"),
        (tmp_path / "turned.npz", "turned.npz: expected the triangles of"),
    ):
        assert text in refused("decompose", files[0], other, "-o", tmp_path / "a.glb", *FAST)


def test_vertices_are_welded_where_they_coincide_in_every_clip(done, tmp_path):
    vertices = np.zeros((4, 4, 3))
    vertices[:, 1:3, 0] = 1
    vertices[:, 3, 1] = np.arange(1, 5)
    vertices[3, 2, 2] = 1  # the seam opens in the second clip alone
    for name, part in (("a", vertices[:2]), ("b", vertices[2:])):
        ssdr.save(MeshSequence(part, [[0, 1, 3], [0, 2, 3]]), tmp_path / f"{name}.npz")
    for names, count in (("a", 3), ("ab", 4)):
        paths = [tmp_path / f"{name}.npz" for name in names]
        out = tmp_path / f"model_{names}.npz"
        done("decompose", *paths, "-o", out, "--read", "weld=true", "-b", 1, "-e", "fast")
        assert ssdr.load_skinning(out).n_vertices == count


def test_one_frame_has_no_motion(refused, wave, tmp_path):
    ssdr.save(wave, tmp_path / "frame_%02d.obj")
    err = refused("decompose", tmp_path / "frame_00.obj", "-o", tmp_path / "a.npz", *FAST)
    assert "(no motion: did you mean frame_*.obj?)" in err
    ssdr.save(tube(frames=1), tmp_path / "statue.glb")
    err = refused("decompose", tmp_path / "statue.glb", "-o", tmp_path / "a.npz", *FAST)
    assert "statue.glb (no motion)" in err


@pytest.mark.parametrize("command", ["info", "convert", "render", "decompose", "compare"])
def test_a_mistyped_option_of_the_format_is_refused(refused, rigged, tmp_path, command):
    rest = {
        "convert": (tmp_path / "o.npz",),
        "render": ("-o", tmp_path / "o.png"),
        "decompose": ("-o", tmp_path / "o.npz", *FAST),
        "compare": (rigged,),
    }.get(command, ())
    err = refused(command, rigged, *rest, "--read", "anim=1")
    assert (
        "--read: expected one of folder, fps, joints_alone, max_bytes, meshes, scale, units, up, "
        in err
    )
    assert "got anim" in err
    assert not list(tmp_path.glob("o.*"))


def test_options_go_to_the_files_that_know_them(run, done, refused, rigged, files, tmp_path):
    (tmp_path / "jump.faces.npy").rename(tmp_path / "f.npy")
    line = ("compare", rigged, files[1], "--clip", "jump", "--no-sted", "--no-hausdorff")
    refused(*line)
    faces = f"faces={tmp_path / 'f.npy'}"
    assert done(*line, "--read", faces)["rmse"] < 1e-6
    for name, expected in (("B", 0), ("npy", 0), ("A", 2), ("obj", 2), ("C", 2)):
        assert run(*line, "--read", f"{name}:{faces}")[0] == expected, name
    # Both are glTF: the letter says which.
    same, b = ("compare", rigged, rigged), ("--read", "B:scale=0.5")
    assert done(*same, "--read", "A:scale=0.5", *b)["rmse"] == 0
    assert done(*same, *b)["rmse"] > 0.01


def test_info_lists_the_clips_of_a_file(run, done, refused, rigged, files):
    assert "walk (9 at 24 a second), jump (10 at 60 a second)" in run("info", rigged)[1]
    document = done("info", rigged)
    walk = {"name": "walk", "start": 0, "stop": 9, "fps": 24.0, "frames": 9, "duration": 0.375}
    assert document["clips"][0] == walk
    assert (document["name"], document["frames"]) == ("horse", 19)
    assert document["duration"] == pytest.approx(0.375 + 10 / 60)
    assert [c["name"] for c in done("info", rigged, "--clip", "jump")["clips"]] == ["jump"]
    assert done("info", files[0])["clips"] == [walk]
    assert "--clip: expected one of walk, jump" in refused("info", rigged, "--clip", "run")


def test_vertices_are_those_of_one_clip(done, refused, rigged, tmp_path):
    out = tmp_path / "a.npz"
    line = ("convert", rigged, out, "--bake")
    assert "walk is taken" in done(*line)["warnings"][0]
    assert len(ssdr.load(out)) == 9
    assert done(*line, "--clip", "jump")["warnings"] == []
    assert len(ssdr.load(out)) == 10
    err = refused(*line, "--clip", "all")
    assert "one clip where vertices are read, of walk, jump" in err
    assert "one frame rate" in refused("convert", rigged, tmp_path / "c.pc2")
    assert not list(tmp_path.glob("c.*"))


def test_compare_walks_through_the_clips(run, done, refused, rigged, clip, tmp_path):
    model = animated()
    moved = model.transforms.copy()
    moved[9:, ..., 2, 3] += 0.5
    other = tmp_path / "b.npz"
    ssdr.save(dataclasses.replace(model, transforms=moved), other)
    document = done("compare", rigged, other)
    walk, jump = document["clips"]
    assert (walk["name"], jump["name"]) == ("walk", "jump")
    assert walk["rmse"] < 1e-6
    assert jump["rmse"] == pytest.approx(0.5, rel=1e-5)
    assert document["rmse"] == pytest.approx(0.5 * np.sqrt(10 / 19), rel=1e-5)
    _, out, _ = run("compare", rigged, other)
    assert "walk: 9 frames" in out
    assert "all clips: 19 frames" in out
    assert done("compare", rigged, other, "--clip", "walk")["rmse"] < 1e-6
    ssdr.save(model.select("jump", "walk"), tmp_path / "c.npz")
    page = tmp_path / "page.html"
    assert done("compare", rigged, tmp_path / "c.npz", "-o", page)["rmse"] < 1e-6
    held = Held(page.read_text(encoding="utf-8"))
    assert held.document["error"]["max"] < 1e-5
    assert [c["name"] for c in held.document["clips"]] == ["walk", "jump"]
    done("compare", rigged, other, "--clip", "jump", "-o", page, "-f")
    held = Held(page.read_text(encoding="utf-8"))
    assert held.document["error"]["mean"] == pytest.approx([0.5] * 10, rel=1e-5)
    renamed = [CLIPS[0], dataclasses.replace(CLIPS[1], name="run")]
    ssdr.save(dataclasses.replace(model, clips=renamed), tmp_path / "d.npz")
    assert "the clips of A, jump too" in refused("compare", rigged, tmp_path / "d.npz")
    assert "--clip: expected one of sheet" in refused("compare", clip, clip, "--clip", "walk")
    done("compare", clip, clip, "--clip", "sheet")


def test_render_draws_a_clip(done, refused, rigged, files, tmp_path):
    small = ("--width", 300)
    done("render", rigged, "-o", tmp_path / "a.png", "--clip", "walk", "-r", files[0], *small)
    done("render", rigged, "-o", tmp_path / "b.png", "-r", rigged, "--frames", 2, *small)
    film = tmp_path / "c.gif"
    err = refused("render", rigged, "-o", film)
    assert "one frame rate, for a film" in err
    assert "walk at 24, jump at 60" in err
    done("render", rigged, "-o", film, "--clip", "jump", "--frames", "0,5", "--width", 64)


def test_a_mesh_without_a_skin_may_have_clips(done, tmp_path):
    """Morph targets and nodes move it: a model with shapes."""
    source = make_asset(tmp_path / "a.gltf")
    assert [c["name"] for c in done("info", source)["clips"]] == ["Dance", "Spin"]
    converted = done("convert", source, tmp_path / "b.npz")
    assert [c["name"] for c in converted["clips"]] == ["Dance", "Spin"]
    done("convert", source, tmp_path / "c.npz", "--clip", "Spin")
    spin = ssdr.load(tmp_path / "c.npz")
    assert spin.clip == "Spin"
    truth = ssdr.load(source, clip="Spin").vertices
    np.testing.assert_allclose(spin.vertices, truth, atol=1e-6 * np.ptp(truth))


@pytest.mark.parametrize("suffix", ["glb", "usdc", "npz"])
def test_skinned_inputs_take_the_frame_rate_that_is_asked_for(done, refused, tmp_path, suffix):
    if suffix == "usdc":
        pytest.importorskip("pxr")
    model = animated()
    source = tmp_path / f"rigged.{suffix}"
    ssdr.save(model, source)
    out = tmp_path / "slower.glb"
    # A file with times lasts as long as before; frames alone follow each other more slowly.
    counts = [9, 10] if suffix == "npz" else [5, 2]
    slower = "--read", "fps=12"
    for document in (done("convert", source, out, *slower), done("info", source, *slower)):
        rates = [(c["fps"], c["frames"]) for c in document["clips"]]
        assert rates == [(12.0, counts[0]), (12.0, counts[1])]
    back = ssdr.load_skinning(out)
    picked = np.arange(19) if suffix == "npz" else [0, 2, 4, 6, 8, 9, 14]
    assert largest_distance(back.skin(), model.skin(picked)) < 1e-5
    assert ssdr.list_clips(source, fps=12) == back.clips
    # Clips of several rates make no film, unless all get one.
    film = tmp_path / "film.gif"
    line = ("render", source, "-o", film, "--width", 64)
    assert "of one frame rate" in refused(*line)
    done(*line, *slower)
    with Image.open(film) as picture:
        assert picture.n_frames <= sum(counts)
