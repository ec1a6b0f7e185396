"""``ssdr.decompose`` as a whole: each documented property, measured independently."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import threadpoolctl

import ssdr
from helpers import motions
from helpers.measures import Ticks, bits, check, frames, rig, rmse_of

# the number of bones


def test_one_bone_is_procrustes() -> None:
    """B = 1 with the rest pose kept is Kabsch; with a free one it can only be better."""
    rest = frames()[0]
    kept = ssdr.decompose(frames(), bones=1, start=ssdr.Kept(rest=rest))
    fitted = ssdr.kabsch(np.broadcast_to(rest, frames().shape), frames())
    # the reduced basis may lose a hundredth of a percent of what one bone cannot follow
    np.testing.assert_allclose(kept.skinning.transforms[:, 0], fitted, atol=1e-4)
    best = np.einsum("tab,ib->tia", fitted[..., :3], rest) + fitted[:, None, :, 3]
    assert kept.rmse == pytest.approx(np.sqrt(((best - frames()) ** 2).sum(-1).mean()), rel=1e-6)
    free = check(ssdr.decompose(frames(), bones=1), frames(), 1)
    assert free.rmse < kept.rmse


def test_plain_alternation_is_beaten() -> None:
    """Alternating the public fits from ``initialize`` by hand ends higher."""
    model = ssdr.initialize(frames(), bones=4)
    for _ in range(30):
        model = ssdr.fit_weights(frames(), model).skinning
        model = ssdr.fit_bones(frames(), model, from_transforms=True, max_sweeps=5).skinning
        model = ssdr.fit_rest_pose(frames(), model).skinning
    last = ssdr.fit_weights(frames(), model)
    assert ssdr.decompose(frames(), bones=4).rmse < last.rmse


# history


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [{}, {"smoothness": 0.1, "effort": "fast"}, {"rig": "rigid"}], ids=str
)
def test_history_is_what_a_run_stopped_there_gives(options: dict[str, Any]) -> None:
    """A run that is stopped at a record returns a model of that record's error.

    No record has less error than the last one, even where a model before it had.
    """
    call = {"sequence": frames(), "faces": rig().faces, "bones": 4} | options
    whole = ssdr.decompose(**call)
    for record in whole.history[1 :: max(1, len(whole.history) // 3)]:
        reached = {"callback": lambda p, last=record: p.iteration >= last.iteration}
        part = ssdr.decompose(**call, **reached)
        assert part.stop_reason in ("cancelled", whole.stop_reason)
        error = max(rmse_of(part.skinning, frames()), whole.rmse)
        assert error == pytest.approx(record.rmse, rel=0.01)
        assert part.history[-1].iteration == record.iteration


def test_while_a_sample_is_solved_models_are_of_the_whole_mesh() -> None:
    """The history and what a stopped run returns, measured on all vertices."""
    large = motions.chain(bones=3, rows=120, ring=8, frames=8)
    moved = motions.wobble(large, 0.05)
    seen: list[ssdr.search.progress.Progress] = []
    whole = ssdr.decompose(moved, large.faces, bones=3, callback=seen.append)
    phases = [record.phase for record in whole.history]
    assert phases[:2] == ["quick", "alternate"]
    assert phases.count("all vertices") >= 1
    errors = np.array([record.rmse for record in whole.history])
    assert (np.diff(errors) <= 0).all()
    records = [r for r in whole.history if r.phase in ("alternate", "all vertices")]
    merged = next(p for p in seen if p.phase == "merge")  # on the sample
    for last in (*records, merged):

        def reached(p: ssdr.search.progress.Progress, last: Any = last) -> bool:
            return p.iteration >= last.iteration

        part = ssdr.decompose(moved, large.faces, bones=3, callback=reached)
        assert part.stop_reason == "cancelled"
        error = rmse_of(part.skinning, moved)
        assert error == pytest.approx(part.rmse, rel=1e-6)
        if last is merged:
            assert error <= 1.01 * last.rmse
        else:
            assert max(error, whole.rmse) == pytest.approx(last.rmse, rel=0.01)


def test_progress_agrees_with_the_result() -> None:
    seen = []
    result = ssdr.decompose(frames(), bones=4, callback=lambda p: seen.append(p))
    assert seen[-1].rmse == pytest.approx(result.rmse, rel=0.01)
    assert (np.diff([p.rmse for p in seen]) <= 0).all()
    assert (np.diff([p.elapsed for p in seen]) >= 0).all()
    assert (np.diff([p.fraction for p in seen]) >= 0).all()
    assert all(0 <= p.fraction <= 1 for p in seen)
    assert all(p.time_left >= 0 for p in seen)
    phases = {"quick", "compress", "start", "merge", "alternate", "move bones", "polish"}
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


def test_time_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, late = Ticks(monkeypatch, 0.01), []

    def watch(state: ssdr.search.progress.Progress) -> None:
        if state.elapsed > 0.5:
            late.append(state.phase)

    options = {"bones": 6, "effort": "best", "time_limit": 0.5, "callback": watch}
    result = check(ssdr.decompose(frames(), **options), frames(), 6)
    assert result.stop_reason == "time limit"
    assert not result.converged
    assert clock.now < 0.6
    assert len(late) <= 1


def test_cancel_before_any_model() -> None:
    # where weights are kept, compression comes first
    given = ssdr.Kept(indices=np.zeros((84, 1), int), weights=np.ones((84, 1)))
    with pytest.raises(ssdr.Cancelled, match="before"):
        ssdr.decompose(frames(), bones=4, start=given, callback=lambda p: True)


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


@pytest.mark.parametrize("kind", ["memory map", "zarr"])
def test_what_lies_on_disk_is_as_good_as_memory(kind: str, tmp_path: Path) -> None:
    if kind == "zarr":
        zarr = pytest.importorskip("zarr")
        store = zarr.create_array(tmp_path / "f.zarr", data=frames(), chunks=(4, 84, 3))
    else:
        np.save(tmp_path / "f.npy", frames())
        store = np.load(tmp_path / "f.npy", mmap_mode="r")
    lazy = ssdr.MeshSequence(store, rig().faces)
    assert lazy.is_lazy
    assert bits(ssdr.decompose(lazy, bones=4, effort="fast")) == bits(
        ssdr.decompose(frames(), rig().faces, bones=4, effort="fast")
    )


def test_input_is_left_alone() -> None:
    given = [frames(), rig().faces, np.arange(84.0), np.arange(1.0, 16.0)]
    array, faces, vertices, rows = copies = [np.array(a) for a in given]
    counts = {"vertex_importance": vertices, "frame_importance": rows}
    ssdr.decompose(array, faces, bones=4, effort="fast", **counts)
    for before, after in zip(given, copies, strict=True):
        assert np.array_equal(before, after)


def test_what_the_sequence_carries_survives(seam: ssdr.MeshSequence) -> None:
    result = ssdr.decompose(seam, bones=2, effort="fast")
    s = result.skinning
    assert s.fps == seam.fps
    assert s.name == seam.name
    assert np.array_equal(s.faces, seam.faces)
    assert s.surface.uv is seam.surface.uv
    assert s.surface.materials is seam.surface.materials
