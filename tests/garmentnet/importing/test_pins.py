"""Clips that have lost their pins are refused; pins are found from clips."""

from __future__ import annotations

import dataclasses

import numpy as np
from typer.testing import CliRunner

from garmentnet.cli import app
from garmentnet.importing.importing import import_clips
from helpers.walking_rig import FPS, cloth, motion, rig
from ssdr import MeshSequence


def test_cloth_that_lost_its_pins_is_refused(pair, tmp_path):
    """The upper ring stays 30 cm above its place; in the clip before, the hips carried it."""
    loose = cloth()
    v = np.array(loose.vertices)
    v[:, :10] += np.float32([0.0, 0.3, 0.0])
    sources = [pair(), pair("loose", dataclasses.replace(loose, vertices=v))]
    store = import_clips(sources, tmp_path / "a.clips")
    assert "pins_off" in store.clip("loose").quality["reason"]
    assert store.refused().startswith("1 of 2 clips are refused and left out: loose (")
    words = ["import", "--cloth", sources[0][0], "--rig", sources[0][1], "-o", store.path]
    result = CliRunner().invoke(app, list(map(str, words)))
    assert "1 of 2 clips are refused" in result.stderr


def test_some_pins_that_are_lost_are_told_from_cloth_that_was_still(pair, tmp_path):
    """In the first clip the hips carry three rings of ten; in the third two vertices come off."""
    first, hips = np.array(cloth().vertices), motion()[:, 0]
    carried = first[0] @ hips[..., :3].swapaxes(1, 2) + hips[:, None, :, 3]
    first[:, :30] = carried[:, :30]
    loose = np.array(cloth(motion(seed=2)).vertices)
    loose[30:, :2] += np.float32([0, 0.1, 0])
    pairs = [
        pair(name, MeshSequence(v, cloth().faces, FPS), rig(motion(seed=k)))
        for k, (name, v) in enumerate(
            [("still", first), ("walk", cloth(motion(seed=1)).vertices), ("loose", loose)]
        )
    ]
    said: list[str] = []
    store = import_clips(pairs, tmp_path / "a.clips", say=said.append)
    assert "walk: 67% of the vertices that the body carried before are free" in said
    assert {c.motion for c in store.clips()} == {"still", "walk"}


def test_between_which_joints_pins_hang_may_show_later(pair, tmp_path):
    """A leg carries them, which in the first clip moves with the hips."""
    stiff, legs = motion(), [1, 0, 2]
    stiff[:, 1] = stiff[:, 0]
    kick = pair("kick", cloth(motion(seed=1)[:, legs]), rig(motion(seed=1)))
    store = import_clips([pair("walk", cloth(stiff), rig(stiff)), kick], tmp_path / "a.clips")
    assert {c.quality["reason"] for c in store.clips(accepted=None)} == {""}
