"""Where does an iteration's time go, beside the matrix products that it cannot do without?

    python benchmarks/speed/steps.py
    python benchmarks/speed/steps.py --only "horse_gallop-20, polish step, 1"

An outer iteration is a bone step and a vertex step; a polish step has its own parts.  Parts are
timed from outside, by functions put in the place of the solver's own, in one thread, where their
times add up; whole steps also in two.  "floor" is the time that the step's dense and sparse
products would take at the rate of a large float64 matrix product, measured in the same run.
A part's own "bound" is the longer of its operations at that rate and of the bytes that it must
read or write once at the rate of a copy.  Times are the lowest of several iterations: the machine
may be busy with other work.
"""

from __future__ import annotations

import contextlib
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.common import Row
from benchmarks.speed.long_sequences import paper
from ssdr.common.parallel import serial_blas
from ssdr.solver import alternation, gauss_newton, moments, vertex_elimination, vertex_newton
from ssdr.solver.initialization import start_model
from ssdr.solver.model import Model
from ssdr.solver.tangents import RigidTangent
from ssdr.solver.trajectories import Trajectories, gather
from ssdr.solver.vertex_elimination import ReducedSystem

DATA = {"horse_gallop": 20, "samba": 60, "paper_size": 80}  # bones
PAPER_FRAMES, SWEEPS = 2000, 3  # of the paper's size, of full rank
PARTS = [
    ("bones: sums U, AᵀZ", moments, "bone_moments"),
    ("bones: expansion to C", Trajectories, "expand"),
    ("bones: sweeps", alternation, "sweep_bones"),
    ("vertices: G and QᵀM", alternation, "transform_sums"),
    ("chunks", alternation, "run_chunks"),
    ("vertices: kernel", alternation, "solve_vertices"),
]
POLISH_PARTS = [
    ("sums U, C", vertex_elimination, "bone_sums"),
    ("preconditioner", RigidTangent, "precondition"),
    ("elimination of vertices", ReducedSystem, "_eliminate"),
    ("tangents", RigidTangent, "image"),
    ("tangents", RigidTangent, "pullback"),
    ("vertex step", gauss_newton, "optimise_vertices"),
    ("vertices: kernel", vertex_newton, "choose_influences"),
    ("vertices: kernel", vertex_newton, "polish_vertices"),
]


class Watch:
    """Seconds and calls, by name, of functions that are replaced during one step."""

    def __init__(self, step: Callable[[], object], targets: list[tuple[str, Any, str]]) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)
        with contextlib.ExitStack() as stack:
            for name, home, attribute in targets:
                stand_in = self._over(name, getattr(home, attribute))
                stack.enter_context(mock.patch.object(home, attribute, stand_in))
            self._over("all", step)()

    def _over(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                self.seconds[name] += time.perf_counter() - began
                self.calls[name] += 1

        return timed


def prepared(data: str) -> tuple[Trajectories, Model]:
    """Data and a model some alternations after its start."""
    if data == "paper_size":
        skirt = paper()
        frames = np.concatenate([skirt.block(k, 250)[0] for k in range(0, PAPER_FRAMES, 250)])
        # noise has full rank, which no basis reduces
        found = gather([ssdr.MeshSequence(frames)], bones=skirt.bones, compress=False)
        rest, bones = found.from_world(skirt.rest, skirt.transforms(np.arange(PAPER_FRAMES)))
        largest = skirt.indices[np.arange(len(rest)), skirt.weights.argmax(axis=1)]
        model = Model.start(bones, rest, largest.astype(np.intp), 8)
        count = 2
    else:
        found = gather([ssdr.MeshSequence(*common.load(data))], bones=DATA[data])
        rng = np.random.default_rng(0)
        model, count = start_model(found, found.frame(0), DATA[data], 4, rng), 6
    for _ in range(count):
        alternation.vertex_step(found, model)
        alternation.bone_step(found, model, sweeps=SWEEPS)
    alternation.vertex_step(found, model)
    return found, model


def products(data: Trajectories, model: Model) -> dict[str, float]:
    """Floating-point operations of the products of each step.

    G is counted whole (a product with its own transpose could save half), C = Aᵀ X through the
    reduced basis and only where A is not zero.
    """
    f, b, v, r = data.n_frames, model.n_bones, data.n_vertices, data.z.shape[1]
    through = 0.0 if data.q is None else 2.0 * 3 * f * r * 4 * b
    return {
        "G": 2.0 * 3 * f * (4 * b) ** 2,
        "QᵀM": through,
        "Y": 2.0 * v * r * 4 * b,
        "C": 2.0 * 4 * float((model.weights > 0).sum()) * r,
        "Q(AᵀZ)ᵀ": through,
    }


def bounds(data: Trajectories, model: Model, flop: dict[str, float], rates: Row) -> Row:
    """Least milliseconds of each part of an outer iteration by its operations and bytes."""
    f, b, v, r = data.n_frames, model.n_bones, data.n_vertices, data.z.shape[1]
    uses = np.zeros((v, b), dtype=bool)
    np.put_along_axis(uses, model.indices, model.weights > 0, axis=1)
    pairs = int((uses.T.astype(int) @ uses > 0).sum()) - b
    z, y, per_frame = 8.0 * v * r, 8.0 * v * 4 * b, 8.0 * 12 * f * b
    need = {
        "bones: sums U, AᵀZ": (flop["C"], z),
        "bones: expansion to C": (flop["Q(AᵀZ)ᵀ"], 8.0 * 4 * b * r + per_frame),
        "bones: sweeps": (SWEEPS * f * 96.0 * pairs, 3 * per_frame),
        "vertices: G and QᵀM": (flop["G"] + flop["QᵀM"], 2 * per_frame),
        "vertices: Y": (flop["Y"], z + y),
        "vertices: kernel": (20.0 * float(model.count.sum()) * b, y),
    }
    return {
        part: 1e3 * max(1e-9 * ops / rates["gemm_1"], 1e-9 * size / rates["memory"])
        for part, (ops, size) in need.items()
    }


def measure(data: str, step: str, threads: int = 1) -> Row:
    ssdr.set_threads(threads)
    rates = common.machine()
    with serial_blas():
        found, model = prepared(data)
        flop = products(found, model)
        needed = sum(flop.values())
        if step == "outer iteration":
            watch = quickest(outer(found, model), PARTS)
            seconds = watch.seconds
            seconds["vertices: Y"] = seconds.pop("chunks") - seconds["vertices: kernel"]
            seconds["vertices: Y"] -= seconds["bones: sweeps"]
            rest = "rest"
            limits = bounds(found, model, flop, rates)
            order = [*limits]
        else:
            newton = gauss_newton.GaussNewton(found, model)
            newton.step()
            watch = quickest(newton.step, POLISH_PARTS)
            seconds = watch.seconds
            seconds["vertices: G, QᵀM, Y"] = (
                seconds.pop("vertex step") - seconds["vertices: kernel"]
            )
            rest, limits = "CG: matrix products", {}
            order = [name for name in dict.fromkeys(n for n, *_ in POLISH_PARTS) if name in seconds]
            order.append("vertices: G, QᵀM, Y")
            # the vertices are eliminated once for the gradient and once for their own step
            count = watch.calls["elimination of vertices"] - 2 + 1
            needed += count * (3 * flop["G"] + 2.0 * found.n_frames * (6 * model.n_bones) ** 2)
    whole = seconds.pop("all")
    parts = {name: 1e3 * seconds[name] for name in order} if threads == 1 else {}
    if parts:
        parts[rest] = 1e3 * whole - sum(parts.values())
    rate = rates["gemm_1" if threads == 1 else "gemm_2"]
    return {
        "bones": model.n_bones, "V": found.n_vertices, "F": found.n_frames,
        "r": found.z.shape[1], "ms": 1e3 * whole, "parts": parts, "bounds": limits if parts else {},
        "GFLOP": 1e-9 * needed, "floor ms": 1e-6 * needed / rate,
        "ratio": whole / (1e-9 * needed / rate), "rate": rate, "machine": rates,
    }  # fmt: skip


def outer(data: Trajectories, model: Model) -> Callable[[], None]:
    def run() -> None:
        alternation.bone_step(data, model, sweeps=SWEEPS)
        alternation.vertex_step(data, model)

    return run


def quickest(step: Callable[[], object], targets: list[tuple[str, Any, str]]) -> Watch:
    watches: list[Watch] = []
    while len(watches) < 3 or (len(watches) < 8 and sum(w.seconds["all"] for w in watches) < 2):
        watches.append(Watch(step, targets))
    return min(watches, key=lambda w: w.seconds["all"])


if __name__ == "__main__":
    cases: dict[str, Row] = {
        f"{data}-{bones}, {step}, {threads}": {"data": data, "step": step, "threads": threads}
        for step in ("outer iteration", "polish step")
        for data, bones in DATA.items()
        for threads in (1, 2)
    }
    columns = ("V", "F", "r", "ms", "GFLOP", "floor ms", "ratio", "rate")
    common.run(__file__, __doc__, cases, measure, columns)
