"""Arguments that the fits of one part of a model refuse."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import ssdr
from helpers import motions

CHAIN = motions.chain(bones=5)
MIRRORED = motions.model(CHAIN.rest, transforms=CHAIN.transforms * np.array([1, 1, -1, 1.0]))


@pytest.mark.parametrize(
    ("function", "argument", "change"),
    [
        (ssdr.fit_bones, "bone_model", {"bone_model": "soft"}),
        (ssdr.fit_bones, "rest", {"rest": "model.npz"}),
        (ssdr.fit_bones, "skinning", {"rest": motions.model(np.zeros((119, 3)))}),
        (ssdr.fit_bones, "skinning.rest", {"rest": motions.model(np.full((120, 3), 1e155))}),
        (
            ssdr.fit_bones,
            "skinning.rest",
            {"rest": motions.model(np.full((120, 3), 1e95)), "small": 1e-60},
        ),
        (ssdr.fit_bones, "skinning.transforms", {"locked_bones": [0]}),
        (ssdr.fit_bones, "skinning.transforms", {"from_transforms": True}),
        (ssdr.fit_bones, "from_transforms", {"from_transforms": 1}),
        (ssdr.fit_bones, "locked_bones", {"locked_bones": [5]}),
        (ssdr.fit_bones, "max_sweeps", {"max_sweeps": 0}),
        (ssdr.fit_bones, "tolerance", {"tolerance": -1.0}),
        (ssdr.fit_bones, "vertex_importance", {"vertex_importance": np.zeros(120)}),
        (ssdr.fit_bones, "vertex_importance", {"vertex_importance": -np.ones(120)}),
        (ssdr.fit_weights, "influences", {"influences": 0}),
        (ssdr.fit_weights, "influences", {"influences": 2.5}),
        (ssdr.fit_weights, "iterations", {"iterations": 0}),
        (ssdr.fit_weights, "smoothness", {"smoothness": -1.0}),
        (ssdr.fit_weights, "smoothness", {"smoothness": float("nan")}),
        (ssdr.fit_weights, "rest", {"rest": None}),
        (ssdr.fit_weights, "skinning", {"rest": motions.model(np.zeros((3, 3)))}),
        (
            ssdr.fit_weights,
            "skinning.transforms",
            {
                "rest": motions.model(
                    np.zeros((120, 3)), transforms=np.tile(np.eye(3, 4), (19, 2, 1, 1))
                )
            },
        ),
        (ssdr.fit_rest_pose, "weights", {"rest": np.zeros((120, 3))}),
        (
            ssdr.fit_rest_pose,
            "skinning.transforms",
            {"rest": motions.model(np.zeros((120, 3)))},
        ),
        (ssdr.fit_rest_pose, "locked_vertices", {"locked_vertices": [120]}),
        (ssdr.fit_rest_pose, "locked_vertices", {"locked_vertices": [True]}),
        (ssdr.initialize, "bones", {"bones": 0}),
        (ssdr.initialize, "bones", {"bones": 121}),
        (ssdr.initialize, "bones", {"bones": 2.0}),
        (ssdr.initialize, "bones", {"bones": True}),
        (ssdr.initialize, "influences", {"influences": 65}),
        (ssdr.initialize, "rest", {"rest": np.zeros((119, 3))}),
        (ssdr.initialize, "rng", {"rng": -1}),
        (ssdr.initialize, "rng", {"rng": "seed"}),
        (ssdr.fit_weights, "skinning.transforms", {"rest": MIRRORED}),
    ],
)
def test_refuses(function: Callable[..., object], argument: str, change: dict[str, object]) -> None:
    still = motions.model(CHAIN.rest, CHAIN.indices, CHAIN.weights)
    model = {"rest": still if function is ssdr.fit_bones else CHAIN.skinning}
    options = {"bones": 3} if function is ssdr.initialize else model
    options = options | change
    frames = options.pop("small", 1.0) * CHAIN.frames
    with pytest.raises(ssdr.InputError) as caught:
        function(frames, **options)
    assert caught.value.argument == argument
