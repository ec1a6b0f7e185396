"""Several files of one mesh, and files that may hold a skinning."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.gltf_asset import make_asset
from helpers.rig_model import largest_distance, tube
from ssdr import Clip, MeshSequence, SsdrWarning
from ssdr.io import load_any, load_clips

CLIPS = (Clip("walk", 0, 9, 24.0), Clip("jump", 9, 19, 60.0))


@pytest.fixture(scope="module")
def model():
    made = tube(bones=3, frames=19, rings=7, sides=6)
    return dataclasses.replace(made, clips=CLIPS, surface=None, name="horse")


@pytest.fixture
def rigged(model, tmp_path):
    return ssdr.save(model, tmp_path / "rigged.glb").path


@pytest.fixture
def files(model, tmp_path):
    """Each clip in a file of another format."""
    walk, jump = (
        MeshSequence(model.skin(c.frames), model.faces, c.fps, name=c.name) for c in CLIPS
    )
    return ssdr.save(walk, tmp_path / "walk.npz").path, ssdr.save(jump, tmp_path / "jump.npy").path


def test_several_files_are_clips_of_one_model(files, model, tmp_path):
    clips = load_clips(files, fps=60)
    assert [(c.clip, len(c), c.fps) for c in clips] == [("walk", 9, 60), ("jump", 10, 60)]
    start = ssdr.initialize(clips, bones=3)
    assert [c.name for c in start.clips] == ["walk", "jump"]
    # a mesh in other units and with another up axis comes into the space of the first
    there = dataclasses.replace(clips[1], space=ssdr.Space(1.0, "y"))
    ssdr.save(ssdr.io.in_space(there, ssdr.Space(0.01, "z")), tmp_path / "cm.npz")
    ssdr.save(dataclasses.replace(clips[0], space=ssdr.Space(1.0, "y")), tmp_path / "m.npz")
    _, jump = load_clips([tmp_path / "m.npz", tmp_path / "cm.npz"])
    assert jump.space == ssdr.Space(1.0, "y")
    assert largest_distance(jump.vertices, clips[1].vertices) < 1e-5


def test_clips_are_chosen_by_name(rigged):
    with pytest.warns(SsdrWarning, match=r"2 clips \(walk, jump\): walk is taken"):
        assert [c.clip for c in load_clips(rigged)] == ["walk"]
    assert [(c.clip, c.fps) for c in load_clips(rigged, clip="all")] == [("walk", 24), ("jump", 60)]
    assert [c.clip for c in load_clips(rigged, clip=["jump", "jump"])] == ["jump"]


def test_clips_of_one_name_are_told_apart_by_their_files(model, tmp_path):
    paths = []
    for k, stem in enumerate(("trot", "run")):
        one = dataclasses.replace(model.select(k), clips=[Clip("mixamo", 0, 9 + k, 24.0)], fps=24.0)
        paths.append(ssdr.save(one, tmp_path / f"{stem}.glb").path)
    assert [c.clip for c in load_clips(paths)] == ["trot", "run"]
    assert [c.clip for c in load_clips([paths[0], paths[0]])] == ["trot_mixamo", "trot_mixamo_1"]


def test_vertices_are_welded_where_they_coincide_in_every_clip(tmp_path):
    vertices = np.zeros((4, 4, 3))
    vertices[:, 1:3, 0] = 1
    vertices[:, 3, 1] = np.arange(1, 5)
    vertices[3, 2, 2] = 1  # the seam opens in the second clip alone
    for name, part in (("a", vertices[:2]), ("b", vertices[2:])):
        ssdr.save(MeshSequence(part, [[0, 1, 3], [0, 2, 3]]), tmp_path / f"{name}.npz")
    for names, count in (("a", 3), ("ab", 4)):
        clips = load_clips([tmp_path / f"{name}.npz" for name in names], weld=True)
        assert [c.n_vertices for c in clips] == [count] * len(names)
        assert [c.clip for c in clips] == list(names)


def test_options_go_to_the_files_that_know_them(files, rigged, tmp_path):
    (tmp_path / "jump.faces.npy").rename(tmp_path / "f.npy")
    load_clips(files, faces=tmp_path / "f.npy")


def test_a_skinning_is_read_where_there_is_one(files, rigged, model, tmp_path):
    assert [c.name for c in load_any(rigged).clips] == ["walk", "jump"]
    assert [c.name for c in load_any(rigged, clip="jump").clips] == ["jump"]
    assert isinstance(load_any(files[0]), MeshSequence)
    # morph targets and nodes that move are shapes
    assert [c.name for c in load_any(make_asset(tmp_path / "a.gltf")).clips] == ["Dance", "Spin"]
    (tmp_path / "bad.npz").write_bytes(b"not a zip archive")
    with pytest.raises(ssdr.FormatError, match=r"bad\.npz"):
        load_any(tmp_path / "bad.npz")
