"""What holds for any motion: answers follow the input, and models never get worse."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from benchmarks.robustness import soak
from helpers import motions
from helpers.measures import bits

STEPS = 1e-8  # relative, steps without a choice


SINGLE = 1e-5  # the same in float32


TOLERANCE = 0.05  # relative, whole runs; 0.007 was measured


TOLERANCE_OF_WAVES = 0.25  # where nothing moves as a bone does there are many minima; 0.17


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
    """The error by plain NumPy, which is also what the result states."""
    s = result.skinning
    gap = motions.blend(s.rest, s.indices, s.weights, s.transforms) - frames
    rmse = float(np.sqrt((gap**2).sum(axis=-1).mean()))
    assert result.rmse == pytest.approx(rmse, rel=1e-6)
    return rmse


@functools.cache
def before(name: str, **options: Any) -> float:
    frames, faces, bones = problem(name)
    return ssdr.decompose(frames, faces, bones=bones, **options).rmse


@pytest.mark.parametrize("name", ["chain0", "chain1", "chain2", "waves", "blend"])
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
    """From given weights there is nothing to choose: ten alternations are compared."""
    rig = motions.chain(0, bones=4, rows=16, frames=16)
    frames = motions.wobble(rig, 0.05)

    def error(frames: Frames, indices: Any, weights: Any, **options: Any) -> float:
        result = ssdr.decompose(
            frames,
            bones=4,
            indices=indices,
            weights=weights,
            locked_vertices=[],
            bone_model=kind,
            max_iterations=10,
            **options,
        )
        assert result.state.progress["iteration"] == 10
        return measured(result, np.asarray(frames, dtype=np.float64))

    changed, factor, options = change(frames, rig.faces)
    order = np.arange(len(rig.rest))
    if change is vertices_renumbered:
        order = change(order[None, :, None], None)[0].ravel()
    found = error(changed, rig.indices[order], rig.weights[order], **options) / factor
    wanted = error(frames, rig.indices, rig.weights, faces=rig.faces)
    assert found == pytest.approx(wanted, rel=SINGLE if change is float32 else STEPS)


@pytest.mark.parametrize("change", CHANGES, **by_name)
def test_exact_motion_stays_exact(change: Callable[[Frames, Any], Change]) -> None:
    """Bodies that move apart, a bone each: whatever the choices, nothing is left over."""
    frames = motions.boxes(4).frames
    changed, factor, options = change(frames, None)
    error = measured(ssdr.decompose(changed, bones=4, effort="fast", **options), changed)
    assert error < factor * (1e-5 if change is float32 else 1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_one_bone_more_never_fits_worse(seed: int, kind: str) -> None:
    """A finished model and a bone more, a copy of one of its own, go on together."""
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
    second = ssdr.decompose(
        frames,
        bones=bones + 1,
        rest=s.rest,
        indices=s.indices,
        weights=s.weights,
        transforms=grown,
        locked_bones=[],
        locked_vertices=[],
        **options,
    )
    assert measured(second, frames) <= measured(first, frames) * (1 + 1e-9)
    assert second.skinning.n_bones == bones + 1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("effort", ["fast", "balanced"])
def test_accepted_models_never_get_worse(kind: str, effort: str) -> None:
    """Stopped again and again and resumed: every model handed out, measured by plain NumPy."""
    frames, faces, bones = problem("waves")
    options: dict[str, Any] = {
        "bones": bones,
        "bone_model": kind,
        "effort": effort,
        "influences": 2,
    }
    whole = ssdr.decompose(frames, faces, **options)
    state, errors, stated = None, [], {r.iteration: r.rmse for r in whole.history}
    for record in whole.history[:: max(1, len(whole.history) // 6)]:
        part = ssdr.decompose(
            frames,
            faces,
            resume=state,
            **options,
            callback=lambda p, least=record.iteration: (
                p.iteration >= least and bool(np.isfinite(p.rmse))
            ),
        )
        state = part.state
        errors.append(measured(part, frames))
        # the reduced basis may shift an error by a hundredth of a percent of what it leaves out
        assert errors[-1] == pytest.approx(stated[part.history[-1].iteration], rel=1e-3)
    assert len(errors) > 4
    assert (np.diff(errors) <= 1e-6 * errors[0]).all()
    last = ssdr.decompose(frames, faces, resume=state, **options)
    assert measured(last, frames) <= errors[-1] * (1 + 1e-6)
    assert last.rmse == whole.rmse


@pytest.mark.parametrize("kind", ["similarity", "affine"])
def test_same_bits_on_one_thread_and_on_two(kind: str) -> None:
    """Several chunks of vertices and of frames; rigid bones: see test_decomposition."""
    big = motions.chain(bones=5, rows=140, ring=8, frames=40)
    frames = motions.wobble(big, 0.05)
    found = []
    threads = ssdr.get_threads()
    try:
        for count in (1, 2):
            ssdr.set_threads(count)
            found.append(
                bits(ssdr.decompose(frames, bones=5, bone_model=kind, effort="fast", influences=3))
            )
    finally:
        ssdr.set_threads(threads)
    assert found[0] == found[1]


@pytest.mark.parametrize("first", range(0, 80, 20))
def test_random_problems(first: int) -> None:
    """A minute of the hour that benchmarks/robustness/soak.py takes.

    Checked are simplex, SO(3), counts, true errors, histories that fall, fixed parts that stay, and
    the same bits when stopped and resumed.
    """
    cases = [soak.run_case(seed) for seed in range(first, first + 20)]
    assert [case for case in cases if case["wrong"]] == []
    assert len({case["motion"] for case in cases}) > 3


def spoil(what: str, result: ssdr.Decomposition) -> None:
    s = result.skinning
    if what == "weights not convex":
        s.weights[0, 0] += 1e-3
    elif what == "rotations not orthonormal":
        s.transforms[1, 0, 0, :3] *= 1 + 1e-5
    elif what == "joints out of range":
        s.indices[2, 0] = s.n_bones
    elif what == "says rmse":
        s.transforms[1, :, 0, 3] += 0.1
    elif what == "NaN or Inf":
        s.rest[0, 0] = np.nan
    elif what == "3 bones, not 2":
        more = np.concatenate([s.transforms, s.transforms[:, :1]], axis=1)
        object.__setattr__(s, "transforms", more)
    elif what == "more than 2 influences":
        third = np.full((len(s.rest), 1), 0.1)
        object.__setattr__(s, "weights", np.concatenate([0.9 * s.weights, third], axis=1))
        object.__setattr__(s, "indices", np.concatenate([s.indices, s.indices[:, :1]], axis=1))
    elif what == "history rises":
        object.__setattr__(result, "history", (result.history[-1], *result.history))
    elif what == "history does not end":
        object.__setattr__(result, "history", result.history[:1])


@pytest.mark.parametrize(
    "what",
    [
        "weights not convex", "rotations not orthonormal", "joints out of range", "says rmse",
        "NaN or Inf", "3 bones, not 2", "more than 2 influences", "history rises",
        "history does not end",
    ],
)  # fmt: skip
def test_the_checks_can_fail(what: str) -> None:
    frames = motions.wobble(motions.chain(bones=3, rows=8, frames=6), 0.1)
    options = {"bones": 2, "influences": 2, "bone_model": "rigid", "rest_frame": 0}
    result = ssdr.decompose(frames, **options)
    asked = {"frames": frames, "options": options}
    assert soak.faults(result, asked) == []
    for array in (
        result.skinning.weights,
        result.skinning.transforms,
        result.skinning.rest,
        result.skinning.indices,
    ):
        array.setflags(write=True)
    spoil(what, result)
    with np.errstate(invalid="ignore"):
        assert any(what in fault for fault in soak.faults(result, asked))


def test_stopped_after_a_merge_with_many_influences(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    indices, weights = motions.weights_of(rng, 700, 10, 8)
    frames = motions.blend(
        rng.standard_normal((700, 3)), indices, weights, motions.motions(rng, 6, 10)
    ) + 0.02 * rng.standard_normal((6, 700, 3))
    options: dict[str, Any] = {"bones": 13, "influences": 13, "effort": "fast"}
    whole = ssdr.decompose(frames, **options)
    merged: list[str] = []
    part = ssdr.decompose(
        frames,
        **options,
        callback=lambda p: (merged.append(p.phase) or "merge" in merged) and bool(p.rmse < np.inf),
    )
    assert merged[-1] == "merge"
    again = ssdr.decompose(frames, resume=part.state.save(tmp_path / "s.npz"), **options)
    for name in ("rest", "indices", "weights", "transforms"):
        assert np.array_equal(getattr(again.skinning, name), getattr(whole.skinning, name)), name


def farthest(result: ssdr.Decomposition, frames: Frames) -> float:
    s = result.skinning
    return float(np.abs(motions.blend(s.rest, s.indices, s.weights, s.transforms) - frames).max())


@pytest.mark.parametrize("far", [1.0, 1e4])
def test_an_affine_bone_of_one_vertex_far_away(far: float) -> None:
    rng = np.random.default_rng(2)
    given = motions.motions(rng, 3, 1)
    given[..., 3] *= far
    frames = rng.standard_normal((3, 1, 3)) + far
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ssdr.SsdrWarning)
        result = ssdr.decompose(
            frames,
            bones=1,
            bone_model="affine",
            effort="balanced",
            indices=[[0]],
            weights=[[1.0]],
            transforms=given,
            locked_bones=[],
        )
        kept = ssdr.decompose(frames, bones=1, bone_model="affine", transforms=given)
    assert farthest(result, frames) < 1e-6 * far
    np.testing.assert_allclose(kept.skinning.transforms, given, rtol=1e-9, atol=1e-9 * far)
