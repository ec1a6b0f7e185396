"""Arguments that ``decompose`` and ``smallest`` refuse, and the argument that each error names."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions, trees
from helpers.measures import frames, rig

TWO = np.tile(np.eye(3, 4), (15, 2, 1, 1))
SHOT = ssdr.MeshSequence(frames(), rig().faces)
EACH_ONE = {"indices": np.zeros((84, 1), int), "weights": np.ones((84, 1))}


def far(size: float) -> np.ndarray:
    """Two bones at this distance from the origin."""
    return np.tile(np.c_[np.eye(3), np.full(3, size)], (15, 2, 1, 1))


@pytest.mark.parametrize("function", [ssdr.decompose, ssdr.smallest])
def test_a_mistyped_keyword_is_refused_with_the_one_that_was_meant(function: Any) -> None:
    with pytest.raises(ssdr.InputError, match=r"^bone: expected bones, got an argument that"):
        function(SHOT, bone=3)
    with pytest.raises(ssdr.InputError, match=r"^xyz: expected sequence, faces, .*bones"):
        function(SHOT, xyz=3)


REFUSED: dict[str, tuple[str, dict[str, Any]]] = {
    "no bones": ("bones", {"bones": 0}),
    "bones of no number": ("bones", {"bones": None}),
    "more bones than vertices": ("bones", {"bones": 85}),
    "bones as text": ("bones", {"bones": "5"}),
    "no influences": ("influences", {"influences": 0}),
    "unknown effort": ("effort", {"effort": "heroic"}),
    "efforts": ("effort", {"effort": np.array(["fast", "best"])}),
    "positions beyond squares": ("vertices", {"sequence": 1e200 * frames()}),
    "an extent below squares": ("vertices", {"sequence": 1e-200 * frames()}),
    "an extent of subnormals": ("vertices", {"sequence": 1e-310 * frames()}),
    "unknown bone model": ("bone_model", {"bone_model": "soft"}),
    "unknown rig": ("rig", {"rig": "tree"}),
    "a rig that is true": ("rig", {"rig": True}),
    "rigs": ("rig", {"rig": np.array(["rigid", "loose"])}),
    "no time": ("time_limit", {"time_limit": 0.0}),
    "time NaN": ("time_limit", {"time_limit": float("nan")}),
    "time as text": ("time_limit", {"time_limit": "10"}),
    "time that is true": ("time_limit", {"time_limit": True}),
    "unknown rest pose": ("rest_pose", {"rest_pose": "first"}),
    "a rest pose of points": ("rest_pose", {"rest_pose": np.zeros((84, 3))}),
    "no rest pose": ("rest_pose", {"rest_pose": None}),
    "normals as a number": ("normals", {"normals": 1}),
    "normals as text": ("normals", {"normals": "fitted"}),
    "normals of each vertex": ("normals", {"normals": np.ones((84, 3))}),
    "smoothness as text": ("smoothness", {"smoothness": "0.1"}),
    "smoothness below 0": ("smoothness", {"smoothness": -1}),
    "smoothness NaN": ("smoothness", {"smoothness": float("nan")}),
    "smoothness without faces": ("smoothness", {"smoothness": 1.0, "faces": None}),
    "a file's name": ("vertices", {"sequence": "walk.npz"}),
    "shots as arrays": ("sequence", {"sequence": [np.zeros((3, 84, 3)), np.zeros((5, 84, 3))]}),
    "importance below 0": ("vertex_importance", {"vertex_importance": -np.ones(84)}),
    "importance all 0": ("vertex_importance", {"vertex_importance": np.zeros(84)}),
    "importance of others": ("vertex_importance", {"vertex_importance": np.ones(83)}),
    "a frame of no importance": ("frame_importance", {"frame_importance": np.arange(15.0)}),
    "no seed": ("rng", {"rng": None}),
    "shots of other meshes": (
        "sequence[1]",
        {"sequence": [SHOT, ssdr.MeshSequence(frames()[:, :-1])], "faces": None},
    ),
    "shots of other faces": (
        "sequence[1].faces",
        {"sequence": [SHOT, ssdr.MeshSequence(frames(), rig().faces[::-1])], "faces": None},
    ),
    "a shot and an array": ("sequence[1]", {"sequence": [SHOT, frames()], "faces": None}),
    "faces twice": ("faces", {"sequence": ssdr.MeshSequence(np.zeros((2, 84, 3)))}),
    "a callback that is none": ("callback", {"callback": 3}),
    "a frame that is true": ("rest_frame", {"rest_frame": True}),
    "half a frame": ("rest_frame", {"rest_frame": 2.5}),
    "rest frame out of range": ("rest_frame", {"rest_frame": 15}),
    "a rest frame beside a rest pose": (
        "rest_frame",
        {"rest_frame": 1, "start": ssdr.Start(rest=frames()[0])},
    ),
}
REFUSED_PARTS: dict[str, tuple[str, dict[str, Any]]] = {
    "indices alone": ("weights", {"indices": np.zeros((84, 1), int)}),
    "weights alone": ("indices", {"weights": np.ones((84, 1))}),
    "indices out of range": ("indices", EACH_ONE | {"indices": np.full((84, 1), 4)}),
    "indices beyond 32 bits": ("indices", EACH_ONE | {"indices": np.full((84, 1), 2**32)}),
    "ragged indices": ("indices", EACH_ONE | {"indices": 83 * [[0]] + [[0, 1]]}),
    "too many influences": (
        "weights", {"indices": np.tile(np.arange(4), (84, 1)), "weights": np.full((84, 4), 0.25)},
    ),
    "a bone twice": (
        "indices", {"indices": np.zeros((84, 2), int), "weights": np.full((84, 2), 0.5)},
    ),
    "rest of another mesh": ("rest", {"rest": np.zeros((83, 3))}),
    "complex rest": ("rest", {"rest": np.zeros((84, 3), complex)}),
    "rest NaN": ("rest", {"rest": np.full((84, 3), np.nan)}),
    "rest beyond squares": ("rest", {"rest": np.full((84, 3), 1e155)}),
    "rest beyond squares of the mesh": (
        "rest", {"sequence": 1e-60 * frames(), "rest": np.full((84, 3), 1e95)},
    ),
}  # fmt: skip


@functools.cache
def made() -> trees.Skeleton:
    return trees.skeleton(6, 15, seed=3, around=14)


@functools.cache
def skeleton() -> ssdr.Skinning:
    return made().skinning(bone_names=NAMES)


NAMES = ("hips", "spine", "arm", "leg", "hand", "foot")
REFUSED_RIGS: dict[str, tuple[str, dict[str, Any]]] = {
    "an affine tree": ("bone_model", {"rig": "rigid", "bone_model": "affine"}),
    "growing bones that hang": ("bone_model", {"rig": "loose", "bone_model": "similarity"}),
    "a smooth tree": ("smoothness", {"rig": "rigid", "smoothness": 0.1}),
    "a tree of given weights": ("start.weights", {"rig": "rigid"} | EACH_ONE),
}
REFUSED_SKELETONS: dict[str, tuple[str, dict[str, Any]]] = {
    "no model": ("rig.skinning", {"skinning": np.zeros((6, 3))}),
    "no hierarchy": (
        "rig.skinning",
        {"skinning": motions.model(np.zeros((84, 3)))},
    ),
    "joints of another kind": ("rig.joints", {"joints": "none"}),
    "more bones than it has": ("bones", {"bones": 7}),
    "more bones beside extra ones": ("bones", {"extra_bones": {"hand": 1}, "bones": 6}),
    "fewer than no extra bones": ("rig.extra_bones", {"extra_bones": -1}),
    "half an extra bone": ("rig.extra_bones", {"extra_bones": 1.5}),
    "extra bones beyond memory": ("rig.extra_bones", {"extra_bones": 10**12}),
    "extra bones below nothing": ("rig.extra_bones", {"extra_bones": {"tail": 1}}),
    "fewer than none by name": ("rig.extra_bones", {"extra_bones": {"hand": -1}}),
    "loose extra bones": ("rig.extra_bones", {"joints": "loose", "extra_bones": 2}),
    "extra bones beside weights": ("rig.extra_bones", {"extra_bones": 1} | EACH_ONE),
    "an affine skeleton": ("bone_model", {"bone_model": "affine"}),
    "a smooth skeleton": ("smoothness", {"smoothness": 0.1}),
}


def still(n: int = 84, bones: int = 4, **parts: Any) -> ssdr.Skinning:
    arrays = {"transforms": np.tile(np.eye(3, 4), (15, bones, 1, 1))} | parts
    return motions.model(np.zeros((n, 3)), **arrays)


TWICE = {"indices": np.zeros((84, 2), int), "weights": np.full((84, 2), 0.5)}
THREE = {"indices": np.tile([0, 1, 2], (84, 1)), "weights": np.full((84, 3), 1 / 3)}
GROWN = {"transforms": np.tile(2 * np.eye(3, 4), (15, 2, 1, 1)), "bone_model": "affine"}
DENSE = ssdr.Start(weights=np.eye(84)[:, :2])
ON = {"sequence": made().frames, "rig": ssdr.Skeleton(skeleton())}
FLAT = dataclasses.replace(skeleton(), parents=None, joint_positions=None)
OTHER = dataclasses.replace(skeleton(), parents=[-1, 0, 0, 0, 0, 0])
REFUSED_STARTS: dict[str, tuple[str, dict[str, Any]]] = {
    "a file's name to start from": ("start", {"start": "model.npz", "bones": 2}),
    "a skeleton": ("start", {"start": ssdr.Skeleton(skeleton()), "bones": 2}),
    "another mesh": ("start", {"start": still(83)}),
    "more bones than the start": ("bones", {"start": still(), "bones": 5}),
    "bones that are true": ("bones", {"start": still(bones=1), "bones": True}),
    "a start of more bones than vertices": ("start", {"start": still(bones=85)}),
    "a start of too many influences": (
        "start.weights",
        {"start": still(**THREE), "influences": 2},
    ),
    "dense weights": ("start.indices", {"start": DENSE, "bones": 2}),
    "a bone twice in the start": ("start.indices", {"start": still(**TWICE)}),
    "bones that grow": ("start.transforms", {"start": still(**GROWN)}),
    "bones beyond squares": ("start.transforms", {"start": still(transforms=far(1e155))}),
    "bones beyond squares of the mesh": (
        "start.transforms",
        {"sequence": 1e-60 * frames(), "start": still(transforms=far(1e95))},
    ),
    "far away": ("start.rest", {"start": motions.model(np.full((84, 3), 1e155))}),
    "other bones than the skeleton's": ("start", ON | {"start": still(), "sequence": frames()}),
    "another skeleton's": ("start", ON | {"start": OTHER}),
    "no skeleton's": ("start", ON | {"start": FLAT}),
}


def linear(matrix: Any) -> np.ndarray:
    m = np.tile(np.eye(3, 4), (15, 2, 1, 1))
    m[3, 1, :, :3] = matrix
    return m


REFUSED_KINDS: dict[str, tuple[str, str, np.ndarray]] = {
    "rigid, grown": ("rigid", "off by", 1.1 * np.eye(3)),
    "similarity, sheared": ("similarity", "off by", np.diag([1, 1, 1.1])),
    "similarity, mirrored": ("similarity", "reflection", np.diag([2, 2, -2.0])),
    "similarity, of size 0": ("similarity", "zeros", np.zeros((3, 3))),
    "affine, mirrored": ("affine", "reflection", np.diag([2, 1, -1.0])),
    "affine, flat": ("affine", "singular", np.diag([2, 1, 0.0])),
}
REFUSED_STARTS |= {
    f"{name} ({why})": (
        "start.transforms",
        {"bone_model": kind, "start": still(transforms=linear(matrix), bone_model="affine")},
    )
    for name, (kind, why, matrix) in REFUSED_KINDS.items()
}
TOLERANCES = ["half", "0.5", "%", "0%", "-1%", "1.2.3%", "nan%", "inf%", "", 0, -0.1, True, np.nan,
              np.inf, [1]]  # fmt: skip
UNEVEN = np.where(np.arange(84) < 42, 5.0, 4e-6)
REFUSED_SMALLEST: dict[str, tuple[str, dict[str, Any]]] = {
    "the mean": ("measure", {"measure": "mean"}),
    "smallest of no bones": ("bones", {"bones": 0}),
    "smallest of more bones than vertices": ("bones", {"bones": 85}),
    "a soft rest pose": ("rest_pose", {"rest_pose": "soft"}),
    "weights beside a tolerance": ("start.weights", {"start": ssdr.Start(**EACH_ONE)}),
    "vertices of no importance": ("vertex_importance", {"vertex_importance": np.arange(84) < 42}),
    "importances too far apart": ("vertex_importance", {"vertex_importance": UNEVEN}),
    "normals in words": ("normals", {"normals": "no"}),
    **{f"tolerance {t!r}": ("tolerance", {"tolerance": t}) for t in TOLERANCES},
}


@pytest.mark.parametrize(
    "case", [*REFUSED, *REFUSED_PARTS, *REFUSED_RIGS, *REFUSED_SKELETONS, *REFUSED_STARTS]
)
def test_decompose_refuses(case: str) -> None:
    """The error names the argument as the caller wrote it, before anything is computed."""
    tables = REFUSED | REFUSED_PARTS | REFUSED_RIGS | REFUSED_SKELETONS | REFUSED_STARTS
    argument, change = tables[case]
    change = {"bones": None if case in REFUSED_STARTS else 4} | change
    if case in REFUSED_PARTS:
        argument, change["influences"] = f"start.{argument}", 3
    if case in REFUSED_SKELETONS:
        change = {"sequence": made().frames, "skinning": skeleton(), "bones": None}
        change |= REFUSED_SKELETONS[case][1]
        parts = {name: change.pop(name) for name in RIG if name in change}
        change["rig"] = ssdr.Skeleton(parts.pop("skinning"), **parts)
    parts = {name: change.pop(name) for name in PARTS if name in change}
    if parts:
        change["start"] = ssdr.Start(**parts)
    error = refusal(ssdr.decompose, change)
    assert error.argument == argument
    assert case.partition("(")[2].rstrip(")") in str(error)


@pytest.mark.parametrize("case", REFUSED_SMALLEST)
def test_smallest_refuses(case: str) -> None:
    argument, change = REFUSED_SMALLEST[case]
    error = refusal(ssdr.smallest, {"tolerance": "1%"} | change)
    assert error.argument == argument
    assert argument != "tolerance" or "a share of the diagonal such as" in str(error)


def refusal(function: Any, change: dict[str, Any]) -> ssdr.InputError:
    calls: list[object] = []
    call = {"sequence": frames(), "faces": rig().faces, "callback": calls.append}
    with pytest.raises(ssdr.InputError, match="expected") as caught:
        function(**(call | change))
    assert not calls
    return caught.value


def test_errors_say_where_a_start_is_found() -> None:
    for start, said in (
        (DENSE, r"Skinning\.from_dense has both"),
        (still(**TWICE), r"from_dense of dense_weights\(\) adds them up"),
    ):
        with pytest.raises(ssdr.InputError, match=said):
            ssdr.decompose(frames(), start=start, bones=2 if start is DENSE else None)


PARTS = [field.name for field in dataclasses.fields(ssdr.Start)]
RIG = [field.name for field in dataclasses.fields(ssdr.Skeleton) if field.name != "_"]
