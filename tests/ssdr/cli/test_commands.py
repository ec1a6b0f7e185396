"""Every command once: what it writes, its table and its JSON object."""

from __future__ import annotations

import dataclasses
import inspect
import io
import re
import sys

import numpy as np
import pytest
from PIL import Image

import ssdr
from helpers import trees
from helpers.command import fake_decompose, model_of, start
from helpers.glb import rebuild
from helpers.page import Held
from helpers.rig_model import largest_distance
from ssdr import cli
from ssdr.cli import app, files
from ssdr.cli.output import Output
from ssdr.cli.parameters import command
from ssdr.cli.shell import safe_streams

COMMANDS = ("decompose", "smallest", "info", "compare", "convert", "render", "view")
FAST = ("--bones", 3, "--effort", "fast")
QUICK = ("--no-sted", "--no-hausdorff")


def test_help_and_version(run):
    assert run("--version")[:2] == (0, f"ssdr {ssdr.__version__}\n")
    for arguments in ((), ("--help",)):
        code, out, _ = run(*arguments)
        assert code == 0
        assert all(name in out for name in (*COMMANDS, "Exit codes"))


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_shows_few_options_before_the_others_and_a_text_for_each(run, name):
    code, out, _ = run(name, "--help")
    first, more, _ = out.partition(" More ")
    assert (code, more) == (0, " More ")
    assert len(re.findall(r"^\W+(?!--help)--[\w-]+", first, re.MULTILINE)) <= 12
    made = command(app._COMMANDS[name])
    assert made.__doc__
    for parameter in inspect.signature(made).parameters.values():
        (info,) = parameter.annotation.__metadata__
        assert re.fullmatch(r"[A-Z.].*\.", info.help), (parameter.name, info.help)


def test_decompose_passes_options_and_writes_models_pages_and_pictures(faked, done, clip, wave):
    outputs = [clip.with_name(name) for name in ("a.npz", "b.pc2", "c.html", "d.png")]
    document = done(
        "decompose", clip, *(f for o in outputs for f in ("-o", o)), "--bones", 3, "-k", 2,
        "--checkpoint", clip.with_name("c.npz"), "--time-limit", 9, "--seed", 5,
        "--effort", "fast", "--normals", "False", "--smoothness", 0.1,
        "--rest-pose", "free", "--rest-frame", 2,
    )  # fmt: skip
    assert (document["bones"], document["influences"], document["rmse"]) == (3, 2, 0.25)
    assert document["rmse_percent"] == pytest.approx(25 / wave.diagonal())
    way = np.linalg.norm(wave.vertices - wave.vertices[0], axis=2).max()
    assert document["max_error_percent"] == pytest.approx(100 * way / wave.diagonal())
    assert [o["path"] for o in document["outputs"]] == [str(o) for o in outputs]
    assert [o["bytes"] for o in document["outputs"]] == [p.stat().st_size for p in outputs]
    assert fake_decompose.options == {
        "effort": "fast",
        "rest_pose": "free",
        "rest_frame": 2,
        "normals": False,
        "rig": None,
        "rng": 5,
        "time_limit": 9.0,
        "smoothness": 0.1,
        "checkpoint": clip.with_name("c.npz"),
    }
    held = Held(outputs[2].read_text(encoding="utf-8")).document
    assert held["title"] == "clip"
    with Image.open(outputs[3]) as image:
        assert image.width == 1600


@pytest.mark.parametrize(("word", "value"), [("0.05%", "0.05%"), ("2e-3", 0.002), ("true", None)])
def test_a_word_is_a_flag_a_number_or_a_share(faked, done, clip, word, value):
    done("decompose", clip, "-o", clip.with_name("a.npz"), *FAST, "--normals", word)
    assert fake_decompose.options.get("normals") == value


def test_the_table_tells_the_error_and_quiet_tells_nothing(faked, run, clip):
    code, out, err = run("decompose", clip, "-o", clip.with_name("a.npz"), "-b", 2)
    assert (code, err) == (0, "")
    for text in ("% of the motion, 0.25 in the mesh's units", "largest ", "converged", "2 bones"):
        assert text in out
    assert out.endswith(" kB\n")  # what rounding adds is far below the error
    metres = ("decompose", clip, "-o", clip.with_name("a.npz"), "-b", 2, "--units", 1)
    assert "% of the motion, 250 mm, " in run(*metres)[1]
    assert "<bool>" not in run("decompose", "--help")[1]
    quiet = ("decompose", clip, "-o", clip.with_name("b.npz"), "-b", 2, "--quiet")
    assert run(*quiet) == (0, "", "")


@pytest.mark.filterwarnings("ignore:.*no loss:ssdr.SsdrWarning")
def test_a_run_goes_on_from_a_model_or_keeps_a_rest_pose(faked, done, clip, wave):
    model, out = clip.with_name("model.npz"), clip.with_name("out.npz")
    ssdr.save(model_of(wave), model)
    line = ("decompose", clip, "-b", 2, "-o", out, "--start")
    # A run that was killed goes on from its checkpoint, and saves to it.
    done(*line, model, "--checkpoint", model)
    assert fake_decompose.options["start"].n_bones == 2
    done(*line, clip)
    np.testing.assert_array_equal(fake_decompose.options["start"].rest, wave.vertices[0])


def test_a_rig_is_kept_and_gets_bones(done, tmp_path):
    made, names = trees.skeleton(4, 16, seed=3), ("hips", "chest", "arm", "leg")
    ssdr.save(made.skinning(bone_names=names), tmp_path / "rig.npz")
    ssdr.save(ssdr.MeshSequence(made.wavy), tmp_path / "walk.npz")
    out = tmp_path / "out.npz"
    line = ("decompose", tmp_path / "walk.npz", "-o", out, "-e", "fast", "-k", 2, "--rig")
    done(*line, tmp_path / "rig.npz", "--extra-bones", 2)
    model = ssdr.load_skinning(out)
    assert model.names()[:4] == names
    assert model.n_bones == 6
    done(*line, tmp_path / "rig.npz", "--keep-weights")
    model = ssdr.load_skinning(out)
    np.testing.assert_allclose(model.rest, made.rest, atol=1e-6)
    kept = ssdr.load_skinning(tmp_path / "rig.npz").dense_weights()
    np.testing.assert_allclose(model.dense_weights(), kept, atol=1e-6)
    done(*line, tmp_path / "rig.npz", "--joints", "loose")
    assert np.array_equal(ssdr.load_skinning(out).parents, made.parents)
    done(*line, "rigid", "--bones", 4)
    assert ssdr.load_skinning(out).joint_gaps().max() < 1e-6


def walking_tree(rigged, path):
    model = ssdr.load_skinning(rigged).select("walk")
    tree = dataclasses.replace(model, parents=[-1, 0, 1], joint_positions=model.centroids())
    ssdr.save(tree, path, units=1, up="y")
    return tree


def test_joints_without_a_mesh_keep_their_motion(done, run, rigged, tmp_path, monkeypatch):
    model = walking_tree(rigged, tmp_path / "rig.glb")

    def without_mesh(document, _):
        del document["meshes"], document["skins"]
        for node in document["nodes"]:
            node.pop("mesh", None), node.pop("skin", None)

    rebuild(tmp_path / "rig.glb", tmp_path / "joints.glb", without_mesh)
    line = ("decompose", rigged, "--clip", "walk", "-o", tmp_path / "out.npz", "-e", "fast")
    done(*line, "--rig", tmp_path / "joints.glb")
    found = ssdr.load_skinning(tmp_path / "out.npz")
    assert found.parents.tolist() == [-1, 0, 1]
    assert ssdr.metrics.rmse(model, found) < 1e-5
    read = []

    def load_skinning(*given, **options):
        read.append(given)
        return ssdr.load_skinning(*given, **options)

    monkeypatch.setattr(files, "load_skinning", load_skinning)
    done(*line, "--fps", 12, "--rig", tmp_path / "joints.glb")
    assert read == [(tmp_path / "joints.glb",)]  # once, at the rate of the input
    code, _, err = run(*line, "--fps", 12, "--rig", tmp_path / "rig.glb", "--joints", "kept")
    assert (code, "--rig: expected joints that move in the 5 frames" in err) == (2, True), err


def test_a_rig_of_another_size_is_told(run, rigged, tmp_path):
    model = walking_tree(rigged, tmp_path / "rig.glb")
    large = ssdr.MeshSequence(100 * model.skin(), model.faces, model.fps)
    ssdr.save(large, tmp_path / "cm.npz")
    line = ("decompose", tmp_path / "cm.npz", "-o", tmp_path / "out.npz", "-e", "fast", "--rig")
    code, _, err = run(*line, tmp_path / "rig.glb")
    assert (code, "times as much: if their units differ" in err) == (0, True)
    assert re.search(r"the rig is [\d.]+ across, the mesh [\d.]+, [\d.]+ times", err)
    assert "across" not in run(*line, tmp_path / "rig.glb", "--units", 0.01)[2]


def test_a_rig_comes_into_the_space_of_the_input(done, rigged, tmp_path):
    model = ssdr.load_skinning(rigged)
    rig = dataclasses.replace(model, parents=[-1, 0, 1], joint_positions=model.centroids())
    ssdr.save(ssdr.io.in_space(rig, ssdr.Space(0.01, "z")), tmp_path / "rig.npz")
    line = ("decompose", rigged, "-o", tmp_path / "out.npz", "-e", "fast", "--clip", "walk")
    done(*line, "--rig", tmp_path / "rig.npz", "--keep-weights")
    found = ssdr.load_skinning(tmp_path / "out.npz")
    np.testing.assert_allclose(found.rest, rig.rest, atol=1e-5)


def test_clips_units_and_welding_reach_the_library(faked, run, done, rigged, seam, tmp_path):
    out = tmp_path / "out.glb"
    line = ("decompose", rigged, "-b", 2, "-o", out)
    (warning,) = done(*line)["warnings"]
    assert "2 clips (walk, jump): walk is taken" in warning
    assert done(*line, "--clip", "jump")["clips"][0]["name"] == "jump"
    ssdr.save(seam, tmp_path / "seam.npz")
    line = ("decompose", tmp_path / "seam.npz", "-b", 1, "-o", tmp_path / "out.npz", "--fps", 12)
    document = done(*line, "--weld", "--scale", 2, "--units", 0.01, "--up", "z")
    assert document["vertices"] == 15 < seam.n_vertices
    assert document["clips"][0]["fps"] == 12
    assert document["diagonal"] == pytest.approx(2 * seam.diagonal())


def test_smallest(run, done, rigged, tmp_path):
    line = ("smallest", rigged, "-o", tmp_path / "out.npz", "-e", "fast", "--clip", "jump")
    document = done(*line, "--tolerance", "0.8%")
    found, model = document["parsimony"], ssdr.load_skinning(tmp_path / "out.npz")
    assert found["held"] is True
    assert document["bones"] == model.n_bones <= 3
    assert found["bytes"] == ssdr.parsimony.size(model).total
    # A length; with too few bones, the closest model comes with a warning.
    code, out, err = run(*line, "--tolerance", found["tolerance"] / 100, "--bones", 1)
    assert code == 0
    assert "1 bones of at most 4 influences reach" in err
    assert "held: no" in out
    assert "bytes in an engine" in out


def test_info(run, done, rigged, tmp_path):
    model = ssdr.load_skinning(rigged)
    tree = dataclasses.replace(model, parents=[-1, 0, 1], joint_positions=model.centroids())
    ssdr.save(tree, tmp_path / "m.npz")
    d = done("info", tmp_path / "m.npz")
    assert (d["bones"], d["bones_without_vertices"]) == (3, 0)
    assert (d["hierarchy"]["joints"], d["hierarchy"]["depth"]) == (3, 3)
    assert "3 joints, 3 deep" in run("info", tmp_path / "m.npz")[1]
    # The last vertex lies on the first.
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [5, 5, 5], [0, 0, 0.0]])
    mesh = ssdr.MeshSequence(np.stack([points, points + 1]), [[0, 1, 2], [0, 2, 3], [1, 1, 2]], 10)
    ssdr.save(mesh, tmp_path / "a.npz")
    d = done("info", tmp_path / "a.npz")
    assert (d["kind"], d["frames"], d["vertices"], d["triangles"]) == ("sequence", 2, 6, 3)
    assert d["seams"] == 1
    assert "--weld merges them" in run("info", tmp_path / "a.npz")[1]
    code, out, _ = run("info", rigged, "--units", 0.0254, "--up", "z")
    assert code == 0
    assert "a skinning" in out
    assert "walk (9 at 24 a second), jump (10 at 60 a second)" in out
    assert "0.0254 m a unit, z up" in out
    assert [c["name"] for c in done("info", rigged, "--clip", "jump")["clips"]] == ["jump"]
    assert done("info", "sample:dancer_small")["input"] == str(ssdr.samples.path("dancer_small"))


def test_convert_keeps_a_skinning_or_bakes_it(done, run, rigged, tmp_path):
    out = tmp_path / "out.npz"
    assert done("convert", rigged, out, "--scale", 10)["kind"] == "skinning"
    model = ssdr.load_skinning(rigged)
    assert largest_distance(ssdr.load_skinning(out).skin(), 10 * model.skin()) < 1e-4
    assert done("convert", rigged, out, "--bake", "--clip", "jump")["kind"] == "sequence"
    assert len(ssdr.load(out)) == 10
    target = tmp_path / "rounded.glb"
    assert run("convert", rigged, target, "--weights", "uint8", "--template", "none", "-q")[0] == 0
    assert target.stat().st_size < rigged.stat().st_size
    np.save(tmp_path / "bare.npy", ssdr.load(out).vertices)
    assert done("convert", tmp_path / "bare.npy", out, "--faces", "none")["kind"] == "sequence"
    done("convert", out, tmp_path / "new" / "a_%02d.ply")
    assert len(ssdr.load(tmp_path / "new")) == 10


def test_compare_measures_the_clips_of_the_same_names_together(done, rigged, tmp_path):
    model = ssdr.load_skinning(rigged)
    moved = model.transforms.copy()
    moved[9:, ..., 2, 3] += 0.5
    moved = dataclasses.replace(model, transforms=moved)
    ssdr.save(moved.select("jump", "walk"), tmp_path / "b.npz")  # in another order
    line = ("compare", rigged, tmp_path / "b.npz", *QUICK)
    assert done(*line)["rmse"] == pytest.approx(0.5 * np.sqrt(10 / 19), rel=1e-5)
    assert done(*line, "--clip", "walk")["rmse"] < 1e-6
    assert done(*line, "--clip", "jump")["rmse"] == pytest.approx(0.5, rel=1e-5)
    ssdr.save(moved.select("jump"), tmp_path / "b.npz")  # its only clip
    assert done(*line, "--clip", "jump")["rmse"] == pytest.approx(0.5, rel=1e-5)


def test_compare_reads_a_welded_mesh_and_other_triangles(done, seam, tmp_path):
    welded, _ = seam.weld()
    paths = [tmp_path / f"{name}.npz" for name in ("seam", "welded", "turned")]
    turned = dataclasses.replace(model_of(seam), faces=seam.faces[::-1])
    for thing, path in zip((seam, welded, turned), paths, strict=True):
        ssdr.save(thing, path)
    for pair in (paths[:2], paths[1::-1]):
        assert done("compare", *pair, *QUICK)["rmse"] == 0
    done("compare", paths[0], paths[2], *QUICK)


def test_compare_hints_at_other_units_and_says_what_it_converts(done, rigged, clip, wave):
    other = clip.with_name("large.npz")
    ssdr.save(dataclasses.replace(wave, vertices=wave.vertices * np.float32(100)), other)
    (hint,) = done("compare", clip, other, *QUICK)["warnings"]
    assert "the diagonal of OTHER is about 100 times that of REFERENCE" in hint
    assert "--scale 0.01 brings OTHER to REFERENCE" in hint
    found = done("compare", clip, other, *QUICK, "--scale", 0.01)
    assert (found["warnings"], found["rmse"]) == ([], pytest.approx(0, abs=1e-6))
    model = ssdr.load_skinning(rigged)
    ssdr.save(ssdr.io.in_space(model, ssdr.Space(0.01, "z")), other)
    found = done("compare", rigged, other, *QUICK)
    assert found["rmse"] < 1e-5
    assert "both are taken to 1 m a unit, y up" in found["warnings"][0]


def test_render_sheet_frame_and_film(run, clip, wave, tmp_path):
    ssdr.save(model_of(wave), tmp_path / "m.npz")
    sheet, one, film = (tmp_path / n for n in ("sheet.png", "one.jpg", "film.gif"))
    line = ("render", tmp_path / "m.npz", "-r", clip, "-o")
    code, _, err = run(*line, sheet, "--width", 500, "--frames", "0,-1")
    assert code == 0, err
    assert run("render", clip, "-o", one, "--frame", 1, "--width", 80)[0] == 0
    assert run(*line, film, "-s", "weights", "-s", "bones", "--width", 40, "-q") == (0, "", "")
    with Image.open(sheet) as a, Image.open(one) as b, Image.open(film) as c:
        assert (a.width, b.size) == (500, (80, 80))
        assert (c.size, c.n_frames) == ((120, 40), 4)


def test_view_writes_a_page_or_opens_the_browser(run, done, clip, wave, tmp_path, monkeypatch):
    model, page = tmp_path / "m.npz", tmp_path / "page.html"
    ssdr.save(model_of(wave), model)
    found = done("view", model, clip, "-o", page, "--up", "z", "--title", "horse")
    assert (found["path"], found["bytes"]) == (str(page), page.stat().st_size)
    held = Held(page.read_text(encoding="utf-8")).document
    assert held["title"] == "horse"
    assert "clip.npz" in {name: note for name, _, note in held["figures"]}["RMSE"]
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    assert run("view", clip, "-q")[0] == 0
    assert opened[0].startswith("file:")


def test_log_and_threads_are_options_of_the_program(run, clip, monkeypatch):
    counts = []
    monkeypatch.setattr("ssdr.cli.app.set_threads", counts.append)
    line = ("decompose", clip, "-o", clip.with_name("a.npz"), *FAST)
    _, _, err = run("-vv", "--threads", 3, *line)
    assert counts == [3]
    # what the extension of Blender may follow
    assert re.search(r"DEBUG \S+ (.+), iteration \d+, rmse (\S+), (\d+) % done", err)
    assert run("info", clip)[2] == ""


def test_a_process_of_its_own_without_a_display(clip, tmp_path):
    process = start(["-m", "ssdr.cli", "render", clip, "-o", tmp_path / "a.png", "--width", 300])
    out, err = process.communicate(timeout=600)
    assert (process.returncode, err) == (0, "")
    assert "a.png" in out


class Terminal(io.TextIOWrapper):
    """A terminal that lacks most characters."""

    def __init__(self, shows=True):
        super().__init__(io.BytesIO(), "latin-1")
        self._shows = shows

    def isatty(self):
        return self._shows


@pytest.mark.parametrize(
    ("terminal", "options", "shown"),
    [(True, {}, True), (True, {"quiet": True}, False), (True, {"json": True}, False),
     (False, {}, False)],
)  # fmt: skip
def test_progress_is_shown_on_a_terminal_and_nowhere_else(terminal, options, shown, monkeypatch):
    stream = Terminal(terminal)
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    with safe_streams():
        output = Output(**options)
        with output.waiting("loading a[1].abc"):
            pass
        with output.progress_bar() as show:
            show("alternate", 0.5, "RMSE 1")
    stream.flush()
    text = stream.buffer.getvalue().decode("latin-1")
    for part in ("loading a[1].abc", "alternate", "50%", "RMSE 1"):
        assert (part in text) == shown


def test_the_shell_completes_commands_and_options(monkeypatch, capsys):
    def complete(words):
        variables = {"_SSDR_COMPLETE": "complete_bash", "COMP_WORDS": words}
        for key, value in (variables | {"COMP_CWORD": str(len(words.split()) - 1)}).items():
            monkeypatch.setenv(key, value)
        with pytest.raises(SystemExit):
            cli.main([])
        return capsys.readouterr().out

    commands = complete("ssdr dec")
    assert "decompose" in commands
    assert "convert" not in commands
    assert "--tolerance" in complete("ssdr smallest --to")
