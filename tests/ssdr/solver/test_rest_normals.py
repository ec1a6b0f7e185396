"""Rest normals of a model, the normals that they are fitted to, and their part of the objective."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers import naive, terms
from helpers.terms import Case
from ssdr.solver.initialization import with_rest_normals
from ssdr.solver.model import FREE, Constraints
from ssdr.solver.objective import Objective, normal_length, rest_pulls
from ssdr.solver.trajectories import gather


def test_normals_of_the_frames_are_those_of_their_triangles() -> None:
    case = Case(surface=False, counts="some")
    data, _ = terms.problem(case, n=20, frames=5)
    frames = np.stack([data.frame(t) for t in range(data.n_frames)])
    scale = data.frame_scale[:, None, None]
    want = scale * terms.frame_normals(frames, data.faces)
    found = data.normals.reshape(20, 5, 3).transpose(1, 0, 2)
    np.testing.assert_allclose(found, want, atol=1e-12)
    np.testing.assert_allclose(data.n2, (want**2).sum(axis=(0, 2)), rtol=1e-12)


@pytest.mark.parametrize("frames", [1, 65])
def test_a_frame_alone_stays_as_it_is(frames: int) -> None:
    """Frames are taken 64 at a time, so that the last of 65 is alone."""
    data, _ = terms.problem(Case(surface=False, normals=False, counts="some"), n=20, frames=frames)
    scaled = dataclasses.replace(data, frame_scale=2 * data.frame_scale)
    before = data.z.copy()
    found = scaled.with_normals()
    np.testing.assert_array_equal(data.z, before)
    np.testing.assert_allclose(found.normals, 2 * data.with_normals().normals, atol=1e-12)


def test_compressed_normals_lose_nothing_that_bones_can_follow() -> None:
    """Products with transforms that the basis holds are those of all columns."""
    data, model = terms.problem(Case(surface=False, compressed=True))
    x = data.z @ data.q.T
    frames = x.reshape(80, 24, 3).transpose(1, 0, 2)
    full = terms.frame_normals(frames, data.faces).transpose(1, 0, 2).reshape(80, -1)
    np.testing.assert_allclose(data.normals, full @ data.q, atol=1e-12)
    np.testing.assert_allclose(data.n2, (full**2).sum(axis=1), rtol=1e-12)
    assert model.normals.shape == (80, 1, 3)


def test_a_sheet_of_few_translations_gets_a_basis_of_its_normals() -> None:
    """Its positions have rank 3, in which no normal turns."""
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 11)))
    ring = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    frames = np.stack([np.stack([x, y, 0.2 * np.sin(9 * x - t)], axis=-1) for t in ring])
    i = np.arange(231).reshape(11, 21)
    faces = np.stack([i[:-1, :-1], i[:-1, 1:], i[1:, 1:]], axis=-1).reshape(-1, 3)
    full = gather([ssdr.MeshSequence(frames, faces)], bones=6, compress=False)
    few, want = full.compressed(6), full.with_normals()
    assert few.q.shape[1] < 24  # of 120: 3, and what a processor's rounding adds
    found = few.with_normals(6)
    np.testing.assert_allclose(found.q.T @ found.q, np.eye(found.q.shape[1]), atol=1e-12)
    np.testing.assert_allclose(found.z @ found.q.T, few.z @ few.q.T, atol=1e-12)
    np.testing.assert_allclose(found.normals @ found.q.T, want.normals, atol=0.02)
    np.testing.assert_allclose(found.n2, want.n2)
    assert np.abs(few.with_normals().normals @ few.q.T - want.normals).max() > 0.9


@pytest.mark.parametrize("counts", ["equal", "some"])
def test_rest_normals_are_the_least_squares_fit(counts: str) -> None:
    data, model = terms.problem(Case(surface=False, counts=counts), n=20, frames=5)
    frames = np.stack([data.frame(t) for t in range(data.n_frames)])
    scale = data.frame_scale[:, None, None]
    target = scale * terms.frame_normals(frames, data.faces)
    turns = model.transforms.copy()
    turns[..., 3] = 0
    turns *= scale[..., None]
    want = naive.rest_position(target, model.indices, model.weights, turns)
    np.testing.assert_allclose(model.normals[:, 0], want, rtol=1e-6, atol=1e-6)
    error = naive.squared_error(target, want, model.indices, model.weights, turns)
    np.testing.assert_allclose(model.normal_error, error, rtol=1e-6)


def test_bones_that_turn_a_normal_away_leave_none() -> None:
    """Where the blend of turns is singular the fit stays finite, and no longer than it need be."""
    data, model = terms.problem(Case(surface=False), n=20, frames=5)
    model.transforms[..., :3] = 0.0
    found = with_rest_normals(data, model)
    assert (found.normals == 0).all()
    np.testing.assert_allclose(found.normal_error, data.n2, rtol=1e-12)


@pytest.mark.parametrize("slack", [0.0, 3.0])
def test_the_length_of_a_normal_makes_both_errors_count_alike(slack: float) -> None:
    data, model = terms.problem(Case(counts="some", slack=slack), n=20, frames=5)

    def slope(name: str) -> float:
        ends = []
        for sign in (1e-6, -1e-6):
            moved = model.copy()
            getattr(moved, name)[3] += sign
            ends.append(Objective().value(data, moved))
        return (ends[0] - ends[1]) / 2e-6

    ratio = slope("normal_error") / slope("error")
    assert normal_length(data, model) ** 2 == pytest.approx(ratio, rel=1e-6)
    without = dataclasses.replace(model, normals=model.normals[:, :0])
    assert normal_length(data, without) == 0
    assert normal_length(dataclasses.replace(data, normals=None, n2=None), model) == 0


def test_there_are_pulls_only_on_a_free_rest_pose_with_a_surface_and_errors() -> None:
    data, model = terms.problem(Case(normals=False), n=20, frames=5)
    pulls = rest_pulls(data, model, FREE)
    assert (pulls[:, 0] > 0).all()
    error = model.weighted_error(data)
    np.testing.assert_array_equal(pulls, data.surface.pulls(model.rest, error, data.importance))
    more = rest_pulls(data, model, FREE, error)
    np.testing.assert_allclose(more[:, 0], 2 * pulls[:, 0], rtol=1e-12)
    unknown = dataclasses.replace(model, error=np.full(20, np.inf))
    few = dataclasses.replace(data, importance=np.arange(20) % 2 * 2.0)
    assert (rest_pulls(few, unknown, FREE) == 0).all()
    assert (rest_pulls(data, model, Constraints(lock_rest=True)) == 0).all()
    assert (rest_pulls(dataclasses.replace(data, surface=None), model, FREE) == 0).all()
