"""Models solved for the integers in which files store their weights."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers.measures import frames, rig, rmse_of
from ssdr.io.rig import build_rig

STEPS = {"uint8": 255, "uint16": 65535}


def in_units(model: ssdr.Skinning, storage: str) -> np.ndarray:
    """Weights in whole units, which sum to what the storage holds."""
    units = STEPS[storage] * model.weights
    np.testing.assert_allclose(units, np.rint(units), atol=1e-7)
    assert (np.rint(units).sum(axis=1) == STEPS[storage]).all()
    return np.rint(units)


@pytest.fixture(scope="module")
def exact() -> ssdr.Decomposition:
    return ssdr.decompose(frames(), bones=5, influences=3, effort="fast")


@pytest.mark.parametrize("storage", ["uint8", "uint16"])
def test_weights_are_whole_units_and_files_keep_them(tmp_path: Path, storage: Any) -> None:
    result = ssdr.decompose(frames(), bones=5, influences=(3, storage), effort="fast")
    model = result.skinning
    units = in_units(model, storage)
    assert result.rmse == pytest.approx(rmse_of(model, frames()), rel=1e-6)
    assert result.history[-1].phase == "round weights"
    assert np.array_equal(build_rig(model, storage=storage).weights, units)
    report = ssdr.save(model, tmp_path / "a.glb", weights=storage)
    alone = ssdr.save(model, tmp_path / "b.glb")
    assert report.error < 2 * alone.error < 1e-6
    back = ssdr.load_skinning(tmp_path / "a.glb")
    np.testing.assert_allclose(STEPS[storage] * back.weights, units, atol=5e-3)


def test_rounding_is_solved_for_and_ends(exact: ssdr.Decomposition) -> None:
    plain = build_rig(exact.skinning, storage="uint8")
    rounded = dataclasses.replace(
        exact.skinning, indices=plain.indices, weights=plain.weights / 255.0
    )
    result = ssdr.round_weights(frames(), exact.skinning)
    in_units(result.skinning, "uint8")
    assert result.rmse < 0.99 * rmse_of(rounded, frames())
    again = ssdr.round_weights(frames(), result.skinning)
    np.testing.assert_array_equal(again.skinning.indices, result.skinning.indices)
    for name in ("weights", "rest", "transforms"):
        a, b = (getattr(r.skinning, name) for r in (again, result))
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_sixteen_bits_cost_next_to_nothing(exact: ssdr.Decomposition) -> None:
    result = ssdr.round_weights(frames(), exact.skinning, storage="uint16")
    in_units(result.skinning, "uint16")
    assert result.rmse < (1 + 1e-4) * exact.rmse


@pytest.mark.parametrize("kind", ["rigid", "loose"])
def test_a_hierarchy_and_names_stay(kind: str) -> None:
    given = ssdr.decompose(frames(), bones=4, effort="fast", rig=kind).skinning
    given = dataclasses.replace(given, bone_names=tuple("abcd"))
    model = ssdr.round_weights(frames(), given).skinning
    in_units(model, "uint8")
    assert model.bone_names == given.bone_names
    np.testing.assert_array_equal(model.parents, given.parents)
    assert (model.joint_gaps().max() < 1e-12) == (kind == "rigid")


def test_a_start_in_whole_units_is_never_left_for_worse(exact: ssdr.Decomposition) -> None:
    start = ssdr.round_weights(frames(), exact.skinning)
    again = ssdr.decompose(frames(), start=start.skinning, influences=(3, "uint8"), effort="fast")
    in_units(again.skinning, "uint8")
    assert again.rmse <= start.rmse * (1 + 1e-12)


def test_the_smallest_model_holds_the_tolerance_with_its_stored_weights() -> None:
    result = ssdr.smallest(frames(), tolerance="3%", influences=(4, "uint8"), effort="fast")
    in_units(result.skinning, "uint8")
    assert result.parsimony.held
    assert rmse_of(result.skinning, frames()) <= result.parsimony.tolerance
    stored = ssdr.parsimony.size(result.skinning, storage="uint8")
    assert stored == result.parsimony.size
    wide = ssdr.parsimony.size(result.skinning)
    assert wide.weights - stored.weights == np.count_nonzero(result.skinning.weights)


def test_frames_that_are_streamed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ssdr.search.solve.needs_streaming", lambda _: True)
    result = ssdr.decompose(rig().frames, bones=5, influences=(3, "uint8"), effort="fast")
    in_units(result.skinning, "uint8")


def test_refusals(exact: ssdr.Decomposition) -> None:
    for influences in ((3, "uint4"), (3, None)):
        with pytest.raises(ssdr.InputError, match=r"influences\[1\]: expected one of"):
            ssdr.decompose(frames(), bones=5, influences=influences)  # type: ignore[arg-type]
    with pytest.raises(ssdr.InputError, match="influences: expected an integer"):
        ssdr.decompose(frames(), bones=5, influences=(3,))  # type: ignore[arg-type]
    with pytest.raises(ssdr.InputError, match="storage: expected one of"):
        ssdr.round_weights(frames(), exact.skinning, storage="float32")  # type: ignore[arg-type]
    with pytest.raises(ssdr.InputError, match="skinning: expected a Skinning"):
        ssdr.round_weights(frames(), None)  # type: ignore[arg-type]
