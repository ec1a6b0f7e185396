"""Arguments of other kinds, found by trying some 5,000 of them: refused by name, or right."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest

import ssdr
from ssdr import InputError

ODD = [None, "x", b"x", [], {}, set(), 1j, True, -1, float("nan"), float("inf"), object(),
       np.array([1, 2]), np.array("a"), np.datetime64("2020"), np.ma.masked, Ellipsis]  # fmt: skip


def named(value: Any) -> str:
    """A name that is the same in every process, which an object's address is not."""
    return "an object" if type(value) is object else repr(value)


FRAMES = np.random.default_rng(0).normal(size=(4, 9, 3))
FACES = np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8]])


@functools.cache
def model() -> ssdr.Skinning:
    return ssdr.initialize(FRAMES, bones=2)


def decompose(**options: Any) -> Any:
    return ssdr.decompose(FRAMES, **({"bones": 2} | options))


def skeleton(**options: Any) -> Any:
    hung = dataclasses.replace(model(), parents=[-1, 0], joint_positions=np.zeros((2, 3)))
    return ssdr.decompose(FRAMES, rig=ssdr.Skeleton(hung, **options))


# options of decompose, and the odd values that are right there
INF = float("inf")
OPTIONS: dict[str, tuple[Any, ...]] = {
    "bone_model": (), "callback": (None,), "checkpoint": (None,), "effort": (), "influences": (),
    "normals": (True,), "rest_frame": (None,), "rest_pose": (), "rig": (None,), "rng": (),
    "smoothness": (), "start": (None,), "time_limit": (None, INF), "vertex_importance": (None,),
    "frame_importance": (None,),
}  # fmt: skip
# what the error says, a call with the odd value, and the odd values that are right there
EMPTY, TWO = ([], {}, set()), (np.array([1, 2]),)
CALLS: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "tolerance: expected a number >= 0": (lambda x: ssdr.MeshSequence(FRAMES, FACES).weld(x), ()),
    "count: expected": (ssdr.set_threads, (None,)),
    "surface: expected a Surface": (lambda x: dataclasses.replace(model(), surface=x), (None,)),
    "^surface: expected": (lambda x: ssdr.MeshSequence(FRAMES, FACES, surface=x), (None,)),
    "bone_names: expected": (lambda x: dataclasses.replace(model(), bone_names=x), (None, *TWO)),
    r"rest: expected .*(Skinning|shape)": (lambda x: ssdr.fit_weights(FRAMES, x), ()),
    r"^rest: expected .*(Skinning|shape)": (lambda x: ssdr.fit_bones(FRAMES, x), ()),
    r"rest: expected (.*Skinning|.*shape)": (lambda x: ssdr.fit_rest_pose(FRAMES, x), ()),
    r"^start\.rest: ": (lambda x: decompose(start=ssdr.Kept(rest=x)), (None,)),
    r"^rig\.joints: expected": (lambda x: skeleton(joints=x), ()),
    r"^rig\.extra_bones: expected": (lambda x: skeleton(extra_bones=x), EMPTY),
    "hausdorff: expected True": (
        lambda x: ssdr.metrics.compare(FRAMES, FRAMES, FACES, hausdorff=x), (True,)),
    "sted: expected True": (lambda x: ssdr.metrics.compare(FRAMES, FRAMES, FACES, sted=x), (True,)),
    "surface: expected True": (
        lambda x: ssdr.metrics.hausdorff(FRAMES, FRAMES, FACES, surface=x), (True,)),
    "backend: expected": (
        lambda x: ssdr.laplacian.LaplacianSmoother(FRAMES[0], FACES, 0.1, backend=x), (None,)),
    "model: expected a Skinning": (ssdr.parsimony.size, ()),
}  # fmt: skip


CALLS |= {
    f"^{name}: expected": (lambda x, name=name: decompose(**{name: x}), right)
    for name, right in OPTIONS.items()
}


@pytest.mark.parametrize("said", CALLS)
def test_what_is_of_another_kind_is_refused_by_name(said: str) -> None:
    call, right = CALLS[said]
    for odd in ODD:
        if not any(odd is x or (type(odd) is type(x) and named(odd) == named(x)) for x in right):
            with pytest.raises(InputError, match=said):
                call(odd)


@pytest.mark.parametrize("name", ["a.usda", "a.usdc", "a.glb", "a.npz"])
def test_a_name_with_half_a_character_is_written(name: str, tmp_path: Any) -> None:
    if name.startswith("a.usd"):
        pytest.importorskip("pxr.UsdSkel")
    odd = dataclasses.replace(model(), name="\ud800", bone_names=("\ud800a", "b"))
    assert ssdr.save(odd, tmp_path / name).bytes > 0
