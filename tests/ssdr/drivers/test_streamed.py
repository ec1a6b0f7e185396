"""Sequences that do not fit into memory: exact over all frames, whatever was solved first."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers import motions, trees
from helpers.measures import bits, diagonal, rmse_of
from ssdr.drivers import scan
from ssdr.drivers.streamed_state import StreamedState
from ssdr.search.progress import Reporter


@pytest.mark.usefixtures("tiny_memory")
def test_the_error_is_that_of_all_frames_and_near_the_one_in_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frames = motions.rippled()
    streamed = ssdr.decompose(frames, bones=5)
    true = np.sqrt(
        ((streamed.reconstruct() - frames) ** 2).sum() / frames.shape[0] / frames.shape[1]
    )
    assert streamed.rmse == pytest.approx(true, rel=1e-9)
    errors = [record.rmse for record in streamed.history]
    assert errors == sorted(errors, reverse=True)
    assert streamed.history[-1].rmse == streamed.rmse
    assert {record.phase for record in streamed.history} == {"all frames"}
    monkeypatch.setattr(scan, "_IN_MEMORY", 1 << 40)
    whole = ssdr.decompose(frames, bones=5)
    assert streamed.rmse < 1.25 * whole.rmse


@pytest.mark.usefixtures("tiny_memory")
def test_exact_skinning_is_found_again() -> None:
    rig = motions.chain(2, bones=5, frames=120)
    result = ssdr.decompose(rig.frames, bones=5, effort="best")
    diagonal = ssdr.MeshSequence(rig.frames).diagonal()
    assert result.rmse < 1e-4 * diagonal


@pytest.mark.usefixtures("tiny_memory")
def test_a_skeleton_is_found_again_and_every_frame_hangs_on_its_joints() -> None:
    made = trees.skeleton(6, 120, seed=3)
    result = ssdr.decompose(made.frames, bones=6, influences=2, hierarchy="rigid")
    model, size = result.skinning, diagonal(made.frames)
    assert {record.phase for record in result.history} == {"all frames"}
    assert result.rmse < 1e-4 * size
    assert result.rmse == pytest.approx(rmse_of(model, made.frames), rel=1e-6)
    assert model.joint_gaps().max() < 1e-9 * size
    place = trees.matched(model, made)
    named = {frozenset(int(place[k]) for k in edge) for edge in trees.edges(made.parents)}
    assert named == trees.edges(model.parents)


@pytest.mark.usefixtures("tiny_memory")
def test_motion_alone_of_a_rig_over_streamed_frames() -> None:
    made = trees.skeleton(6, 120, seed=3)
    rig = ssdr.Skinning(
        made.rest,
        made.indices,
        made.weights,
        made.transforms[:1],
        parents=made.parents,
        joint_positions=made.points,
    )
    kept = {"indices": made.indices, "weights": made.weights, "rest": made.rest}
    result = ssdr.decompose(made.frames, skeleton=rig, influences=2, **kept)
    assert result.rmse < 1e-6 * diagonal(made.frames)
    hung = made.parents >= 0
    found = result.skinning.joint_positions
    np.testing.assert_allclose(found[hung], made.points[hung], atol=1e-9)


@pytest.mark.usefixtures("tiny_memory")
def test_a_loose_hierarchy_of_streamed_frames_leaves_the_bones_as_they_are() -> None:
    frames = motions.rippled()
    flat = ssdr.decompose(frames, bones=5, effort="fast")
    loose = ssdr.decompose(frames, bones=5, effort="fast", hierarchy="loose")
    assert bits(flat) == bits(loose)
    assert (loose.skinning.parents >= 0).sum() == 4


@pytest.mark.usefixtures("tiny_memory")
def test_same_bits_for_any_number_of_threads_from_memory_and_from_disk(tmp_path: Path) -> None:
    frames = motions.rippled()
    path = tmp_path / "frames.npy"
    np.save(path, frames)
    results = []
    try:
        for threads, source in ((1, frames), (3, frames), (2, np.load(path, mmap_mode="r"))):
            ssdr.set_threads(threads)
            results.append(ssdr.decompose(ssdr.MeshSequence(source), bones=4, effort="fast"))
    finally:
        ssdr.set_threads(None)
    for other in results[1:]:
        np.testing.assert_array_equal(results[0].skinning.transforms, other.skinning.transforms)
        np.testing.assert_array_equal(results[0].skinning.weights, other.skinning.weights)


@pytest.mark.usefixtures("tiny_memory")
def test_fixed_parts_stay() -> None:
    rig = motions.chain(3, bones=4, frames=120)
    frames = motions.rippled()
    given = ssdr.decompose(
        frames,
        bones=4,
        effort="fast",
        rest=rig.rest,
        transforms=rig.transforms,
        locked_bones=[1],
    )
    np.testing.assert_allclose(given.skinning.rest, rig.rest, atol=1e-9)
    np.testing.assert_allclose(given.skinning.transforms[:, 1], rig.transforms[:, 1], atol=1e-9)


@pytest.mark.usefixtures("tiny_memory")
@pytest.mark.parametrize("smoothness", [0.0, 0.01])
def test_settling_on_more_frames_pays(monkeypatch: pytest.MonkeyPatch, smoothness: float) -> None:
    frames, faces = motions.rippled(), motions.chain(3, bones=4, frames=2).faces
    settled = ssdr.decompose(frames, faces, bones=5, smoothness=smoothness)
    monkeypatch.setattr(scan, "_MOST_SETTLED", 40)
    hasty = ssdr.decompose(frames, faces, bones=5, smoothness=smoothness)
    assert settled.history[0].rmse < hasty.history[0].rmse
    assert settled.rmse < hasty.rmse


@pytest.mark.usefixtures("tiny_memory")
def test_progress_and_cancel() -> None:
    seen = []

    def watch(progress) -> bool:
        seen.append((progress.phase, progress.fraction))
        return progress.phase == "all frames"

    result = ssdr.decompose(motions.rippled(), bones=4, effort="fast", callback=watch)
    assert len(result.history) == 1
    assert result.stop_reason == "cancelled"
    assert [share for _, share in seen] == sorted(share for _, share in seen)
    shares = [share for phase, share in seen if phase == "all frames"]
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


def same(a: ssdr.Skinning, b: ssdr.Skinning) -> None:
    for name in ("rest", "indices", "weights", "transforms"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


@pytest.mark.usefixtures("tiny_memory")
@pytest.mark.parametrize(
    ("after", "phase", "nth"),
    [
        ("", "polish", 3), ("", "spread", 1), ("spread", "polish", 2), ("", "all frames", 1),
        ("", "all frames", 6),
    ],
)  # fmt: skip
def test_stopped_saved_and_resumed_it_ends_with_the_same_bits(
    tmp_path: Path, after: str, phase: str, nth: int
) -> None:
    frames, count, due = motions.rippled(), 0, not after

    def stop(progress) -> bool:
        nonlocal count, due
        due |= progress.phase == after
        count += due and progress.phase == phase
        return progress.phase == phase and count == nth

    whole = ssdr.decompose(frames, bones=4)
    assert len(whole.history) > 1
    part = ssdr.decompose(frames, bones=4, callback=stop)
    assert part.stop_reason == "cancelled"
    path = part.state.save(tmp_path / "state.npz")
    again = ssdr.decompose(frames, bones=4, resume=path)
    same(whole.skinning, again.skinning)
    assert [r.rmse for r in again.history] == [r.rmse for r in whole.history]
    # nothing is left to do: nothing changes
    same(whole.skinning, ssdr.decompose(frames, bones=4, resume=again.state).skinning)


@pytest.mark.usefixtures("tiny_memory")
def test_stopped_by_the_last_step_before_it_settles_a_run_makes_one_pass_and_goes_on_later() -> (
    None
):
    phases: list[str] = []
    whole = ssdr.decompose(motions.rippled(), bones=4, callback=lambda p: phases.append(p.phase))
    last = phases.index("spread") - 1
    count = -1

    def stop_once(_) -> bool:
        nonlocal count
        count += 1
        return count == last

    part = ssdr.decompose(motions.rippled(), bones=4, callback=stop_once)
    assert part.stop_reason == "cancelled"
    assert len(part.history) == 1
    assert not StreamedState.of(part.state).settling
    same(whole.skinning, ssdr.decompose(motions.rippled(), bones=4, resume=part.state).skinning)


@pytest.mark.usefixtures("tiny_memory")
def test_a_killed_run_goes_on_from_its_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What an exception at any moment leaves on disk is what SIGKILL leaves."""
    from ssdr.search import state

    monkeypatch.setattr(state, "_CHECKPOINT_SECONDS", 0.0)
    frames, path, seen = motions.rippled(), tmp_path / "run.npz", 0

    def die(progress) -> bool:
        nonlocal seen
        seen += progress.phase == "all frames"
        if seen == 6:  # in the second pass
            raise KeyboardInterrupt
        return False

    with pytest.raises(KeyboardInterrupt):
        ssdr.decompose(frames, bones=4, callback=die, checkpoint=path)
    streamed = StreamedState.of(ssdr.SolverState.load(path))
    assert streamed is not None
    assert len(streamed.passes) == 1
    assert streamed.model is not None
    monkeypatch.setattr(scan, "_scan_span", None)  # the first walk is not made again
    again = ssdr.decompose(frames, bones=4, resume=path, checkpoint=path)
    monkeypatch.undo()
    streamed = StreamedState.of(ssdr.SolverState.load(path))
    assert streamed is not None
    assert len(streamed.passes) == len(again.history)


def test_a_checkpoint_must_have_a_place(tmp_path: Path) -> None:
    (tmp_path / "folder.npz").mkdir()
    for path in (tmp_path / "a.txt", tmp_path / "none" / "a.npz", tmp_path / "folder.npz", 3):
        with pytest.raises(ssdr.InputError, match="checkpoint"):
            ssdr.decompose(np.zeros((2, 4, 3)), bones=1, checkpoint=path)


def test_a_checkpoint_whose_folder_goes_does_not_end_the_run(tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()

    calls = []

    def remove(progress: object) -> None:
        calls.append(progress)
        if folder.exists():
            folder.rmdir()

    frames, path = motions.rippled(12), folder / "a.npz"
    with pytest.warns(ssdr.SsdrWarning, match="no checkpoint"):
        result = ssdr.decompose(frames, bones=3, effort="fast", checkpoint=path, callback=remove)
    assert calls
    assert np.isfinite(result.rmse)


@pytest.mark.usefixtures("tiny_memory")
def test_a_full_disk_does_not_end_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self, path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(ssdr.SolverState, "save", full)
    with pytest.warns(ssdr.SsdrWarning, match="no checkpoint"):
        result = ssdr.decompose(
            motions.rippled(), bones=4, effort="fast", checkpoint=tmp_path / "state.npz"
        )
    assert result.stop_reason != "cancelled"


@pytest.mark.usefixtures("tiny_memory")
def test_many_short_shots_are_what_one_long_one_is() -> None:
    """Spans and blocks do not care where shots end."""
    frames = motions.rippled()
    cuts = [0, 1, 4, 30, 31, 33, 90, 120]
    shots = [ssdr.MeshSequence(frames[a:b]) for a, b in itertools.pairwise(cuts)]
    one = ssdr.decompose(frames, bones=4, effort="fast")
    many = ssdr.decompose(shots, bones=4, effort="fast")
    same(one.skinning, many.skinning)
    assert many.offsets.tolist() == cuts


@pytest.mark.usefixtures("tiny_memory")
def test_a_time_limit_within_the_passes_is_the_reason_to_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It said "converged", of the run on representative frames."""
    late = False

    def watch(progress) -> None:
        nonlocal late
        late |= progress.phase == "all frames"

    monkeypatch.setattr(Reporter, "out_of_time", property(lambda _: late))
    result = ssdr.decompose(motions.rippled(), bones=4, time_limit=1e6, callback=watch)
    assert result.stop_reason == "time limit"
    assert not result.converged
    assert len(result.history) == 1


@pytest.mark.usefixtures("tiny_memory")
def test_passes_count_as_iterations() -> None:
    whole = ssdr.decompose(motions.rippled(), bones=4)
    assert len(whole.history) > 1
    most = whole.history[0].iteration
    part = ssdr.decompose(motions.rippled(), bones=4, max_iterations=most)
    assert part.stop_reason == "iterations"
    assert part.history[-1].iteration == most
    same(whole.skinning, ssdr.decompose(motions.rippled(), bones=4, resume=part.state).skinning)
