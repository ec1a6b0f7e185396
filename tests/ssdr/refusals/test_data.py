"""What sequences, models, clips, shapes, trees and rotations refuse."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.calls import Call, Row, each, refused
from helpers.rig_model import tube
from helpers.rig_tree import creature
from ssdr import Clip, Surface
from ssdr.common.checks import check_transforms
from ssdr.model import rigid
from ssdr.model.transforms import check_parents

NAN, INF = float("nan"), float("inf")
NO_RATE = [0, -24, NAN, INF, "24", True]
FRAMES = np.arange(24.0).reshape(2, 4, 3)
ONE = np.array([[0, 1, 2]])
CHAIN = motions.chain(bones=3, rows=5, frames=4)
PARTS = {n: getattr(CHAIN, n) for n in ("rest", "indices", "weights", "transforms")}
SQUARE = np.concatenate(
    [CHAIN.transforms, np.broadcast_to([0, 0, 0, 1.0], (4, 3, 1, 4))], axis=2
)  # 4×4 matrices
ROWS = np.swapaxes(CHAIN.transforms, -1, -2)
SIZED = CHAIN.transforms * np.array([1.25, 1.25, 1.25, 1.0])
STRETCHED = CHAIN.transforms @ np.diag([1.25, 1.0, 1.0, 1.0])
MODEL = tube(rings=5, sides=5)
MOVED, AMOUNTS = np.zeros((3, MODEL.n_vertices, 3)), np.zeros((20, 3))
SHAPED = ssdr.ShapedSkinning(MODEL, ssdr.Shapes(MOVED, AMOUNTS))
CLIPS = (Clip("walk", 0, 9, 24.0), Clip("jump", 9, 19, 60.0), Clip("death", 19, 20, 24.0))
CLIPPED = dataclasses.replace(MODEL, clips=CLIPS)
RIG = creature(frames=2)
POINTS, HALF = np.zeros((2, 5, 3)), np.ones(4) / 2
UV = Surface(uv=np.zeros((2, 3, 2), np.float32))
EYE = np.tile(np.eye(3), (2, 7, 1, 1))


def put(array: np.ndarray, where: Any, value: Any) -> np.ndarray:
    changed = array.copy()
    changed[where] = value
    return changed


def at(name: str, where: Any, value: Any) -> np.ndarray:
    return put(PARTS[name], where, value)


CALLS: dict[str, Call] = {
    "sequence": (ssdr.MeshSequence, {"vertices": FRAMES, "faces": ONE}),
    "skin": (ssdr.skin, PARTS),
    "gradients": (ssdr.skin_gradients, PARTS | {"gradient": np.ones((4, 30, 3))}),
    "model": (ssdr.Skinning, PARTS | {"faces": CHAIN.faces}),
    "dense": (ssdr.Skinning.from_dense, {
        "rest": np.eye(3), "weights": np.eye(3, 4),
        "transforms": np.tile(np.eye(3, 4), (2, 4, 1, 1))}),
    "bones": (check_transforms, {"transforms": CHAIN.transforms, "n_frames": 4}),
    "skinned": (CHAIN.skinning.skin, {}),
    "prune": (CHAIN.skinning.prune, {}),
    "clip": (Clip, {"name": "walk", "start": 3, "stop": 8}),
    "clips": (functools.partial(dataclasses.replace, MODEL), {}),
    "clipped": (functools.partial(dataclasses.replace, CLIPPED), {}),
    "select": (lambda clip: CLIPPED.select(*clip), {}),
    "shapes": (ssdr.Shapes, {"displacements": MOVED, "amounts": AMOUNTS}),
    "shaped": (functools.partial(dataclasses.replace, SHAPED), {}),
    "parents": (check_parents, {"n_bones": 2}),
    "pose": (RIG.pose, {"local_rotations": EYE}),
    "pose without joints": (CHAIN.skinning.pose, {"local_rotations": EYE}),
    "local transforms": (CHAIN.skinning.local_transforms, {}),
    "joint gaps": (CHAIN.skinning.joint_gaps, {}),
    "kabsch": (ssdr.kabsch, {"source": POINTS, "target": POINTS}),
    "slerp": (rigid.slerp, {"a": HALF, "b": HALF, "u": np.float64(0.5)}),
    **{f.__name__: (f, {}) for f in (
        rigid.nearest_rotation, rigid.quaternion_from_matrix, rigid.matrix_from_quaternion,
        rigid.unflip_quaternions, rigid.sixd_from_matrix, rigid.matrix_from_sixd)},
}  # fmt: skip
ARRAYS: list[Row] = [  # of all that skins
    (call, argument, says, values)
    for call in ("skin", "gradients", "model")
    for argument, says, values in (
        ("rest", "", [np.zeros((30, 2)), np.full((30, 3), "a"), [[1, 2], [3]]]),
        ("indices", "", [np.zeros((30, 3)), at("indices", (3, 1), 3), at("indices", (3, 1), -1),
                         np.zeros((29, 3), int), [[1, 2], [3]], np.zeros((30, 0), int)]),
        ("transforms", "", [np.zeros((4, 3, 3, 3)), np.zeros(4), [[1, 2], [3]]]),
        ("transforms", "(of 4×4 matrices for column vectors pass m[..., :3, :])", [SQUARE]),
        ("transforms", "(of matrices for row vectors pass np.swapaxes(m, -1, -2))", [ROWS]),
    )
]  # fmt: skip
MODELS: list[Row] = [
    ("model", "rest", "", [np.zeros((0, 3)), np.zeros((30, 3), complex), at("rest", (3, 1), NAN)]),
    ("model", "indices", "", [{"weights": np.full((30, 2), 0.5)}]),
    ("model", "weights", "",
     [at("weights", (3, 1), INF), at("weights", 3, [1.5, -0.5, 0]), at("weights", 3, 0.2)]),
    ("model", "indices", "(of weights (V, B) of all bones: Skinning.from_dense)",
     [{"indices": None, "weights": CHAIN.skinning.dense_weights()}]),
    ("model", "transforms", "", [np.zeros((5, 3, 4)), np.zeros((0, 3, 3, 4)),
                                 np.zeros((4, 0, 3, 4)), at("transforms", (0, 0, 0, 0), NAN)]),
    ("model", "bone_model", "", ["soft"]),
    ("model", "fps", "", [x for x in NO_RATE if x is not None]),
    ("model", "faces", "", [[[0, 1, 30]]]),
    ("model", "keyframes", "", [np.zeros((4, 4), bool), np.zeros((4, 3))]),
    ("model", "vertex_map", "", [[30], [0.5]]),
    ("model", "bone_names", "", [("a", "b")]),
    ("model", "surface.uv", "", [{"surface": UV}]),
    ("model", "joint_positions", "", [{"parents": [-1, 0, 1]}]),
    ("model", "parents", "", [{"joint_positions": np.zeros((3, 3))}]),
    ("skin", "weights", "", [np.zeros((30, 2))]),
    ("gradients", "weights", "", [np.zeros((30, 2)), [[1, 2], [3]]]),
    ("gradients", "gradient", "", [np.ones((4, 29, 3)), np.ones((30, 3)),
                                   np.ones((4, 30, 3), complex), [[1, 2], [3]]]),
    *((call, "dtype", "", ["half a number", "x"]) for call in ("skin", "gradients")),
    ("dense", "weights", "", [
        np.full((3, 5), 0.2), np.full((3, 3), 1 / 3), np.full((2, 4), 0.25), np.full(4, 0.25),
        [[2, -1, 0, 0]] * 3, np.full((3, 4), 0.2), np.full((3, 4), NAN)]),
    ("dense", "influences", "", [0, 1.5]),
    *(("bones", "transforms", f'(bone_model="{named}" allows them)',
       [{"transforms": given, "bone_model": kind}])
      for given, kind, named in ((SIZED, "rigid", "similarity"), (STRETCHED, "rigid", "affine"),
                                 (STRETCHED, "similarity", "affine"))),
    ("bones", "transforms", "scales from 1.25 to 1.25", [SIZED]),
    ("skinned", "frames", "", [4, -5, [0, 4], [0.5], "a", [[0]], [True, False]]),
    ("prune", "influences", "", [0, -1, 1.5, True]),
]  # fmt: skip
SEQUENCES: list[Row] = [
    *(("sequence", "vertices", f"{value} at frame 1, vertex 3", [put(FRAMES, (1, 3, 2), value)])
      for value in (NAN, INF, -INF)),
    ("sequence", "vertices", "(2, 0, 3)", [{"vertices": FRAMES[:, :0], "faces": None}]),
    *(("sequence", "vertices", says, [value]) for says, value in (
        ("(0, 4, 3)", FRAMES[:0]), ("(1, 2, 4, 3)", FRAMES[None]), ("(2, 4, 2)", FRAMES[..., :2]),
        ("(of a single frame pass frame[None])", FRAMES[0]), ("complex128", FRAMES.astype(complex)),
        ("bool", FRAMES > 3), ("object", FRAMES.astype(object)), ("type str", "walk.npz"),
        ("inhomogeneous", [[[1, 2, 3], [1, 2]]]), ("NoneType", None),
        ("masked", np.ma.masked_greater(FRAMES, 0)))),
    *(("sequence", "faces", says, [value]) for says, value in (
        ("4 in face 0", [[0, 1, 4]]), ("-1 in face 1", [[0, 1, 2], [0, -1, 2]]),
        (str(2**40), [[0, 1, 2**40]]), ("(3,)", [0, 1, 2]), ("(1, 4)", [[0, 1, 2, 3]]),
        ("inhomogeneous", [[0, 1, 2], [0, 1]]), ("float64", [[0.0, 1.0, 2.0]]))),
    ("sequence", "fps", "a positive number", [*NO_RATE, None]),
    ("sequence", "surface.uv", "", [{"surface": UV}]),
    ("sequence", "surface.normals", "", [{"surface": Surface(normals=np.zeros((1, 3, 2), "f4"))}]),
    ("sequence", "surface.material_index", "",
     [{"surface": Surface(material_index=np.array([k], np.int32))} for k in (1, -1)]),
    ("sequence", "vertex_map", "", [[0, 4], [-1], [0.5], [[0]]]),
]  # fmt: skip
CLIPS_AND_SHAPES: list[Row] = [
    ("clip", "clip.name", "", [{"name": x} for x in (3, "zero\0", "half \ud800")]),
    ("clip", "clip", "", [{"start": -1}, {"start": 8}, {"stop": 2.5}]),
    ("clip", "clip.fps", "", [{"fps": x} for x in (0, NAN, True)]),
    *(("clips", "clips", f"cover the 20 frames, got {n}", [clips])
      for n, clips in ((0, ()), (19, (Clip("a", 0, 19),)), (21, (Clip("a", 0, 21),)))),
    *(("clips", f"clips[{k}]", says, [{"clips": clips}]) for k, says, clips in (
        (0, "the frames from 0 on", (Clip("a", 1, 20),)),
        (1, "the frames from 5 on", (Clip("a", 0, 5), Clip("b", 6, 20))),
        (1, "the frames from 5 on", (Clip("a", 0, 5), Clip("b", 4, 20))),
        (1, "a name that no other", (Clip("a", 0, 5), Clip("a", 5, 20))),
        (0, "a name that no other", (Clip("", 0, 5), Clip("a", 5, 20))),
        (0, "a Clip", "walk"), (0, "a Clip", 7))),
    ("clipped", "fps", "24, as of the first clip", [60.0]),
    ("select", "clip", "", [(), ("run",), (3,), (-1,), ("walk", 0), (True,)]),
    ("shaped", "shapes", "20 frames, 27 vertices, got 20 frames, 26",
     [ssdr.Shapes(MOVED[:, 1:], AMOUNTS)]),
    ("shaped", "shapes", "20 frames, 27 vertices, got 19 frames, 27",
     [ssdr.Shapes(MOVED, AMOUNTS[1:])]),
    ("shaped", "shapes", "Shapes, got ndarray", [MOVED]),
    ("shaped", "skinning", "a clip of two frames", [{"driven": True}]),
    ("shapes", "shapes.amounts", "3 columns, got 2", [{"amounts": AMOUNTS[:, 1:]}]),
    ("shapes", "shapes.displacements", "finite", [{"displacements": MOVED * NAN}]),
    ("shapes", "shapes.displacements", "shape (S, V, 3)", [{"displacements": MOVED[:, :, 0]}]),
    ("shapes", "shapes.names", "3 names", [{"names": ["a"]}, {"names": 3}]),
]  # fmt: skip
TREES: list[Row] = [
    ("parents", "parents", "cycle",
     [{"parents": x, "n_bones": len(x)} for x in ([1, 0], [0, -1], [1, 2, 0, -1])]),
    ("parents", "parents", "-1 or a bone from 0 to 1", [[-1, 2], [-2, 0]]),
    ("parents", "parents", "", [[-1], [0.5, 1]]),
    ("pose", "local_rotations", "", [
        np.ones((2, 4, 4)), np.zeros((2, 7, 4)), 2 * EYE, -EYE, np.full(EYE.shape, NAN)]),
    ("pose", "root", "", [np.zeros((2, 1, 3)), np.full((2, 2, 3), NAN)]),
    *((call, "parents", "a hierarchy for", [{}])
      for call in ("pose without joints", "local transforms", "joint gaps")),
]  # fmt: skip
NO_NUMBERS: list[Row] = [
    (call, argument, "numbers", [np.full(shape, bad) for bad in (NAN, INF, -INF, 1j, "a", None)])
    for call, argument, shape in (
        ("kabsch", "source", (5, 3)), ("kabsch", "target", (5, 3)), ("kabsch", "weights", 5),
        ("slerp", "a", 4), ("slerp", "b", 4), ("slerp", "u", ()),
        ("nearest_rotation", "moment", (3, 3)), ("quaternion_from_matrix", "rotation", (3, 3)),
        ("matrix_from_quaternion", "quaternion", 4), ("unflip_quaternions", "quaternion", (2, 4)),
        ("sixd_from_matrix", "rotation", (3, 3)), ("matrix_from_sixd", "sixd", 6))
]  # fmt: skip
ROTATIONS: list[Row] = [
    ("kabsch", "source", "", [np.zeros(3), np.zeros((4, 2)), np.zeros((0, 3))]),
    ("kabsch", "target", "",
     [np.zeros((4, 3)), np.zeros((3, 5, 3)), {"weights": np.ones((3, 5))}]),
    ("kabsch", "weights", "", [np.ones(3), -np.ones(5)]),
    ("kabsch", "target", "translation within float64", [
        {"source": np.full((4, 3), 1.7e308), "target": np.full((4, 3), -1.7e308)}]),
    ("slerp", "u", "", [{"a": np.ones((2, 4)), "b": np.ones((3, 4))}]),
    ("slerp", "a", "", [np.ones(3)]),
    ("unflip_quaternions", "quaternion", "", [np.zeros(4), np.zeros((5, 3))]),
    ("nearest_rotation", "moment", "", [np.ones((3, 2))]),
    ("quaternion_from_matrix", "rotation", "", [np.zeros((3, 4)), 1e200 * np.eye(3)]),
    ("sixd_from_matrix", "rotation", "", [np.zeros(9)]),
    ("matrix_from_quaternion", "quaternion", "", [np.zeros(3), np.zeros(4)]),
    ("matrix_from_sixd", "sixd", "", [np.zeros(5), np.zeros(6), [1.0, 0, 0, 2, 0, 0]]),
]  # fmt: skip
REFUSED = ARRAYS + MODELS + SEQUENCES + CLIPS_AND_SHAPES + TREES + NO_NUMBERS + ROTATIONS


@pytest.mark.parametrize(("call", "argument", "says", "value"), each(REFUSED))
def test_refuses(call: str, argument: str, says: str, value: Any) -> None:
    refused(CALLS[call], argument, says, value)
