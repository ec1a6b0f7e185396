"""What the tests of decompositions share: two small motions, and measures by code of their own."""

from __future__ import annotations

import functools

import motions
import numpy as np
import pytest

import ssdr
from ssdr.given import Given
from ssdr.model import Fixed, Model
from ssdr.plan import Op
from ssdr.run import Run
from ssdr.trajectories import Trajectories


@functools.cache
def rig() -> motions.Rig:
    return motions.chain(bones=5, rows=14, frames=15)


@functools.cache
def frames() -> np.ndarray:
    """The rig's frames with a wobble that no bones can follow; a read-only array."""
    out = motions.wobble(rig(), 0.1)
    out.setflags(write=False)
    return out


@functools.cache
def wavy() -> np.ndarray:
    """A chain of five with a motion on top that no rigid bones can follow."""
    out = motions.wobble(motions.chain(bones=5, rows=14, frames=15), 0.05)
    out.setflags(write=False)
    return out


@functools.cache
def small() -> ssdr.Decomposition:
    return ssdr.decompose(wavy(), tolerance="0.8%", effort="fast")


def solved(
    data: Trajectories, bones: int, influences: int = 4, plan: list[Op] | None = None
) -> Model:
    run = Run(
        data, plan or [Op("start", amount=1.0), Op("alternate", count=8)], bones=bones,
        influences=influences, rng=np.random.default_rng(0), fixed=Fixed(), given=Given(),
        smooth=None,
    )  # fmt: skip
    while not run.finished:
        run.advance()
    assert run.best is not None
    return run.best


def diagonal(array: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(array, axis=1), axis=1).max())


def rmse_of(skinning: ssdr.Skinning, array: np.ndarray) -> float:
    again = motions.blend(skinning.rest, skinning.joints, skinning.weights, skinning.transforms)
    return float(np.sqrt(((again - array) ** 2).sum(axis=-1).mean()))


def errors_of(skinning: ssdr.Skinning, frames: np.ndarray) -> tuple[float, float]:
    """RMSE and largest distance, by code of the tests alone."""
    s = skinning
    squares = ((motions.blend(s.rest, s.joints, s.weights, s.transforms) - frames) ** 2).sum(-1)
    return float(np.sqrt(squares.mean())), float(np.sqrt(squares.max()))


def bits(result: ssdr.Decomposition) -> list[bytes]:
    s = result.skinning
    return [a.tobytes() for a in (s.rest, s.joints, s.weights, s.transforms)]


def check(
    result: ssdr.Decomposition, array: np.ndarray, bones: int, influences: int = 4
) -> ssdr.Decomposition:
    """What holds for every result."""
    s = result.skinning
    n_frames, n = array.shape[:2]
    assert s.transforms.shape == (n_frames, bones, 3, 4)
    assert s.rest.shape == (n, 3)
    assert s.joints.shape == s.weights.shape == (n, influences)
    assert s.joints.min() >= 0
    assert s.joints.max() < bones
    assert s.weights.min() >= 0
    assert np.abs(s.weights.sum(axis=1) - 1).max() < 1e-6
    assert (np.diff(s.weights, axis=1) <= 1e-12).all()
    assert (s.joints[s.weights == 0] == 0).all()
    r = s.transforms[..., :3]
    assert np.abs(np.einsum("tjca,tjcb->tjab", r, r) - np.eye(3)).max() < 1e-6
    assert np.abs(np.linalg.det(r) - 1).max() < 1e-6
    scale = max(diagonal(array), float(np.abs(array).max()))
    assert result.rmse == pytest.approx(rmse_of(s, array), rel=1e-6, abs=1e-13 * scale)
    errors = [record.rmse for record in result.history]
    assert (np.diff(errors) <= 0).all()
    assert errors[-1] == result.rmse
    assert (np.diff([record.elapsed for record in result.history]) >= 0).all()
    assert (np.diff([record.iteration for record in result.history]) >= 0).all()
    assert result.history[0].elapsed > 0
    assert result.stop_reason in (
        "converged", "plan finished", "iterations", "time limit", "cancelled",
    )  # fmt: skip
    assert result.converged == (result.stop_reason == "converged")
    return result
