"""Clips of a model: named ranges with their own rates, from a list of sequences to the result."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.rig_model import tube
from ssdr import Clip, MeshSequence


def three(bones=3):
    """A walk of 24 fps, a jump of 60 and one still frame, of one mesh."""
    frames = tube(bones=bones, frames=20, rings=7, sides=6).skin()
    faces = tube(bones=bones, frames=2, rings=7, sides=6).faces
    return [
        MeshSequence(frames[:9], faces, 24.0, name="walk"),
        MeshSequence(frames[9:19], faces, 60.0, name="jump"),
        MeshSequence(frames[19:], faces, 24.0, name="death"),
    ]


CLIPS = (Clip("walk", 0, 9, 24.0), Clip("jump", 9, 19, 60.0), Clip("death", 19, 20, 24.0))


def with_clips(**options):
    return dataclasses.replace(tube(**options), clips=CLIPS)


def test_a_clip_is_a_range_with_a_name_and_a_rate():
    clip = Clip("walk", np.int64(3), 8, 30)
    assert (clip.n_frames, clip.frames, clip.fps) == (5, slice(3, 8), 30.0)


def test_a_model_without_clips_is_one_and_follows_rate_and_frames():
    model = tube()
    assert model.clips == (Clip("tube", 0, 20, 24.0),)
    faster = dataclasses.replace(model, fps=60)
    assert (faster.fps, faster.clips) == (60.0, (Clip("tube", 0, 20, 60.0),))
    shorter = dataclasses.replace(model, transforms=model.transforms[::4])
    assert shorter.clips == (Clip("tube", 0, 5, 24.0),)
    renamed = dataclasses.replace(model, name="hose")
    assert renamed.clips[0].name == "tube"
    alone = dataclasses.replace(model, clips=[Clip("bend", 0, 20, 24.0)])
    assert dataclasses.replace(alone, fps=12).clips == (Clip("bend", 0, 20, 12.0),)


def test_the_rate_of_a_model_is_that_of_its_first_clip():
    model = with_clips()
    assert (model.fps, model.clips) == (24.0, CLIPS)
    arrays = (model.rest, model.indices, model.weights, model.transforms)
    assert ssdr.Skinning(*arrays, clips=[Clip("run", 0, 20, 60.0)]).fps == 60.0
    assert ssdr.Skinning(*arrays).fps == 24.0


def test_a_clip_can_be_taken_out():
    model = with_clips()
    jump = model.select("jump")
    np.testing.assert_array_equal(jump.transforms, model.transforms[9:19])
    assert (jump.fps, jump.clips, jump.name) == (60.0, (Clip("jump", 0, 10, 60.0),), "tube")
    two = model.select("death", 0)
    assert two.clips == (Clip("death", 0, 1, 24.0), Clip("walk", 1, 10, 24.0))
    np.testing.assert_array_equal(two.skin(two.clips[1].frames), model.skin(CLIPS[0].frames))


def test_clips_stay_when_weights_are_pruned_and_keys_are_cut():
    model = with_clips()
    assert model.prune(2).clips == CLIPS
    keys = np.zeros(model.transforms.shape[:2], dtype=bool)
    keys[[0, 19]] = True
    keyed = dataclasses.replace(model, keyframes=keys)
    jump = keyed.select("jump").keyframes
    np.testing.assert_array_equal(np.flatnonzero(jump[:, 0]), [0, 9])
    assert not keyed.keyframes[9].any()


@pytest.mark.filterwarnings("ignore::ssdr.SsdrWarning")
@pytest.mark.parametrize("way", ["in memory", "streamed", "smallest"])
def test_a_clip_is_made_of_each_sequence(way, monkeypatch):
    if way == "smallest":
        result = ssdr.smallest(three(), tolerance="20%", effort="fast")
    else:
        monkeypatch.setattr("ssdr.search.solve.needs_streaming", lambda _: way == "streamed")
        result = ssdr.decompose(three(), bones=3, effort="fast")
    assert result.skinning.clips == CLIPS
    assert (result.skinning.fps, result.skinning.name) == (24.0, "")
    np.testing.assert_array_equal(result.offsets, [0, 9, 19, 20])


def test_names_come_from_clip_then_sequence_then_number():
    walk, jump, death = three()
    named = [
        dataclasses.replace(walk, name="horse", clip="walk"),
        dataclasses.replace(jump, name="horse", clip="walk"),
        dataclasses.replace(death, name=""),
    ]
    model = ssdr.initialize(named, bones=2)
    assert [c.name for c in model.clips] == ["walk", "walk_1", "clip_2"]
    assert ssdr.initialize(named[:2], bones=2).name == "horse"
    assert ssdr.initialize(walk, bones=2).clips == (Clip("walk", 0, 9, 24.0),)
    plain = ssdr.initialize(walk.vertices, bones=2)
    assert (plain.name, plain.clips) == ("", (Clip("", 0, 9, 24.0),))
