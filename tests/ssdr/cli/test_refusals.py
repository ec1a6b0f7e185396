"""What the command refuses: the line, its exit code and its text, before the work and after it."""

from __future__ import annotations

import dataclasses
import json
import sys

import pytest

import ssdr
from helpers.blender import no_blender
from helpers.command import fake_decompose, model_of
from helpers.disks import fill

LONG = "n" * 252
D = ("decompose", "clip.npz", "-b", "2", "-o")
OUT = (*D, "out.npz")
RIG = ("decompose", "clip.npz", "-o", "out.npz", "--rig", "rig.npz")
TREE = ("decompose", "clip.npz", "-o", "out.npz")
SMALL = ("smallest", "clip.npz", "-o", "out.npz")
TABLE = [
    # usage
    (("decompose", "a.npz", "-b", "many", "-o", "b.npz"), 2, "'--bones'"),
    (("decompose", "a.npz", "-b", "1", "-o", "b.npz", "--bone-model", "rubber"), 2, "'affine'"),
    (("info", "clip.npz", "-v"), 2, "No such option: -v"),
    (("convert", "clip.npz", "b.npz", "--folder", "missing"), 2, "folder: expected a folder"),
    # inputs
    (("info", "none.npz"), 2, "none.npz: no such file"),
    (("info", "9" * 300 + ".npz"), 2, "File name too long"),
    (("info", "bad.npz"), 3, "bad.npz"),
    (("info", "sample:nobody"), 2, "one of dancer, dancer_small"),
    (("info", "clip.npz", "--units", "ell"), 2, "'--units'"),
    (("info", "clip.npz", "--up", "x"), 2, "--up"),
    (("info", "clip.npz", "--meshes", "Body"), 2, "got meshes"),
    (("info", "rigged.glb", "--clip", "run"), 2, "clip: expected one of walk, jump, or all"),
    (("decompose", "still.obj", "-b", "2", "-o", "out.npz"), 2, "(no motion)"),
    # options
    ((*OUT, "-b", "0"), 2, "--bones: expected an integer"),
    ((*OUT, "--start", "none.npz"), 2, "no such file"),
    (TREE, 2, "bones (ssdr smallest clip.npz -o out.npz --tolerance 0.5% finds it), --rig FILE or"),
    ((*TREE, "--rig", "loose"), 2, "--bones"),
    ((*TREE, "--rig", "renamed.npz"), 2, "--rig: expected a model whose bones have parents"),
    ((*RIG, "--joints", "kept", "--extra-bones", "1"), 2, "--rig: expected 0 beside kept joints"),
    ((*RIG, "--extra-bones", "chest=x"), 2, "--extra-bones"),
    ((*RIG, "--keep-weights", "--start", "clip.npz"), 2, "--start: expected none"),
    ((*OUT, "--extra-bones", "1"), 2, "--extra-bones: expected the file of a rig beside it"),
    ((*OUT, "--joints", "loose"), 2, "--joints: expected the file of a rig beside it"),
    (SMALL, 2, "--tolerance"),
    ((*SMALL, "--tolerance", "half"), 2, "such as"),
    ((*SMALL, "--tolerance", "1%", "--normals", "0"), 2, "normals: expected True, False"),
    ((*OUT, "--normals", "some"), 2, "normals: expected True, False"),
    ((*SMALL, "--tolerance", "1%", "--rig", "rig.npz"), 2, "'loose'"),
    # outputs
    ((*D, "a.xyz"), 2, "output: expected a suffix of"),
    ((*OUT, "-o", "a.png", "-o", "a.png"), 2, "no other output"),
    ((*D, "a.png"), 2, "--output: expected a file for the model, too"),
    ((*OUT, "--checkpoint", "state.txt"), 2, "ending in .npz"),
    ((*OUT, "--checkpoint", "./out.npz"), 2, "no other output"),
    ((*OUT, "-o", f"{LONG}.png"), 2, "File name too long"),
    ((*D, "a.fbx"), 4, "a.fbx: FBX needs Blender. Blender, 4.2 or newer, was not found"),
    ((*OUT, "--weights", "uint8"), 2, "got weights"),
    (("convert", "rigged.glb", "a.npz", "--bake", "--clip", "all"), 2, "one clip where vertices"),
    (("compare", "rigged.glb", "renamed.npz"), 2, "clip: expected one of walk, jump"),
    (("compare", "clip.npz", "rigged.glb", "--clip", "jump"), 2, "vertices"),
    (("render", "clip.npz", "-o", "x.png", "--frames", "many"), 2, "--frames: expected"),
    (("render", "clip.npz", "-o", "x.png", "--styles", "bones"), 2, "bones"),
    (("render", "rigged.glb", "-o", "x.gif"), 2, "walk at 24, jump at 60"),
    (("view", "clip.npz", "-o", "page.png"), 2, "a file ending in .html"),
    (("view", "clip.npz", "-o", "page.html", "--max-bytes", "100"), 2, "--max-bytes"),
]


@pytest.fixture
def folder(clip, rigged, wave, tmp_path, monkeypatch):
    """The folder of the files in the table, as working folder; the solver is not to be called."""
    monkeypatch.chdir(tmp_path)
    no_blender(monkeypatch, tmp_path)
    (tmp_path / "bad.npz").write_bytes(b"not a zip archive")
    ssdr.save(ssdr.MeshSequence(wave.vertices[:1], wave.faces), "still.obj")
    model = ssdr.load_skinning(rigged)
    clips = [model.clips[0], dataclasses.replace(model.clips[1], name="run")]
    ssdr.save(dataclasses.replace(model, clips=clips), "renamed.npz")
    joints = {"parents": [-1, 0], "joint_positions": wave.vertices[0, :2]}
    tree = dataclasses.replace(model_of(wave, 2), bone_names=["hips", "chest"], **joints)
    ssdr.save(tree, "rig.npz")
    return tmp_path


@pytest.mark.parametrize(("line", "code", "text"), TABLE)
def test_what_is_refused_in_one_line_before_anything_is_written(run, folder, line, code, text):
    before = sorted(folder.iterdir())
    found, out, err = run(*line)
    assert (found, out) == (code, ""), err
    assert text in err
    assert len(err.strip().splitlines()) <= 2  # usage, and the error
    assert "Traceback" not in err
    assert sorted(folder.iterdir()) == before


def test_errors_as_json_and_those_that_nobody_expected(run, folder, monkeypatch):
    code, out, err = run("info", "bad.npz", "--json")
    document = json.loads(out)
    assert (code, err, document["kind"], document["exit_code"]) == (3, "", "FormatError", 3)

    def fall(*_, **__):
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("ssdr.cli.file_commands.load_any", fall)
    assert run("info", "clip.npz") == (
        *(1, ""),
        "ssdr: error: unexpected ZeroDivisionError: oh (ssdr -vv COMMAND shows where)\n",
    )


def test_packages_that_cannot_be_loaded_are_a_sentence(run, monkeypatch):
    """As in a small address space, where importing SciPy fails."""
    monkeypatch.setitem(sys.modules, "ssdr.cli.app", None)
    code, out, err = run("info", "clip.npz")
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert err.startswith("ssdr: error: a package cannot be loaded (")


@pytest.mark.usefixtures("faked")
def test_a_model_that_cannot_be_written_is_kept(run, clip, tmp_path, monkeypatch):
    """On a disk that fills, in a folder that goes."""
    (tmp_path / "full").mkdir()
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    fill(tmp_path / "full", monkeypatch)
    line = ("decompose", clip, "-b", 2, "-o", tmp_path / "full" / "a.glb")
    code, out, err = run(*line)
    place = tmp_path / "temporary" / "a.rescued.npz"
    assert (code, out) == (1, "")
    assert ssdr.load_skinning(place).n_bones == 2
    assert err.splitlines() == [
        f"ssdr: warning: the model is kept in {place}",
        f"ssdr: error: {tmp_path / 'full' / 'a.glb'}: No space left on device",
    ]
    gone = tmp_path / "gone"
    gone.mkdir()

    def decompose(*args, **options):
        gone.rmdir()
        return fake_decompose(*args, **options)

    monkeypatch.setitem(vars(ssdr), "decompose", decompose)
    code, _, err = run("decompose", clip, "-b", 2, "-o", gone / "b.npz")
    assert code == 2
    assert f"the model is kept in {tmp_path / 'temporary' / 'b.rescued.npz'}" in err
