"""Export of a trained garment as one ONNX graph of standard operators.

The graph computes :meth:`~garmentnet.runtime.garment.LiveGarment.step` in float32; the state is
among its inputs and outputs.  Skinning is one product with the dense skin weights, which inference
engines compute fast.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.common.errors import InputError
from ssdr.io.optional import import_optional as require

from ..data.parameters import RANGES
from ..io.files import write_file
from .garment import LiveGarment
from .pivot import Recurrent

_OPSET, _IR = 17, 8  # versions of 2021, which the engines' importers know
_FEW = 4096  # arrays with fewer numbers keep 32 bits
_SHORT = 1e-8


def export_onnx(garment: LiveGarment, path: Path | str, *, bits: int = 32) -> Path:
    """Write a garment as an ONNX model, complete or not at all.

    Inputs are ``pose`` (J, 3, 4); ``reset`` (1,), which is 1 where a motion starts and otherwise 0;
    ``parameters`` (3,) if the garment reads them; and the states ``pose_state``, ``low_state`` and
    ``high_state``, which are ignored where a motion starts.  Outputs are ``vertices`` (V, 3), in
    metres in the world, and the states for the next frame, whose names end in ``_out``.  The
    metadata ``garmentnet`` is a JSON document with frame rate, skeleton, triangles and parameters.

    Parameters
    ----------
    garment : LiveGarment
        A garment with a single network.
    path : path
        File that ends in ``.onnx``.
    bits : {32, 16, 8}
        Bits of a stored network weight; the arithmetic is float32.  Skin weights have at least 16.

    Raises
    ------
    InputError
        If the garment is an ensemble or reads rotation vectors, or `bits` is another number.
    MissingDependencyError
        If ``onnx`` is not installed.
    """
    if bits not in (32, 16, 8):
        raise InputError("bits", "32, 16 or 8", bits)
    if garment.mixture is not None:
        raise InputError("model", "one network, such as reads the parameters", "an ensemble")
    if garment.features.rotation != "sixd":
        raise InputError("model", "features.rotation 'sixd'", garment.features.rotation)
    onnx = require("onnx", "garmentnet[onnx]", "an ONNX file")
    graph = _Graph(onnx, bits)
    _frame(graph, garment)
    model = graph.model()
    entry = model.metadata_props.add()
    entry.key, entry.value = "garmentnet", json.dumps(_document(garment))
    onnx.checker.check_model(model)
    file = Path(path)
    write_file(file, model.SerializeToString())
    return file


def _document(garment: LiveGarment) -> dict[str, Any]:
    s = garment.subject
    return {
        "fps": s.fps,
        "joints": list(s.skeleton.names),
        "parents": s.skeleton.parents.tolist(),
        "joints_at_rest": s.skeleton.rest.tolist(),
        "faces": np.asarray(s.garment.faces).tolist(),
        "parameters": {k: list(r) for k, r in RANGES.items()} if garment.reads_parameters else {},
        "garment_id": s.garment_id,
        "body_id": s.body_id,
    }


class _Graph:
    """Builder of an ONNX graph; methods add nodes or arrays and return the names of the results."""

    def __init__(self, onnx: Any, bits: int) -> None:
        self.onnx, self.bits, self.count = onnx, bits, 0
        self.nodes: list[Any] = []
        self.arrays: list[Any] = []
        self.ends: tuple[list[Any], list[Any]] = ([], [])

    def op(self, kind: str, *inputs: Any, out: str = "", **attributes: Any) -> str:
        self.count += 1
        name = out or f"{kind.lower()}_{self.count}"
        names = [i if isinstance(i, str) else self.array(i) for i in inputs]
        self.nodes.append(self.onnx.helper.make_node(kind, names, [name], **attributes))
        return name

    def array(self, value: Any) -> str:
        self.count += 1
        a = np.asarray(value)
        a = a.astype(np.float32) if a.dtype.kind == "f" else a.astype(np.int64)
        return self._store(a)

    def weight(self, value: NDArray[np.float32], bits: int = 0) -> str:
        """Add weights in 32, 16 or 8 bits; in 8 they are integers with one scale a row."""
        bits = bits or self.bits
        if bits == 32 or value.size < _FEW:
            return self.array(value)
        if bits == 16:
            kind = self.onnx.TensorProto.FLOAT
            return self.op("Cast", self._store(value.astype(np.float16)), to=kind)
        scale = np.maximum(np.abs(value).max(axis=1), 1e-12).astype(np.float32) / 127
        steps = np.rint(value / scale[:, None]).astype(np.int8)
        return self.op("DequantizeLinear", self._store(steps), scale, axis=0)

    def _store(self, a: NDArray[Any]) -> str:
        name = f"array_{len(self.arrays)}"
        self.arrays.append(self.onnx.numpy_helper.from_array(np.array(a, order="C"), name))
        return name

    def end(self, side: int, name: str, *shape: int) -> str:
        """Declare an input (`side` 0) or output (`side` 1) of the model."""
        kind = self.onnx.TensorProto.FLOAT
        self.ends[side].append(self.onnx.helper.make_tensor_value_info(name, kind, shape))
        return name

    def take(self, x: str, indices: Any, axis: int = 0) -> str:
        return self.op("Gather", x, np.asarray(indices, np.int64), axis=axis)

    def shaped(self, x: str, *shape: int) -> str:
        return self.op("Reshape", x, np.array(shape, np.int64))

    def part(self, x: str, start: int, stop: int) -> str:
        return self.op("Slice", x, np.array([start]), np.array([stop]), np.array([-1]))

    def unit(self, x: str) -> str:
        size = self.op("ReduceL2", x, axes=[-1], keepdims=1)
        return self.op("Div", x, self.op("Max", size, np.float32(_SHORT)))

    def turn(self, a: str, b: str) -> tuple[str, str, str]:
        """Rotations as three columns (N, 3) each, from their first two by Gram–Schmidt."""
        a = self.unit(a)
        dot = self.op("ReduceSum", self.op("Mul", a, b), np.array([-1]), keepdims=1)
        b = self.unit(self.op("Sub", b, self.op("Mul", dot, a)))
        after, before = ([1, 2, 0], [2, 0, 1])
        first = self.op("Mul", self.take(a, after, 1), self.take(b, before, 1))
        second = self.op("Mul", self.take(a, before, 1), self.take(b, after, 1))
        return a, b, self.op("Sub", first, second)

    def model(self) -> Any:
        h = self.onnx.helper
        graph = h.make_graph(self.nodes, "garment", *self.ends, self.arrays)
        opset = [h.make_opsetid("", _OPSET)]
        return h.make_model(graph, opset_imports=opset, ir_version=_IR, producer_name="garmentnet")


def _frame(g: _Graph, garment: LiveGarment) -> None:
    s, o, pivot = garment.subject, garment.features, garment.pivots[0]
    joints, bones = s.skeleton.n_joints, s.garment.n_bones
    pose, reset = g.end(0, "pose", joints, 3, 4), g.end(0, "reset", 1)
    rotations, shifts = g.part(pose, 0, 3), g.shaped(g.part(pose, 3, 4), joints, 3)
    root = g.take(rotations, 0)
    position = g.op(
        "Add", g.op("MatMul", root, s.skeleton.rest[0].astype(np.float32)), g.take(shifts, 0)
    )
    heading = _heading(g, root)
    x = _features(g, garment, rotations, root, position, heading, reset)
    if pivot.condition:
        low, high = np.log(np.array(list(RANGES.values()))).T
        theta = g.op("Log", g.end(0, "parameters", 3))
        theta = g.op("Sub", g.op("Mul", theta, 2 / (high - low)), 2 * low / (high - low) + 1)
        x = g.op("Concat", x, theta, axis=0)
    motion = _recurrent(g, pivot.low, x, "low_state", reset)
    frame = {"root": root, "heading": heading, "world": ""}[o.frame]
    near = position if frame else ""
    # Bones in the moving frame, then in the world relative to the frame's origin.
    numbers = g.op("Add", g.op("Mul", g.shaped(motion, bones, 9), pivot.scale), pivot.shift)
    columns = g.turn(g.part(numbers, 0, 3), g.part(numbers, 3, 6))
    matrix = g.op("Concat", *(g.shaped(c, bones, 3, 1) for c in columns), axis=2)
    centre = g.op("MatMul", matrix, pivot.centres[:, :, None])
    place = g.op("Sub", g.shaped(g.part(numbers, 6, 9), bones, 3, 1), centre)
    all_ = g.op("Concat", matrix, place, axis=2)
    carried, follows = s.bound is not None, (pivot.followed >= 0).any()
    moved = g.op("Sub", shifts, near) if near and (carried or follows) else shifts
    if follows:
        still = g.shaped(frame or g.array(np.eye(3)), 1, 3, 3)
        turns = g.op("Concat", rotations, still, axis=0)
        ends = g.op("Concat", moved, np.zeros((1, 3), np.float32), axis=0)
        index = np.where(pivot.followed < 0, joints, pivot.followed)
        all_ = g.op("MatMul", g.take(turns, index), all_)
        place = g.op("Add", g.part(all_, 3, 4), g.shaped(g.take(ends, index), bones, 3, 1))
        all_ = g.op("Concat", g.part(all_, 0, 3), place, axis=2)
    elif frame:
        all_ = g.op("MatMul", frame, all_)
    rest, index, weights = s.skin(smooth=pivot.high is None)
    dense = np.zeros((len(rest), bones + joints * carried), np.float32)
    np.add.at(dense, (np.arange(len(rest))[:, None], index), weights)
    if carried:
        body = g.op("Concat", rotations, g.shaped(moved, joints, 3, 1), axis=2)
        all_ = g.op("Concat", all_, body, axis=0)
    skin = g.weight(dense, min(32, max(16, g.bits)))
    # Rounded weights still sum to 1.
    skin = g.op("Div", skin, g.op("ReduceSum", skin, np.array([1]), keepdims=1))
    blend = g.shaped(g.op("MatMul", skin, g.shaped(all_, -1, 12)), -1, 3, 4)
    turned = g.shaped(g.op("MatMul", g.part(blend, 0, 3), rest[:, :, None]), -1, 3)
    v = g.op("Add", turned, g.shaped(g.part(blend, 3, 4), -1, 3))
    if pivot.high is not None:
        v = g.op("Add", v, _detail(g, garment, x, motion, blend, reset))
    g.op("Add", v, near or np.zeros(3, np.float32), out=g.end(1, "vertices", len(rest), 3))


def _heading(g: _Graph, root: str) -> str:
    read, written = np.zeros((2, 9), np.float32), np.zeros((9, 2), np.float32)
    read[0, [2, 6]], read[1, [0, 8]] = (1, -1), (1, 1)  # sine and cosine of the twist about y
    written[[2, 6], 0], written[[0, 8], 1] = (1, -1), 1
    both = g.op("MatMul", read, g.shaped(root, 9))
    size = g.op("ReduceL2", both, axes=[-1], keepdims=1)
    tiny = np.float32(1e-12)
    unit = g.op("Div", both, g.op("Max", size, tiny))
    upright = g.op("Where", g.op("Greater", size, tiny), unit, np.array([0.0, 1.0]))
    flat = g.op("Add", g.op("MatMul", written, upright), np.eye(9)[4])
    return g.shaped(flat, 3, 3)


def _features(
    g: _Graph,
    garment: LiveGarment,
    rotations: str,
    root: str,
    position: str,
    heading: str,
    reset: str,
) -> str:
    o, s, pivot = garment.features, garment.subject, garment.pivots[0]
    read, fps = garment.read, np.float32(s.fps)
    first = g.shaped(heading, 1, 3, 3) if o.heading_free else np.eye(3, dtype=np.float32)[None]
    parents = g.op("Concat", first, g.take(rotations, s.skeleton.parents[read[1:]]), axis=0)
    # A transposed matrix, flattened, lists the columns one after the other.
    local = g.op("MatMul", g.op("Transpose", g.take(rotations, read), perm=[0, 2, 1]), parents)
    size = 6 * len(read)
    code = g.shaped(g.take(local, [0, 1], 1), size)
    flat = g.shaped(root, 9)
    own = g.op("Concat", position, position, np.zeros(3), flat, code, axis=0)
    before = g.end(0, "pose_state", 18 + size)
    before = g.op("Where", g.op("Greater", reset, np.float32(0.5)), own, before)
    past = [g.part(before, *ends) for ends in ((0, 3), (3, 6), (6, 9), (9, 18), (18, 18 + size))]
    velocity = g.op("Mul", g.op("Sub", position, past[1]), fps)
    new = ("Concat", past[0], position, velocity, flat, code)
    g.op(*new, axis=0, out=g.end(1, "pose_state_out", 18 + size))
    parts = [g.op("Sub", position, past[0])] if o.translation else []
    parts.append(code)
    if o.velocities:
        parts.append(g.op("Mul", g.op("Sub", code, past[4]), fps))
    if o.root_motion:
        change = g.op("Mul", g.op("Sub", velocity, past[2]), fps)
        spin = g.op("Mul", _rotation_vector(g, root, g.shaped(past[3], 3, 3)), fps)
        moves = [g.op("MatMul", v, heading) for v in (velocity, change, spin)]
        parts += [*moves, g.op("Mul", moves[2], moves[2])]
    x = g.op("Concat", *parts, axis=0)
    x = g.op("Mul", g.op("Sub", x, pivot.mean), 1 / pivot.deviation)
    clamp = np.float32(pivot.clamp)
    return g.op("Clip", x, -clamp, clamp) if clamp > 0 else x


def _rotation_vector(g: _Graph, now: str, before: str) -> str:
    # Of now beforeᵀ, by tan(angle / 2) = sine / (1 + cosine).
    turn = g.shaped(g.op("MatMul", now, g.op("Transpose", before, perm=[1, 0])), 9)
    half = np.float32(0.5)
    axis = g.op("Mul", g.op("Sub", g.take(turn, [7, 2, 3]), g.take(turn, [5, 6, 1])), half)
    sine = g.op("ReduceL2", axis, axes=[0], keepdims=1)
    trace = g.op("ReduceSum", g.take(turn, [0, 4, 8]), np.array([0]), keepdims=1)
    cosine = g.op("Mul", g.op("Sub", trace, np.float32(1)), half)
    below = g.op("Max", g.op("Add", cosine, np.float32(1)), np.float32(1e-6))
    angle = g.op("Mul", g.op("Atan", g.op("Div", sine, below)), np.float32(2))
    safe = g.op("Max", sine, np.float32(1e-12))
    return g.op("Div", g.op("Mul", axis, angle), safe)


def _recurrent(g: _Graph, r: Recurrent, x: str, state: str, reset: str) -> str:
    n = r.size
    h = g.op("Mul", g.end(0, state, n), g.op("Sub", np.float32(1), reset))
    gates = g.op("Add", g.op("MatMul", g.weight(r.w_in), x), r.b_in)
    u = g.op("Add", g.op("MatMul", g.weight(r.w_state), h), r.b_state)
    rz = g.op("Sigmoid", g.part(g.op("Add", gates, u), 0, 2 * n))
    kept = g.op("Mul", g.part(rz, 0, n), g.part(u, 2 * n, 3 * n))
    new = g.op("Tanh", g.op("Add", g.part(gates, 2 * n, 3 * n), kept))
    step = g.op("Mul", g.part(rz, n, 2 * n), g.op("Sub", h, new))
    h = g.op("Add", new, step, out=g.end(1, f"{state}_out", n))
    return g.op("Add", g.op("MatMul", g.weight(r.w_out), h), r.b_out)


def _detail(g: _Graph, garment: LiveGarment, x: str, motion: str, blend: str, reset: str) -> str:
    pivot, n = garment.pivots[0], garment.subject.garment.n_vertices
    assert pivot.high is not None
    assert pivot.basis is not None
    read = x
    if not pivot.reads_body:
        read = motion
        if pivot.condition:
            size = len(pivot.mean)
            read = g.op("Concat", motion, g.part(x, size, size + 3), axis=0)
    numbers = _recurrent(g, pivot.high, read, "high_state", reset)
    count = len(pivot.basis)
    every = np.zeros((count, n, 3), np.float32)
    every[:, garment.subject.free] = pivot.basis.reshape(count, 3, -1).transpose(0, 2, 1)
    basis = every.reshape(count, -1)
    flat = g.op("Add", g.op("MatMul", numbers, g.weight(basis[1:])), basis[0])
    rows = g.op("Transpose", blend, perm=[2, 0, 1])
    columns = g.turn(g.take(rows, 0), g.take(rows, 1))
    d = g.shaped(flat, n, 3)
    parts = [g.op("Mul", c, g.part(d, k, k + 1)) for k, c in enumerate(columns)]
    return g.op("Add", g.op("Add", parts[0], parts[1]), parts[2])
