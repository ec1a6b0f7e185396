"""Outputs checked before the work; warnings, sizes and options in words."""

from __future__ import annotations

import errno
import importlib.util
import json
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

import ssdr
from helpers.command import fake_decompose
from ssdr.cli.output import size_text, write_options
from ssdr.cli.progress import describe


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


def test_words_for_sizes_options_and_progress():
    assert [size_text(n) for n in (999, 1500, 2.5e6, 3e9)] == [
        "999 bytes",
        "1.5 kB",
        "2.5 MB",
        "3 GB",
    ]
    pairs = ["a=1", "glb:b=x", ".npz:c=true"]
    assert write_options(pairs, Path("m.GLB")) == {"a": 1, "b": "x"}
    assert write_options(pairs, Path("m.npz")) == {"a": 1, "c": True}
    progress = SimpleNamespace(rmse=float("nan"), elapsed=12.2, time_left=130.0)
    assert describe(progress) == "13 s, 2 min 10 s left"


def test_what_a_format_refuses_is_refused_before_the_work(run, clip, wave, tmp_path, monkeypatch):
    """One file for many frames, an option's value: it came after hours of solving."""

    def never(*_, **__):
        raise AssertionError("the work has started")

    monkeypatch.setitem(vars(ssdr), "decompose", never)
    good = tmp_path / "good.npz"
    for arguments, text in (
        (["-o", tmp_path / "x.obj"], "one number such as %04d in the name, for 4 files"),
        (["-o", tmp_path / "x.ply"], "one number such as %04d"),
        (["-o", tmp_path / "x.glb", "--write", "up=q"], "up: expected"),
        (["-o", tmp_path / "x.glb", "--write", "influences=0"], "influences: expected"),
        (["-o", tmp_path / "x.pc2", "--write", "unweld=true"], "unweld: expected"),
        (["-o", tmp_path / ("n" * 252 + ".npz")], "File name too long"),
        (["-o", good, "--checkpoint", tmp_path / ("n" * 252 + ".npz")], "File name too long"),
        (["-o", good, "--picture", tmp_path / ("n" * 252 + ".png")], "File name too long"),
        (["-o", good, "--checkpoint", good], "--checkpoint: expected each file once"),
        (["-o", good, "--checkpoint", tmp_path / "." / "good.npz"], "each file once"),
        (["-o", tmp_path / "a.glb", "-o", tmp_path / "a.state.npz"], "each file once"),
    ):
        code, out, err = run("decompose", clip, "-b", 2, *arguments)
        assert (code, out) == (2, ""), (arguments, err)
        assert text in err
    assert [p.name for p in tmp_path.iterdir()] == ["clip.npz"]


def test_a_folder_that_takes_no_file_is_refused_before_the_work(run, clip, tmp_path, monkeypatch):
    """Not every such folder says so by its permissions: one without inodes left does not."""

    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(ssdr, "load", lambda *_, **__: pytest.fail("the work has started"))
    monkeypatch.setattr(Path, "touch", full)
    code, out, err = run("decompose", clip, "-b", 2, "-o", tmp_path / "a.npz")
    assert (code, out) == (2, "")
    assert "--output: expected a file in a folder that can be written to" in err
    assert "(No space left on device)" in err


def test_a_file_beside_the_output_is_not_overwritten(run, clip, tmp_path):
    """glTF's .bin and NumPy's .faces.npy were."""
    for name, beside in (("a.gltf", "a.bin"), ("b.npy", "b.faces.npy")):
        (tmp_path / beside).write_bytes(b"precious")
        code, _, err = run("decompose", clip, "-b", 2, "-o", tmp_path / name)
        assert code == 2
        assert f"{tmp_path / beside}, which exists" in err
        assert (tmp_path / beside).read_bytes() == b"precious"
