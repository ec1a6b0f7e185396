"""Two small motions and independent error measures for tests of decompositions."""

from __future__ import annotations

import functools
import traceback
from collections.abc import Callable, Sequence
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

import ssdr
from helpers import motions
from helpers.stretches import check_kind
from ssdr.search import progress
from ssdr.search.descent import Descent, Schedule
from ssdr.search.problem import Initial
from ssdr.search.starts import start
from ssdr.search.steps import alternate
from ssdr.solver import warmup
from ssdr.solver.model import Constraints, Model
from ssdr.solver.trajectories import Trajectories


@functools.cache
def rig() -> motions.Rig:
    return motions.chain(bones=5, rows=14, frames=15)


@functools.cache
def frames() -> np.ndarray:
    """The rig's frames with a wobble that no bones can follow."""
    return motions.still(motions.wobble(rig(), 0.1))


@functools.cache
def wavy() -> np.ndarray:
    """The same frames with half the wobble."""
    return motions.still(motions.wobble(rig(), 0.05))


@functools.cache
def small() -> ssdr.Decomposition:
    return ssdr.smallest(wavy(), tolerance="0.8%", effort="fast")


def descent_of(
    data: Trajectories,
    bones: int,
    influences: int = 4,
    *,
    constraints: Constraints | None = None,
    initial: Initial | None = None,
) -> Descent:
    """A descent that has not begun."""
    return Descent(
        data,
        bones=bones,
        influences=influences,
        rng=np.random.default_rng(0),
        constraints=constraints or Constraints(),
        initial=initial or Initial(),
    )


def start_and_alternate(d: Descent, steps: int = 8) -> None:
    start(d)
    alternate(d, steps=steps)


def solved(
    data: Trajectories, bones: int, influences: int = 4, schedule: Schedule = start_and_alternate
) -> Model:
    d = descent_of(data, bones, influences)
    d.follow(schedule)
    return d.best.model


def diagonal(array: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(array, axis=1), axis=1).max())


def pooled(frames: np.ndarray, again: np.ndarray) -> float:
    """RMSE over all vertices of all frames."""
    return float(np.sqrt(((frames - again) ** 2).sum(axis=-1).mean()))


def played(skinning: ssdr.Skinning) -> np.ndarray:
    """Frames of a model, skinned by code of the tests alone."""
    s = skinning
    return motions.blend(s.rest, s.indices, s.weights, s.transforms)


def rmse_of(skinning: ssdr.Skinning, array: np.ndarray) -> float:
    return pooled(array, played(skinning))


def largest_of(skinning: ssdr.Skinning, array: np.ndarray) -> float:
    """Largest distance of a vertex from its position in `array`."""
    return float(np.sqrt(((played(skinning) - array) ** 2).sum(axis=-1).max()))


def bits(result: ssdr.Decomposition) -> tuple[bytes, ...]:
    """All numbers of a model, its hierarchy among them."""
    s = result.skinning
    arrays = (s.rest, s.indices, s.weights, s.transforms, s.parents, s.joint_positions)
    return tuple(a.tobytes() for a in arrays if a is not None)


def bits_on_threads(
    solve: Callable[[], ssdr.Decomposition], counts: Sequence[int] = (1, 2)
) -> set[tuple[bytes, ...]]:
    """Set of the results for these numbers of threads: one element if all are the same."""
    found = set()
    try:
        for count in counts:
            ssdr.set_threads(count)
            found.add(bits(solve()))
    finally:
        ssdr.set_threads(None)
    return found


def check(
    result: ssdr.Decomposition,
    array: np.ndarray,
    bones: int,
    influences: int = 4,
    *,
    falls: bool = True,
) -> ssdr.Decomposition:
    """Assert what holds for every result; `falls`: also that its history never rises."""
    s = result.skinning
    n_frames, n = array.shape[:2]
    assert s.transforms.shape == (n_frames, bones, 3, 4)
    assert s.rest.shape == (n, 3)
    assert np.isfinite(s.rest).all()
    assert s.indices.shape == s.weights.shape == (n, influences)
    assert s.indices.min() >= 0
    assert s.indices.max() < bones
    assert s.weights.min() >= 0
    assert np.abs(s.weights.sum(axis=1) - 1).max() < 1e-6
    assert (np.diff(s.weights, axis=1) <= 1e-12).all()
    assert (s.indices[s.weights == 0] == 0).all()
    check_kind(s.transforms, s.bone_model)
    rounding = 1e-13 * size_of(s, array)
    assert result.rmse == pytest.approx(rmse_of(s, array), rel=1e-6, abs=rounding)
    errors = [record.rmse for record in result.history]
    assert not falls or (np.diff(errors) <= 0).all()
    assert errors[-1] == result.rmse
    assert (np.diff([record.elapsed for record in result.history]) >= 0).all()
    assert (np.diff([record.iteration for record in result.history]) >= 0).all()
    assert result.history[0].elapsed > 0
    ends = ("converged", "effort spent")
    if getattr(result, "parsimony", None) is not None:  # of a search for the smallest
        ends = ("tolerance held", "tolerance out of reach")
    assert result.stop_reason in (*ends, "time limit", "cancelled")
    assert result.converged == (result.stop_reason == ends[0])
    return result


def broken(
    result: ssdr.Decomposition, array: np.ndarray, bones: int, influences: int = 4, **options: bool
) -> str:
    """The assertion of :func:`check` that fails, or an empty text."""
    try:
        check(result, array, bones, influences, **options)
    except AssertionError as error:
        frames = traceback.extract_tb(error.__traceback__)
        return str(frames[-1].line)
    return ""


def size_of(skinning: ssdr.Skinning, array: np.ndarray) -> float:
    """The largest of the numbers that are added up, to which rounding is relative."""
    parts = (array, skinning.rest, skinning.transforms[..., 3])
    return float(max(np.abs(part.astype(np.float64)).max() for part in parts))


class Ticks:
    """Clock of a run that is `step` seconds later at each reading, however long the run takes."""

    def __init__(self, patch: pytest.MonkeyPatch, step: float) -> None:
        self.now, self.step = 0.0, step
        clock = SimpleNamespace(perf_counter=self.read, monotonic=self.read)
        patch.setattr(progress, "time", clock)
        patch.setattr(warmup, "time", clock)

    def read(self) -> float:
        self.now += self.step
        return self.now


def largest_gap(a, b):
    """Largest distance from a point of either set to the nearest of the other."""
    return max(cKDTree(x).query(y)[0].max() for x, y in ((a, b), (b, a)))
