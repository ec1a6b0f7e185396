"""Sequences that do not fit into memory: exact over all frames, whatever was solved first."""

from __future__ import annotations

import itertools
from pathlib import Path

import motions
import numpy as np
import pytest

import ssdr
from ssdr.frames import executor
from ssdr.solver.alternation import vertex_step
from ssdr.solver.initialization import start_model
from ssdr.solver.model import Fixed, Model
from ssdr.solver.trajectories import gather
from ssdr.streaming import scan
from ssdr.streaming.passes import AllFrames, carried
from ssdr.streaming.state import StreamedState


@pytest.fixture
def tiny_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything counts as too large; forty frames are solved first, then some ninety."""
    monkeypatch.setattr(scan, "_IN_MEMORY", 1)
    monkeypatch.setattr(scan, "_MOST_SETTLED", 80)
    monkeypatch.setattr(scan, "_FEWEST", 40)
    monkeypatch.setattr(scan, "_MOST", 40)
    monkeypatch.setattr(executor, "_BLOCK", 24 * 200 * 7)
    monkeypatch.setattr(executor, "_SPANS", 4)


def wobbly(n_frames: int = 120) -> np.ndarray:
    """A bending chain with ripples that no bone can follow."""
    rig = motions.chain(3, bones=4, frames=n_frames)
    frames = rig.frames
    t = np.arange(n_frames)[:, None, None]
    return frames + 0.01 * np.sin(7 * frames[..., [1, 2, 0]] + 0.2 * t)


def test_only_large_sequences_are_streamed() -> None:
    small = ssdr.MeshSequence(np.zeros((300, 10, 3)))
    large = ssdr.MeshSequence(np.broadcast_to(np.float32(0), (10_000, 10_000, 3)), validate=False)
    assert not scan.needs_streaming([small])
    assert scan.needs_streaming([large])


@pytest.mark.usefixtures("tiny_memory")
def test_the_error_is_that_of_all_frames_and_near_the_one_in_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frames = wobbly()
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
def test_same_bits_for_any_number_of_threads_from_memory_and_from_disk(tmp_path: Path) -> None:
    frames = wobbly()
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
    frames = wobbly()
    given = ssdr.decompose(
        frames, bones=4, effort="fast",
        rest=rig.rest, transforms=rig.transforms, locked_bones=[1],
    )  # fmt: skip
    np.testing.assert_allclose(given.skinning.rest, rig.rest, atol=1e-9)
    np.testing.assert_allclose(given.skinning.transforms[:, 1], rig.transforms[:, 1], atol=1e-9)


def test_an_extent_below_squares_is_refused() -> None:
    for size in (1e-120, 1e-200):
        with pytest.raises(ssdr.InputError, match="extent"):
            scan.scan([ssdr.MeshSequence(size * wobbly(9))], None)
    assert scan.scan([ssdr.MeshSequence(1e-90 * wobbly(9))], None).alignment.scale < 1e-89
    assert scan.scan([ssdr.MeshSequence(np.ones((9, 5, 3)))], None).alignment.scale == 1


@pytest.mark.usefixtures("tiny_memory")
def test_a_pass_is_one_exact_alternation() -> None:
    """The sums that a pass gathers give the error that skinning the model shows."""
    frames = wobbly(90)
    sequences = [ssdr.MeshSequence(frames[:50]), ssdr.MeshSequence(frames[50:])]
    found = scan.scan(sequences, None, keep=[7])
    assert {0, 7} <= set(found.chosen.tolist())
    assert found.importance(None).sum() == pytest.approx(90)
    few = scan.subset(sequences, found.chosen)
    np.testing.assert_array_equal(few.vertices, frames[found.chosen])
    data = gather([few], bones=4)
    model = start_model(data, data.frame(0), 4, 4, np.random.default_rng(0))
    vertex_step(data, model)
    passes = AllFrames(
        sequences, found, data, model, fixed=Fixed(), prescribed=None, importance=None
    )
    values = [passes.pass_over(entering=3) for _ in range(3)]
    assert values == sorted(values, reverse=True)
    rest, transforms = found.alignment.to_world(passes.model.rest, passes.model.transforms)
    shown = motions.blend(rest, passes.model.joints, passes.model.weights, transforms)
    squared = ((shown - frames) ** 2).sum()
    assert values[-1] * found.alignment.scale**2 == pytest.approx(squared, rel=1e-8)


@pytest.mark.usefixtures("tiny_memory")
def test_telling_frames_are_among_the_many_on_which_the_model_settles() -> None:
    found = scan.scan([ssdr.MeshSequence(wobbly())], None, keep=[7])
    more = found.extended(200)
    assert more is not None
    assert 80 <= len(more.chosen) < 120
    assert set(found.chosen) < set(more.chosen)
    np.testing.assert_array_equal(more.chosen[more.nearest[more.chosen]], more.chosen)
    other = np.setdiff1d(np.arange(120), more.chosen)
    np.testing.assert_array_equal(
        more.chosen[more.nearest[other]], found.chosen[found.nearest[other]]
    )
    assert found.extended(200_000_000) is None  # not even one could be held


@pytest.mark.usefixtures("tiny_memory")
@pytest.mark.parametrize("smoothness", [0.0, 0.01])
def test_settling_on_more_frames_pays(monkeypatch: pytest.MonkeyPatch, smoothness: float) -> None:
    frames, faces = wobbly(), motions.chain(3, bones=4, frames=2).faces
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

    result = ssdr.decompose(wobbly(), bones=4, effort="fast", callback=watch)
    assert len(result.history) == 1
    assert result.stop_reason == "cancelled"
    assert [share for _, share in seen] == sorted(share for _, share in seen)
    shares = [share for phase, share in seen if phase == "all frames"]
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


def same(a: ssdr.Skinning, b: ssdr.Skinning) -> None:
    for name in ("rest", "joints", "weights", "transforms"):
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
    frames, count, due = wobbly(), 0, not after

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
    whole = ssdr.decompose(wobbly(), bones=4, callback=lambda p: phases.append(p.phase))
    last = phases.index("spread") - 1
    count = -1

    def stop_once(_) -> bool:
        nonlocal count
        count += 1
        return count == last

    part = ssdr.decompose(wobbly(), bones=4, callback=stop_once)
    assert part.stop_reason == "cancelled"
    assert len(part.history) == 1
    assert not StreamedState.of(part.state).settling
    same(whole.skinning, ssdr.decompose(wobbly(), bones=4, resume=part.state).skinning)


def test_of_bones_to_start_from_only_locked_ones_are_given_again() -> None:
    data = gather([ssdr.MeshSequence(wobbly(12))], bones=4)
    model = start_model(data, data.frame(0), 4, 2, np.random.default_rng(0))
    prescribed = np.random.default_rng(1).standard_normal((20, 3, 3, 4))
    nearest = np.arange(20) % 12
    fixed = Fixed(bones=np.array([False, True, False]))
    moved = carried(model, nearest, 0.5, prescribed, fixed)
    np.testing.assert_array_equal(moved.transforms[:, 1], prescribed[:, 1])
    np.testing.assert_array_equal(moved.rest, 0.5 * model.rest)
    for j in (0, 2, 3):
        np.testing.assert_array_equal(
            moved.transforms[:, j] / [1, 1, 1, 0.5], model.transforms[nearest, j]
        )


@pytest.mark.usefixtures("tiny_memory")
def test_a_killed_run_goes_on_from_its_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What an exception at any moment leaves on disk is what SIGKILL leaves."""
    from ssdr.search import state

    monkeypatch.setattr(state, "_CHECKPOINT_SECONDS", 0.0)
    frames, path, seen = wobbly(), tmp_path / "run.npz", 0

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


@pytest.mark.usefixtures("tiny_memory")
def test_a_state_of_other_frames_is_refused() -> None:
    state = ssdr.decompose(wobbly(), bones=4, effort="fast").state
    for other in (wobbly(120) * 1.5, wobbly(90)):
        with pytest.raises(ssdr.InputError, match="resume"):
            ssdr.decompose(other, bones=4, effort="fast", resume=state)


@pytest.mark.usefixtures("tiny_memory")
def test_a_damaged_state_is_refused(tmp_path: Path) -> None:
    path = ssdr.decompose(wobbly(), bones=3, effort="fast").state.save(tmp_path / "good.npz")
    streamed = StreamedState.of(ssdr.SolverState.load(path))
    assert streamed is not None
    assert streamed.model is not None
    with np.load(path) as archive:
        good = dict(archive)
    bad: dict[str, np.ndarray | None] = {
        "scan_nearest": good["driver_scan_nearest"] + 10**6,
        "scan_chosen": good["driver_scan_chosen"][::-1],
        "scan_turn": good["driver_scan_turn"] * np.nan,
        "scan_scale": np.array(0.0),
        "scan_centre": good["driver_scan_centre"][1:],
        "model_transforms": good["driver_model_transforms"][1:],
        "model_weights": good["driver_model_weights"][:, :1],
        "model_rest": None,
    }
    bad = {f"driver_{name}": value for name, value in bad.items()}
    for name, value in bad.items():
        arrays = {k: v for k, v in good.items() if k != name}
        if value is not None:
            arrays[name] = value
        np.savez(tmp_path / "bad.npz", **arrays)
        with pytest.raises(ssdr.FormatError, match=r"bad\.npz"):
            ssdr.decompose(wobbly(), bones=3, effort="fast", resume=tmp_path / "bad.npz")


def test_a_checkpoint_must_have_a_place(tmp_path: Path) -> None:
    for path in (tmp_path / "a.txt", tmp_path / "none" / "a.npz", 3):
        with pytest.raises(ssdr.InputError, match="checkpoint"):
            ssdr.decompose(np.zeros((2, 4, 3)), bones=1, checkpoint=path)


@pytest.mark.usefixtures("tiny_memory")
def test_a_full_disk_does_not_end_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self, path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(ssdr.SolverState, "save", full)
    with pytest.warns(ssdr.SsdrWarning, match="no checkpoint"):
        result = ssdr.decompose(wobbly(), bones=4, effort="fast", checkpoint=tmp_path / "state.npz")
    assert result.stop_reason != "cancelled"


@pytest.mark.usefixtures("tiny_memory")
def test_the_scan_can_be_stopped() -> None:
    seen = []
    with pytest.raises(ssdr.Cancelled):
        ssdr.decompose(wobbly(), bones=4, callback=lambda p: seen.append(p.phase) or True)
    assert seen == ["scan"]


@pytest.mark.usefixtures("tiny_memory")
def test_many_short_shots_are_what_one_long_one_is() -> None:
    """Spans and blocks do not care where shots end."""
    frames = wobbly()
    cuts = [0, 1, 4, 30, 31, 33, 90, 120]
    shots = [ssdr.MeshSequence(frames[a:b]) for a, b in itertools.pairwise(cuts)]
    one = ssdr.decompose(frames, bones=4, effort="fast")
    many = ssdr.decompose(shots, bones=4, effort="fast")
    same(one.skinning, many.skinning)
    assert many.offsets.tolist() == cuts


def test_rotations_leap_to_where_they_belong() -> None:
    """Far from the start, the error falls at once below what many sweeps reach."""
    from ssdr.solver.alternation import bone_step

    rig = motions.chain(3, bones=4, frames=60)
    data = gather([ssdr.MeshSequence(rig.frames)], bones=4, compress=False)
    rest, exact = data.from_world(rig.rest, rig.transforms)
    assert exact is not None
    errors = []
    for leaps, sweeps in ((0, 6), (0, 12), (1, 6)):
        start = np.repeat(exact[:1], 60, axis=0)
        model = Model.start(start, rest, rig.joints[:, 0], rig.joints.shape[1])
        model.joints[:], model.weights[:] = rig.joints, rig.weights
        bone_step(data, model, sweeps=sweeps, fixed=Fixed(), leaps=leaps)
        r = model.transforms[..., :3]
        np.testing.assert_allclose(np.linalg.det(r), 1.0, atol=1e-9)
        np.testing.assert_allclose(
            r @ np.swapaxes(r, -1, -2), np.eye(3)[None, None] + 0 * r, atol=1e-9
        )
        shown = motions.blend(rest, model.joints, model.weights, model.transforms)
        errors.append(
            float(((shown - data.z.reshape(len(rest), 60, 3).transpose(1, 0, 2)) ** 2).sum())
        )
    assert errors[2] < errors[1] < errors[0]
