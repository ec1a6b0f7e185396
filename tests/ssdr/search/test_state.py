"""Stopping, saving and going on: the same bits as a run that was never stopped."""

from __future__ import annotations

import dataclasses
import functools
import io
import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers import motions
from ssdr.solver.model import ARRAYS, Model

OPTIONS = {"bones": 4, "influences": 3, "rng": 5}


@functools.cache
def rig() -> motions.Rig:
    return motions.chain(bones=5, rows=14, frames=12)


@functools.cache
def frames() -> np.ndarray:
    return motions.wobble(rig(), 0.1)


@functools.cache
def whole(effort: str = "balanced") -> tuple[ssdr.Decomposition, list[tuple[str, int]]]:
    """An undisturbed run, and the phase and iteration of each of its steps."""
    steps: list[tuple[str, int]] = []
    result = ssdr.decompose(
        frames(), rig().faces, effort=effort, **OPTIONS,
        callback=lambda p: steps.append((p.phase, p.iteration)),
    )  # fmt: skip
    return result, steps


def stopped_after(step: int, **options: object) -> ssdr.Decomposition:
    count = 0

    def callback(progress: object) -> bool:
        nonlocal count
        count += 1
        return count == step

    return ssdr.decompose(frames(), rig().faces, callback=callback, **(OPTIONS | options))


def assert_same_model(a: ssdr.Skinning, b: ssdr.Skinning) -> None:
    for name in ("rest", "indices", "weights", "transforms"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


def stops() -> list[int]:
    """First and last step of every phase from the first model on."""
    _, steps = whole()
    phases = [phase for phase, _ in steps]
    edges = {
        k
        for k in range(len(phases))
        if k == 0 or k == len(phases) - 2 or phases[k] != phases[k - 1]
    }
    return sorted({k + 1 for k in edges} | {k + 2 for k in edges if k + 2 < len(phases)})


def test_resumed_from_a_file_at_every_phase_ends_on_the_same_bits(tmp_path: Path) -> None:
    result, steps = whole()
    seen = set()
    for step in stops():
        part = stopped_after(step)
        if part.stop_reason != "cancelled":  # more of the start's bones were merged away at once
            continue
        seen.add(steps[step - 1][0])
        path = part.state.save(tmp_path / f"{step}.npz")
        again = ssdr.decompose(frames(), rig().faces, resume=path, **OPTIONS)
        assert_same_model(again.skinning, result.skinning)
        assert again.rmse == result.rmse
        assert again.state.progress["rng"] == result.state.progress["rng"]
        assert [r.rmse for r in again.history] == [r.rmse for r in result.history]
        assert [r.iteration for r in again.history] == [r.iteration for r in result.history]
        assert again.stop_reason == result.stop_reason
        assert (np.diff([r.elapsed for r in again.history]) >= 0).all()
    assert {"quick", "compress", "start", "alternate", "reseed", "polish"} <= seen


@pytest.mark.slow
def test_resumed_within_the_best_effort(tmp_path: Path) -> None:
    """Stopped at the phases that are its own, or are longer than the default's."""
    result, steps = whole("best")
    assert {phase for phase, _ in steps} - {phase for phase, _ in whole()[1]} == {
        "regrow",
        "search",
    }
    # reseed: of the start that draws aside
    for phase in ("reseed", "regrow", "relax", "search"):
        at = [k for k, (name, _) in enumerate(steps) if name == phase]
        # the first relaxing while there are influences to spare
        for step in (at[0] + 1, at[-1] + 1):
            part = stopped_after(step, effort="best")
            assert part.stop_reason == "cancelled"
            assert part.skinning.indices.shape[1] == result.skinning.indices.shape[1]
            path = part.state.save(tmp_path / f"{phase}{step}.npz")
            again = ssdr.decompose(frames(), rig().faces, resume=path, effort="best", **OPTIONS)
            assert_same_model(again.skinning, result.skinning)


def test_a_state_of_other_steps_is_refused() -> None:
    state = stopped_after(3).state
    other = dataclasses.replace(state, settings=state.settings | {"schedule": "another"})
    with pytest.raises(ssdr.InputError, match="this version"):
        ssdr.decompose(frames(), rig().faces, resume=other, **OPTIONS)


@pytest.mark.parametrize(
    "change",
    [{"rng": None}, {"lead": None}, {"turns": 3}, {"position": 99}, {"position": -1},
     {"count": "x"}, {"best_value": []}, {"best_value": -1.0}, {"best_value": float("nan")},
     {"best_value": float("inf")}, {"best_value": "1"}, {"elapsed": float("nan")},
     {"elapsed": -1.0}, {"iteration": -1}, {"iteration": 1.5}, {"iteration": True},
     {"settled": 1}, {"damping": "x"}, {"damping": -1.0}, {"recent": ["x"]}, {"recent": [None]},
     {"recent": "12"}, {"lead": [-1.0]}, {"track": [float("nan")]}, {"turns": [0, 1, 2]},
     {"misses": [0]}, {"failures": -1}, {"count": 2.0},
     {"rng": {"bit_generator": "PCG64", "state": {"state": -1, "inc": "x"}}},
     {"rng": {"bit_generator": "MT19937"}}, {"branch_rng": []}],
    ids=str,
)  # fmt: skip
def test_a_state_whose_progress_is_damaged_is_refused(change: dict[str, object]) -> None:
    state = stopped_after(3).state
    for damaged in (
        state.progress | change,
        {k: v for k, v in state.progress.items() if k not in change},
    ):
        other = dataclasses.replace(state, progress=damaged)
        with pytest.raises(ssdr.InputError, match="damaged") as caught:
            ssdr.decompose(frames(), rig().faces, resume=other, **OPTIONS)
        assert caught.value.argument == "resume"


@pytest.mark.parametrize("smoothness", [0.0, 0.1])
def test_a_state_of_other_faces_is_refused(smoothness: float) -> None:
    """Where weights need not be smooth, the result had the faces of another mesh."""
    state = stopped_after(3, effort="fast", smoothness=smoothness).state
    arguments = OPTIONS | {"effort": "fast", "smoothness": smoothness, "resume": state}
    with pytest.raises(ssdr.InputError, match="very frames"):
        ssdr.decompose(frames(), rig().faces[:-1], **arguments)


def test_stopped_twice(tmp_path: Path) -> None:
    result, steps = whole()
    first = stopped_after(len(steps) - 12)
    second = stopped_after(5, resume=first.state)
    assert second.stop_reason == "cancelled"
    third = ssdr.decompose(frames(), rig().faces, resume=second.state, **OPTIONS)
    assert_same_model(third.skinning, result.skinning)


def test_a_limit_leaves_a_state_too() -> None:
    result, steps = whole()
    short = ssdr.decompose(frames(), rig().faces, max_iterations=steps[-8][1], **OPTIONS)
    assert short.stop_reason == "iterations"
    again = ssdr.decompose(frames(), rig().faces, resume=short.state, **OPTIONS)
    assert_same_model(again.skinning, result.skinning)


def test_a_finished_state_changes_nothing() -> None:
    result, _ = whole()
    again = ssdr.decompose(frames(), rig().faces, resume=result.state, **OPTIONS)
    assert_same_model(again.skinning, result.skinning)
    assert again.stop_reason == result.stop_reason


@pytest.mark.parametrize("kind", [np.random.PCG64, np.random.MT19937, np.random.Philox])
def test_any_generator(kind: Callable[[int], np.random.BitGenerator], tmp_path: Path) -> None:
    def run(**more: object) -> ssdr.Decomposition:
        generator = np.random.Generator(kind(3))
        return ssdr.decompose(frames(), rig().faces, **(OPTIONS | {"rng": generator} | more))

    result = run()
    part = run(max_iterations=result.history[len(result.history) // 3].iteration)
    assert part.stop_reason == "iterations"
    path = part.state.save(tmp_path / "state.npz")
    assert_same_model(run(resume=path).skinning, result.skinning)


def test_stopping_changes_no_state_that_was_handed_out() -> None:
    _, steps = whole()
    part = stopped_after(len(steps) - 12)
    assert part.state.current is not None
    before = part.state.current.copy()
    ssdr.decompose(frames(), rig().faces, resume=part.state, **OPTIONS)
    for name in vars(before):
        assert np.array_equal(getattr(before, name), getattr(part.state.current, name)), name


CHANGES: dict[str, Callable[[], dict[str, object]]] = {
    "bones": lambda: {"bones": 5},
    "influences": lambda: {"influences": 2},
    "effort": lambda: {"effort": "fast"},
    "rest_frame": lambda: {"rest_frame": 1},
    "smoothness": lambda: {"smoothness": 0.1},
    "a vertex moved": lambda: {"sequence": frames() + 1e-3 * np.eye(84)[7][:, None]},
    "moved as a whole": lambda: {"sequence": frames() + 2.0},
    "turned as a whole": lambda: {"sequence": frames() @ motions.rotation(0, 0, 1.0)},
    "a frame less": lambda: {"sequence": frames()[1:]},
    "frames in another order": lambda: {"sequence": frames()[::-1]},
    "a vertex less": lambda: {"sequence": frames()[:, :-1], "faces": None},
    "importance": lambda: {"vertex_importance": np.arange(1.0, 85.0)},
    "frame importance": lambda: {"frame_importance": np.arange(1.0, 13.0)},
    "a given rest pose": lambda: {"rest": rig().rest},
    "given bones": lambda: {"transforms": rig().transforms[:, :2]},
    "given weights": lambda: {
        "indices": np.zeros((84, 1), dtype=int), "weights": np.ones((84, 1)),
    },
}  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_refuses_the_state_of_another_run(change: str) -> None:
    result, _ = whole()
    arguments = {"sequence": frames(), "faces": rig().faces, **OPTIONS, "resume": result.state}
    with pytest.raises(ssdr.InputError) as caught:
        ssdr.decompose(**(arguments | CHANGES[change]()))
    assert caught.value.argument == "resume"


def test_round_trip(tmp_path: Path) -> None:
    state = whole()[0].state
    back = ssdr.SolverState.load(state.save(tmp_path / "s.npz"))
    assert back.settings == state.settings
    assert back.progress == state.progress
    assert back.phases == state.phases
    assert np.array_equal(back.history, state.history)
    for name in ("current", "best"):
        assert getattr(back, name).tree is None
        for field in ARRAYS:
            value, other = (getattr(getattr(s, name), field) for s in (state, back))
            assert np.array_equal(value, other), field
            assert value.dtype == other.dtype


def test_it_prints_in_a_line() -> None:
    text = repr(whole()[0].state)
    assert "bones=" in text
    assert len(text) < 120


def test_name_must_say_what_it_is(tmp_path: Path) -> None:
    with pytest.raises(ssdr.InputError, match=r"\.npz"):
        whole()[0].state.save(tmp_path / "state.bin")


def damaged(tmp_path: Path, edit: Callable[[dict[str, np.ndarray]], None]) -> Path:
    path = whole()[0].state.save(tmp_path / "s.npz")
    with np.load(path) as file:
        arrays = dict(file)
    edit(arrays)
    np.savez(path, **arrays)
    return path


def edit_header(**changes: object) -> Callable[[dict[str, np.ndarray]], None]:
    def edit(arrays: dict[str, np.ndarray]) -> None:
        header = json.loads(bytes(arrays["ssdr_state"])) | changes
        arrays["ssdr_state"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)

    return edit


def put(name: str, value: Callable[[np.ndarray], object]) -> Callable[[dict], None]:
    return lambda arrays: arrays.__setitem__(name, value(arrays[name]))


@pytest.mark.parametrize(
    "edit",
    [
        lambda arrays: arrays.pop("ssdr_state"),
        lambda arrays: arrays.pop("history"),
        lambda arrays: arrays.pop("best_weights"),
        edit_header(version=99),
        edit_header(phases=None),
        edit_header(phases="abc"),
        edit_header(phases=[1, 2]),
        put("ssdr_state", lambda _: np.frombuffer(b"[" * 100_000, dtype=np.uint8)),
        put("ssdr_state", lambda _: np.frombuffer(b'{"a":' * 100_000, dtype=np.uint8)),
        put("ssdr_state", lambda a: a[:-9]),
        put("ssdr_state", lambda a: np.array([0xFF, 0xFE], dtype=np.uint8)),
        put("best_joints", lambda a: a - 1),
        put("best_joints", lambda a: a + 4),
        put("current_support", lambda a: a + 100),
        put("current_support", lambda a: a.ravel()),
        put("current_count", lambda a: a * 0),
        put("current_count", lambda a: a + 100),
        put("best_rest", lambda a: a * np.nan),
        put("best_transforms", lambda a: a + 1e200),
        put("current_error", lambda a: -1 - a),
        put("best_weights", lambda a: -a),
        put("best_rest", lambda a: a[:-1]),
        put("best_weights", lambda a: a.astype("U9")),
        put("best_transforms", lambda a: a[..., :3]),
        put("best_transforms", lambda a: a.ravel()),
        put("history", lambda a: a.ravel()[:-1]),
    ],
    ids=range(26),
)
def test_damaged_state(edit: Callable[[dict], None], tmp_path: Path) -> None:
    path = damaged(tmp_path, edit)
    with pytest.raises(ssdr.FormatError, match=r"s\.npz"):
        ssdr.SolverState.load(path)


@pytest.mark.parametrize(
    "lists",
    [
        {"turns": [0], "misses": [0]},
        {"turns": [-4, -3, -2, "x"], "misses": [0, 0, 0, 0]},
        {"turns": [-4, -3, -2, -1], "misses": [0, 0, 0]},
        {"turns": [-4, -3, -2, -1], "misses": [0, 0, 0, -1]},
        {"track": [[1.0]]},
    ],
    ids=str,
)
def test_lists_of_a_search_have_its_lengths_and_kinds(lists: dict[str, object]) -> None:
    """Others were found at the next step, by an IndexError."""
    count = 0

    def stop(progress: ssdr.search.progress.Progress) -> bool:
        nonlocal count
        count += progress.phase == "search"
        return count == 2

    options = OPTIONS | {"effort": "best"}
    state = ssdr.decompose(frames(), rig().faces, callback=stop, **options).state
    assert len(state.progress["turns"]) == 4
    other = dataclasses.replace(state, progress=state.progress | lists)
    with pytest.raises(ssdr.InputError, match="damaged"):
        ssdr.decompose(frames(), rig().faces, resume=other, **options)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_a_history_of_what_is_no_error_is_refused(value: float) -> None:
    state = stopped_after(30).state
    history = state.history.copy()
    assert len(history)
    history[0, 2] = value
    with pytest.raises(ssdr.InputError, match="damaged"):
        ssdr.decompose(
            frames(), rig().faces, resume=dataclasses.replace(state, history=history), **OPTIONS
        )


def test_truncated_state(tmp_path: Path) -> None:
    path = whole()[0].state.save(tmp_path / "s.npz")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ssdr.FormatError, match=r"s\.npz"):
        ssdr.decompose(frames(), rig().faces, resume=path, **OPTIONS)


def test_nothing_is_unpickled(tmp_path: Path) -> None:
    path = tmp_path / "s.npz"
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    assert pickle.dumps({"a": 1})[:1] == b"\x80"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("ssdr_state.npy", buffer.getvalue())
        file.writestr("history.npy", buffer.getvalue())
    with pytest.raises(ssdr.FormatError):
        ssdr.SolverState.load(path)


def test_models_are_plain_arrays() -> None:
    state = whole()[0].state
    assert isinstance(state.best, Model)
    assert {type(getattr(state.best, name)) for name in ARRAYS} == {np.ndarray}


def test_a_result_shares_no_memory_with_its_state() -> None:
    result, _ = whole()
    assert result.state.best is not None
    for name in ("rest", "indices", "weights", "transforms"):
        mine, its = getattr(result.skinning, name), getattr(result.state.best, name)
        assert not np.shares_memory(mine, its), name
