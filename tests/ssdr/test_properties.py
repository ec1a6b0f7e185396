"""What must hold for any input: the result follows the input, and never gets worse.

The steps of the solver follow a change of the input to rounding.  Its choices (where patches
start, which bone is moved, which influence enters) are made by comparing numbers, and rounding
alone can tip one of them: a whole run follows to `TOLERANCE`.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import motions
import numpy as np
import pytest
import soak
from measures import bits

import ssdr
from ssdr.kernels.polish import invert
from ssdr.parsimony.keyframes import Tracks
from ssdr.solver.model import Model
from ssdr.solver.smoothness import WeightSmoothness
from ssdr.solver.trajectories import gather

STEPS = 1e-8  # relative, steps without a choice
SINGLE = 1e-5  # the same in float32
TOLERANCE = 0.05  # relative, whole runs; 0.007 was measured
TOLERANCE_OF_WAVES = 0.1  # where nothing moves as a bone does there are many minima; 0.075

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
    rigid_motion, rigid_motion_of_each_frame, scale, vertices_renumbered, frames_renumbered,
    float32,
]  # fmt: skip
by_name = {"ids": lambda change: change.__name__}


def measured(result: ssdr.Decomposition, frames: Frames) -> float:
    """The error by plain NumPy, which is also what the result states."""
    s = result.skinning
    gap = motions.blend(s.rest, s.joints, s.weights, s.transforms) - frames
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

    def error(frames: Frames, joints: Any, weights: Any, **options: Any) -> float:
        result = ssdr.decompose(
            frames, bones=4, joints=joints, weights=weights, locked_vertices=[], bone_model=kind,
            max_iterations=10, **options,
        )  # fmt: skip
        assert result.state.progress["iteration"] == 10
        return measured(result, np.asarray(frames, dtype=np.float64))

    changed, factor, options = change(frames, rig.faces)
    order = np.arange(len(rig.rest))
    if change is vertices_renumbered:
        order = change(order[None, :, None], None)[0].ravel()
    found = error(changed, rig.joints[order], rig.weights[order], **options) / factor
    wanted = error(frames, rig.joints, rig.weights, faces=rig.faces)
    assert found == pytest.approx(wanted, rel=SINGLE if change is float32 else STEPS)


@pytest.mark.parametrize("change", CHANGES, **by_name)
def test_exact_motion_stays_exact(change: Callable[[Frames, Any], Change]) -> None:
    """Bodies that move apart, a bone each: whatever the choices, nothing is left over."""
    frames = motions.boxes(4).frames
    changed, factor, options = change(frames, None)
    error = measured(ssdr.decompose(changed, bones=4, effort="fast", **options), changed)
    assert error < factor * (1e-5 if change is float32 else 1e-9)


# one bone more, one step more


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_one_bone_more_never_fits_worse(seed: int, kind: str) -> None:
    """A finished model and a bone more, a copy of one of its own, go on together."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    bones, influences, n = (int(rng.integers(*r)) for r in ((1, 6), (1, 5), (10, 80)))
    joints, weights = motions.weights_of(rng, n, 5, 3)
    moves = motions.motions(rng, int(rng.integers(2, 15)), 5)
    frames = motions.blend(rng.standard_normal((n, 3)), joints, weights, moves)
    frames += 10 ** rng.uniform(-4, -0.5) * rng.standard_normal(frames.shape)
    options: dict[str, Any] = {
        "influences": influences, "bone_model": kind, "effort": "fast",
    }  # fmt: skip
    first = ssdr.decompose(frames, bones=bones, **options)
    s = first.skinning
    grown = np.concatenate([s.transforms, s.transforms[:, :1]], axis=1)
    second = ssdr.decompose(
        frames, bones=bones + 1, rest=s.rest, joints=s.joints, weights=s.weights,
        transforms=grown, locked_bones=[], locked_vertices=[], **options,
    )  # fmt: skip
    assert measured(second, frames) <= measured(first, frames) * (1 + 1e-9)
    assert second.skinning.n_bones == bones + 1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("effort", ["fast", "balanced"])
def test_accepted_models_never_get_worse(kind: str, effort: str) -> None:
    """Stopped again and again and resumed: every model handed out, measured by plain NumPy."""
    frames, faces, bones = problem("waves")
    options: dict[str, Any] = {
        "bones": bones, "bone_model": kind, "effort": effort, "influences": 2,
    }  # fmt: skip
    whole = ssdr.decompose(frames, faces, **options)
    state, errors, told = None, [], {r.iteration: r.rmse for r in whole.history}
    for record in whole.history[:: max(1, len(whole.history) // 6)]:
        part = ssdr.decompose(
            frames, faces, resume=state, **options,
            callback=lambda p, least=record.iteration: (
                p.iteration >= least and bool(np.isfinite(p.rmse))
            ),
        )  # fmt: skip
        state = part.state
        errors.append(measured(part, frames))
        # the reduced basis may shift an error by a hundredth of a percent of what it leaves out
        assert errors[-1] == pytest.approx(told[part.history[-1].iteration], rel=1e-3)
    assert len(errors) > 4
    assert (np.diff(errors) <= 1e-6 * errors[0]).all()
    last = ssdr.decompose(frames, faces, resume=state, **options)
    assert measured(last, frames) <= errors[-1] * (1 + 1e-6)
    assert last.rmse == whole.rmse


# threads


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


# random problems, every result checked


@pytest.mark.parametrize("first", range(0, 80, 20))
def test_random_problems(first: int) -> None:
    """A minute of the hour that benchmarks/soak.py takes: simplex, SO(3), counts, true errors,
    falling histories, fixed parts that stay, the same bits when stopped and resumed."""
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
        s.joints[2, 0] = s.n_bones
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
        object.__setattr__(s, "joints", np.concatenate([s.joints, s.joints[:, :1]], axis=1))
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
    for array in (result.skinning.weights, result.skinning.transforms, result.skinning.rest,
                  result.skinning.joints):  # fmt: skip
        array.setflags(write=True)
    spoil(what, result)
    with np.errstate(invalid="ignore"):
        assert any(what in fault for fault in soak.faults(result, asked))


# what the soak found


def test_what_is_left_of_a_model_shares_no_memory() -> None:
    """With 12 influences and more, joints were the support itself, and steps wrote to both."""
    rng = np.random.default_rng(0)
    for influences in (4, 12, 13):
        model = Model.start(
            rng.standard_normal((3, 14, 3, 4)), rng.standard_normal((30, 3)),
            rng.integers(0, 14, 30), influences,
        )  # fmt: skip
        smaller = model.without(np.array([3]))
        arrays = [a for m in (model, smaller) for a in vars(m).values()]
        for k, a in enumerate(arrays):
            assert not any(np.shares_memory(a, b) for b in arrays[k + 1 :])


def test_stopped_after_a_merge_with_many_influences(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    joints, weights = motions.weights_of(rng, 700, 10, 8)
    frames = motions.blend(
        rng.standard_normal((700, 3)), joints, weights, motions.motions(rng, 6, 10)
    ) + 0.02 * rng.standard_normal((6, 700, 3))
    options: dict[str, Any] = {"bones": 13, "influences": 13, "effort": "fast"}
    whole = ssdr.decompose(frames, **options)
    merged: list[str] = []
    part = ssdr.decompose(
        frames, **options,
        callback=lambda p: (merged.append(p.phase) or "merge" in merged) and bool(p.rmse < np.inf),
    )  # fmt: skip
    assert merged[-1] == "merge"
    again = ssdr.decompose(frames, resume=part.state.save(tmp_path / "s.npz"), **options)
    for name in ("rest", "joints", "weights", "transforms"):
        assert np.array_equal(getattr(again.skinning, name), getattr(whole.skinning, name)), name


def test_the_inverse_of_what_depends_on_itself_does_not_overflow() -> None:
    """Weights that say the same, to rounding: what is undetermined stays where it is."""
    numba = pytest.importorskip("numba")

    @numba.njit
    def inverse(a: Any, scale: Any, out: Any) -> None:
        invert(a, len(a), scale, out)

    rng = np.random.default_rng(0)
    for n in (2, 4, 6, 8):
        root = rng.standard_normal((n, n))
        good = root @ root.T + np.eye(n)
        good /= np.sqrt(np.outer(np.diag(good), np.diag(good)))
        scale, out = rng.uniform(0.1, 10, n), np.zeros((n, n))
        inverse(good.copy(), scale, out)
        np.testing.assert_allclose(out, np.linalg.inv(good) * np.outer(scale, scale), rtol=1e-5)
        # a unit diagonal, and beside it rounding that was scaled up with it
        bad = np.eye(n) + np.tril(rng.uniform(-2, 2, (n, n)), -1)
        inverse(bad, np.ones(n), out)
        assert np.isfinite(out).all()
        assert np.abs(out).max() < 1e13


def farthest(result: ssdr.Decomposition, frames: Frames) -> float:
    s = result.skinning
    return float(np.abs(motions.blend(s.rest, s.joints, s.weights, s.transforms) - frames).max())


@pytest.mark.parametrize("far", [1.0, 1e4])
def test_an_affine_bone_of_one_vertex_far_away(far: float) -> None:
    rng = np.random.default_rng(2)
    given = motions.motions(rng, 3, 1)
    given[..., 3] *= far
    frames = rng.standard_normal((3, 1, 3)) + far
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ssdr.SsdrWarning)
        result = ssdr.decompose(
            frames, bones=1, bone_model="affine", effort="balanced", joints=[[0]],
            weights=[[1.0]], transforms=given, locked_bones=[],
        )  # fmt: skip
        kept = ssdr.decompose(frames, bones=1, bone_model="affine", transforms=given)
    assert farthest(result, frames) < 1e-6 * far
    np.testing.assert_allclose(kept.skinning.transforms, given, rtol=1e-9, atol=1e-9 * far)


def test_affine_bones_between_keys_do_not_turn_over() -> None:
    """Half a turn while one side grows and one shrinks: straight from the first matrix to the
    last det falls below 0, and two keys would do for the place."""
    rng = np.random.default_rng(0)
    transforms = np.zeros((9, 2, 3, 4))
    for t in range(9):
        grown = np.diag([1 + t / 8, 1, 1 - t / 16])
        transforms[t, :, :, :3] = motions.rotation(0, np.pi * t / 8, 0) @ grown
        transforms[t, :, 0, 3] = 100 * t
    halfway = 0.5 * (transforms[0] + transforms[8])[..., :3]
    assert np.linalg.det(halfway).max() < 0
    model = ssdr.Skinning(
        rng.standard_normal((20, 3)), np.arange(20)[:, None] % 2, np.ones((20, 1)), transforms,
        bone_model="affine",
    )  # fmt: skip
    tracks = Tracks(model, np.array([0, 9]))
    for price in (1e-3, 1.0, 10.0, 100.0):
        keys, _ = tracks.choose(price)
        assert np.linalg.det(tracks.play(keys).transforms[..., :3]).min() > 0
    assert keys.sum(axis=0).max() < 5


def test_the_penalty_of_equal_weights_is_not_below_zero() -> None:
    """It is a difference of equal sums, and its root is taken."""
    rng = np.random.default_rng(0)
    for n in (4, 30, 100):
        faces = rng.integers(0, n, (2 * n, 3)).astype(np.int32)
        data = gather([ssdr.MeshSequence(rng.standard_normal((2, n, 3)), faces)], bones=3)
        smooth = WeightSmoothness.build(data, faces, 1.0)
        model = Model.start(rng.standard_normal((2, 3, 3, 4)), rng.standard_normal((n, 3)),
                            np.zeros(n, dtype=int), 3)  # fmt: skip
        for _ in range(50):
            shares = np.sort(rng.dirichlet(np.ones(3)))[::-1]
            model.joints[:], model.weights[:] = np.arange(3), shares
            assert smooth is not None
            assert 0 <= smooth.penalty(model) < 1e-9
