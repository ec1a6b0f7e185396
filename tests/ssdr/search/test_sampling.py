"""A search on a sample of the vertices, and the way back to all of them."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.measures import run_of
from ssdr.drivers.schedule import FIRST_MODEL, merged_start
from ssdr.search.given import Given
from ssdr.search.run import Run
from ssdr.search.sampling import AllVertices, ReturnToBest, SampleVertices
from ssdr.search.stages import Alternate, MoveBones
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


def new_run(*stages: object, rest: bool = False) -> Run:
    data = gather([ssdr.MeshSequence(strip())], bones=BONES, compress=False)
    given = Given(rest=data.frame(3).copy() if rest else None)
    stages = (*FIRST_MODEL, *stages)
    return run_of(data, stages, BONES, INFLUENCES, locked=Locked(rest=rest), given=given)


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
    run = new_run(SampleVertices(least=EACH, most=EACH))
    run.drive()
    assert run.chosen is not None
    assert len(run.chosen) == EACH * BONES == len(np.unique(run.chosen))
    rank = np.argsort(np.argsort(run.whole.x2))[run.chosen]
    assert np.diff(np.sort(rank)).max() <= -(-run.whole.n_vertices // (EACH * BONES)) + 1
    assert run.data.n_vertices == EACH * BONES
    np.testing.assert_array_equal(run.data.z, run.whole.z[run.chosen])
    np.testing.assert_array_equal(run.present.rest, run.best_model.rest[run.chosen])
    assert run.present.weighted_error(run.data) == pytest.approx(
        float(run.best_model.error[run.chosen].sum())
    )


def test_a_small_mesh_stays_whole() -> None:
    run = new_run(SampleVertices(least=80), AllVertices())
    before = run.whole.n_vertices
    run.drive()
    assert run.chosen is None
    assert run.data.n_vertices == before


@pytest.mark.parametrize("rest", [False, True])
def test_the_way_back_ends_on_a_model_of_all_vertices(rest: bool) -> None:
    search = (*merged_start(12, 6), MoveBones(steps=4))
    run = new_run(SampleVertices(least=EACH, most=EACH), *search, AllVertices(), rest=rest)
    run.drive()
    model = run.present
    assert model.n_bones == BONES
    assert len(model.rest) == run.whole.n_vertices
    assert run.chosen is None
    value = model.weighted_error(run.whole)  # in a basis that loses a little
    assert value == pytest.approx(true_error(run.whole, model), rel=0.02)
    # as good as a search among all vertices, about
    alone = new_run(*search, rest=rest)
    alone.drive()
    assert value < 1.3 * alone.best_value
    if rest:
        np.testing.assert_array_equal(model.rest, run.given.rest)


def test_nothing_is_recorded_on_a_sample() -> None:
    run = new_run(SampleVertices(least=EACH, most=EACH), Alternate(steps=5))
    run.drive()
    assert len(run.best_model.rest) == run.whole.n_vertices
    assert run.records == [r for r in run.records if r[3] in ("quick", "alternate", "compress")]
    seen = len(run.records)
    again = new_run()
    again.drive()
    assert len(again.records) == seen
    assert again.best_value == run.best_value


def test_the_way_back_leads_to_the_best_model_of_all_vertices() -> None:
    stages = (Alternate(steps=2), AllVertices(), ReturnToBest())
    run = new_run(SampleVertices(least=EACH, most=EACH), *stages)
    run.drive()
    assert run.present.weighted_error(run.data) == run.best_value
