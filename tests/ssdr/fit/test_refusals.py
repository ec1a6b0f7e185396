"""Arguments that the fits of one part of a model refuse."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions

CHAIN = motions.chain(bones=5)
DENSE = CHAIN.skinning.dense_weights()
MASK = np.ones((120, 5), bool)
MIRRORED = motions.model(CHAIN.rest, transforms=CHAIN.transforms * np.array([1, 1, -1, 1.0]))


def arrays(*names: str) -> dict[str, Any]:
    return {name: getattr(CHAIN, name) for name in names}


CALLS: dict[str, tuple[Callable[..., object], dict[str, Any]]] = {
    "weights": (ssdr.fit_weights, {"rest": CHAIN.skinning}),
    "bones": (ssdr.fit_bones, {"rest": motions.model(CHAIN.rest, CHAIN.indices, CHAIN.weights)}),
    "rest_pose": (ssdr.fit_rest_pose, {"rest": CHAIN.skinning}),
    "initialize": (ssdr.initialize, {"bones": 3}),
    "2012": (ssdr.ssdr2012, {"bones": 3}),
    "arrays, weights": (ssdr.fit_weights, arrays("rest", "transforms")),
    "arrays, bones": (ssdr.fit_bones, arrays("rest", "indices", "weights")),
    "arrays, rest_pose": (ssdr.fit_rest_pose, arrays("rest", "indices", "weights", "transforms")),
}
REFUSED: list[tuple[str, str, dict[str, Any]]] = [
    ("bones", "bone_model", {"bone_model": "soft"}),
    ("bones", "rest", {"rest": "model.npz"}),
    ("bones", "skinning", {"rest": motions.model(np.zeros((119, 3)))}),
    ("bones", "skinning.rest", {"rest": motions.model(np.full((120, 3), 1e155))}),
    (
        "bones",
        "skinning.rest",
        {"rest": motions.model(np.full((120, 3), 1e95)), "small": 1e-60},
    ),
    ("bones", "skinning.transforms", {"from_transforms": True}),
    ("bones", "from_transforms", {"from_transforms": 1}),
    ("bones", "max_sweeps", {"max_sweeps": 0}),
    ("bones", "tolerance", {"tolerance": -1.0}),
    ("bones", "vertex_importance", {"vertex_importance": np.zeros(120)}),
    ("bones", "vertex_importance", {"vertex_importance": -np.ones(120)}),
    ("weights", "influences", {"influences": 0}),
    ("weights", "influences", {"influences": 2.5}),
    ("weights", "iterations", {"iterations": 0}),
    ("weights", "smoothness", {"smoothness": -1.0}),
    ("weights", "smoothness", {"smoothness": float("nan")}),
    ("weights", "rest", {"rest": None}),
    ("weights", "skinning", {"rest": motions.model(np.zeros((3, 3)))}),
    (
        "weights",
        "skinning.transforms",
        {
            "rest": motions.model(
                np.zeros((120, 3)), transforms=np.tile(np.eye(3, 4), (19, 2, 1, 1))
            )
        },
    ),
    ("rest_pose", "weights", {"rest": np.zeros((120, 3))}),
    (
        "rest_pose",
        "skinning.transforms",
        {"rest": motions.model(np.zeros((120, 3)))},
    ),
    ("initialize", "bones", {"bones": 0}),
    ("initialize", "bones", {"bones": 121}),
    ("initialize", "bones", {"bones": 2.0}),
    ("initialize", "bones", {"bones": True}),
    ("initialize", "influences", {"influences": 65}),
    ("initialize", "rest", {"rest": np.zeros((119, 3))}),
    ("initialize", "rng", {"rng": -1}),
    ("initialize", "rng", {"rng": "seed"}),
    ("weights", "skinning.transforms", {"rest": MIRRORED}),
    ("arrays, weights", "transforms", {"transforms": None}),
    ("arrays, weights", "transforms", {"transforms": CHAIN.transforms[:-1]}),
    ("arrays, weights", "transforms", {"rest": CHAIN.skinning}),
    ("arrays, weights", "rest", {"rest": CHAIN.rest[:-1]}),
    ("arrays, weights", "rest", {"rest": "rest"}),
    ("arrays, weights", "allowed", {"allowed": MASK.astype(int)}),
    ("arrays, weights", "allowed", {"allowed": MASK[:, :4]}),
    ("arrays, weights", "allowed", {"allowed": MASK.T}),
    ("arrays, weights", "allowed", {"allowed": np.arange(120)[:, None] != 7 * np.ones(5)}),
    ("arrays, weights", "prior", {"prior": DENSE[:-1], "prior_length": 1.0}),
    ("arrays, weights", "prior", {"prior": 2 * DENSE, "prior_length": 1.0}),
    ("arrays, weights", "prior", {"prior": "paint", "prior_length": 1.0}),
    ("arrays, weights", "prior_length", {"prior": DENSE}),
    ("arrays, weights", "prior_length", {"prior": DENSE, "prior_length": -1.0}),
    ("arrays, weights", "prior_length", {"prior_length": 1.0}),
    ("arrays, weights", "vertex_importance", {"vertex_importance": np.zeros(120)}),
    ("arrays, weights", "frame_importance", {"frame_importance": np.ones(19)}),
    ("arrays, weights", "frame_importance", {"frame_importance": np.arange(20)}),
    ("arrays, weights", "bone_model", {"bone_model": "soft"}),
    ("arrays, bones", "weights", {"weights": None}),
    ("arrays, bones", "indices", {"indices": np.zeros((120, 2), int)}),
    ("arrays, bones", "indices", {"indices": -np.ones(CHAIN.indices.shape, int)}),
    ("arrays, bones", "indices", {"rest": CHAIN.skinning}),
    ("arrays, bones", "weights", {"indices": None, "weights": DENSE[:-1]}),
    ("arrays, bones", "weights", {"indices": None, "weights": 2 * DENSE}),
    ("arrays, bones", "from_transforms", {"from_transforms": True}),
    ("arrays, rest_pose", "transforms", {"transforms": None}),
    ("arrays, rest_pose", "weights", {"weights": None}),
    ("arrays, rest_pose", "weights", {"indices": None, "weights": DENSE[:, :4]}),
    ("arrays, rest_pose", "indices", {"indices": 5 + CHAIN.indices}),
    ("2012", "bones", {"bones": 0}),
    ("2012", "influences", {"influences": 0}),
    ("2012", "iterations", {"iterations": -1}),
    ("2012", "callback", {"callback": 5}),
    ("2012", "rest", {"rest": np.zeros((4, 3))}),
    ("2012", "bone_model", {"bone_model": "affine"}),
]


@pytest.mark.parametrize(("call", "argument", "change"), REFUSED)
def test_refuses(call: str, argument: str, change: dict[str, Any]) -> None:
    function, options = CALLS[call]
    options = options | change
    frames = options.pop("small", 1.0) * CHAIN.frames
    with pytest.raises(ssdr.InputError) as caught:
        function(frames, **options)
    assert caught.value.argument == argument
