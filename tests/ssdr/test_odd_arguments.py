"""Arguments of other kinds, found by trying some 5,000 of them: refused by name, or right."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import ssdr
from ssdr import InputError

ODD = [None, "x", b"x", [], {}, set(), 1j, True, -1, float("nan"), float("inf"), object(),
       np.array([1, 2]), np.array("a"), np.datetime64("2020"), np.ma.masked, Ellipsis]  # fmt: skip


def small() -> tuple[np.ndarray, np.ndarray]:
    frames = np.random.default_rng(0).normal(size=(4, 9, 3))
    return frames, np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8]])


@pytest.mark.parametrize("odd", ODD, ids=repr)
def test_a_tolerance_of_welding_is_a_number(odd: Any) -> None:
    with pytest.raises(InputError, match="tolerance: expected a number >= 0"):
        ssdr.MeshSequence(*small()).weld(odd)


@pytest.mark.parametrize("odd", [o for o in ODD if o is not None], ids=repr)
def test_a_number_of_threads_is_an_integer(odd: Any) -> None:
    with pytest.raises(InputError, match="count: expected"):
        ssdr.set_threads(odd)


@pytest.mark.parametrize("odd", [o for o in ODD if o is not None], ids=repr)
def test_a_surface_and_names_are_of_their_kind(odd: Any) -> None:
    frames, faces = small()
    with pytest.raises(InputError, match="surface: expected a Surface"):
        ssdr.MeshSequence(frames, faces, surface=odd)
    model = ssdr.initialize(frames, bones=2)
    with pytest.raises(InputError, match="surface: expected a Surface"):
        dataclasses.replace(model, surface=odd)
    if not (isinstance(odd, np.ndarray) and odd.shape == (2,)):
        with pytest.raises(InputError, match="bone_names: expected"):
            dataclasses.replace(model, bone_names=odd)


def test_a_number_of_bones_beyond_any_memory_is_refused() -> None:
    frames, _ = small()
    model = ssdr.initialize(frames, bones=2)
    fixed = {"rest": model.rest, "joints": model.joints, "weights": model.weights}
    for bones in (10**30, np.uint64(2**63), 2**31):
        with pytest.raises(InputError, match="bones: expected"):
            ssdr.fit_bones(frames, **fixed, bones=bones)


def test_a_mesh_of_no_size_very_far_away_under_a_tolerance() -> None:
    """Rounding alone is left of it: its square was no number."""
    frames, faces = small()
    with pytest.raises(InputError, match="less than 1e"):
        ssdr.decompose(frames * 1e99 + 1e198, faces, tolerance="5%", effort="fast")


@pytest.mark.parametrize("name", ["a.usda", "a.usdc", "a.csv", "a.glb", "a.json", "a.npz"])
def test_a_name_with_half_a_character_is_written(name: str, tmp_path: Any) -> None:
    """A glTF's JSON may spell one."""
    if name.startswith("a.usd"):
        pytest.importorskip("pxr.UsdSkel")
    frames, _ = small()
    model = ssdr.initialize(frames, bones=2)
    model = dataclasses.replace(model, name="\ud800", bone_names=("\ud800a", "b"))
    assert ssdr.save(model, tmp_path / name).bytes > 0


@pytest.mark.parametrize("name", ["a.glb", "a.gltf", "a.mdd"])
def test_a_rate_whose_times_are_no_numbers_is_refused(name: str, tmp_path: Any) -> None:
    """Infinite times were written."""
    frames, _ = small()
    model = dataclasses.replace(ssdr.initialize(frames, bones=2), fps=1e-300)
    with pytest.raises(InputError, match="fps: expected"):
        ssdr.save(model, tmp_path / name)
    assert list(tmp_path.iterdir()) == []
