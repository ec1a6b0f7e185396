"""The state of a streamed run: refused for other frames, or where it is damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers import motions
from ssdr.drivers import scan
from ssdr.drivers.streamed_state import StreamedState


@pytest.mark.usefixtures("tiny_memory")
def test_a_state_of_other_frames_is_refused() -> None:
    state = ssdr.decompose(motions.rippled(), bones=4, effort="fast").state
    for other in (motions.rippled(120) * 1.5, motions.rippled(90)):
        with pytest.raises(ssdr.InputError, match="resume"):
            ssdr.decompose(other, bones=4, effort="fast", resume=state)


@pytest.mark.usefixtures("tiny_memory")
def test_a_damaged_state_is_refused(tmp_path: Path) -> None:
    path = ssdr.decompose(motions.rippled(), bones=3, effort="fast").state.save(
        tmp_path / "good.npz"
    )
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
            ssdr.decompose(motions.rippled(), bones=3, effort="fast", resume=tmp_path / "bad.npz")


@pytest.mark.usefixtures("tiny_memory")
@pytest.mark.parametrize("phase", ["polish", "all frames", "end"])
@pytest.mark.parametrize("frames", ["chosen", "settling", "others"])
def test_a_state_of_frames_that_have_changed_anywhere_is_refused(phase: str, frames: str) -> None:
    """Only the representative frames were compared."""
    first = motions.rippled()
    count = 0

    def stop(progress: ssdr.search.progress.Progress) -> bool:
        nonlocal count
        count += progress.phase == phase
        return count == 3

    state = ssdr.decompose(first, bones=4, callback=stop).state
    streamed = StreamedState.of(state)
    assert streamed is not None
    few = streamed.scan
    more = few.extended(first.shape[1])
    assert more is not None
    among = {
        "chosen": few.chosen[1:],
        "settling": np.setdiff1d(more.chosen, few.chosen),
        "others": np.setdiff1d(np.arange(len(first)), more.chosen),
    }[frames]
    changed = first.copy()
    changed[among[3], 17] *= 1 + 1e-12  # a single vertex, hardly
    with pytest.raises(ssdr.InputError, match="very frames") as caught:
        ssdr.decompose(changed, bones=4, resume=state)
    assert caught.value.argument == "resume"
    # float32 that became float64 is the same animation
    ssdr.decompose(list(first), bones=4, resume=state, max_iterations=1)


@pytest.mark.usefixtures("tiny_memory")
def test_under_a_tolerance_other_frames_are_refused_too() -> None:
    frames = motions.rippled()
    options = {"tolerance": "2%", "bones": 12, "effort": "fast"}
    state = ssdr.decompose(frames, **options).state
    chosen = scan.scan([ssdr.MeshSequence(frames)], None, keep=[0]).chosen
    frames[np.setdiff1d(np.arange(len(frames)), chosen)[5], 3] += 0.1
    with pytest.raises(ssdr.InputError, match="very frames"):
        ssdr.decompose(frames, **options, resume=state)


@pytest.mark.usefixtures("tiny_memory")
def test_frames_that_change_during_the_run_are_an_error() -> None:
    frames = motions.rippled()

    def spoil(progress: ssdr.search.progress.Progress) -> None:
        if progress.phase == "polish":
            frames[:] = 0

    with pytest.raises(ssdr.InputError, match="stay as they are during the run"):
        ssdr.decompose(frames, bones=4, effort="fast", callback=spoil)


@pytest.mark.usefixtures("tiny_memory")
def test_the_same_numbers_from_elsewhere_are_the_same_frames(tmp_path: Path) -> None:
    """Of another dtype, byte order or place, in other blocks, with zeros of the other sign."""
    frames = motions.rippled().astype(np.float32)
    frames[:, 0, 0] = 0.0
    state = ssdr.decompose(frames, bones=4, effort="fast").state
    np.save(tmp_path / "a.npy", frames)
    minus = frames.astype(np.float64)
    minus[:, 0, 0] = -0.0
    for same in (
        minus,
        frames.astype(">f4"),
        np.asfortranarray(frames),
        np.load(tmp_path / "a.npy", mmap_mode="r"),
    ):
        again = ssdr.decompose(same, bones=4, effort="fast", resume=state)
        assert again.skinning.n_frames == len(frames)
    # Other boundaries of clips make another model.
    shots = [ssdr.MeshSequence(frames[:7]), ssdr.MeshSequence(frames[7:].astype(np.float64))]
    with pytest.raises(ssdr.InputError, match=r"clips of \[7, 113\] frames"):
        ssdr.decompose(shots, bones=4, effort="fast", resume=state)
