"""Results follow the input, and a bone more never fits worse."""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.measures import largest_of, rmse_of

STEPS = 1e-8  # relative, steps without a choice
SINGLE = 1e-5  # the same in float32
TOLERANCE = 0.05  # relative, whole runs; 0.007 was measured
TOLERANCE_OF_WAVES = 0.5  # where nothing moves as a bone does there are many minima; 0.34
Frames = np.ndarray
Change = tuple[Frames, float, dict[str, Any]]  # frames, the factor of all errors, options
KINDS = ["rigid", "similarity", "affine"]


@functools.cache
def problem(name: str) -> tuple[Frames, Any, int]:
    """Frames, faces and bones: a chain (by its seed), waves in a cloud, a noisy blend."""
    rng = np.random.default_rng(0)
    if name.startswith("chain"):
        rig = motions.chain(int(name[-1]), bones=4, rows=16, frames=16)
        return motions.wobble(rig, 0.05, int(name[-1])), rig.faces, 4
    rest = rng.standard_normal((150, 3))
    if name == "waves":
        t = np.arange(16)[:, None, None]
        return rest + 0.3 * np.sin(0.5 * t + rest @ rng.standard_normal((3, 3))), None, 5
    exact = motions.random_skinning(rng, rest, 15, 5, 3)
    return exact + 0.01 * rng.standard_normal(exact.shape), None, 5


def rigid_motion(frames: Frames, faces: Any) -> Change:
    return frames @ motions.rotation(1, 2, -0.5).T + [10, -20, 5], 1.0, {"faces": faces}


def rigid_motion_of_each_frame(frames: Frames, faces: Any) -> Change:
    rng = np.random.default_rng(1)
    turned = [x @ motions.rotation(*rng.standard_normal(3)).T for x in frames]
    return np.stack(turned) + 5 * rng.standard_normal((len(frames), 1, 3)), 1.0, {"faces": faces}


def scale(frames: Frames, faces: Any) -> Change:
    return 3.7 * frames, 3.7, {"faces": faces}


def vertices_renumbered(frames: Frames, faces: Any) -> Change:
    order = np.random.default_rng(2).permutation(frames.shape[1])
    return frames[:, order], 1.0, {"faces": None if faces is None else np.argsort(order)[faces]}


def frames_renumbered(frames: Frames, faces: Any) -> Change:
    order = np.random.default_rng(3).permutation(len(frames))
    return frames[order], 1.0, {"faces": faces, "rest_frame": int(np.argsort(order)[0])}


def float32(frames: Frames, faces: Any) -> Change:
    return frames.astype(np.float32), 1.0, {"faces": faces}


CHANGES: list[Callable[[Frames, Any], Change]] = [
    rigid_motion,
    rigid_motion_of_each_frame,
    scale,
    vertices_renumbered,
    frames_renumbered,
    float32,
]
by_name = {"ids": lambda change: change.__name__}


def measured(result: ssdr.Decomposition, frames: Frames) -> float:
    """RMSE by plain NumPy, checked against the result's own."""
    rmse = rmse_of(result.skinning, frames)
    assert result.rmse == pytest.approx(rmse, rel=1e-6)
    return rmse


@functools.cache
def before(name: str, **options: Any) -> float:
    frames, faces, bones = problem(name)
    return ssdr.decompose(frames, faces, bones=bones, **options).rmse


@pytest.mark.parametrize("name", ["chain0", "waves", "blend"])
@pytest.mark.parametrize("change", CHANGES, **by_name)
def test_a_run_follows_the_input(change: Callable[[Frames, Any], Change], name: str) -> None:
    frames, faces, bones = problem(name)
    changed, factor, options = change(frames, faces)
    found = measured(ssdr.decompose(changed, bones=bones, **options), changed)
    tolerance = TOLERANCE_OF_WAVES if name == "waves" else TOLERANCE
    assert found / factor == pytest.approx(before(name), rel=tolerance)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("change", CHANGES, **by_name)
def test_steps_follow_the_input(change: Callable[[Frames, Any], Change], kind: str) -> None:
    """Ten alternations from given weights make no choices, so only rounding differs."""
    rig = motions.chain(0, bones=4, rows=16, frames=16)
    frames = motions.wobble(rig, 0.05)

    def error(frames: Frames, order: Any, faces: Any, rest_frame: Any = None) -> float:
        parts = {"indices": rig.indices[order], "weights": rig.weights[order]}
        given = {"start": ssdr.Kept(**parts), "rest_frame": rest_frame}
        steps: list[str] = []

        def tenth(progress: ssdr.search.progress.Progress) -> bool:
            steps.append(progress.phase)
            return progress.iteration == 10

        options = {"bones": 4, "bone_model": kind, "callback": tenth, **given}
        result = ssdr.decompose(frames, faces, **options)
        assert steps[-1] == "alternate"
        return measured(result, np.asarray(frames, dtype=np.float64))

    changed, factor, options = change(frames, rig.faces)
    order = np.arange(len(rig.rest))
    if change is vertices_renumbered:
        order = change(order[None, :, None], None)[0].ravel()
    found = error(changed, order, **options) / factor
    wanted = error(frames, np.arange(len(order)), rig.faces)
    assert found == pytest.approx(wanted, rel=SINGLE if change is float32 else STEPS)


@pytest.mark.parametrize("change", CHANGES, **by_name)
def test_exact_motion_stays_exact(change: Callable[[Frames, Any], Change]) -> None:
    """Separate bodies with one bone each leave no error, whatever the search chooses."""
    frames = motions.boxes(4).frames
    changed, factor, options = change(frames, None)
    error = measured(ssdr.decompose(changed, bones=4, effort="fast", **options), changed)
    assert error < factor * (1e-5 if change is float32 else 1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.filterwarnings("ignore:.*could each go")  # where a polish alone gives it nothing to do
def test_one_bone_more_never_fits_worse(seed: int, kind: str) -> None:
    """A search from a finished model with one bone duplicated ends no higher."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    bones, influences, n = (int(rng.integers(*r)) for r in ((1, 6), (1, 5), (10, 80)))
    indices, weights = motions.weights_of(rng, n, 5, 3)
    moves = motions.motions(rng, int(rng.integers(2, 15)), 5)
    frames = motions.blend(rng.standard_normal((n, 3)), indices, weights, moves)
    frames += 10 ** rng.uniform(-4, -0.5) * rng.standard_normal(frames.shape)
    options: dict[str, Any] = {
        "influences": influences,
        "bone_model": kind,
        "effort": "fast",
    }
    first = ssdr.decompose(frames, bones=bones, **options)
    s = first.skinning
    grown = np.concatenate([s.transforms, s.transforms[:, :1]], axis=1)
    start = dataclasses.replace(s, transforms=grown)
    second = ssdr.decompose(frames, start=start, **options)
    assert measured(second, frames) <= measured(first, frames) * (1 + 1e-9)
    assert second.skinning.n_bones == bones + 1


@pytest.mark.parametrize("far", [1.0, 1e4])
def test_an_affine_bone_of_one_vertex_far_away(far: float) -> None:
    rng = np.random.default_rng(2)
    given = motions.motions(rng, 3, 1)
    given[..., 3] *= far
    frames = rng.standard_normal((3, 1, 3)) + far
    start = motions.model(frames[0], transforms=given)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ssdr.SsdrWarning)
        result = ssdr.decompose(frames, start=start, bones=1, bone_model="affine")
    assert largest_of(result.skinning, frames) < 1e-6 * far
