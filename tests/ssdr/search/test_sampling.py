"""A search on a sample of the vertices, and the way back to all of them."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.measures import descent_of
from ssdr.search.descent import Descent, Schedule, motion_sample
from ssdr.search.problem import Initial
from ssdr.search.progress import Stop
from ssdr.search.starts import first_model, merged_start
from ssdr.search.steps import alternate, move_bones, on_sample
from ssdr.solver.model import Constraints, Model
from ssdr.solver.trajectories import Trajectories, gather

BONES, INFLUENCES, EACH = 4, 2, 40


def strip(frames: int = 12, columns: int = 150) -> np.ndarray:
    """A strip that waves, (F, 4 columns, 3)."""
    x, y = np.meshgrid(np.linspace(0, 5, columns), np.linspace(0, 0.5, 4), indexing="ij")
    time = np.linspace(0, 6, frames)[:, None, None]
    z = 0.4 * np.sin(1.3 * x + time) + 0.1 * np.cos(2.1 * x - 1.7 * time) * y
    flat = np.broadcast_to(np.stack([x, y], -1), (frames, *x.shape, 2))
    return np.concatenate([flat, z[..., None]], -1).reshape(frames, -1, 3)


def few_vertices(d: Descent, schedule: Schedule) -> None:
    on_sample(d, schedule, least=EACH, most=EACH)


def descent(rest: bool = False) -> Descent:
    data = gather([ssdr.MeshSequence(strip())], bones=BONES, compress=False)
    initial = Initial(rest=data.frame(3).copy() if rest else None)
    return descent_of(
        data, BONES, INFLUENCES, constraints=Constraints(lock_rest=rest), initial=initial
    )


def followed(*parts: Schedule, rest: bool = False) -> Descent:
    """A descent that has made a first model and followed some schedules."""
    d = descent(rest)

    def schedule(d: Descent) -> None:
        for part in (first_model, *parts):
            part(d)

    d.follow(schedule)
    return d


def true_error(data: Trajectories, model: Model) -> float:
    """Σ |x − Σ w M p|² over all frames, as the formula has it."""
    total = 0.0
    for t in range(data.n_frames):
        moved = np.einsum("jab,vb->vja", model.transforms[t, :, :, :3], model.rest)
        moved += model.transforms[t, :, :, 3]
        mixed = np.take_along_axis(moved, model.indices[..., None], axis=1)
        gap = data.frame(t) - np.einsum("vk,vka->va", model.weights, mixed)
        total += float((gap**2).sum())
    return total


def test_a_sample_is_spread_from_still_to_wild_vertices() -> None:
    seen: list[Descent] = []
    d = followed(lambda d: few_vertices(d, seen.append))
    few, chosen = seen[-1], motion_sample(d.data, EACH * BONES)
    assert len(np.unique(chosen)) == len(chosen) == few.data.n_vertices
    rank = np.argsort(np.argsort(d.data.x2))[chosen]
    assert np.diff(np.sort(rank)).max() <= -(-d.data.n_vertices // (EACH * BONES)) + 1
    np.testing.assert_array_equal(few.data.z, d.data.z[chosen])


def test_a_small_mesh_stays_whole() -> None:
    seen: list[Descent] = []
    d = followed(lambda d: seen.append(d) if on_sample(d, seen.append, least=80) else None)
    assert seen[-1] is d
    assert d.few is None
    assert d.data.n_vertices == strip().shape[1]


@pytest.mark.parametrize("rest", [False, True])
def test_the_way_back_ends_on_a_model_of_all_vertices(rest: bool) -> None:
    def search(d: Descent) -> None:
        merged_start(d)
        move_bones(d, steps=4)

    d = followed(lambda d: few_vertices(d, search), rest=rest)
    model = d.model
    assert model.n_bones == BONES
    assert len(model.rest) == d.data.n_vertices
    assert d.few is None
    value = model.weighted_error(d.data)  # in a basis that loses a little
    assert value == pytest.approx(true_error(d.data, model), rel=0.02)
    # as good as a search among all vertices, about
    alone = followed(search, rest=rest)
    assert value < 1.3 * alone.best.value
    if rest:
        np.testing.assert_array_equal(model.rest, d.initial.rest)


def test_a_stop_on_a_sample_keeps_what_it_found() -> None:
    """The model of a sample is carried over to all vertices before the descent ends."""

    def stop(phase: str) -> None:
        if stopping and phase == "alternate" and d.few is not None:
            raise Stop("time limit")

    def schedule(d: Descent) -> None:
        first_model(d)
        stopping.append(not d.planning)
        few_vertices(d, lambda d: (merged_start(d), alternate(d, steps=4)))

    stopping: list[bool] = []
    d = descent()
    assert d.follow(schedule, stop) == "time limit"
    first = followed()
    assert d.best.value < first.best.value
    assert d.best.value == d.value(d.best.model)
    *_, (iteration, _, error, phase) = d.records
    assert (iteration, phase) == (d.work.iteration, "all vertices")
    assert error == d.best.model.weighted_error(d.data) < d.records[-2][2]
