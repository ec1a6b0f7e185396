"""A model to start from never makes the result worse than a call without one."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import ssdr
from helpers import motions

BONES = 5


@functools.cache
def clip() -> tuple[np.ndarray, np.ndarray]:
    return motions.wings(frames=24, rows=21, columns=7)


def clusters() -> ssdr.Skinning:
    """One bone a strip of the sheet, still in every frame: a start that is far off."""
    shots, faces = clip()
    label = np.arange(shots.shape[1]) * BONES // shots.shape[1]
    still = np.tile(np.eye(3, 4), (len(shots), BONES, 1, 1))
    ones = np.ones((len(label), 1))
    return ssdr.Skinning(shots[0], label[:, None].astype(np.int32), ones, still, faces=faces)


def crumpled() -> ssdr.Skinning:
    shots, faces = clip()
    free = {"rest_pose": "free", "normals": False, "rest_frame": 20}
    return ssdr.decompose(shots, faces, bones=BONES, effort="fast", **free).skinning


def of_other_frames() -> ssdr.Skinning:
    shots, faces = clip()
    return ssdr.decompose(shots[:9], faces, bones=BONES, effort="fast").skinning


def own() -> ssdr.Skinning:
    shots, faces = clip()
    return ssdr.decompose(shots, faces, bones=BONES, effort="fast").skinning


@functools.cache
def from_nothing(effort: str) -> float:
    return ssdr.decompose(*clip(), bones=BONES, effort=effort).rmse


@pytest.mark.parametrize("effort", ["fast", pytest.param("balanced", marks=pytest.mark.slow)])
@pytest.mark.parametrize("make", [clusters, crumpled, of_other_frames, own])
def test_no_worse_than_the_start_and_than_none(make, effort: str) -> None:
    shots, _ = clip()
    start = make()
    result = ssdr.decompose(*clip(), start=start, effort=effort)
    assert result.rmse <= 1.02 * from_nothing(effort)
    if start.n_frames == len(shots):
        error = np.linalg.norm(start.skin() - shots, axis=-1)
        assert result.rmse <= np.sqrt((error**2).mean()) * (1 + 1e-6)
