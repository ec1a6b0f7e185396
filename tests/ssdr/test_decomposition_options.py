"""``ssdr.decompose`` with what callers want: parts that stay, smooth weights, importances."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions, naive
from helpers.measures import diagonal, frames, rig, rmse_of
from helpers.promises import check

# fixed parts


def test_given_rest_pose_stays() -> None:
    rest = rig().rest + 0.01
    fixed = check(ssdr.decompose(frames(), bones=5, rest=rest), frames(), 5)
    np.testing.assert_allclose(fixed.skinning.rest, rest, atol=1e-13)
    assert ssdr.decompose(frames(), bones=5).rmse < fixed.rmse < 0.2


def test_given_exact_rest_pose() -> None:
    exact = rig().frames
    fixed = check(ssdr.decompose(exact, bones=5, rest=rig().rest), exact, 5)
    assert fixed.rmse < 1e-4 * diagonal(exact)


@pytest.mark.filterwarnings("ignore:1 of 5 bones could")  # the fifth has next to no weight
def test_given_weights_stay() -> None:
    w = rig().weights + 1e-5
    w /= w.sum(axis=1, keepdims=True)
    indices = np.tile(np.arange(5)[None], (84, 1))
    dense = np.zeros((84, 5))
    np.put_along_axis(dense, rig().indices, w, axis=1)
    np.add.at(dense, (np.arange(84), 4), 1 - dense.sum(axis=1))
    dense = np.abs(dense) / np.abs(dense).sum(axis=1, keepdims=True)
    result = ssdr.decompose(frames(), bones=5, influences=5, indices=indices, weights=dense)
    check(result, frames(), 5, 5)
    got = result.skinning.sparse_weights().toarray()
    np.testing.assert_allclose(got, dense, atol=1e-14)


def test_given_exact_weights_are_enough() -> None:
    exact = rig().frames
    result = check(
        ssdr.decompose(exact, bones=5, indices=rig().indices, weights=rig().weights), exact, 5
    )
    np.testing.assert_allclose(
        result.skinning.sparse_weights().toarray(),
        ssdr.Skinning(rig().rest, rig().indices, rig().weights, rig().transforms)
        .sparse_weights()
        .toarray(),
        atol=1e-14,
    )
    assert result.rmse < 1e-4 * diagonal(exact)


def test_locked_vertices_keep_their_weights() -> None:
    locked = np.arange(84) % 3 == 0
    wrong = np.zeros((84, 1), dtype=int)
    result = check(
        ssdr.decompose(
            frames(), bones=5, indices=wrong, weights=np.ones((84, 1)), locked_vertices=locked
        ),
        frames(),
        5,
    )
    s = result.skinning
    assert (s.indices[locked] == 0).all()
    assert (s.weights[locked] == [1, 0, 0, 0]).all()
    assert (s.weights[~locked, 0] < 1).any()
    with pytest.warns(ssdr.SsdrWarning, match="4 of 5"):
        everything = ssdr.decompose(frames(), bones=5, indices=wrong, weights=np.ones((84, 1)))
    assert result.rmse < 0.9 * everything.rmse


@pytest.mark.parametrize("locked", [[0], [3], [1, 4], [0, 1, 2, 3, 4], None])
def test_locked_bones_stay(locked: list[int] | None) -> None:
    given = rig().transforms.copy()
    given[..., 3] += 0.3 * np.random.default_rng(0).standard_normal(given[..., 3].shape)
    which = range(5) if locked is None else locked
    for bones in (5, 7):
        result = check(
            ssdr.decompose(frames(), bones=bones, transforms=given, locked_bones=locked),
            frames(),
            bones,
        )
        for j in which:
            np.testing.assert_allclose(result.skinning.transforms[:, j], given[:, j], atol=1e-12)
    free = ssdr.decompose(frames(), bones=5, transforms=given, locked_bones=[])
    held = ssdr.decompose(frames(), bones=5, transforms=given, locked_bones=locked)
    assert free.rmse < held.rmse


def test_given_skeleton_is_worth_having() -> None:
    """With the true bones held, the exact model is found; and extra bones only help."""
    exact = rig().frames
    result = check(ssdr.decompose(exact, bones=5, transforms=rig().transforms), exact, 5)
    assert result.rmse < 1e-5 * diagonal(exact)
    fewer = rig().transforms[:, :3]
    some = check(ssdr.decompose(exact, bones=3, transforms=fewer), exact, 3)
    more = check(ssdr.decompose(exact, bones=5, transforms=fewer), exact, 5)
    assert more.rmse < 0.1 * some.rmse
    np.testing.assert_allclose(more.skinning.transforms[:, :3], fewer, atol=1e-12)


def test_rest_frame() -> None:
    result = check(ssdr.decompose(frames(), bones=5, rest_frame=9), frames(), 5)
    assert result.rmse < 1.5 * ssdr.decompose(frames(), bones=5).rmse


# smoothness and importance


def test_smoothness_trades_error_for_dirichlet_energy() -> None:
    seen: list[list[float]] = []

    def run(length: float) -> tuple[float, float]:
        values: list[float] = []
        result = ssdr.decompose(
            frames(),
            rig().faces,
            bones=5,
            smoothness=length,
            effort="fast",
            callback=lambda p: values.append(p.rmse),
        )
        s = result.skinning
        seen.append(values)
        assert result.rmse == pytest.approx(rmse_of(s, frames()), rel=1e-6)
        return result.rmse, naive.dirichlet(rig().faces, s.indices, s.weights, 5)

    table = [run(length) for length in (0.0, 0.05, 0.5)]
    errors, energies = zip(*table, strict=True)
    assert energies[2] < 0.5 * energies[1] < 0.5 * energies[0]
    assert errors[0] < errors[1] < errors[2]
    for values in seen:  # progress tells the penalised objective
        assert (np.diff([v for v in values if np.isfinite(v)]) <= 0).all()


def test_vertex_importance_shifts_the_error() -> None:
    heavy = np.arange(84) < 42

    def error(importance: object) -> np.ndarray:
        result = ssdr.decompose(frames(), bones=3, vertex_importance=importance)
        gap = result.reconstruct() - frames()
        return np.array([np.sqrt((gap[:, m] ** 2).sum(-1).mean()) for m in (heavy, ~heavy)])

    even, uneven = error(None), error(np.where(heavy, 20.0, 1.0))
    assert uneven[0] < 0.8 * even[0]
    assert uneven[1] > even[1]
    np.testing.assert_allclose(error(np.full(84, 7.0)), even, rtol=0.05)


def test_vertices_of_no_importance_may_be_anything() -> None:
    exact = motions.chain(bones=4, frames=40, rows=24)
    array = exact.frames
    junk = np.arange(array.shape[1]) % 2 == 0
    array[:, junk] += 50 * np.random.default_rng(0).standard_normal((40, junk.sum(), 3))
    result = check_weighted(array, (~junk).astype(float))
    gap = (result.reconstruct() - array)[:, ~junk]
    assert np.sqrt((gap**2).sum(-1).mean()) < 1e-2 * diagonal(exact.frames)


def check_weighted(array: np.ndarray, importance: np.ndarray) -> ssdr.Decomposition:
    result = ssdr.decompose(array, bones=4, vertex_importance=importance)
    return check(result, array, 4)


def test_importances_stay_as_they_were_given() -> None:
    vertices, rows = np.arange(84.0), np.arange(1.0, 16.0)
    ssdr.decompose(
        frames(), bones=2, effort="fast", vertex_importance=vertices, frame_importance=rows
    )
    assert (vertices == np.arange(84)).all()
    assert (rows == np.arange(1, 16)).all()


def test_only_ratios_of_importance_count() -> None:
    results = [
        ssdr.decompose(
            frames(),
            bones=4,
            effort="fast",
            vertex_importance=size * np.arange(84.0),
            frame_importance=np.full(15, size),
        ).rmse
        for size in (1.0, 2.0**-1000, 2.0**1016)
    ]
    assert results[0] == results[1] == results[2]


def test_frame_importance_shifts_the_error() -> None:
    heavy = np.arange(15) % 5 == 0

    def error(importance: object) -> np.ndarray:
        result = ssdr.decompose(frames(), bones=3, frame_importance=importance)
        gap = result.reconstruct() - frames()
        return np.array([np.sqrt((gap[m] ** 2).sum(-1).mean()) for m in (heavy, ~heavy)])

    even, uneven = error(None), error(np.where(heavy, 50.0, 1.0))
    assert uneven[0] < 0.8 * even[0]
    assert uneven[1] > even[1]


@pytest.mark.parametrize("make", [motions.wings, motions.cloth])
@pytest.mark.parametrize("importance", [1e-4, 1e-12])
def test_a_frame_that_hardly_counts_is_skinned_all_the_same(
    make: Callable[[], Any], importance: float
) -> None:
    shots, _ = make()
    counts = np.ones(len(shots))
    counts[3] = importance
    for seed in (0, 1):
        result = ssdr.decompose(shots, bones=4, frame_importance=counts, rng=seed)
        error = ((result.reconstruct() - shots) ** 2).sum(axis=-1).mean(axis=1)
        assert error[3] <= 4 * np.delete(error, 3).max()


# what smoothness is for


@pytest.mark.parametrize("make", [motions.wings, motions.cloth])
@pytest.mark.parametrize("share", [3e-3, 1e-2])
def test_smoothness_finds_what_is_better_with_it(make: Callable[[], Any], share: float) -> None:
    """Lower by its own measure than what is found without, or nearly so; and smoother weights."""
    shots, faces = make()
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    length = share * float(np.linalg.norm(np.ptp(shots[0], axis=0)))

    def measured(smoothness: float) -> tuple[float, float]:
        model = ssdr.decompose(shots, faces, bones=6, smoothness=smoothness).skinning
        dense = np.zeros((shots.shape[1], 6))
        np.add.at(dense, (np.arange(len(dense))[:, None], model.indices), model.weights)
        jumps = float(((dense[edges[:, 0]] - dense[edges[:, 1]]) ** 2).sum())
        return float(((model.skin() - shots) ** 2).sum()) + len(shots) * length**2 * jumps, jumps

    without, with_it = measured(0.0), measured(length)
    assert with_it[0] <= 1.2 * without[0]
    if share == 1e-2:  # below that it is the error that decides
        assert with_it[1] < 1.2 * without[1]


def test_a_callback_that_writes_to_the_arrays_changes_nothing() -> None:
    """The error and the history were measured against what it had written."""
    rig = motions.chain(3, bones=4, frames=12)

    def call(callback=None):
        arrays = {
            "sequence": motions.wobble(rig, 0.1),
            "faces": rig.faces.copy(),
            "rest": rig.rest.copy(),
            "indices": rig.indices.copy(),
            "weights": rig.weights.copy(),
            "transforms": rig.transforms.copy(),
            "vertex_importance": np.linspace(1.0, 2.0, len(rig.rest)),
            "frame_importance": np.linspace(1.0, 2.0, 12),
            "locked_vertices": np.arange(5),
            "locked_bones": np.arange(2),
        }

        def spoil(_) -> None:
            for array in arrays.values():
                array[...] = 0

        follow = spoil if callback else None
        return ssdr.decompose(**arrays, bones=4, effort="fast", callback=follow)

    quiet, spoiled = call(), call(True)
    assert spoiled.rmse == quiet.rmse
    assert [r.rmse for r in spoiled.history] == [r.rmse for r in quiet.history]
    for name in ("rest", "indices", "weights", "transforms", "faces"):
        np.testing.assert_array_equal(
            getattr(spoiled.skinning, name), getattr(quiet.skinning, name), err_msg=name
        )


@pytest.mark.parametrize("smoothness", [1e100, 1e160, 1e200, 1e308])
def test_a_smoothness_whose_square_is_no_number(smoothness: float) -> None:
    """It ended in an OverflowError."""
    options: dict[str, Any] = {"bones": 3, "effort": "fast", "max_iterations": 5}
    result = ssdr.decompose(frames(), rig().faces, smoothness=smoothness, **options)
    strong = ssdr.decompose(frames(), rig().faces, smoothness=1e6, **options)
    assert result.rmse == pytest.approx(strong.rmse, rel=1e-6)
