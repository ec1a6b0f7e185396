"""What solving refuses: decompositions, the smallest model, fits and starts."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions, trees
from helpers.calls import Call, Row, each, refused
from helpers.measures import frames, rig

SHOT = ssdr.MeshSequence(frames(), rig().faces)
TURNED = ssdr.MeshSequence(frames(), rig().faces[::-1])
EACH_ONE = {"indices": np.zeros((84, 1), int), "weights": np.ones((84, 1))}
TWICE = {"indices": np.zeros((84, 2), int), "weights": np.full((84, 2), 0.5)}
THREE = {"indices": np.tile([0, 1, 2], (84, 1)), "weights": np.full((84, 3), 1 / 3)}
GROWN = {"transforms": np.tile(2 * np.eye(3, 4), (15, 2, 1, 1)), "bone_model": "affine"}
UNEVEN = np.where(np.arange(84) < 42, 5.0, 4e-6)
DENSE = ssdr.Kept(weights=np.eye(84)[:, :2])
MADE = trees.skeleton(6, 15, seed=3, around=14)
SKELETON = MADE.skinning(bone_names=("hips", "spine", "arm", "leg", "hand", "foot"))


def far(size: float) -> np.ndarray:
    """Two bones at this distance from the origin."""
    return np.tile(np.c_[np.eye(3), np.full(3, size)], (15, 2, 1, 1))


def still(n: int = 84, bones: int = 4, **parts: Any) -> ssdr.Skinning:
    arrays = {"transforms": np.tile(np.eye(3, 4), (15, bones, 1, 1))} | parts
    return motions.model(np.zeros((n, 3)), **arrays)


def linear(matrix: Any) -> ssdr.Skinning:
    m = np.tile(np.eye(3, 4), (15, 2, 1, 1))
    m[3, 1, :, :3] = matrix
    return still(transforms=m, bone_model="affine")


def start(**parts: Any) -> dict[str, Any]:
    return {"start": ssdr.Kept(**parts), "influences": 3}


def hung(**parts: Any) -> dict[str, Any]:
    return {"rig": ssdr.Skeleton(**({"skinning": SKELETON} | parts))}


CHAIN = motions.chain(bones=5)
SHAPED = ssdr.ShapedSkinning(CHAIN.skinning, ssdr.Shapes(np.zeros((1, 120, 3)), np.zeros((20, 1))))
MATRIX = CHAIN.skinning.dense_weights()
MASK = np.ones((120, 5), bool)
MIRRORED = motions.model(CHAIN.rest, transforms=CHAIN.transforms * np.array([1, 1, -1, 1.0]))
OTHER_FRAMES = motions.model(CHAIN.rest, transforms=np.tile(np.eye(3, 4), (19, 2, 1, 1)))
UNMOVED = motions.model(CHAIN.rest, CHAIN.indices, CHAIN.weights)


def arrays(*names: str) -> dict[str, Any]:
    return {"sequence": CHAIN.frames} | {name: getattr(CHAIN, name) for name in names}


ON_FRAMES = {"sequence": frames(), "faces": rig().faces}
CALLS: dict[str, Call] = {
    "decompose": (ssdr.decompose, ON_FRAMES | {"bones": 4}),
    "start": (ssdr.decompose, ON_FRAMES),
    "skeleton": (ssdr.decompose, {"sequence": MADE.frames, "faces": rig().faces}),
    "smallest": (ssdr.smallest, ON_FRAMES | {"tolerance": "1%"}),
    "fit_bones": (ssdr.fit_bones, {"sequence": CHAIN.frames, "rest": UNMOVED}),
    "fit_weights": (ssdr.fit_weights, {"sequence": CHAIN.frames, "rest": CHAIN.skinning}),
    "fit_rest_pose": (ssdr.fit_rest_pose, {"sequence": CHAIN.frames, "rest": CHAIN.skinning}),
    "initialize": (ssdr.initialize, {"sequence": CHAIN.frames, "bones": 3}),
    "ssdr2012": (ssdr.ssdr2012, {"sequence": CHAIN.frames, "bones": 3}),
    "weights": (ssdr.fit_weights, arrays("rest", "transforms")),
    "bones": (ssdr.fit_bones, arrays("rest", "indices", "weights")),
    "rest_pose": (ssdr.fit_rest_pose, arrays("rest", "indices", "weights", "transforms")),
}
FAR_REST = np.full((84, 3), 1e155)
NEAR_REST = {"sequence": 1e-60 * frames()}
NO_TOLERANCE = ["half", "0.5", "%", "0%", "-1%", "1.2.3%", "nan%", "inf%", "", 0, -0.1, True,
                np.nan, np.inf, [1]]  # fmt: skip
REFUSED: list[Row] = [
    ("decompose", "bone", "expected bones, got an argument that", [3]),
    ("smallest", "bone", "expected bones, got an argument that", [3]),
    ("decompose", "xyz", "expected sequence, faces, ", [3]),
    ("decompose", "bones", "", [None, "5"]),
    ("decompose", "bones", "an integer from 1 to 84", [10**30, np.uint64(2**63), 2**31]),
    ("decompose", "influences", "", [0]),
    ("decompose", "effort", "", [np.array(["fast", "best"])]),
    ("decompose", "rig", "", [np.array(["rigid", "loose"])]),
    ("decompose", "time_limit", "", [0.0]),
    ("decompose", "rest_pose", "", [np.zeros((84, 3))]),
    ("decompose", "normals", "", [np.ones((84, 3)), 0]),
    ("decompose", "smoothness", "", [{"smoothness": 1.0, "faces": None}]),
    ("decompose", "smoothness", "", [{"rig": "rigid", "smoothness": 0.1}]),
    ("decompose", "vertices", "",
     [{"sequence": x} for x in (1e200 * frames(), 1e-200 * frames(), 1e-310 * frames(), "a.npz")]),
    ("decompose", "sequence", "", [[np.zeros((3, 84, 3)), np.zeros((5, 84, 3))]]),
    ("decompose", "sequence[1]", "",
     [{"sequence": [SHOT, second], "faces": None}
      for second in (ssdr.MeshSequence(frames()[:, :-1]), frames())]),
    *((call, "sequence[1].faces", "", [{"sequence": [SHOT, TURNED], "faces": None}])
      for call in ("decompose", "smallest")),
    ("decompose", "faces", "", [{"sequence": ssdr.MeshSequence(np.zeros((2, 84, 3)))}]),
    ("decompose", "vertex_importance", "", [-np.ones(84), np.zeros(84), np.ones(83)]),
    ("decompose", "frame_importance", "", [np.arange(15.0)]),
    ("decompose", "rest_frame", "", [2.5, 15]),
    ("decompose", "rest_frame", "", [{"rest_frame": 1, "start": ssdr.Kept(rest=frames()[0])}]),
    ("decompose", "bone_model", "",
     [{"rig": "rigid", "bone_model": "affine"}, {"rig": "loose", "bone_model": "similarity"}]),
    ("decompose", "checkpoint", "", ["a.txt", "none/a.npz", "folder.npz", 3, True, b"a.npz"]),
    ("decompose", "start.weights", "",
     [start(**EACH_ONE) | {"rig": "rigid"}, start(indices=EACH_ONE["indices"]),
      start(**THREE) | {"influences": 2}]),
    ("decompose", "start.indices", "",
     [start(weights=np.ones((84, 1))), start(**TWICE),
      *(start(**EACH_ONE | {"indices": x})
        for x in (np.full((84, 1), 4), np.full((84, 1), 2**32), 83 * [[0]] + [[0, 1]]))]),
    ("decompose", "start.rest", "",
     [*(start(rest=x) for x in (np.zeros((83, 3)), np.zeros((84, 3), complex),
                                np.full((84, 3), np.nan), FAR_REST)),
      start(rest=np.full((84, 3), 1e95)) | NEAR_REST]),
    ("start", "start", "",
     [{"start": "model.npz", "bones": 2}, {"start": ssdr.Skeleton(SKELETON), "bones": 2},
      still(83), still(bones=85)]),
    ("start", "start", "got ShapedSkinning", [SHAPED]),
    ("start", "bones", "",
     [{"start": still(), "bones": 5}, {"start": still(bones=1), "bones": True}]),
    ("start", "start.weights", "", [{"start": still(**THREE), "influences": 2}]),
    ("start", "start.indices", "Skinning.from_dense has both", [{"start": DENSE, "bones": 2}]),
    ("start", "start.indices", "from_dense of dense_weights() adds them up",
     [{"start": still(**TWICE)}]),
    ("start", "start.transforms", "",
     [{"start": still(**GROWN)}, {"start": still(transforms=far(1e155))},
      {"start": still(transforms=far(1e95))} | NEAR_REST]),
    ("start", "start.rest", "", [{"start": motions.model(FAR_REST)}]),
    *(
        ("start", "start.transforms", why, [{"bone_model": kind, "start": linear(matrix)}])
        for kind, why, matrix in (
            ("rigid", "off by", 1.1 * np.eye(3)),
            ("similarity", "off by", np.diag([1, 1, 1.1])),
            ("similarity", "reflection", np.diag([2, 2, -2.0])),
            ("similarity", "zeros", np.zeros((3, 3))),
            ("affine", "reflection", np.diag([2, 1, -1.0])),
            ("affine", "singular", np.diag([2, 1, 0.0])),
        )
    ),
    ("skeleton", "start", "",
     [hung() | {"start": still(), "sequence": frames()},
      *(hung() | {"start": dataclasses.replace(SKELETON, **other)}
        for other in ({"parents": [-1, 0, 0, 0, 0, 0]},
                      {"parents": None, "joint_positions": None}))]),
    ("skeleton", "rig.skinning", "",
     [hung(skinning=np.zeros((6, 3))), hung(skinning=motions.model(np.zeros((84, 3))))]),
    ("skeleton", "rig.joints", "", [hung(joints="none")]),
    ("skeleton", "bones", "",
     [hung() | {"bones": 7}, hung(extra_bones={"hand": 1}) | {"bones": 6}]),
    ("skeleton", "rig.extra_bones", "",
     [*(hung(extra_bones=x) for x in (-1, 1.5, 10**12, {"tail": 1}, {"hand": -1})),
      hung(extra_bones=2, joints="loose"),
      hung(extra_bones=1) | {"start": ssdr.Kept(**EACH_ONE)}]),
    ("skeleton", "bone_model", "", [hung() | {"bone_model": "affine"}]),
    ("skeleton", "smoothness", "", [hung() | {"smoothness": 0.1}]),
    ("smallest", "vertices", "less than 1e",
     [{"sequence": 1e99 * frames() + 1e198}]),
    ("smallest", "measure", "", ["mean"]),
    ("smallest", "bones", "", [0, 85]),
    ("smallest", "rest_pose", "", ["soft"]),
    ("smallest", "start.weights", "", [{"start": ssdr.Kept(**EACH_ONE)}]),
    ("smallest", "vertex_importance", "", [np.arange(84) < 42, UNEVEN]),
    ("smallest", "normals", "", ["no"]),
    ("smallest", "tolerance", "a share of the diagonal such as", NO_TOLERANCE),
    ("fit_bones", "bone_model", "", ["soft"]),
    ("fit_bones", "rest", "", ["model.npz"]),
    ("fit_bones", "skinning", "", [{"rest": motions.model(np.zeros((119, 3)))}]),
    ("fit_bones", "skinning.rest", "",
     [{"rest": motions.model(np.full((120, 3), 1e155))},
      {"rest": motions.model(np.full((120, 3), 1e95)), "sequence": 1e-60 * CHAIN.frames}]),
    ("fit_bones", "skinning.transforms", "", [{"from_transforms": True}]),
    ("fit_bones", "from_transforms", "", [1]),
    ("fit_bones", "max_sweeps", "", [0]),
    ("fit_bones", "tolerance", "", [-1.0]),
    ("fit_bones", "vertex_importance", "", [np.zeros(120), -np.ones(120)]),
    ("fit_weights", "influences", "", [0, 2.5]),
    ("fit_weights", "iterations", "", [0]),
    ("fit_weights", "smoothness", "", [-1.0, float("nan")]),
    ("fit_weights", "skinning", "", [{"rest": motions.model(np.zeros((3, 3)))}]),
    ("fit_weights", "skinning.transforms", "", [{"rest": OTHER_FRAMES}, {"rest": MIRRORED}]),
    ("fit_weights", "rest", "got ShapedSkinning", [SHAPED]),
    ("fit_rest_pose", "weights", "", [{"rest": np.zeros((120, 3))}]),
    ("fit_rest_pose", "skinning.transforms", "", [{"rest": motions.model(np.zeros((120, 3)))}]),
    ("initialize", "bones", "", [0, 121, 2.0, True, 10**30, np.uint64(2**63), 2**31]),
    ("initialize", "influences", "", [65]),
    ("initialize", "rest", "", [np.zeros((119, 3))]),
    ("initialize", "rng", "", [-1, "seed"]),
    ("ssdr2012", "bones", "", [0]),
    ("ssdr2012", "influences", "", [0]),
    ("ssdr2012", "iterations", "", [-1]),
    ("ssdr2012", "callback", "", [5]),
    ("ssdr2012", "rest", "", [np.zeros((4, 3))]),
    ("ssdr2012", "bone_model", "", ["affine"]),
    ("weights", "transforms", "", [None, CHAIN.transforms[:-1], {"rest": CHAIN.skinning}]),
    ("weights", "transforms", 'bone_model="similarity" allows them', [2 * CHAIN.transforms]),
    ("weights", "rest", "", [CHAIN.rest[:-1]]),
    ("weights", "allowed", "",
     [MASK.astype(int), MASK[:, :4], MASK.T, np.arange(120)[:, None] != 7 * np.ones(5)]),
    ("weights", "prior", "",
     [{"prior": x, "prior_length": 1.0} for x in (MATRIX[:-1], 2 * MATRIX, "paint")]),
    ("weights", "prior_length", "",
     [{"prior": MATRIX}, {"prior": MATRIX, "prior_length": -1.0}, 1.0]),
    ("weights", "vertex_importance", "", [np.zeros(120)]),
    ("weights", "frame_importance", "", [np.ones(19), np.arange(20)]),
    ("weights", "bone_model", "", ["soft"]),
    ("bones", "weights", "",
     [None, *({"indices": None, "weights": x} for x in (MATRIX[:-1], 2 * MATRIX))]),
    ("bones", "indices", "",
     [np.zeros((120, 2), int), -np.ones(CHAIN.indices.shape, int), {"rest": CHAIN.skinning}]),
    ("bones", "weights", "dense weights (V, B) go in by name, weights=",
     [{"indices": MATRIX, "weights": None}]),
    ("bones", "indices", "at most 65,536 bones",
     [np.full(CHAIN.indices.shape, 10**9), np.full(CHAIN.indices.shape, 2**63, np.uint64)]),
    ("bones", "from_transforms", "", [True]),
    ("rest_pose", "transforms", "", [None]),
    ("rest_pose", "weights", "", [None, {"indices": None, "weights": MATRIX[:, :4]}]),
    ("rest_pose", "indices", "", [5 + CHAIN.indices]),
]  # fmt: skip


@pytest.mark.parametrize(("call", "argument", "says", "value"), each(REFUSED))
def test_refuses(
    call: str, argument: str, says: str, value: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before anything is computed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.npz").mkdir()
    function, options = CALLS[call]
    calls: list[object] = []
    if function in (ssdr.decompose, ssdr.smallest):
        options = options | {"callback": calls.append}
    refused((function, options), argument, says, value)
    assert not calls
