"""A search on a sample of the vertices, and the way back to all of them."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.measures import descent_of
from ssdr.problem.initial import Initial
from ssdr.search.bone_steps import move_bones
from ssdr.search.descent import Descent, Schedule
from ssdr.search.schedule_parts import first_model, merged_start
from ssdr.search.steps import all_vertices, alternate, return_to_best, sample_vertices
from ssdr.solver.model import Locked, Model
from ssdr.solver.trajectories import Trajectories, gather

BONES, INFLUENCES, EACH = 4, 2, 40


def strip(frames: int = 12, columns: int = 150) -> np.ndarray:
    """A strip that waves, (F, 4 columns, 3)."""
    x, y = np.meshgrid(np.linspace(0, 5, columns), np.linspace(0, 0.5, 4), indexing="ij")
    time = np.linspace(0, 6, frames)[:, None, None]
    z = 0.4 * np.sin(1.3 * x + time) + 0.1 * np.cos(2.1 * x - 1.7 * time) * y
    flat = np.broadcast_to(np.stack([x, y], -1), (frames, *x.shape, 2))
    return np.concatenate([flat, z[..., None]], -1).reshape(frames, -1, 3)


def few_vertices(d: Descent) -> None:
    sample_vertices(d, least=EACH, most=EACH)


def followed(*parts: Schedule, rest: bool = False) -> Descent:
    """A descent that has made a first model and followed some schedules."""
    data = gather([ssdr.MeshSequence(strip())], bones=BONES, compress=False)
    given = Initial(rest=data.frame(3).copy() if rest else None)
    d = descent_of(data, BONES, INFLUENCES, locked=Locked(rest=rest), initial=given)

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
    d = followed(few_vertices)
    assert d.chosen is not None
    assert len(d.chosen) == EACH * BONES == len(np.unique(d.chosen))
    rank = np.argsort(np.argsort(d.full.x2))[d.chosen]
    assert np.diff(np.sort(rank)).max() <= -(-d.full.n_vertices // (EACH * BONES)) + 1
    assert d.data.n_vertices == EACH * BONES
    np.testing.assert_array_equal(d.data.z, d.full.z[d.chosen])
    np.testing.assert_array_equal(d.model.rest, d.best_model.rest[d.chosen])
    assert d.model.weighted_error(d.data) == pytest.approx(
        float(d.best_model.error[d.chosen].sum())
    )


def test_a_small_mesh_stays_whole() -> None:
    d = followed(lambda d: sample_vertices(d, least=80), all_vertices)
    assert d.chosen is None
    assert d.data.n_vertices == strip().shape[1]


@pytest.mark.parametrize("rest", [False, True])
def test_the_way_back_ends_on_a_model_of_all_vertices(rest: bool) -> None:
    def search(d: Descent) -> None:
        merged_start(d)
        move_bones(d, steps=4)

    d = followed(few_vertices, search, all_vertices, rest=rest)
    model = d.model
    assert model.n_bones == BONES
    assert len(model.rest) == d.full.n_vertices
    assert d.chosen is None
    value = model.weighted_error(d.full)  # in a basis that loses a little
    assert value == pytest.approx(true_error(d.full, model), rel=0.02)
    # as good as a search among all vertices, about
    alone = followed(search, rest=rest)
    assert value < 1.3 * alone.best_value
    if rest:
        np.testing.assert_array_equal(model.rest, d.initial.rest)


def test_nothing_is_recorded_on_a_sample() -> None:
    d = followed(few_vertices, lambda d: alternate(d, steps=5))
    assert len(d.best_model.rest) == d.full.n_vertices
    assert d.records == [r for r in d.records if r[3] in ("quick", "alternate", "compress")]
    seen = len(d.records)
    again = followed()
    assert len(again.records) == seen
    assert again.best_value == d.best_value


def test_the_way_back_leads_to_the_best_model_of_all_vertices() -> None:
    d = followed(few_vertices, lambda d: alternate(d, steps=2), all_vertices, return_to_best)
    assert d.model.weighted_error(d.data) == d.best_value
