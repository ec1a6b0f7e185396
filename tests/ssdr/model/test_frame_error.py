"""The error over all frames, and the motion that it is a share of: without its rigid part."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ssdr
from helpers import motions, naive
from ssdr.model.frame_error import largest_error, motion_rms, squared_error

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def moved_rigidly(frames, rng):
    turns = Rotation.random(len(frames), random_state=3).as_matrix()
    return frames @ np.swapaxes(turns, 1, 2) + 5 * rng.normal(size=(len(frames), 1, 3))


@pytest.mark.parametrize("rigid", [False, True])
def test_a_cube_that_breathes(rng, rigid):
    """Its best rigid fit is that of its centre and axes: what is left is its size."""
    sizes = np.array([1.0, 1.3, 0.8, 1.1])
    frames = sizes[:, None, None] * CUBE
    frames = moved_rigidly(frames, rng) if rigid else frames
    by_hand = np.sqrt(3) * sizes.std()
    assert motion_rms([ssdr.MeshSequence(frames)]) == pytest.approx(by_hand, rel=1e-12)
    shots = [ssdr.MeshSequence(part) for part in (frames[:1], frames[1:])]
    assert motion_rms(shots) == pytest.approx(by_hand, rel=1e-12)
    lost = frames + 0.1 * by_hand / np.sqrt(3)
    found = ssdr.metrics.distances(frames, lost)
    assert found.motion == pytest.approx(by_hand, rel=1e-12)
    assert found.percent_of_motion == pytest.approx(10, rel=1e-9)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_mesh_that_only_moves_about_has_no_motion_to_lose(rng, dtype):
    frames = moved_rigidly(np.tile(CUBE, (9, 1, 1)), rng).astype(dtype)
    assert motion_rms([ssdr.MeshSequence(frames)]) == 0
    found = ssdr.metrics.compare(frames, frames + dtype(1), sted=False, hausdorff=False)
    assert math.isnan(found.percent_of_motion)
    assert "motion" not in str(found)
    assert json.loads(json.dumps(found.as_dict(), allow_nan=False))["percent_of_motion"] is None


def test_loops(rng):
    frames = moved_rigidly(CUBE + 0.2 * rng.normal(size=(6, 8, 3)), rng)
    posed = []
    for frame in frames:
        turn, _ = Rotation.align_vectors(frames[0] - frames[0].mean(0), frame - frame.mean(0))
        posed.append(turn.apply(frame - frame.mean(0)) + frames[0].mean(0))
    mean = np.mean(posed, axis=0)
    square = [math.dist(p, m) ** 2 for pose in posed for p, m in zip(pose, mean, strict=True)]
    assert motion_rms([ssdr.MeshSequence(frames)]) == pytest.approx(math.sqrt(np.mean(square)))


def test_local_motion_that_is_lost_is_measured():
    """A bump of a thousandth of the mesh: the error is nothing beside the mesh, and all of it."""
    x, y = np.meshgrid(np.linspace(0, 1, 12), np.linspace(0, 1, 12))
    bump = np.exp(-60 * ((x - 0.5) ** 2 + (y - 0.5) ** 2))
    height = 0.001 * np.sin(np.arange(8))[:, None, None] * bump
    frames = np.stack([np.broadcast_to(a, height.shape) for a in (x, y, height)], axis=-1)
    frames = frames.reshape(8, -1, 3)
    result = ssdr.decompose(frames, bones=1, effort="fast")
    assert result.rmse < 2e-4 * ssdr.MeshSequence(frames).diagonal()
    assert result.motion_lost == pytest.approx(1, abs=0.01)
    assert result.motion == pytest.approx(motion_rms([ssdr.MeshSequence(frames)]))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_true_error_against_loops(kind: type, rng: np.random.Generator) -> None:
    rig = motions.chain(bones=3, rows=6, frames=7)
    frames = (rig.frames + 0.1 * rng.standard_normal(rig.frames.shape)).astype(kind)
    shots = [ssdr.MeshSequence(frames[:4]), ssdr.MeshSequence(frames[4:])]
    got = squared_error(shots, rig.rest, rig.indices, rig.weights, rig.transforms)
    want = naive.squared_error(frames, rig.rest, rig.indices, rig.weights, rig.transforms)
    np.testing.assert_allclose(got, want, rtol=1e-10)


def test_a_largest_error_that_is_no_number_is_seen() -> None:
    rig = motions.chain(bones=3, rows=6, frames=7)
    transforms = rig.transforms.copy()
    transforms[5, 1, 0, 0] = np.nan
    shots = [ssdr.MeshSequence(rig.frames)]
    assert np.isnan(largest_error(shots, rig.rest, rig.indices, rig.weights, transforms))
