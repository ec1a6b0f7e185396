"""Descents: what they accept, several starts, and `best` that is no worse than `balanced`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.measures import descent_of
from ssdr.search.descent import Descent, Schedule, step
from ssdr.search.progress import Stop
from ssdr.search.steps import lowest
from ssdr.solver.model import Model
from ssdr.solver.trajectories import gather


def beam(frames: int, rings: int) -> tuple[np.ndarray, np.ndarray]:
    """A smooth motion of few vertices: a bar that bends while waves run along it."""
    rest = np.array([[x, y, z] for x in np.linspace(0, 4, rings) for y in (0, 1) for z in (0, 1)])
    out = []
    for t in range(frames):
        angle = 0.1 * np.sin(0.7 * t) * rest[:, 0] + 0.1 * np.cos(0.3 * t)
        c, s = np.cos(angle), np.sin(angle)
        wave = rest[:, 2] + 0.2 * np.sin(t + rest[:, 0])
        out.append(
            np.stack([c * rest[:, 0] - s * rest[:, 1], s * rest[:, 0] + c * rest[:, 1], wave], 1)
        )
    return np.array(out), rest


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frames", "rings", "options"),
    [
        (15, 10, {"bones": 4, "influences": 1}),
        (10, 12, {"bones": 5, "start": ssdr.Kept(rest=beam(10, 12)[1])}),
        (6, 7, {"bones": 25, "influences": 1}),
    ],
)
def test_best_is_no_worse_than_balanced(
    frames: int, rings: int, options: dict[str, object]
) -> None:
    """The quick start alone ended at two to eight times its error here."""
    moving, _ = beam(frames, rings)
    balanced, best = (
        ssdr.decompose(moving, effort=effort, **options).rmse for effort in ("balanced", "best")
    )
    assert best <= balanced + 1e-11  # of a beam of length four: rounding


def start_at(error: float, seen: list[float]) -> Schedule:
    """A start whose vertices all have this error."""

    @step("start")
    def made(d: Descent) -> Iterator[None]:
        seen.append(error)
        moves = np.tile(np.eye(3, 4), (d.data.n_frames, 3, 1, 1))
        label = np.arange(d.data.n_vertices) % 3
        d.model = Model.start(moves, d.data.frame(0), label, 2)
        d.model.error[:] = error
        yield

    return made


@pytest.mark.parametrize("least", [0, 1, 2])
def test_the_lowest_of_several_starts_goes_on(least: int) -> None:
    data = gather([ssdr.MeshSequence(motions.chain(bones=3, frames=8).frames)], bones=3)
    seen: list[float] = []
    errors = [1.0 if k == least else 2.0 + k for k in range(3)]
    d = descent_of(data, 3, 2)
    reason = d.follow(lambda d: lowest(d, *[start_at(error, seen) for error in errors]))
    assert reason == "effort spent"
    assert seen == errors
    assert (d.model.error == 1.0).all()
    assert d.best.value == d.value(d.model)
    assert d.fraction == 1.0


def test_a_descent_ends_early_where_nothing_is_left_or_it_is_stopped() -> None:
    data = gather([ssdr.MeshSequence(motions.chain(bones=3, frames=8).frames)], bones=3)
    seen: list[float] = []

    def schedule(d: Descent) -> None:
        for error in (5.0, 0.0, 7.0):
            start_at(error, seen)(d)

    d = descent_of(data, 3, 2)
    assert d.follow(schedule) == "converged"
    assert seen == [5.0, 0.0]
    assert [error for _, _, error, _ in d.records] == [5.0 * data.n_vertices, 0.0]

    def stop(phase: str) -> None:
        raise Stop(f"enough of {phase}")

    d = descent_of(data, 3, 2)
    assert d.follow(schedule, stop) == "enough of start"
    assert 0 < d.fraction < 1
