"""What is asked of files and cannot be done: the call and what is said; nothing is written."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import ssdr
from helpers.rig_model import tube
from ssdr import Clip, FormatError, InputError, Space
from ssdr.io import check_outputs, list_meshes, load_any, load_clips

ODD = ("", "nan", "٣", "true", [], True)


def save(name, what="model", **options):
    return lambda g: ssdr.save(getattr(g, what), g.folder / name, **options)


def load(name, read=ssdr.load, **options):
    return lambda g: read(g.folder / name, **options)


def skinning(name, **options):
    return load(name, ssdr.load_skinning, **options)


def several(*names, **options):
    return lambda g: load_clips([g.folder / name for name in names], **options)


def outputs(*names, **options):
    return lambda g: check_outputs(
        [g.folder / name for name in names], inputs=[g.folder / "shot.npz"], **options
    )


def into(what, meshes=None):
    """Into the model's own file as a template."""
    return lambda g: ssdr.save(
        what(g), g.folder / "o.glb", template=g.folder / "rigged.glb", meshes=meshes
    )


def bent(model, kind):
    """The model with the first axis of a bone turned over."""
    moves = model.transforms.copy()
    moves[3, 2, :, 0] *= -1
    return dataclasses.replace(model, transforms=moves, bone_model=kind)


INPUT = [
    # paths and suffixes
    (save("no/a.npz"), "a file in a folder that exists"),
    (save("folder.npz"), "the folder"),
    (save("all.obj", "shot"), "one number such as %04d"),
    (save("all.ply", "shot"), "one number such as %04d"),
    (save("b.xyz", "shot"), "path: expected a suffix of"),
    (save("b.glb", "shot"), r"path: expected a suffix of .* for a MeshSequence"),
    (save("b.npz", "folder"), "thing: expected a MeshSequence"),
    *(
        (lambda g, act=act, path=path: act(g, path), "path: expected a path")
        for path in ("a\0.npz", b"a.npz", 3)
        for act in (
            lambda g, path: ssdr.load(path),
            lambda g, path: ssdr.load_skinning(path),
            lambda g, path: ssdr.save(g.shot, path),
        )
    ),
    # options
    (load("shot.npz", faces="b.obj"), r"options: expected clip, fps, max_bytes .*got faces"),
    (load("shot.obj", faces="missing.glb"), r"^options: .* got faces"),
    (save("a.npz", "shot", level=3), r"options: expected compress .*units and up for all.*level"),
    *((load("shot.npz", fps=v), "fps: expected a positive number") for v in (0, -1, np.nan, "24")),
    (load("shot.npz", fps=True), "fps: expected a positive number"),
    (load("bare.npy", ssdr.list_clips, fps=0), "fps"),
    (load("shot.npz", max_bytes=0), "max_bytes: expected a positive number"),
    *((load("shot.npz", max_bytes=v), "max_bytes: expected an integer") for v in ("", "nan", "1")),
    *((load("bare.npy", mmap=v), "mmap: expected true or false") for v in ("", 1, 0, 1.0, None)),
    *((save("a.glb", units=v), "units: expected metres in a unit") for v in ODD),
    *((save("a.npz", compress=v), "compress: expected true or") for v in (*ODD[:-1], 1)),
    (save("a.glb", up="x"), "up"),
    (save("a.glb", weights="float16"), "weights"),
    *((lambda g, odd=odd: Space(**odd), f"{next(iter(odd))}: expected")
      for odd in ({"units": 0}, {"units": -1.0}, {"units": "cm"}, {"up": "x"})),
    (lambda g: dataclasses.replace(g.shot, space="y"), "space: expected a Space"),
    # clips and meshes by their names
    *((act(name, clip=wrong), "clip: expected")
      for act, name in ((load, "shot.npz"), (load, "rigged.glb"), (skinning, "rigged.glb"))
      for wrong in ("run", 3, -1, True)),
    (load("bare.npy", clip="walk", faces="none"), "clip: expected one of"),
    (load("rigged.glb", load_clips, clip="run"), r"clip: expected a clip of .*: walk, jump, or"),
    (load("rigged.glb", load_any, clip="run"), r"clip: expected one of walk, jump, or all"),
    (load("rigged.glb", meshes="hat"), r"meshes: expected one of \['tube'\], got 'hat'"),
    *((load("rigged.glb", meshes=v), "meshes: expected the name of a mesh, or")
      for v in (3, [], ["tube", 3], [None])),
    (save("a_%02d.obj"), r"one frame rate.*walk at 24, jump at 60"),
    # several files of one mesh
    (load("rigged.glb", load_clips, clip="walk", anim=1), r"options: expected .*, got anim"),
    (several("rigged.glb", "rigged.glb", anim=1), r"options: .*meshes.*, got anim"),
    (load("rigged.glb", scale=0), "scale: expected"),
    (load("rigged.glb", load_clips, weld="yes"), r"weld: expected True or False"),
    (several("rigged.glb", ssdr.samples.path("dancer_small"), clip="walk"), "the 18 vert"),
    (several("shot.npz", "bare.npy"), "faces: expected a mesh"),
    # models that a format cannot hold
    (lambda g: ssdr.save(bent(g.model, "affine"), g.folder / "a.glb"), "bone 2, frame 3"),
    (lambda g: ssdr.save(tube(bones=12, influences=10), g.folder / "a.glb"), r"prune\(8\)"),
    (into(lambda g: tube(rings=5, sides=4)), "vertices"),
    (into(lambda g: g.model, meshes="Hat"), "Hat"),
    (into(lambda g: dataclasses.replace(g.model, faces=g.model.faces[::-1], surface=None)),
     "triangles"),
    (into(lambda g: ssdr.ShapedSkinning(g.model, g.shapes)), "expected no shapes in a file with"),
    # before the work of a solver
    (outputs("a.xyz"), "a suffix of"),
    (outputs("a.npz", "a.npz"), "no other output"),
    (outputs("shot.npz"), "no input"),
    (outputs("no/a.npz"), "folder that exists"),
    (outputs("no/way/a_%02d.obj"), "folder that exists"),
    (outputs(f"{'n' * 252}.npz"), "File name too long"),
    (outputs("b.gltf"), "a name whose b.bin is not taken"),
    (outputs("taken.npy"), "a name whose taken.faces.npy is not taken"),
    (outputs("x.npz", colour="red"), "got colour"),
]  # fmt: skip
FORMAT = [
    (load("a.xyz"), r"a\.xyz: the suffix '\.xyz' is none of \.abc, .*\.usdc"),
    (load("a"), "a name without suffix"),
    (skinning("shot.obj"), "no skinning can be read from"),
    *((load(f"folder{s}"), rf"folder\{s}: a folder, not a file")
      for s in (".abc", ".fbx", ".mdd", ".npy", ".npz", ".pc2", ".usd")),
]  # fmt: skip
MISSING = ["a.npz", "a.npy", "a.obj", "a.pc2", "f_%03d.obj", "f*", "a.glb"]


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """A folder with files of a model of 18 vertices and two clips, and of its vertices alone."""
    folder = tmp_path_factory.mktemp("given")
    model = tube(bones=3, frames=19, rings=4, sides=4)
    clips = [Clip("walk", 0, 9, 24.0), Clip("jump", 9, 19, 60.0)]
    model = dataclasses.replace(model, clips=clips)
    shot = ssdr.MeshSequence(model.skin(), model.faces, name="shot")
    ssdr.save(model, folder / "rigged.glb")
    ssdr.save(shot, folder / "shot.npz")
    np.save(folder / "bare.npy", shot.vertices)
    for name in ("a", "a.xyz", "b.bin", "shot.obj", "taken.faces.npy"):
        (folder / name).write_text("precious")
    for suffix in (".abc", ".fbx", ".mdd", ".npy", ".npz", ".pc2", ".usd"):
        (folder / f"folder{suffix}").mkdir()
    shapes = ssdr.Shapes(np.ones((1, 18, 3)), np.ones((19, 1)))
    return SimpleNamespace(folder=folder, model=model, shot=shot, shapes=shapes)


def content(folder):
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


TABLE = [(InputError, *row) for row in INPUT] + [(FormatError, *row) for row in FORMAT]
TABLE += [(FileNotFoundError, load(name), None) for name in MISSING]
TABLE += [
    (FileNotFoundError, load("missing.glb", ssdr.list_clips), None),
    (FileNotFoundError, load("missing.glb", list_meshes), None),
    (FileNotFoundError, load("bare.npy", faces="missing.glb"), r"missing\.glb"),
]


@pytest.mark.parametrize(("kind", "call", "text"), TABLE, ids=[str(row[2]) for row in TABLE])
def test_a_call_is_refused_in_words_and_writes_nothing(given, kind, call, text):
    before = content(given.folder)
    with pytest.raises(kind, match=text):
        call(given)
    assert content(given.folder) == before
