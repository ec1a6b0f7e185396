"""Sequences that do not fit into memory: exact over all frames, whatever was solved first."""

from __future__ import annotations

from pathlib import Path

import motions
import numpy as np
import pytest

import ssdr
from ssdr import streaming
from ssdr.initialization import start_model
from ssdr.model import Fixed, vertex_step
from ssdr.trajectories import gather


@pytest.fixture
def tiny_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything counts as too large; forty frames are solved first."""
    monkeypatch.setattr(streaming, "_IN_MEMORY", 1)
    monkeypatch.setattr(streaming, "_FEWEST", 40)
    monkeypatch.setattr(streaming, "_MOST", 40)
    monkeypatch.setattr(streaming, "_BLOCK", 24 * 200 * 7)


def wobbly(n_frames: int = 120) -> np.ndarray:
    """A bending chain with ripples that no bone can follow."""
    rig = motions.chain(3, bones=4, frames=n_frames)
    frames = rig.frames
    t = np.arange(n_frames)[:, None, None]
    return frames + 0.01 * np.sin(7 * frames[..., [1, 2, 0]] + 0.2 * t)


def test_only_large_sequences_are_streamed() -> None:
    small = ssdr.MeshSequence(np.zeros((300, 10, 3)))
    large = ssdr.MeshSequence(np.broadcast_to(np.float32(0), (10_000, 10_000, 3)), validate=False)
    assert not streaming.needs_streaming([small])
    assert streaming.needs_streaming([large])


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
    monkeypatch.setattr(streaming, "_IN_MEMORY", 1 << 40)
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


@pytest.mark.usefixtures("tiny_memory")
def test_a_pass_is_one_exact_alternation() -> None:
    """The sums that a pass gathers give the error that skinning the model shows."""
    frames = wobbly(90)
    sequences = [ssdr.MeshSequence(frames[:50]), ssdr.MeshSequence(frames[50:])]
    found = streaming.scan(sequences, None, keep=[7])
    assert {0, 7} <= set(found.chosen.tolist())
    assert found.importance(None).sum() == pytest.approx(90)
    few = streaming.subset(sequences, found.chosen)
    np.testing.assert_array_equal(few.vertices, frames[found.chosen])
    data = gather([few], bones=4)
    model = start_model(data, data.frame(0), 4, 4, np.random.default_rng(0))
    vertex_step(data, model)
    passes = streaming.AllFrames(
        sequences, found, data, model, fixed=Fixed(), given=None, importance=None
    )
    values = [passes.pass_over(entering=3) for _ in range(3)]
    assert values == sorted(values, reverse=True)
    rest, transforms = found.alignment.to_world(passes.model.rest, passes.model.transforms)
    shown = motions.blend(rest, passes.model.joints, passes.model.weights, transforms)
    squared = ((shown - frames) ** 2).sum()
    assert values[-1] * found.alignment.scale**2 == pytest.approx(squared, rel=1e-8)


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
