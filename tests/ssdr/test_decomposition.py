"""``ssdr.decompose`` as a whole: what it promises, each promise measured from outside."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import threadpoolctl

import ssdr
from helpers import motions
from helpers.measures import bits, diagonal, frames, rig, rmse_of
from helpers.promises import check

# exact data


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_exact_chain_is_recovered(seed: int) -> None:
    exact = motions.chain(seed, bones=5, frames=25)
    error = {
        effort: check(
            ssdr.decompose(exact.frames, exact.faces, bones=5, effort=effort), exact.frames, 5
        ).rmse
        for effort in ("fast", "balanced", "best")
    }
    assert error["best"] < 1e-4 * diagonal(exact.frames)
    assert error["best"] <= error["balanced"] <= error["fast"] < 5e-3 * diagonal(exact.frames)


@pytest.mark.slow
def test_exact_chain_of_many_bones() -> None:
    exact = motions.chain(4, bones=16, frames=60, rows=64, bend=0.4)
    result = check(
        ssdr.decompose(exact.frames, exact.faces, bones=16, effort="best"), exact.frames, 16
    )
    assert result.rmse < 1e-4 * diagonal(exact.frames)


@pytest.mark.slow
def test_fox_is_recovered(real: Callable[[str], ssdr.MeshSequence]) -> None:
    fox = real("fox")
    result = check(ssdr.decompose(fox, bones=24), np.asarray(fox.vertices, dtype=np.float64), 24)
    assert result.rmse < 1e-4 * fox.diagonal()


def test_separate_boxes_are_exact() -> None:
    exact = motions.boxes(2)
    result = check(ssdr.decompose(exact.frames, bones=2), exact.frames, 2)
    assert result.rmse < 1e-10 * diagonal(exact.frames)
    assert result.converged
    assert not result.warnings
    owner = result.skinning.indices[:, 0]
    assert len(set(owner[:30])) == len(set(owner[30:])) == 1
    assert (result.skinning.weights[:, 0] > 1 - 1e-6).all()


def test_noise_floor() -> None:
    """White noise of sigma on exact data: no fit of P parameters is better than its share."""
    exact = motions.chain(bones=4, frames=40, rows=30)
    sigma = 0.01
    noisy = exact.frames + sigma * np.random.default_rng(0).standard_normal(exact.frames.shape)
    result = check(ssdr.decompose(noisy, bones=4), noisy, 4)
    values = noisy.size
    unknowns = 40 * 4 * 6 + len(exact.rest) * (3 + 3)
    floor = sigma * np.sqrt(3 * (1 - unknowns / values))
    assert 0.97 * floor < result.rmse < 1.03 * sigma * np.sqrt(3)
    assert rmse_of(result.skinning, exact.frames) < 0.6 * sigma * np.sqrt(3)


# the number of bones


def test_one_frame_is_accepted() -> None:
    """A program may cut a motion anywhere; only the command takes a single frame for a slip."""
    still = rig().frames[:1]
    with pytest.warns(ssdr.SsdrWarning, match="fewer bones would do"):
        result = check(ssdr.decompose(still, bones=6, effort="fast"), still, 6)
    assert result.rmse < 1e-7 * diagonal(still)


def test_static_mesh_still_has_its_bones() -> None:
    still = np.repeat(rig().frames[:1], 6, axis=0)
    for seed in range(3):
        with pytest.warns(ssdr.SsdrWarning, match="fewer bones would do"):
            result = check(ssdr.decompose(still, bones=20, rng=seed), still, 20)
        assert result.rmse < 1e-7 * diagonal(still)
        assert result.warnings


def test_one_rigid_motion_and_twenty_bones() -> None:
    body = np.stack([rig().rest @ motions.rotation(0.3 * t, t, 0).T + t for t in range(8)])
    for seed in range(3):
        with pytest.warns(ssdr.SsdrWarning, match="fewer bones would do"):
            result = check(ssdr.decompose(body, bones=20, rng=seed), body, 20)
        assert result.rmse < 1e-7 * diagonal(body)


@pytest.mark.parametrize("bones", [1, 2, 7, 83, 84])
def test_any_number_of_bones(bones: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ssdr.SsdrWarning)
        result = ssdr.decompose(frames(), bones=bones, effort="fast", influences=3)
    check(result, frames(), bones, 3)


def test_one_bone_is_procrustes() -> None:
    """B = 1 with the rest pose kept is Kabsch; with a free one it can only be better."""
    rest = frames()[0]
    kept = ssdr.decompose(frames(), bones=1, rest=rest)
    fitted = ssdr.kabsch(np.broadcast_to(rest, frames().shape), frames())
    # the reduced basis may lose a hundredth of a percent of what one bone cannot follow
    np.testing.assert_allclose(kept.skinning.transforms[:, 0], fitted, atol=1e-4)
    best = np.einsum("tab,ib->tia", fitted[..., :3], rest) + fitted[:, None, :, 3]
    assert kept.rmse == pytest.approx(np.sqrt(((best - frames()) ** 2).sum(-1).mean()), rel=1e-6)
    free = check(ssdr.decompose(frames(), bones=1), frames(), 1)
    assert free.rmse < kept.rmse


def test_more_bones_and_effort_never_hurt_much() -> None:
    errors = [ssdr.decompose(frames(), bones=b).rmse for b in (1, 2, 4, 8)]
    assert (np.diff(errors) < 0).all()
    fast = ssdr.decompose(frames(), bones=4, effort="fast").rmse
    assert errors[2] <= 1.001 * fast


def test_plain_alternation_is_beaten() -> None:
    """The public parts, alternated by hand from the public start, as the naive solver."""
    skinning = ssdr.initialize(frames(), bones=4)
    rest, transforms = skinning.rest, skinning.transforms
    for _ in range(30):
        w = ssdr.fit_weights(frames(), rest=rest, transforms=transforms)
        b = ssdr.fit_bones(
            frames(),
            rest=rest,
            indices=w.indices,
            weights=w.weights,
            transforms=transforms,
            locked_bones=[],
            max_sweeps=5,
        )
        transforms = b.transforms
        rest = ssdr.fit_rest_pose(
            frames(), indices=w.indices, weights=w.weights, transforms=transforms, rest=rest
        ).rest
    last = ssdr.fit_weights(frames(), rest=rest, transforms=transforms)
    assert ssdr.decompose(frames(), bones=4).rmse < last.rmse


# history


def test_history_is_what_a_run_stopped_there_gives() -> None:
    """Every record's error is that of the model which a run stopped there hands out."""
    whole = check(ssdr.decompose(frames(), bones=4), frames(), 4)
    for record in whole.history[1 :: max(1, len(whole.history) // 6)]:
        part = ssdr.decompose(frames(), bones=4, max_iterations=record.iteration)
        assert rmse_of(part.skinning, frames()) == pytest.approx(record.rmse, rel=0.01)
        assert part.history[-1].iteration == record.iteration


def test_history_with_smoothness_is_the_error_without_the_penalty() -> None:
    options = {"faces": rig().faces, "bones": 4, "smoothness": 0.1, "effort": "fast"}
    whole = ssdr.decompose(frames(), **options)
    for record in whole.history[1 :: max(1, len(whole.history) // 4)]:
        part = ssdr.decompose(frames(), **options, max_iterations=record.iteration)
        assert rmse_of(part.skinning, frames()) == pytest.approx(record.rmse, rel=0.01)


def test_progress_agrees_with_the_result() -> None:
    seen = []
    result = ssdr.decompose(frames(), bones=4, callback=lambda p: seen.append(p))
    assert seen[-1].rmse == pytest.approx(result.rmse, rel=0.01)
    assert (np.diff([p.rmse for p in seen]) <= 0).all()
    assert (np.diff([p.elapsed for p in seen]) >= 0).all()
    assert (np.diff([p.fraction for p in seen]) >= 0).all()
    assert all(0 <= p.fraction <= 1 for p in seen)
    assert all(p.time_left >= 0 for p in seen)
    phases = {"quick", "compress", "start", "merge", "alternate", "reseed", "polish"}
    assert phases <= {p.phase for p in seen}


def test_history_never_rises_where_all_that_counts_is_exact() -> None:
    array = np.random.default_rng(1).standard_normal((3, 9, 3))
    counts = np.arange(9) < 3
    result = ssdr.decompose(array, bones=2, effort="fast", vertex_importance=counts)
    values = [record.rmse for record in result.history]
    assert len(values) > 1
    assert values == sorted(values, reverse=True)
    assert values[-1] == result.rmse > 0.1
    assert values[0] < 10 * values[-1]  # no ratio of an error to nothing


# limits


def test_iterations_are_limited() -> None:
    full = ssdr.decompose(frames(), bones=4)
    for limit in (1, 6, full.history[-1].iteration // 2):
        part = check(ssdr.decompose(frames(), bones=4, max_iterations=limit), frames(), 4)
        assert part.stop_reason == "iterations"
        # a re-seed is one step of several alternations
        assert limit <= part.state.progress["iteration"] < limit + 4


def test_time_is_limited() -> None:
    began = time.perf_counter()
    result = check(ssdr.decompose(frames(), bones=6, effort="best", time_limit=0.5), frames(), 6)
    assert result.stop_reason == "time limit"
    assert not result.converged
    assert time.perf_counter() - began - result.compile_seconds < 5


def test_cancel_before_any_model() -> None:
    # where all bones are locked and there is nothing to start from, compression comes first
    given = np.tile(np.eye(3, 4), (len(frames()), 4, 1, 1))
    with pytest.raises(ssdr.Cancelled, match="before"):
        ssdr.decompose(frames(), bones=4, transforms=given, callback=lambda p: True)


def test_cancel_afterwards() -> None:
    result = check(ssdr.decompose(frames(), bones=4, callback=lambda p: True), frames(), 4)
    assert result.stop_reason == "cancelled"
    assert len(result.history) == 1


def test_an_error_in_the_callback_is_the_callers() -> None:
    class Mine(Exception):
        pass

    def callback(progress: object) -> None:
        raise Mine

    with pytest.raises(Mine):
        ssdr.decompose(frames(), bones=4, callback=callback)
    assert all(pool["num_threads"] >= 1 for pool in threadpoolctl.threadpool_info())


# reproducibility


@pytest.mark.parametrize("effort", ["fast", "balanced"])
def test_same_bits_for_any_number_of_threads(effort: str) -> None:
    big = motions.chain(bones=6, rows=140, ring=8, frames=40)  # several chunks of vertices
    array = motions.wobble(big, 0.05)
    found = []
    try:
        for threads in (1, 2, 3):
            ssdr.set_threads(threads)
            with threadpoolctl.threadpool_limits(threads, user_api="blas"):
                found.append(bits(ssdr.decompose(array, bones=6, effort=effort, max_iterations=60)))
    finally:
        ssdr.set_threads(None)
    assert found[0] == found[1] == found[2]


def test_seed_decides() -> None:
    def run(rng: object) -> list[bytes]:
        return bits(ssdr.decompose(frames(), bones=5, rng=rng))

    assert run(3) == run(3) == run(np.int64(3))
    assert run(np.random.default_rng(8)) == run(np.random.default_rng(8))
    assert any(run(seed) != run(3) for seed in range(4, 10))


def test_the_global_generator_is_left_alone() -> None:
    np.random.seed(1)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    ssdr.decompose(frames(), bones=3, effort="fast")
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002


# input


def test_several_shots() -> None:
    shots = [ssdr.MeshSequence(frames()[a:b], rig().faces) for a, b in ((0, 4), (4, 5), (5, 15))]
    parts = check(ssdr.decompose(shots, bones=4), frames(), 4)
    whole = ssdr.decompose(frames(), rig().faces, bones=4)
    assert parts.offsets.tolist() == [0, 4, 5, 15]
    assert whole.offsets.tolist() == [0, 15]
    assert bits(parts) == bits(whole)
    second = parts.reconstruct(slice(parts.offsets[1], parts.offsets[2]))
    assert np.array_equal(second, parts.reconstruct()[4:5])


def test_shots_must_be_of_one_mesh() -> None:
    one = ssdr.MeshSequence(frames(), rig().faces)
    for other, argument in (
        (ssdr.MeshSequence(frames()[:, :-1]), "sequence[1]"),
        (ssdr.MeshSequence(frames(), rig().faces[::-1]), "sequence[1].faces"),
        (frames(), "sequence[1]"),
    ):
        with pytest.raises(ssdr.InputError) as caught:
            ssdr.decompose([one, other], bones=2)
        assert caught.value.argument == argument


def test_memory_map_is_as_good_as_memory(tmp_path: Path) -> None:
    np.save(tmp_path / "f.npy", frames())
    lazy = ssdr.MeshSequence(np.load(tmp_path / "f.npy", mmap_mode="r"), rig().faces)
    assert lazy.is_lazy
    assert bits(ssdr.decompose(lazy, bones=4, effort="fast")) == bits(
        ssdr.decompose(frames(), rig().faces, bones=4, effort="fast")
    )


def test_chunked_store_is_as_good_as_memory(tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr")
    store = zarr.create_array(
        tmp_path / "f.zarr", shape=frames().shape, chunks=(4, 84, 3), dtype="f8"
    )
    store[:] = frames()
    lazy = ssdr.MeshSequence(store, rig().faces)
    assert lazy.is_lazy
    assert bits(ssdr.decompose(lazy, bones=4, effort="fast")) == bits(
        ssdr.decompose(frames(), rig().faces, bones=4, effort="fast")
    )


def test_input_is_left_alone() -> None:
    array, faces = np.array(frames()), rig().faces.copy()
    ssdr.decompose(array, faces, bones=4, effort="fast")
    assert np.array_equal(array, frames())
    assert np.array_equal(faces, rig().faces)


def test_what_the_sequence_carries_survives(seam: ssdr.MeshSequence) -> None:
    result = ssdr.decompose(seam, bones=2, effort="fast")
    s = result.skinning
    assert s.fps == seam.fps
    assert s.name == seam.name
    assert np.array_equal(s.faces, seam.faces)
    assert s.surface is seam.surface


# refusals


REFUSED: dict[str, tuple[str, dict[str, object]]] = {
    "no bones": ("bones", {"bones": 0}),
    "more bones than vertices": ("bones", {"bones": 85}),
    "bones as text": ("bones", {"bones": "5"}),
    "no influences": ("influences", {"influences": 0}),
    "unknown effort": ("effort", {"effort": "heroic"}),
    "efforts": ("effort", {"effort": np.array(["fast", "best"])}),
    "an error of another kind": ("tolerance_of", {"tolerance_of": "mean"}),
    "an error's kind alone": ("tolerance_of", {"tolerance_of": "max"}),
    "positions beyond squares": ("vertices", {"sequence": 1e200 * frames()}),
    "an extent below squares": ("vertices", {"sequence": 1e-200 * frames()}),
    "an extent of subnormals": ("vertices", {"sequence": 1e-310 * frames()}),
    "unknown bone model": ("bone_model", {"bone_model": "soft"}),
    "no iterations": ("max_iterations", {"max_iterations": 0}),
    "half an iteration": ("max_iterations", {"max_iterations": 2.5}),
    "time as text": ("time_limit", {"time_limit": "10"}),
    "time that is true": ("time_limit", {"time_limit": True}),
    "a frame that is true": ("rest_frame", {"rest_frame": True}),
    "half a frame": ("rest_frame", {"rest_frame": 2.5}),
    "smoothness as text": ("smoothness", {"smoothness": "0.1"}),
    "a result, not its state": ("resume", {"resume": object()}),
    "a file's name": ("vertices", {"sequence": "walk.npz"}),
    "shots as arrays": ("sequence", {"sequence": [np.zeros((3, 84, 3)), np.zeros((5, 84, 3))]}),
    "bones that mirror": (
        "transforms", {"transforms": np.tile(-np.eye(4)[:3], (15, 2, 1, 1))},
    ),
    "no time": ("time_limit", {"time_limit": 0.0}),
    "time NaN": ("time_limit", {"time_limit": float("nan")}),
    "rest frame out of range": ("rest_frame", {"rest_frame": 15}),
    "smoothness below 0": ("smoothness", {"smoothness": -1}),
    "smoothness NaN": ("smoothness", {"smoothness": float("nan")}),
    "smoothness without faces": ("smoothness", {"smoothness": 1.0, "faces": None}),
    "joints alone": ("weights", {"indices": np.zeros((84, 1), int)}),
    "weights alone": ("indices", {"weights": np.ones((84, 1))}),
    "joints out of range": (
        "indices", {"indices": np.full((84, 1), 4), "weights": np.ones((84, 1))},
    ),
    "joints beyond 32 bits": (
        "indices", {"indices": np.full((84, 1), 2**32), "weights": np.ones((84, 1))},
    ),
    "ragged joints": ("indices", {"indices": 83 * [[0]] + [[0, 1]], "weights": np.ones((84, 1))}),
    "too many influences": (
        "weights", {"indices": np.tile(np.arange(3), (84, 1)), "weights": np.full((84, 3), 1 / 3),
                    "influences": 2},
    ),
    "a bone twice": (
        "indices", {"indices": np.zeros((84, 2), int), "weights": np.full((84, 2), 0.5)},
    ),
    "locked vertices alone": ("locked_vertices", {"locked_vertices": [0]}),
    "locked bones alone": ("locked_bones", {"locked_bones": [0]}),
    "too many given bones": ("transforms", {"transforms": np.tile(np.eye(4)[:3], (15, 5, 1, 1))}),
    "bones of other frames": ("transforms", {"transforms": np.tile(np.eye(4)[:3], (9, 2, 1, 1))}),
    "bones that scale": ("transforms", {"transforms": np.tile(2 * np.eye(4)[:3], (15, 2, 1, 1))}),
    "a bone that is not there": (
        "locked_bones",
        {"transforms": np.tile(np.eye(4)[:3], (15, 2, 1, 1)), "locked_bones": [2]},
    ),
    "rest of another mesh": ("rest", {"rest": np.zeros((83, 3))}),
    "complex rest": ("rest", {"rest": np.zeros((84, 3), complex)}),
    "rest beyond squares": ("rest", {"rest": np.full((84, 3), 1e155)}),
    "rest beyond squares of the mesh": (
        "rest", {"sequence": 1e-60 * frames(), "rest": np.full((84, 3), 1e95)},
    ),
    "bones beyond squares": (
        "transforms", {"transforms": np.tile(np.c_[np.eye(3), np.full(3, 1e155)], (15, 2, 1, 1))},
    ),
    "bones beyond squares of the mesh": (
        "transforms", {"sequence": 1e-60 * frames(),
                       "transforms": np.tile(np.c_[np.eye(3), np.full(3, 1e95)], (15, 2, 1, 1))},
    ),
    "ragged locked vertices": (
        "locked_vertices", {"indices": np.zeros((84, 1), int), "weights": np.ones((84, 1)),
                            "locked_vertices": [[1], [1, 2]]},
    ),
    "ragged locked bones": (
        "locked_bones", {"transforms": np.tile(np.eye(4)[:3], (15, 2, 1, 1)),
                         "locked_bones": [[0], [0, 1]]},
    ),
    "rest NaN": ("rest", {"rest": np.full((84, 3), np.nan)}),
    "importance below 0": ("vertex_importance", {"vertex_importance": -np.ones(84)}),
    "importance all 0": ("vertex_importance", {"vertex_importance": np.zeros(84)}),
    "importance of others": ("vertex_importance", {"vertex_importance": np.ones(83)}),
    "a frame of no importance": ("frame_importance", {"frame_importance": np.arange(15.0)}),
    "no seed": ("rng", {"rng": None}),
    "faces twice": ("faces", {"sequence": ssdr.MeshSequence(np.zeros((2, 84, 3)))}),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refuses(case: str) -> None:
    argument, change = REFUSED[case]
    arguments = {"sequence": frames(), "faces": rig().faces, "bones": 4} | change
    calls = []
    with pytest.raises(ssdr.InputError, match="expected") as caught:
        ssdr.decompose(**arguments, callback=lambda p: calls.append(p))
    assert caught.value.argument == argument
    assert not calls


def test_refuses_a_callback_that_is_none() -> None:
    with pytest.raises(ssdr.InputError) as caught:
        ssdr.decompose(frames(), bones=4, callback=3)
    assert caught.value.argument == "callback"
