"""Sequences that do not fit into memory: exact over all frames, whatever was solved first."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers import motions, trees
from helpers.measures import bits, bits_on_threads, diagonal, rmse_of
from ssdr.search import scan
from ssdr.search.progress import Monitor

pytestmark = pytest.mark.usefixtures("tiny_memory")

FACES = motions.chain(3, bones=4, frames=2).faces  # of what ripples


@pytest.mark.parametrize("faces", [None, FACES], ids=["points", "surface"])
def test_the_error_is_that_of_all_frames_and_near_the_one_in_memory(
    monkeypatch: pytest.MonkeyPatch, faces: np.ndarray | None
) -> None:
    frames = motions.rippled()
    streamed = ssdr.decompose(frames, faces, bones=5)
    assert streamed.rmse == pytest.approx(rmse_of(streamed.skinning, frames), rel=1e-9)
    errors = [record.rmse for record in streamed.history]
    assert errors == sorted(errors, reverse=True)
    assert streamed.history[-1].rmse == streamed.rmse
    assert {record.phase for record in streamed.history} == {"all frames"}
    monkeypatch.setattr(scan, "_IN_MEMORY", 1 << 40)
    whole = ssdr.decompose(frames, faces, bones=5)
    assert streamed.rmse < 1.25 * whole.rmse
    if faces is not None:
        assert streamed.normals.mean < 1.25 * whole.normals.mean
        monkeypatch.setattr(scan, "_IN_MEMORY", 1)
        bare = ssdr.decompose(frames, faces, bones=5, normals=False)
        assert streamed.normals.mean < 0.98 * bare.normals.mean


def test_a_skeleton_is_found_again_and_every_frame_hangs_on_its_joints() -> None:
    made = trees.skeleton(6, 120, seed=3)
    result = ssdr.decompose(made.frames, bones=6, influences=2, rig="rigid")
    model, size = result.skinning, diagonal(made.frames)
    assert {record.phase for record in result.history} == {"all frames"}
    assert result.rmse < 1e-4 * size
    assert result.rmse == pytest.approx(rmse_of(model, made.frames), rel=1e-6)
    assert model.joint_gaps().max() < 1e-9 * size
    place = trees.matched(model, made)
    named = {frozenset(int(place[k]) for k in edge) for edge in trees.edges(made.parents)}
    assert named == trees.edges(model.parents)


def test_motion_alone_of_a_rig_over_streamed_frames() -> None:
    made = trees.skeleton(6, 120, seed=3)
    start = ssdr.Kept(indices=made.indices, weights=made.weights, rest=made.rest)
    rig = ssdr.Skeleton(made.skinning())
    result = ssdr.decompose(made.frames, rig=rig, influences=2, start=start)
    assert result.rmse < 1e-6 * diagonal(made.frames)
    hung = made.parents >= 0
    found = result.skinning.joint_positions
    np.testing.assert_allclose(found[hung], made.points[hung], atol=1e-9)


def test_a_loose_hierarchy_of_streamed_frames_leaves_the_bones_as_they_are() -> None:
    frames = motions.rippled()
    flat = ssdr.decompose(frames, bones=5, effort="fast")
    loose = ssdr.decompose(frames, bones=5, effort="fast", rig="loose")
    assert bits(flat) == bits(loose)[:4]  # rest pose, indices, weights, transforms
    assert (loose.skinning.parents >= 0).sum() == 4


@pytest.mark.parametrize("faces", [None, FACES], ids=["points", "surface"])
def test_same_bits_for_any_number_of_threads_from_memory_and_from_disk(
    tmp_path: Path, faces: np.ndarray | None
) -> None:
    frames = motions.rippled()
    np.save(tmp_path / "frames.npy", frames)
    sources = iter((frames, frames, np.load(tmp_path / "frames.npy", mmap_mode="r")))

    def solve() -> ssdr.Decomposition:
        return ssdr.decompose(ssdr.MeshSequence(next(sources), faces), bones=4, effort="fast")

    assert len(bits_on_threads(solve, (1, 3, 2))) == 1


def test_fixed_parts_stay() -> None:
    rig = motions.chain(3, bones=4, frames=120)
    frames = motions.rippled()
    start = ssdr.Kept(rest=rig.rest, indices=rig.indices, weights=rig.weights)
    given = ssdr.decompose(frames, bones=4, effort="fast", start=start)
    np.testing.assert_allclose(given.skinning.rest, rig.rest, atol=1e-9)
    found = given.skinning.dense_weights()
    np.testing.assert_allclose(found, rig.skinning.dense_weights(), atol=1e-12)


def test_evenly_spread_frames_pay(monkeypatch: pytest.MonkeyPatch) -> None:
    """On most seeds, where weights are smooth; else the walk over all frames makes up for it."""
    frames, seeds = motions.rippled(), range(6)

    def errors() -> np.ndarray:
        runs = [ssdr.decompose(frames, FACES, rng=s, bones=5, smoothness=0.01) for s in seeds]
        return np.array([run.rmse for run in runs])

    spread = errors()
    monkeypatch.setattr(scan, "_MOST_SPREAD", 40)
    assert (spread < errors()).sum() >= 4


def test_progress_and_cancel() -> None:
    seen = []

    def watch(progress) -> bool:
        seen.append((progress.phase, progress.fraction))
        return progress.phase == "all frames"

    result = ssdr.decompose(motions.rippled(), bones=4, effort="fast", callback=watch)
    assert len(result.history) == 1
    assert result.stop_reason == "cancelled"
    assert [share for _, share in seen] == sorted(share for _, share in seen)
    # the pass is completed, but the callback is asked no more
    assert [phase for phase, _ in seen].count("all frames") == 1
    assert result.rmse == pytest.approx(rmse_of(result.skinning, motions.rippled()), rel=1e-9)


def test_many_short_shots_are_what_one_long_one_is() -> None:
    """Spans and blocks do not care where shots end."""
    frames = motions.rippled()
    cuts = [0, 1, 4, 30, 31, 33, 90, 120]
    shots = [ssdr.MeshSequence(frames[a:b]) for a, b in itertools.pairwise(cuts)]
    one = ssdr.decompose(frames, bones=4, effort="fast")
    many = ssdr.decompose(shots, bones=4, effort="fast")
    assert bits(one) == bits(many)
    assert many.offsets.tolist() == cuts


def test_a_time_limit_within_the_passes_is_the_reason_to_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    late = False

    def watch(progress) -> None:
        nonlocal late
        late |= progress.phase == "all frames"

    monkeypatch.setattr(Monitor, "out_of_time", property(lambda _: late))
    result = ssdr.decompose(motions.rippled(), bones=4, time_limit=1e6, callback=watch)
    assert result.stop_reason == "time limit"
    assert not result.converged
    assert len(result.history) == 1


@pytest.mark.parametrize("phase", ["polish", "merge"])
def test_stopped_on_some_frames_it_makes_one_pass_over_all(phase: str) -> None:
    frames = motions.rippled()
    result = ssdr.decompose(frames, bones=4, callback=lambda p: p.phase == phase)
    assert result.stop_reason == "cancelled"
    assert len(result.history) == 1
    assert result.rmse == pytest.approx(rmse_of(result.skinning, frames), rel=1e-9)
