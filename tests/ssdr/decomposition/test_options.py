"""``ssdr.decompose`` with what callers want: parts that stay, smooth weights, importances."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions, naive
from helpers.measures import bits, check, diagonal, frames, pooled, rig, rmse_of

# fixed parts


@pytest.mark.filterwarnings("ignore:1 of 5 bones could")  # the fifth has next to no weight
def test_given_weights_stay() -> None:
    indices = np.tile(np.arange(5), (84, 1))
    dense = rig().skinning.dense_weights() * (1 - 1e-5)
    dense[:, 4] += 1e-5
    start = ssdr.Kept(indices=indices, weights=dense)
    result = check(ssdr.decompose(frames(), bones=5, influences=5, start=start), frames(), 5, 5)
    np.testing.assert_allclose(result.skinning.dense_weights(), dense, atol=1e-14)


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
            normals=False,  # which a penalty leaves out
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
    for values, error in zip(seen, errors, strict=True):  # progress tells the error alone
        assert values[-1] == pytest.approx(error, rel=1e-3)


@pytest.mark.parametrize(("name", "heavy"), [
    ("vertex_importance", np.arange(84) < 42), ("frame_importance", np.arange(15) % 5 == 0),
])  # fmt: skip
def test_importance_shifts_the_error(name: str, heavy: np.ndarray) -> None:
    axis = ("frame_importance", "vertex_importance").index(name)

    def error(importance: object) -> np.ndarray:
        result = ssdr.decompose(frames(), bones=3, **{name: importance})
        found, true = (np.moveaxis(a, axis, 0) for a in (result.reconstruct(), frames()))
        return np.array([pooled(true[mask], found[mask]) for mask in (heavy, ~heavy)])

    even, uneven = error(None), error(np.where(heavy, 30.0, 1.0))
    assert uneven[0] < 0.8 * even[0]
    assert uneven[1] > even[1]
    np.testing.assert_allclose(error(np.full(len(heavy), 7.0)), even, rtol=0.05)


def test_vertices_of_no_importance_may_be_anything() -> None:
    exact = motions.chain(bones=4, frames=40, rows=24)
    array = exact.frames
    junk = np.arange(array.shape[1]) % 2 == 0
    array[:, junk] += 50 * np.random.default_rng(0).standard_normal((40, junk.sum(), 3))
    result = check(ssdr.decompose(array, bones=4, vertex_importance=~junk), array, 4)
    error = pooled(array[:, ~junk], result.reconstruct()[:, ~junk])
    assert error < 1e-2 * diagonal(exact.frames)


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


@pytest.mark.parametrize("make", [motions.wings, motions.cloth])
@pytest.mark.parametrize("importance", [1e-4, 1e-12])
def test_a_frame_that_hardly_counts_is_skinned_all_the_same(
    make: Callable[[], Any], importance: float
) -> None:
    shots, _ = make()
    counts = np.ones(len(shots))
    counts[3] = importance
    result = ssdr.decompose(shots, bones=4, frame_importance=counts)
    error = ((result.reconstruct() - shots) ** 2).sum(axis=-1).mean(axis=1)
    assert error[3] <= 4 * np.delete(error, 3).max()


# what smoothness is for


@pytest.mark.slow
@pytest.mark.parametrize("make", [motions.wings, motions.cloth])
def test_smoothness_finds_what_is_better_with_it(make: Callable[[], Any]) -> None:
    """Lower by its own measure than what is found without, or nearly so; and smoother weights.

    Both are sums over two seeds, each of which leads to a minimum of its own.
    """
    shots, faces = make()
    diagonal = float(np.linalg.norm(np.ptp(shots[0], axis=0)))

    def found(smoothness: float) -> tuple[float, float]:
        bare = {"rest_pose": "free", "normals": False}  # what the penalty alone does
        error = jumps = 0.0
        for seed in range(2):
            options = {"bones": 6, "smoothness": smoothness, "rng": seed, **bare}
            s = ssdr.decompose(shots, faces, **options).skinning
            jumps += naive.dirichlet(faces, s.indices, s.weights, 6)
            error += float(((s.skin() - shots) ** 2).sum())
        return error, jumps

    plain, jumps = found(0.0)
    for share in (3e-3, 1e-2):
        length = share * diagonal
        error, smoother = found(length)
        penalty = len(shots) * length**2
        assert error + penalty * smoother <= 1.2 * (plain + penalty * jumps)
        if share == 1e-2:  # below that it is the error that decides
            assert smoother < 1.2 * jumps


def test_a_callback_that_writes_to_the_parts_changes_nothing() -> None:
    chain = motions.chain(3, bones=4, frames=12)

    def call(spoils: bool) -> ssdr.Decomposition:
        counts = {
            "vertex_importance": np.linspace(1.0, 2.0, len(chain.rest)),
            "frame_importance": np.linspace(1.0, 2.0, 12),
        }
        names = ("rest", "indices", "weights")
        parts = {name: getattr(chain, name).copy() for name in names}

        def follow(_: object) -> None:
            for array in (*counts.values(), *parts.values()) if spoils else ():
                array[...] = 0

        array, start = motions.wobble(chain, 0.1), ssdr.Kept(**parts)
        call = {"bones": 4, "effort": "fast", "callback": follow}
        return ssdr.decompose(array, chain.faces, start=start, **counts, **call)

    quiet, spoiled = call(False), call(True)
    assert bits(spoiled) == bits(quiet)
    assert [r.rmse for r in spoiled.history] == [r.rmse for r in quiet.history]


@pytest.mark.parametrize("smoothness", [1e100, 1e160, 1e200, 1e308])
def test_a_smoothness_whose_square_is_no_number(smoothness: float) -> None:
    found, strong = (
        ssdr.decompose(frames(), rig().faces, smoothness=length, bones=3, effort="fast").rmse
        for length in (smoothness, 1e6)
    )
    assert found == pytest.approx(strong, rel=1e-6)
