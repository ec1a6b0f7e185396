"""What was made by a model is found again: exact data leave no error but that of rounding."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions, stretches, trees
from helpers.measures import check, diagonal
from ssdr.search import scan

Made = tuple[np.ndarray, dict[str, Any]]  # frames, and what to call `decompose` with


def of(exact: motions.Rig, **options: Any) -> Made:
    bones = exact.transforms.shape[1]
    return exact.frames, {"faces": exact.faces, "bones": bones} | options


def hung(off: float = 0.0, **options: Any) -> Made:
    """Six bones with joints; what is given is their skeleton, with joints that are off by this."""
    made = trees.six_bones()
    away = diagonal(made.frames) * np.random.default_rng(0).normal(size=(6, 3)) / np.sqrt(3)
    given = dataclasses.replace(made.skinning(), joint_positions=made.points + off * away)
    return made.frames, {"rig": ssdr.Skeleton(given), "influences": 2} | options


def later_frames() -> Made:
    """Frames none of which is the rest pose; the factors of the error vanish with it."""
    exact = motions.chain(2, bones=3, frames=25, rows=12)
    return exact.frames[5:], {"faces": exact.faces, "bones": 3}


def stretching(kind: str) -> Made:
    return stretches.rig(kind, rows=24).frames, {"bones": 4, "bone_model": kind}


def parts(*names: str) -> Made:
    exact = motions.chain(bones=5, rows=14, frames=15)
    return of(exact, faces=None, start=ssdr.Kept(**{n: getattr(exact, n) for n in names}))


def chain(seed: int, **options: Any) -> Made:
    return of(motions.chain(seed, bones=5, frames=25), **options)


def long_chain(**options: Any) -> Made:
    return of(motions.chain(2, bones=5, frames=120), faces=None, **options)


# the largest error that passes, as a part of the diagonal
EXACT: dict[str, tuple[float, Callable[[], Made]]] = {
    "separate boxes": (1e-10, lambda: of(motions.boxes(2), faces=None)),
    **{
        f"27 pieces, {o}": (1e-12, lambda o=o: of(motions.pieces(27), **o))
        for o in ({"influences": 1, "effort": "fast"}, {"effort": "balanced"})
    },
    **{
        f"chain {seed}, {effort}": (
            1e-4 if effort == "best" else 5e-3,
            lambda seed=seed, effort=effort: chain(seed, effort=effort),
        )
        for seed in range(3)
        for effort in ("fast", "balanced", "best")
    },
    "sixteen bones, best": (
        1e-4,
        lambda: of(motions.chain(4, bones=16, frames=25, rows=64, bend=0.4), effort="best"),
    ),
    "similarity": (5e-4, lambda: stretching("similarity")),
    "affine": (5e-4, lambda: stretching("affine")),
    "no frame is the rest pose": (1e-4, later_frames),
    "a given rest pose": (1e-4, lambda: parts("rest")),
    "given weights": (1e-4, lambda: parts("indices", "weights")),
    "a skeleton": (1e-5, hung),
    "a skeleton whose joints are off": (1e-5, lambda: hung(0.02)),
    "streamed": (1e-3, long_chain),
    "streamed, best": (1e-4, lambda: long_chain(effort="best")),
}


def marked(name: str) -> Any:
    return pytest.param(
        name, marks=[pytest.mark.slow] * (name.endswith("best") or "stream" in name)
    )


@pytest.mark.parametrize("name", [*map(marked, EXACT)])
def test_exact_data_are_found_again(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    bound, make = EXACT[name]
    if name.startswith("streamed"):
        for constant, value in (("_IN_MEMORY", 1), ("_FEWEST", 40), ("_MOST", 40)):
            monkeypatch.setattr(scan, constant, value)
    array, options = make()
    result = ssdr.decompose(array, **options)
    model = result.skinning
    check(result, array, model.n_bones, options.get("influences", 4))
    assert result.rmse < bound * diagonal(array)
    start = options.get("start")
    if start and start.rest is not None:
        np.testing.assert_allclose(model.rest, start.rest, atol=1e-12)
    if start and start.weights is not None:
        exact = motions.model(model.rest, start.indices, start.weights, bones=5).dense_weights()
        np.testing.assert_allclose(model.dense_weights(), exact, atol=1e-14)
    if isinstance(options.get("rig"), ssdr.Skeleton):
        np.testing.assert_array_equal(model.parents, trees.six_bones().parents)


@pytest.mark.slow
def test_fox_is_recovered(real: Callable[[str], ssdr.MeshSequence]) -> None:
    fox = real("fox")
    result = check(ssdr.decompose(fox, bones=24), np.asarray(fox.vertices, dtype=np.float64), 24)
    assert result.rmse < 1e-4 * fox.diagonal()


def test_separate_boxes_have_a_bone_each() -> None:
    exact = motions.boxes(2)
    result = ssdr.decompose(exact.frames, bones=2)
    assert result.converged
    assert not result.warnings
    owner = result.skinning.indices[:, 0]
    assert len(set(owner[:30])) == len(set(owner[30:])) == 1
    assert (result.skinning.weights[:, 0] > 1 - 1e-6).all()


@pytest.mark.parametrize("kind", stretches.KINDS)
def test_data_of_a_kind_are_not_found_by_less(kind: str) -> None:
    array, _ = stretching(kind)
    less = stretches.MODELS[stretches.MODELS.index(kind) - 1]
    found = ssdr.decompose(array, bones=4, bone_model=less)
    assert found.rmse > 4e-3 * diagonal(array)
