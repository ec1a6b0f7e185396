"""What is refused, and the argument that each error names: one table of calls."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions, trees
from helpers.measures import frames, rig

SHOT = ssdr.MeshSequence(frames(), rig().faces)
EACH_ONE = {"indices": np.zeros((84, 1), int), "weights": np.ones((84, 1))}
TWICE = {"indices": np.zeros((84, 2), int), "weights": np.full((84, 2), 0.5)}
THREE = {"indices": np.tile([0, 1, 2], (84, 1)), "weights": np.full((84, 3), 1 / 3)}
GROWN = {"transforms": np.tile(2 * np.eye(3, 4), (15, 2, 1, 1)), "bone_model": "affine"}
UNEVEN = np.where(np.arange(84) < 42, 5.0, 4e-6)
DENSE = ssdr.Start(weights=np.eye(84)[:, :2])
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
    return {"start": ssdr.Start(**parts), "influences": 3}


def hung(**parts: Any) -> dict[str, Any]:
    return {"rig": ssdr.Skeleton(**({"skinning": SKELETON} | parts))}


CHAIN = motions.chain(bones=5)
MATRIX = CHAIN.skinning.dense_weights()
MASK = np.ones((120, 5), bool)
MIRRORED = motions.model(CHAIN.rest, transforms=CHAIN.transforms * np.array([1, 1, -1, 1.0]))
OTHER_FRAMES = motions.model(CHAIN.rest, transforms=np.tile(np.eye(3, 4), (19, 2, 1, 1)))
UNMOVED = motions.model(CHAIN.rest, CHAIN.indices, CHAIN.weights)


def arrays(*names: str) -> dict[str, Any]:
    return {"sequence": CHAIN.frames} | {name: getattr(CHAIN, name) for name in names}


ON_FRAMES = {"sequence": frames(), "faces": rig().faces}
CALLS: dict[str, tuple[Callable[..., object], dict[str, Any]]] = {
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
REFUSED: list[tuple[Any, ...]] = [  # call, argument, what is changed, a text of the error
    ("decompose", "bone", {"bone": 3}, "expected bones, got an argument that"),
    ("smallest", "bone", {"bone": 3}, "expected bones, got an argument that"),
    ("decompose", "xyz", {"xyz": 3}, "expected sequence, faces, "),
    ("decompose", "bones", {"bones": None}),
    ("decompose", "bones", {"bones": "5"}),
    ("decompose", "influences", {"influences": 0}),
    ("decompose", "effort", {"effort": np.array(["fast", "best"])}),
    ("decompose", "rig", {"rig": np.array(["rigid", "loose"])}),
    ("decompose", "time_limit", {"time_limit": 0.0}),
    ("decompose", "rest_pose", {"rest_pose": np.zeros((84, 3))}),
    ("decompose", "normals", {"normals": np.ones((84, 3))}),
    ("decompose", "smoothness", {"smoothness": 1.0, "faces": None}),
    ("decompose", "vertices", {"sequence": 1e200 * frames()}),
    ("decompose", "vertices", {"sequence": 1e-200 * frames()}),
    ("decompose", "vertices", {"sequence": 1e-310 * frames()}),
    ("decompose", "vertices", {"sequence": "walk.npz"}),
    ("decompose", "sequence", {"sequence": [np.zeros((3, 84, 3)), np.zeros((5, 84, 3))]}),
    ("decompose", "sequence[1]",
     {"sequence": [SHOT, ssdr.MeshSequence(frames()[:, :-1])], "faces": None}),
    ("decompose", "sequence[1]", {"sequence": [SHOT, frames()], "faces": None}),
    ("decompose", "faces", {"sequence": ssdr.MeshSequence(np.zeros((2, 84, 3)))}),
    ("decompose", "vertex_importance", {"vertex_importance": -np.ones(84)}),
    ("decompose", "vertex_importance", {"vertex_importance": np.zeros(84)}),
    ("decompose", "vertex_importance", {"vertex_importance": np.ones(83)}),
    ("decompose", "frame_importance", {"frame_importance": np.arange(15.0)}),
    ("decompose", "rest_frame", {"rest_frame": 2.5}),
    ("decompose", "rest_frame", {"rest_frame": 15}),
    ("decompose", "rest_frame", {"rest_frame": 1, "start": ssdr.Start(rest=frames()[0])}),
    ("decompose", "bone_model", {"rig": "rigid", "bone_model": "affine"}),
    ("decompose", "bone_model", {"rig": "loose", "bone_model": "similarity"}),
    ("decompose", "smoothness", {"rig": "rigid", "smoothness": 0.1}),
    ("decompose", "start.weights", start(**EACH_ONE) | {"rig": "rigid"}),
    ("decompose", "start.weights", start(indices=np.zeros((84, 1), int))),
    ("decompose", "start.indices", start(weights=np.ones((84, 1)))),
    ("decompose", "start.indices", start(**EACH_ONE | {"indices": np.full((84, 1), 4)})),
    ("decompose", "start.indices", start(**EACH_ONE | {"indices": np.full((84, 1), 2**32)})),
    ("decompose", "start.indices", start(**EACH_ONE | {"indices": 83 * [[0]] + [[0, 1]]})),
    ("decompose", "start.weights", start(**THREE) | {"influences": 2}),
    ("decompose", "start.indices", start(**TWICE)),
    ("decompose", "start.rest", start(rest=np.zeros((83, 3)))),
    ("decompose", "start.rest", start(rest=np.zeros((84, 3), complex))),
    ("decompose", "start.rest", start(rest=np.full((84, 3), np.nan))),
    ("decompose", "start.rest", start(rest=np.full((84, 3), 1e155))),
    ("decompose", "start.rest",
     start(rest=np.full((84, 3), 1e95)) | {"sequence": 1e-60 * frames()}),
    ("start", "start", {"start": "model.npz", "bones": 2}),
    ("start", "start", {"start": ssdr.Skeleton(SKELETON), "bones": 2}),
    ("start", "start", {"start": still(83)}),
    ("start", "bones", {"start": still(), "bones": 5}),
    ("start", "bones", {"start": still(bones=1), "bones": True}),
    ("start", "start", {"start": still(bones=85)}),
    ("start", "start.weights", {"start": still(**THREE), "influences": 2}),
    ("start", "start.indices", {"start": DENSE, "bones": 2}, "Skinning.from_dense has both"),
    ("start", "start.indices", {"start": still(**TWICE)},
     "from_dense of dense_weights() adds them up"),
    ("start", "start.transforms", {"start": still(**GROWN)}),
    ("start", "start.transforms", {"start": still(transforms=far(1e155))}),
    ("start", "start.transforms",
     {"sequence": 1e-60 * frames(), "start": still(transforms=far(1e95))}),
    ("start", "start.rest", {"start": motions.model(np.full((84, 3), 1e155))}),
    *(
        ("start", "start.transforms", {"bone_model": kind, "start": linear(matrix)}, why)
        for kind, why, matrix in (
            ("rigid", "off by", 1.1 * np.eye(3)),
            ("similarity", "off by", np.diag([1, 1, 1.1])),
            ("similarity", "reflection", np.diag([2, 2, -2.0])),
            ("similarity", "zeros", np.zeros((3, 3))),
            ("affine", "reflection", np.diag([2, 1, -1.0])),
            ("affine", "singular", np.diag([2, 1, 0.0])),
        )
    ),
    ("skeleton", "start", hung() | {"start": still(), "sequence": frames()}),
    ("skeleton", "start",
     hung() | {"start": dataclasses.replace(SKELETON, parents=[-1, 0, 0, 0, 0, 0])}),
    ("skeleton", "start",
     hung() | {"start": dataclasses.replace(SKELETON, parents=None, joint_positions=None)}),
    ("skeleton", "rig.skinning", hung(skinning=np.zeros((6, 3)))),
    ("skeleton", "rig.skinning", hung(skinning=motions.model(np.zeros((84, 3))))),
    ("skeleton", "rig.joints", hung(joints="none")),
    ("skeleton", "bones", hung() | {"bones": 7}),
    ("skeleton", "bones", hung(extra_bones={"hand": 1}) | {"bones": 6}),
    ("skeleton", "rig.extra_bones", hung(extra_bones=-1)),
    ("skeleton", "rig.extra_bones", hung(extra_bones=1.5)),
    ("skeleton", "rig.extra_bones", hung(extra_bones=10**12)),
    ("skeleton", "rig.extra_bones", hung(extra_bones={"tail": 1})),
    ("skeleton", "rig.extra_bones", hung(extra_bones={"hand": -1})),
    ("skeleton", "rig.extra_bones", hung(extra_bones=2, joints="loose")),
    ("skeleton", "rig.extra_bones", hung(extra_bones=1) | {"start": ssdr.Start(**EACH_ONE)}),
    ("skeleton", "bone_model", hung() | {"bone_model": "affine"}),
    ("skeleton", "smoothness", hung() | {"smoothness": 0.1}),
    ("smallest", "measure", {"measure": "mean"}),
    ("smallest", "bones", {"bones": 0}),
    ("smallest", "bones", {"bones": 85}),
    ("smallest", "rest_pose", {"rest_pose": "soft"}),
    ("smallest", "start.weights", {"start": ssdr.Start(**EACH_ONE)}),
    ("smallest", "vertex_importance", {"vertex_importance": np.arange(84) < 42}),
    ("smallest", "vertex_importance", {"vertex_importance": UNEVEN}),
    ("smallest", "normals", {"normals": "no"}),
    ("decompose", "normals", {"normals": 0}),
    *(
        ("smallest", "tolerance", {"tolerance": t}, "a share of the diagonal such as")
        for t in ("half", "0.5", "%", "0%", "-1%", "1.2.3%", "nan%", "inf%", "", 0, -0.1, True,
                  np.nan, np.inf, [1])
    ),
    ("fit_bones", "bone_model", {"bone_model": "soft"}),
    ("fit_bones", "rest", {"rest": "model.npz"}),
    ("fit_bones", "skinning", {"rest": motions.model(np.zeros((119, 3)))}),
    ("fit_bones", "skinning.rest", {"rest": motions.model(np.full((120, 3), 1e155))}),
    ("fit_bones", "skinning.rest",
     {"rest": motions.model(np.full((120, 3), 1e95)), "sequence": 1e-60 * CHAIN.frames}),
    ("fit_bones", "skinning.transforms", {"from_transforms": True}),
    ("fit_bones", "from_transforms", {"from_transforms": 1}),
    ("fit_bones", "max_sweeps", {"max_sweeps": 0}),
    ("fit_bones", "tolerance", {"tolerance": -1.0}),
    ("fit_bones", "vertex_importance", {"vertex_importance": np.zeros(120)}),
    ("fit_bones", "vertex_importance", {"vertex_importance": -np.ones(120)}),
    ("fit_weights", "influences", {"influences": 0}),
    ("fit_weights", "influences", {"influences": 2.5}),
    ("fit_weights", "iterations", {"iterations": 0}),
    ("fit_weights", "smoothness", {"smoothness": -1.0}),
    ("fit_weights", "smoothness", {"smoothness": float("nan")}),
    ("fit_weights", "skinning", {"rest": motions.model(np.zeros((3, 3)))}),
    ("fit_weights", "skinning.transforms", {"rest": OTHER_FRAMES}),
    ("fit_weights", "skinning.transforms", {"rest": MIRRORED}),
    ("fit_rest_pose", "weights", {"rest": np.zeros((120, 3))}),
    ("fit_rest_pose", "skinning.transforms", {"rest": motions.model(np.zeros((120, 3)))}),
    ("initialize", "bones", {"bones": 0}),
    ("initialize", "bones", {"bones": 121}),
    ("initialize", "bones", {"bones": 2.0}),
    ("initialize", "bones", {"bones": True}),
    ("initialize", "influences", {"influences": 65}),
    ("initialize", "rest", {"rest": np.zeros((119, 3))}),
    ("initialize", "rng", {"rng": -1}),
    ("initialize", "rng", {"rng": "seed"}),
    ("ssdr2012", "bones", {"bones": 0}),
    ("ssdr2012", "influences", {"influences": 0}),
    ("ssdr2012", "iterations", {"iterations": -1}),
    ("ssdr2012", "callback", {"callback": 5}),
    ("ssdr2012", "rest", {"rest": np.zeros((4, 3))}),
    ("ssdr2012", "bone_model", {"bone_model": "affine"}),
    ("weights", "transforms", {"transforms": None}),
    ("weights", "transforms", {"transforms": CHAIN.transforms[:-1]}),
    ("weights", "transforms", {"rest": CHAIN.skinning}),
    ("weights", "rest", {"rest": CHAIN.rest[:-1]}),
    ("weights", "allowed", {"allowed": MASK.astype(int)}),
    ("weights", "allowed", {"allowed": MASK[:, :4]}),
    ("weights", "allowed", {"allowed": MASK.T}),
    ("weights", "allowed", {"allowed": np.arange(120)[:, None] != 7 * np.ones(5)}),
    ("weights", "prior", {"prior": MATRIX[:-1], "prior_length": 1.0}),
    ("weights", "prior", {"prior": 2 * MATRIX, "prior_length": 1.0}),
    ("weights", "prior", {"prior": "paint", "prior_length": 1.0}),
    ("weights", "prior_length", {"prior": MATRIX}),
    ("weights", "prior_length", {"prior": MATRIX, "prior_length": -1.0}),
    ("weights", "prior_length", {"prior_length": 1.0}),
    ("weights", "vertex_importance", {"vertex_importance": np.zeros(120)}),
    ("weights", "frame_importance", {"frame_importance": np.ones(19)}),
    ("weights", "frame_importance", {"frame_importance": np.arange(20)}),
    ("weights", "bone_model", {"bone_model": "soft"}),
    ("bones", "weights", {"weights": None}),
    ("bones", "indices", {"indices": np.zeros((120, 2), int)}),
    ("bones", "indices", {"indices": -np.ones(CHAIN.indices.shape, int)}),
    ("bones", "indices", {"rest": CHAIN.skinning}),
    ("bones", "weights", {"indices": None, "weights": MATRIX[:-1]}),
    ("bones", "weights", {"indices": None, "weights": 2 * MATRIX}),
    ("bones", "from_transforms", {"from_transforms": True}),
    ("rest_pose", "transforms", {"transforms": None}),
    ("rest_pose", "weights", {"weights": None}),
    ("rest_pose", "weights", {"indices": None, "weights": MATRIX[:, :4]}),
    ("rest_pose", "indices", {"indices": 5 + CHAIN.indices}),
]  # fmt: skip
REFUSED += [
    (call, "sequence[1].faces",
     {"sequence": [SHOT, ssdr.MeshSequence(frames(), rig().faces[::-1])], "faces": None})
    for call in ("decompose", "smallest")
]  # fmt: skip


@pytest.mark.parametrize("row", REFUSED, ids=lambda row: f"{row[0]}-{row[1]}")
def test_refuses(row: tuple[Any, ...]) -> None:
    """The error names the argument as the caller wrote it, before anything is computed."""
    call, argument, change, *said = row
    function, options = CALLS[call]
    calls: list[object] = []
    if function in (ssdr.decompose, ssdr.smallest):
        options = options | {"callback": calls.append}
    with pytest.raises(ssdr.InputError, match="expected") as caught:
        function(**(options | change))
    assert caught.value.argument == argument
    assert not said or said[0] in str(caught.value)
    assert not calls
