"""Outputs that are checked before the work, and a model that survives outputs that fail."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest

import ssdr
from helpers.blender import no_blender
from helpers.command import fake_decompose
from helpers.disks import fill, small_files
from ssdr.cli.format_options import write_options


def test_bad_outputs_are_found_before_a_file_is_read(refused, never, clip, tmp_path, monkeypatch):
    monkeypatch.setattr("ssdr.io.load", never)
    good, long = tmp_path / "good.npz", "n" * 252
    for arguments, text in (
        (["-o", tmp_path / "a.xyz"], "known suffix"),
        (["-o", tmp_path / "a.glb", "--write", "gbl:weights=uint8"], "suffix of a format"),
        (["-o", tmp_path / "no" / "a.npz"], "folder that exists"),
        (["-o", tmp_path / "no" / "way" / "a_%02d.obj"], "folder that exists"),
        (["-o", clip / "a_%02d.obj"], "folder that exists"),
        (["-o", clip], "no input"),
        (["-o", good, "-o", good], "no other output"),
        (["-o", good, "--write", "red"], "KEY=VALUE"),
        (["-o", good, "-o", tmp_path / "a.png", "-o", tmp_path / "a.png"], "no other output"),
        (["-o", tmp_path / "a.png"], "a file for the model, too"),
        (["-o", good, "--checkpoint", tmp_path / "state.txt"], "ending in .npz"),
        (["-o", good, "--checkpoint", clip], "no input"),
        (["-o", good, "--checkpoint", tmp_path / "." / "good.npz"], "no other output"),
        (["-o", tmp_path / f"{long}.npz"], "File name too long"),
        (["-o", good, "--checkpoint", tmp_path / f"{long}.npz"], "File name too long"),
        (["-o", good, "-o", tmp_path / f"{long}.png"], "File name too long"),
    ):
        err = refused("decompose", clip, "-b", 2, *arguments)
        assert text in err
        assert len(err.strip().splitlines()) == 1
    assert not good.exists()


def test_what_a_format_refuses_is_refused_before_the_work(refused, never, clip, tmp_path):
    for arguments, text in (
        (["-o", tmp_path / "x.obj"], "one number such as %04d in the name, for a file a frame"),
        (["-o", tmp_path / "x.glb", "--write", "up=q"], "up: expected"),
        (["-o", tmp_path / "x.glb", "--write", "influences=0"], "influences: expected"),
        (["-o", tmp_path / "x.pc2", "--write", "unweld=true"], "unweld: expected"),
        (["-o", tmp_path / "x.npz", "--write", "colour=red"], "colour"),
        (["-o", tmp_path / "x.glb", "-b", 9, "-k", 9], "at most 8"),
    ):
        assert text in refused("decompose", clip, "-b", 2, *arguments)
    assert [p.name for p in tmp_path.iterdir()] == ["clip.npz"]


def test_a_missing_package_is_named_before_the_work(refused, clip, tmp_path, monkeypatch):
    no_blender(monkeypatch, tmp_path)
    err = refused("decompose", clip, "-b", 2, "-o", tmp_path / "a.fbx", code=4)
    assert "a.fbx: FBX needs Blender. Blender, 4.2 or newer, was not found: put it" in err


def test_a_folder_that_takes_no_file_is_refused(refused, never, clip, tmp_path, monkeypatch):
    """Permissions do not tell, say where no inodes are left."""

    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "touch", full)
    err = refused("decompose", clip, "-b", 2, "-o", tmp_path / "a.npz")
    assert "--output: expected a file in a folder that can be written to" in err
    assert "(No space left on device)" in err


def test_an_output_is_overwritten_as_in_python(faked, done, clip, wave, tmp_path):
    """Getting started can be gone through a second time."""
    out = tmp_path / "a.gltf"
    for _ in range(2):
        done("decompose", clip, "-b", 2, "-o", out, "-o", tmp_path / "m_%02d.obj")
        ssdr.save(wave, tmp_path / "w.npy")
    done("decompose", clip, "-b", 2, "-o", out, "--force")  # as earlier versions asked for
    ssdr.load(out)
    (tmp_path / "m_s.npz").write_bytes(b"")
    done("decompose", clip, "-b", 2, "-o", tmp_path / "m_%s.npz")


def test_the_folder_of_numbered_files_is_made_as_in_python(faked, done, clip, tmp_path):
    done("decompose", clip, "-b", 2, "-o", tmp_path / "new" / "a_%02d.obj")
    done("convert", clip, tmp_path / "newer" / "a_%02d.ply")
    for folder in ("new", "newer"):
        assert len(ssdr.load(tmp_path / folder)) == len(ssdr.load(clip))


def test_a_file_beside_the_output_that_is_another_s_is_not_overwritten(refused, clip, tmp_path):
    for name, beside in (("a.gltf", "a.bin"), ("b.npy", "b.faces.npy")):
        (tmp_path / beside).write_bytes(b"precious")
        err = refused("decompose", clip, "-b", 2, "-o", tmp_path / name)
        assert f"--output: expected a name whose {beside} is not taken" in err
        with pytest.raises(ssdr.InputError, match=f"{beside} is not taken"):
            ssdr.save(ssdr.load(clip), (tmp_path / name).with_suffix(Path(name).suffix))
        assert (tmp_path / beside).read_bytes() == b"precious"


def test_options_of_outputs():
    pairs = ["a=1", "glb:b=x", ".npz:c=true"]
    assert write_options(pairs, Path("m.GLB")) == {"a": 1, "b": "x"}
    assert write_options(pairs, Path("m.npz")) == {"a": 1, "c": True}


@pytest.fixture
def full(tmp_path, monkeypatch):
    """A folder on a full disk; the folder for temporary files is beside it."""
    (tmp_path / "full").mkdir()
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    fill(tmp_path / "full", monkeypatch)
    return tmp_path / "full"


@pytest.mark.usefixtures("faked")
def test_a_full_disk_sends_the_model_to_another_folder(run, clip, full, monkeypatch):
    line = ("decompose", clip, "-b", 2, "-o", full / "a.glb")
    code, out, err = run(*line)
    assert (code, out) == (1, "")
    place = full.parent / "temporary" / "a.rescued.npz"
    assert ssdr.load_skinning(place).n_bones == 2
    lines = err.splitlines()
    assert lines[0] == f"ssdr: warning: the model is kept in {place}"
    assert lines[1] == f"ssdr: error: {full / 'a.glb'}: No space left on device"
    assert list(full.iterdir()) == []
    code, out, _ = run(*line, "--json")
    document = json.loads(out)
    assert (code, document["exit_code"]) == (1, 1)
    assert document["warnings"] != [f"the model is kept in {place}"]  # which is not overwritten
    fill(full.parent / "temporary", monkeypatch)
    assert "the model is lost" in run(*line)[2]


@pytest.mark.usefixtures("faked")
def test_an_output_that_fails_does_not_keep_the_others_from_being_written(run, clip, full):
    good = full.parent / "good.npz"
    code, _, err = run("decompose", clip, "-b", 2, "-o", full / "a.glb", "-o", good)
    assert code == 1
    assert ssdr.load_skinning(good).n_bones == 2
    assert err == f"ssdr: error: {full / 'a.glb'}: No space left on device\n"
    # Vertices are no model.
    weights = full.parent / "w_%d.obj"
    code, _, err = run("decompose", clip, "-b", 2, "-o", full / "a.glb", "-o", weights)
    assert list(full.parent.glob("w_*.obj"))
    assert "the model is kept in" in err


@pytest.mark.usefixtures("faked")
def test_what_a_format_refuses_after_the_work_is_kept_beside_it(run, clip, tmp_path, monkeypatch):
    monkeypatch.setattr("ssdr.cli.fitting.try_format", lambda *_: None)
    code, _, err = run("decompose", clip, "-b", 2, "-o", tmp_path / "a.glb", "--write", "up=q")
    assert code == 2
    assert f"the model is kept in {tmp_path / 'a.rescued.npz'}" in err


@pytest.mark.usefixtures("faked")
def test_a_folder_that_goes_during_the_work(run, clip, tmp_path, monkeypatch):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    def decompose(*args, **options):
        gone.rmdir()
        return fake_decompose(*args, **options)

    monkeypatch.setitem(vars(ssdr), "decompose", decompose)
    code, _, err = run("decompose", clip, "-b", 2, "-o", gone / "a.npz")
    assert code == 2
    assert f"the model is kept in {tmp_path / 'a.rescued.npz'}" in err


@pytest.mark.usefixtures("faked")
def test_files_that_may_not_grow(run, clip, tmp_path):
    """What the system says of a full quota comes from the write itself."""
    with small_files(500):
        code, _, err = run("decompose", clip, "-b", 2, "-o", tmp_path / "a.npz")
    assert code == 1
    assert f"ssdr: error: {tmp_path / 'a.npz'}: File too large" in err
