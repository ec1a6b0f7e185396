"""The state of a streamed run: refused for other frames, or where it is damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers import motions
from ssdr.streaming.state import StreamedState


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
