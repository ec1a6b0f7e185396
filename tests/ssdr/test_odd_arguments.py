"""Arguments of other kinds, found by trying some 5,000 of them: refused by name, or right."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import ssdr
from ssdr import InputError
from ssdr.render import render_frame

ODD = [None, "x", b"x", [], {}, set(), 1j, True, -1, float("nan"), float("inf"), object(),
       np.array([1, 2]), np.array("a"), np.datetime64("2020"), np.ma.masked, Ellipsis]  # fmt: skip


def named(value: Any) -> str:
    """A name that is the same in every process, which an object's address is not."""
    return "an object" if type(value) is object else repr(value)


def small() -> tuple[np.ndarray, np.ndarray]:
    frames = np.random.default_rng(0).normal(size=(4, 9, 3))
    return frames, np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8]])


@pytest.mark.parametrize("odd", ODD, ids=named)
def test_a_tolerance_of_welding_is_a_number(odd: Any) -> None:
    with pytest.raises(InputError, match="tolerance: expected a number >= 0"):
        ssdr.MeshSequence(*small()).weld(odd)


@pytest.mark.parametrize("odd", [o for o in ODD if o is not None], ids=named)
def test_a_number_of_threads_is_an_integer(odd: Any) -> None:
    with pytest.raises(InputError, match="count: expected"):
        ssdr.set_threads(odd)


@pytest.mark.parametrize("odd", [o for o in ODD if o is not None], ids=named)
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


@pytest.mark.parametrize("odd", ODD, ids=named)
def test_models_and_places_are_of_their_kind(odd: Any) -> None:
    frames, _ = small()
    for fit in (ssdr.fit_weights, ssdr.fit_bones, ssdr.fit_rest_pose):
        with pytest.raises(InputError, match=r"rest: expected .*(Skinning|shape)"):
            fit(frames, odd)
    for name in ("start", "rig", "checkpoint", "callback") if odd is not None else ():
        with pytest.raises(InputError, match=f"^{name}: expected"):
            ssdr.decompose(frames, bones=2, **{name: odd})
    for parts in ({"rest": odd}, {"rest_frame": odd}) if odd is not None else ():
        with pytest.raises(InputError, match=r"^start\.rest"):
            ssdr.decompose(frames, bones=2, start=ssdr.Start(**parts))
    model = ssdr.initialize(frames, bones=2)
    hung = dataclasses.replace(model, parents=[-1, 0], joint_positions=np.zeros((2, 3)))
    kinds = ("joints", "extra_bones", "locked_joints")
    for name in kinds if not (isinstance(odd, (dict, list, set)) and not odd) else ("joints",):
        with pytest.raises(InputError, match=rf"^rig\.{name}: expected"):
            ssdr.decompose(frames, rig=ssdr.Skeleton(hung, **{name: odd}))


def test_a_number_of_bones_beyond_any_memory_is_refused() -> None:
    frames, _ = small()
    for bones in (10**30, np.uint64(2**63), 2**31):
        with pytest.raises(InputError, match="bones: expected"):
            ssdr.initialize(frames, bones=bones)
        with pytest.raises(InputError, match=rf"bones: expected .*1 to 9.*{bones}"):
            ssdr.decompose(frames, bones=bones)


def test_a_mesh_of_no_size_very_far_away_under_a_tolerance() -> None:
    """Rounding alone is left of it."""
    frames, faces = small()
    with pytest.raises(InputError, match="less than 1e"):
        ssdr.smallest(frames * 1e99 + 1e198, faces, tolerance="5%", effort="fast")


@pytest.mark.parametrize("name", ["a.usda", "a.usdc", "a.csv", "a.glb", "a.npz"])
def test_a_name_with_half_a_character_is_written(name: str, tmp_path: Any) -> None:
    if name.startswith("a.usd"):
        pytest.importorskip("pxr.UsdSkel")
    frames, _ = small()
    model = ssdr.initialize(frames, bones=2)
    model = dataclasses.replace(model, name="\ud800", bone_names=("\ud800a", "b"))
    assert ssdr.save(model, tmp_path / name).bytes > 0


@pytest.mark.parametrize("name", ["a.glb", "a.gltf", "a.mdd"])
def test_a_rate_whose_times_are_no_numbers_is_refused(name: str, tmp_path: Any) -> None:
    frames, _ = small()
    model = dataclasses.replace(ssdr.initialize(frames, bones=2), fps=1e-300)
    with pytest.raises(InputError, match="fps: expected"):
        ssdr.save(model, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("odd", [o for o in ODD if o is not True], ids=named)
def test_flags_options_and_kinds_of_the_measures(odd: Any) -> None:
    frames, faces = small()
    for name in ("hausdorff", "sted"):
        with pytest.raises(InputError, match=f"{name}: expected True or False"):
            ssdr.metrics.compare(frames, frames, faces, **{name: odd})
    with pytest.raises(InputError, match="surface: expected True or False"):
        ssdr.metrics.hausdorff(frames, frames, faces, surface=odd)
    with pytest.raises(InputError, match="signed: expected True or False"):
        ssdr.metrics.sted(frames, frames, faces, signed=odd)
    if odd is not None:
        with pytest.raises(InputError, match="backend: expected"):
            ssdr.laplacian.LaplacianSmoother(frames[0], faces, 0.1, backend=odd)
    with pytest.raises(InputError, match="skinning: expected a Skinning"):
        ssdr.parsimony.size(odd)


def test_other_odd_arguments() -> None:
    frames, faces = small()
    model = ssdr.initialize(frames, bones=2)
    for call in (
        lambda: ssdr.laplacian.uniform_laplacian(faces, 10**30),
        lambda: ssdr.skin(model.rest, model.indices, model.weights, model.transforms, dtype="x"),
        lambda: render_frame(ssdr.MeshSequence(frames, faces), size=None),
        lambda: render_frame(ssdr.MeshSequence(frames, faces), size=(64, 64.5)),
        lambda: render_frame(ssdr.MeshSequence(frames, faces), size=64),
    ):
        with pytest.raises(InputError, match="expected"):
            call()
