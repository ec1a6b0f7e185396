"""The command: what it checks beforehand, prints, writes and returns."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import os
import shlex
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

import ssdr
from ssdr import cli
from ssdr.cli.output import size_text, write_options
from ssdr.cli.progress import describe

ROOT = Path(__file__).parents[2]


def model_of(sequence, bones=2, influences=4):
    """Bones at rest, all vertices on the first of them."""
    n = sequence.n_vertices
    transforms = np.zeros((sequence.n_frames, bones, 3, 4))
    transforms[..., :3] = np.eye(3)
    weights = np.zeros((n, influences))
    weights[:, 0] = 1
    return ssdr.Skinning(
        np.asarray(sequence.vertices[0], dtype=np.float64),
        np.zeros((n, influences), dtype=int),
        weights,
        transforms,
        faces=sequence.faces,
        fps=sequence.fps,
        surface=sequence.surface,
        vertex_map=sequence.vertex_map,
    )


class FakeState:
    def __init__(self, steps):
        self.steps = steps

    def save(self, path):
        np.savez(path, steps=self.steps)

    @classmethod
    def load(cls, path):
        with np.load(path, allow_pickle=False) as file:
            return cls(int(file["steps"]))


def fake_decompose(sequence, *, bones, influences, callback, resume, steps=3, pause=0.0, **options):
    """Keeps the solver's contract with the command, and takes as long as it is told."""
    fake_decompose.options = options
    began = time.perf_counter()
    step = resume.steps if resume is not None else 0
    reason = "converged"
    while step < steps:
        step += 1
        elapsed = time.perf_counter() - began
        progress = SimpleNamespace(
            phase="alternate", iteration=step, elapsed=elapsed, rmse=1.0 / step,
            fraction=step / steps, time_left=pause * (steps - step),
        )  # fmt: skip
        if callback(progress):
            reason = "cancelled"
            break
        if pause > 1:
            sys.stderr.write("asleep\n")
        time.sleep(pause)
    skinning = model_of(sequence, bones, influences)
    if options.get("checkpoint") is not None:
        FakeState(step).save(options["checkpoint"])
    return SimpleNamespace(
        skinning=skinning,
        rmse=0.25,
        converged=reason == "converged",
        stop_reason=reason,
        history=(SimpleNamespace(iteration=step, elapsed=1.0, rmse=0.25, phase="alternate"),),
        state=FakeState(step),
        compile_seconds=0.0,
    )


@pytest.fixture
def faked(monkeypatch):
    # Into the dictionary: the names are lazy, and setattr would import the solver.
    monkeypatch.setitem(vars(ssdr), "decompose", fake_decompose)
    monkeypatch.setitem(vars(ssdr), "SolverState", FakeState)


@pytest.fixture
def run(capsys):
    """Run the command in this process; exit code, stdout and stderr."""

    def call(*arguments):
        code = cli.main([str(a) for a in arguments])
        out, err = capsys.readouterr()
        return code, out, err

    return call


@pytest.fixture
def clip(wave, tmp_path):
    path = tmp_path / "clip.npz"
    ssdr.save(wave, path)
    return path


def test_help_version_and_usage(run):
    code, out, _ = run("--help")
    assert code == 0
    for name in ("decompose", "info", "compare", "convert", "render", "Exit codes"):
        assert name in out
    assert run("--version")[:2] == (0, f"ssdr {ssdr.__version__}\n")
    code, out, err = run()
    assert (code, out) == (2, "")
    assert err.startswith("Usage: ssdr")
    code, out, err = run("decompose", "a.npz", "--bones", "0", "-o", "b.npz")
    assert (code, out) == (2, "")
    assert "--bones" in err
    code, _, err = run("decompose", "a.npz", "-b", "1", "-o", "b.npz", "--bone-model", "rubber")
    assert code == 2
    assert "'rigid'" in err
    assert "'affine'" in err
    assert "Traceback" not in err


def test_what_a_tolerance_bounds_needs_one(run, clip, tmp_path):
    code, out, err = run("decompose", clip, "-o", tmp_path / "a.npz", "--bones", 2,
                         "--tolerance-of", "max")  # fmt: skip
    assert (code, out) == (2, "")
    assert "tolerance_of" in err
    assert not (tmp_path / "a.npz").exists()


def test_decompose_writes_all_outputs_and_tells_json(faked, run, clip, wave, tmp_path):
    outputs = [tmp_path / "a.npz", tmp_path / "b.pc2", tmp_path / "w.csv"]
    flags = [f for o in outputs for f in ("-o", o)]
    picture, state = tmp_path / "sheet.png", tmp_path / "end.npz"
    code, out, err = run(
        "decompose", clip, *flags, "--bones", 3, "--influences", 2, "--picture", picture,
        "--checkpoint", state, "--time-limit", 9, "--seed", 5, "--effort", "fast", "--json",
    )  # fmt: skip
    assert code == 0, err
    document = json.loads(out)
    assert document["bones"] == 3
    assert document["influences"] == 2
    assert document["rmse"] == 0.25
    assert document["E"] == pytest.approx(250 / np.sqrt(3))
    assert document["rmse_percent"] == pytest.approx(25 / wave.diagonal())
    assert document["stop_reason"] == "converged"
    assert [o["path"] for o in document["outputs"]] == [str(o) for o in outputs]
    assert all(o["bytes"] == Path(o["path"]).stat().st_size for o in document["outputs"])
    assert fake_decompose.options == {
        "effort": "fast", "bone_model": "rigid", "rng": 5, "time_limit": 9.0,
        "max_iterations": None, "smoothness": 0.0, "checkpoint": state,
    }  # fmt: skip
    assert ssdr.load_skinning(outputs[0]).n_bones == 3
    assert FakeState.load(state).steps == 3
    with Image.open(picture) as image:
        assert image.width == 1600
    assert err == ""


def test_decompose_prints_a_table_and_plain_progress(faked, run, clip, tmp_path):
    code, out, err = run("decompose", clip, "-o", tmp_path / "a.npz", "-b", 2)
    assert code == 0
    for text in ("RMSE", "% of the diagonal", "E ", "converged", "a.npz", "2 bones"):
        assert text in out
    assert "alternate" in err
    assert "RMSE 1" in err
    code, out, err = run("decompose", clip, "-o", tmp_path / "b.npz", "-b", 2, "--quiet")
    assert (code, out, err) == (0, "", "")


def test_weld_travels_to_the_model(faked, run, seam, tmp_path):
    ssdr.save(seam, tmp_path / "seam.npz")
    code, _, err = run(
        "decompose", tmp_path / "seam.npz", "-o", tmp_path / "a.npz", "-b", 1, "--weld",
        "--picture", tmp_path / "a.png", "-q",
    )  # fmt: skip
    assert code == 0, err
    model = ssdr.load_skinning(tmp_path / "a.npz")
    assert model.n_vertices == 15
    assert len(model.vertex_map) == seam.n_vertices


def test_bad_outputs_are_found_before_the_work(run, clip, tmp_path, monkeypatch):
    def never(*_, **__):
        raise AssertionError("the work has started")

    monkeypatch.setattr(ssdr, "load", never)
    taken = tmp_path / "taken.npz"
    taken.write_bytes(b"precious")
    good = tmp_path / "good.npz"
    for arguments, text in (
        (["-o", tmp_path / "a.xyz"], "known suffix"),
        (["-o", tmp_path / "a.abc"], "can be written"),
        (["-o", tmp_path / "a.glb", "--write", "gbl:up=z"], "suffix of a format"),
        (["-o", tmp_path / "a.glb", "-b", 9, "-k", 9], "at most 8"),
        (["-o", tmp_path / "no" / "a.npz"], "folder that exists"),
        (["-o", taken], "--force overwrites"),
        (["-o", clip, "--force"], "another file than the input"),
        (["-o", good, "-o", good], "each file once"),
        (["-o", good, "--write", "colour=red"], "colour"),
        (["-o", good, "--write", "red"], "KEY=VALUE"),
        (["-o", good, "--picture", taken], "not the name of a picture"),
        (["-o", good, "--up", "w", "--picture", tmp_path / "a.png"], "x, y or z"),
        (["-o", good, "--checkpoint", tmp_path / "state.txt"], "ending in .npz"),
        (["-o", good, "--checkpoint", taken], "--force overwrites"),
        (["-o", good, "--time-limit", "nan"], "--time-limit"),
        (["-o", good, "--resume", tmp_path / "gone.npz"], "no such file"),
    ):
        code, out, err = run("decompose", clip, "-b", 2, *arguments)
        assert code == (3 if "picture" in text else 2), (arguments, err)
        assert out == ""
        assert text in err
        assert len(err.strip().splitlines()) == 1
    assert taken.read_bytes() == b"precious"
    assert not good.exists()


def test_a_missing_package_is_named_before_the_work(run, clip, tmp_path, monkeypatch):
    real = importlib.util.find_spec
    monkeypatch.delenv("SSDR_BLENDER_PYTHON", raising=False)
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if name == "bpy" else real(name, *a)
    )
    code, out, err = run("decompose", clip, "-b", 2, "-o", tmp_path / "a.fbx")
    assert (code, out) == (4, "")
    assert 'pip install "ssdr[blender]"' in err


def test_exit_codes_and_json_of_errors(run, tmp_path, monkeypatch):
    bad = tmp_path / "bad.npz"
    bad.write_bytes(b"not a zip archive")
    code, out, err = run("info", bad, "--json")
    assert (code, err) == (3, "")
    document = json.loads(out)
    assert document["kind"] == "FormatError"
    assert document["exit_code"] == 3
    assert "bad.npz" in document["error"]
    code, out, err = run("info", tmp_path / "none.npz")
    assert (code, out) == (2, "")
    assert err == f"ssdr: error: {tmp_path / 'none.npz'}: no such file\n"

    def fall(*_, **__):
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("ssdr.cli.inspecting.read_any", fall)
    code, out, err = run("info", bad)
    assert (code, out) == (1, "")
    assert "unexpected ZeroDivisionError: oh" in err
    assert "Traceback" not in err

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("ssdr.cli.inspecting.read_any", interrupt)
    assert run("info", bad)[0] == 130


def test_the_result_survives_a_disk_that_fails(faked, run, clip, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(ssdr, "save", full)
    code, _, err = run("decompose", clip, "-b", 2, "-o", tmp_path / "a.npz")
    assert code == 1
    assert "No space left" in err
    assert FakeState.load(tmp_path / "a.state.npz").steps == 3


def test_warnings_are_lines_and_part_of_the_json(faked, run, clip, tmp_path, monkeypatch):
    def warn(*args, **kwargs):
        import warnings

        warnings.warn("fewer bones\nwould do", ssdr.SsdrWarning, stacklevel=2)
        return fake_decompose(*args, **kwargs)

    monkeypatch.setattr(ssdr, "decompose", warn)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("warnings.filters", [])
        code, out, err = run("decompose", clip, "-b", 2, "-o", tmp_path / "a.npz", "--json")
    assert code == 0
    assert json.loads(out)["warnings"] == ["fewer bones would do"]
    assert err == "ssdr: warning: fewer bones would do\n"


def test_info_counts_what_is_there(run, tmp_path):
    # Two triangles sharing an edge, a degenerate one, a loose vertex and a doubled one.
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [5, 5, 5], [0, 0, 0.0]])
    faces = [[0, 1, 2], [0, 2, 3], [1, 1, 2]]
    clip = ssdr.MeshSequence(np.stack([points, points + 1]), faces, 10.0)
    ssdr.save(clip, tmp_path / "a.npz")
    code, out, _ = run("info", tmp_path / "a.npz", "--json")
    assert code == 0
    d = json.loads(out)
    assert (d["kind"], d["frames"], d["vertices"], d["triangles"]) == ("sequence", 2, 6, 3)
    assert (d["components"], d["loose_vertices"]) == (1, 2)
    assert (d["degenerate_triangles"], d["seams"]) == (1, 1)
    assert d["duration"] == pytest.approx(0.2)
    assert d["diagonal"] == pytest.approx(np.sqrt(75))
    assert d["memory"] == 2 * 6 * 3 * 8
    out = run("info", tmp_path / "a.npz")[1]
    assert "--weld" in out
    assert "1 degenerate triangles" in out


def test_info_of_a_skinning(run, wave, tmp_path):
    model = model_of(wave, bones=3)
    weights = model.weights.copy()
    weights[0, :2] = 0.5
    joints = model.joints.copy()
    joints[0, 1] = 1
    model = dataclasses.replace(model, weights=weights, joints=joints)
    ssdr.save(model, tmp_path / "m.npz")
    d = json.loads(run("info", tmp_path / "m.npz", "--json")[1])
    assert d["kind"] == "skinning"
    assert d["influence_histogram"] == [11, 1, 0, 0]
    assert d["bones_without_vertices"] == 1
    assert d["orthonormality_error"] == 0
    assert "move nothing" in run("info", tmp_path / "m.npz")[1]


def test_convert_keeps_a_skinning_or_bakes_it(run, wave, tmp_path):
    model = model_of(wave)
    ssdr.save(model, tmp_path / "m.npz")
    code, out, err = run("convert", tmp_path / "m.npz", tmp_path / "n.npz", "--json")
    assert code == 0, err
    assert json.loads(out)["kind"] == "skinning"
    np.testing.assert_array_equal(
        ssdr.load_skinning(tmp_path / "n.npz").transforms, model.transforms
    )
    assert run("convert", tmp_path / "m.npz", tmp_path / "n.npz")[0] == 2
    flags = ("--bake", "--force", "--write", "npz:compress=false", "--write", "glb:weights=uint8")
    assert run("convert", tmp_path / "m.npz", tmp_path / "n.npz", *flags)[0] == 0
    with pytest.raises(ssdr.FormatError):
        ssdr.load_skinning(tmp_path / "n.npz")
    np.testing.assert_array_equal(ssdr.load(tmp_path / "n.npz").vertices, model.skin())
    code, out, err = run("convert", tmp_path / "n.npz", tmp_path / "w.csv")
    assert code == 2
    assert "sequence of vertices" in err


def test_render_sheet_frame_and_film(run, clip, wave, tmp_path):
    ssdr.save(model_of(wave), tmp_path / "m.npz")
    sheet, one, film = (tmp_path / n for n in ("sheet.png", "one.jpg", "film.gif"))
    code, _, err = run(
        "render", tmp_path / "m.npz", "-r", clip, "-o", sheet, "--width", 500, "--frames", "0,-1"
    )
    assert code == 0, err
    assert run("render", clip, "-o", one, "--frame", 1, "--width", 80, "--parallel")[0] == 0
    flags = ("-s", "weights", "-s", "bones", "--width", 40, "-q")
    assert run("render", tmp_path / "m.npz", "-r", clip, "-o", film, *flags) == (0, "", "")
    with Image.open(sheet) as a, Image.open(one) as b, Image.open(film) as c:
        assert a.width == 500
        assert b.size == (80, 80)
        assert (c.size, c.n_frames) == ((120, 40), 4)
    assert run("render", clip, "-o", tmp_path / "x.png", "--style", "bones")[0] == 2
    assert run("render", clip, "-o", tmp_path / "x.png", "--frames", "many")[0] == 2
    assert not (tmp_path / "x.png").exists()


def test_compare_measures(run, clip, wave, tmp_path):
    moved = dataclasses.replace(wave, vertices=wave.vertices + np.float32([0, 0, 0.5]))
    ssdr.save(moved, tmp_path / "b.npz")
    code, out, err = run("compare", clip, tmp_path / "b.npz", "--json", "--no-sted")
    assert code == 0, err
    assert json.loads(out)["rmse"] == pytest.approx(0.5)
    code, out, _ = run("compare", clip, tmp_path / "b.npz", "--no-hausdorff", "--no-sted")
    assert code == 0
    assert "0.5" in out


def test_compare_spreads_a_welded_model_back(run, seam, tmp_path):
    welded, _ = seam.weld()
    ssdr.save(seam, tmp_path / "a.npz")
    ssdr.save(welded, tmp_path / "b.npz")
    for pair in (("a.npz", "b.npz"), ("b.npz", "a.npz")):
        code, out, err = run("compare", *(tmp_path / p for p in pair), "--json")
        assert code == 0, err
        assert json.loads(out)["rmse"] == 0
    other = ssdr.MeshSequence(seam.vertices[:, :7])
    ssdr.save(other, tmp_path / "c.npz")
    code, _, err = run("compare", tmp_path / "a.npz", tmp_path / "c.npz")
    assert code == 2
    assert "--weld" in err


def test_words_for_sizes_options_and_progress():
    assert [size_text(n) for n in (999, 1500, 2.5e6, 3e9)] == [
        "999 bytes", "1.5 kB", "2.5 MB", "3 GB",
    ]  # fmt: skip
    pairs = ["a=1", "glb:b=x", ".npz:c=true"]
    assert write_options(pairs, Path("m.GLB")) == {"a": 1, "b": "x"}
    assert write_options(pairs, Path("m.npz")) == {"a": 1, "c": True}
    progress = SimpleNamespace(rmse=float("nan"), elapsed=12.2, time_left=130.0)
    assert describe(progress) == "13 s, 2 min 10 s left"


FAKED = textwrap.dedent(
    """
    import functools, sys
    sys.path.insert(0, {tests!r})
    import ssdr, test_cli
    ssdr.decompose = functools.partial(test_cli.fake_decompose, steps={steps}, pause=0.02)
    ssdr.SolverState = test_cli.FakeState
    sys.exit(ssdr.cli.main())
    """
)


def start(arguments, **options):
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    return subprocess.Popen(
        [sys.executable, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        **options,
    )


def wait_for(process, text):
    """Read stderr until a line holds the text."""
    seen = ""
    for line in process.stderr:
        seen += line
        if text in line:
            return
    raise AssertionError(f"{text!r} never came: {seen}")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_leaves_a_state_to_resume_from(number, clip, tmp_path):
    def faked(steps):
        return ["-c", FAKED.format(tests=str(Path(__file__).parent), steps=steps)]

    out = tmp_path / "a.npz"
    work = ["decompose", clip, "-o", out, "--bones", 2]
    process = start([*faked(100_000), *work])
    wait_for(process, "alternate")
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert not out.exists()
    state = tmp_path / "a.state.npz"
    assert FakeState.load(state).steps >= 1
    command = shlex.split(err.strip().splitlines()[-1].partition("go on with: ")[2])
    assert command == ["ssdr", *map(str, work), "--resume", str(state)]
    process = start([*faked(FakeState.load(state).steps + 2), *command[1:]])
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert out.exists()


def test_second_ctrl_c_quits_at_once(clip, tmp_path):
    code = FAKED.format(tests=str(Path(__file__).parent), steps=100_000).replace("0.02", "60")
    process = start(["-c", code, "decompose", clip, "-o", tmp_path / "a.npz", "--bones", 2])
    wait_for(process, "asleep")
    process.send_signal(signal.SIGINT)
    wait_for(process, "again to quit")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=20)
    assert process.returncode == 130
    assert [p.name for p in tmp_path.iterdir()] == ["clip.npz"]


def test_a_process_of_its_own_without_a_display(clip, tmp_path):
    process = start(["-m", "ssdr", "render", clip, "-o", tmp_path / "a.png", "--width", 300])
    out, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, "")
    assert "a.png" in out
    process = start(["-m", "ssdr", "info", tmp_path / "none.npz"])
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, "")
    assert "Traceback" not in err


@pytest.mark.slow
def test_the_real_solver_is_interrupted_and_resumed(tmp_path):
    """The whole way on the sample: two formats, a picture, Ctrl-C, resume."""
    clip = ssdr.samples.path("dancer_small")
    out, model = tmp_path / "a.glb", tmp_path / "b.npz"
    work = ["decompose", clip, "-o", out, "-o", model, "-b", 12, "--effort", "best"]
    process = start(["-m", "ssdr", *work])
    wait_for(process, "RMSE")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert not out.exists()
    last = err.strip().splitlines()[-1]
    before = float(last.partition("RMSE ")[2].partition(";")[0])
    command = shlex.split(last.partition("go on with: ")[2])
    assert command[-1] == str(tmp_path / "a.state.npz")
    more = ("--json", "--time-limit", "4", "--picture", str(tmp_path / "a.png"))
    process = start(["-m", "ssdr", *command[1:], *more])
    text, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    document = json.loads(text)
    sequence = ssdr.load(clip)
    back = ssdr.load_skinning(model)
    assert (back.n_bones, back.n_influences) == (12, 4)
    gap = back.skin().astype(np.float64) - sequence.vertices
    rmse = np.sqrt((gap**2).sum() / gap[..., 0].size)
    assert document["rmse"] == pytest.approx(rmse, rel=1e-3)
    assert rmse <= before * (1 + 1e-3)
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.width == 1600
