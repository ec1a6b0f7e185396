"""Where does an iteration's time go, beside the matrix products that it cannot do without?

    python benchmarks/speed/steps.py

An outer iteration is a bone step and a vertex step; a polish step has its own parts.  Parts are
timed from outside, by functions put in the place of the solver's own, in one thread, where their
times add up; whole steps also in two.  "floor" is the time that the step's dense and sparse
products would take at the rate of a large float64 matrix product, measured in the same run.
A part's own "bound" is the longer of its operations at that rate and of the bytes that it must
read or write once at the rate of a copy.
Times are the lowest of several iterations: the machine may be busy with other work.
Peak memory is that of a process of its own (--memory runs that process).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import resource
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import (
    IMAGES,
    RESULTS,
    load,
    machine,
    pyplot,
    save_figure,
    table,
    tell,
    write_json,
)
from benchmarks.speed import paper_size
from ssdr.parallel import serial_blas
from ssdr.solver import alternation, gauss_newton, moments, vertex_elimination, vertex_newton
from ssdr.solver.gauss_newton import GaussNewton
from ssdr.solver.initialization import start_model
from ssdr.solver.model import Model
from ssdr.solver.tangents import RigidTangent
from ssdr.solver.trajectories import Trajectories, gather

CASES = [("horse_gallop", 20), ("samba", 60)]
PAPER = ("paper_size", 80)  # 2,000 of its frames, of full rank
PAPER_FRAMES = 2000
INFLUENCES, SWEEPS = 4, 3


class Watch:
    """Seconds by name, of functions that it stands in for."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)

    def over(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                self.seconds[name] += time.perf_counter() - began
                self.calls[name] += 1

        return timed

    @contextlib.contextmanager
    def watching(self, targets: list[tuple[str, Any, str]]) -> Iterator[None]:
        with contextlib.ExitStack() as stack:
            for name, home, attribute in targets:
                stand_in = self.over(name, getattr(home, attribute))
                if isinstance(home.__dict__[attribute], staticmethod):
                    stand_in = staticmethod(stand_in)  # type: ignore[assignment]
                stack.enter_context(mock.patch.object(home, attribute, stand_in))
            yield


BONE = [
    ("sums", moments, "bone_moments"),
    ("expansion", Trajectories, "expand"),
    ("sweeps", alternation, "sweep_bones"),
]
VERTEX = [
    ("sums", alternation, "transform_sums"),
    ("chunks", alternation, "run_chunks"),
    ("kernel", alternation, "solve_vertices"),
]
POLISH = [
    ("bone sums", vertex_elimination, "bone_sums"),
    ("preconditioner", RigidTangent, "precondition"),
    ("solve", GaussNewton, "_solve"),
    ("elimination", vertex_elimination.ReducedSystem, "_eliminate"),
    ("tangents", RigidTangent, "image"),
    ("tangents", RigidTangent, "pullback"),
    ("vertex step", gauss_newton, "optimise_vertices"),
    ("vertex kernel", vertex_newton, "polish_vertices"),
]


def fastest(run: Callable[[Watch], None], targets: list[tuple[str, Any, str]], repeats: int) -> Any:
    """Seconds by part of the quickest of several calls, and "all" of it."""
    found = []
    for _ in range(repeats):
        watch = Watch()
        with watch.watching(targets):
            began = time.perf_counter()
            run(watch)
            watch.seconds["all"] = time.perf_counter() - began
        found.append(watch)
    return min(found, key=lambda w: w.seconds["all"])


def prepare(name: str, bones: int) -> tuple[Trajectories, Model]:
    """A model some alternations after its start, as most iterations find it."""
    if name == PAPER[0]:
        return prepare_paper()
    frames, faces = load(name)
    data = gather([ssdr.MeshSequence(frames, faces)], bones=bones)
    rng = np.random.default_rng(0)
    model = start_model(data, data.frame(0), bones, INFLUENCES, rng)
    for _ in range(6):
        alternation.vertex_step(data, model)
        alternation.bone_step(data, model, sweeps=SWEEPS)
    alternation.vertex_step(data, model)
    return data, model


def prepare_paper() -> tuple[Trajectories, Model]:
    """The paper's size: each vertex starts with its largest weight; some alternations follow."""
    source = paper_size.Source()
    frames = np.concatenate([source.block(k, 250)[0] for k in range(0, PAPER_FRAMES, 250)])
    # noise has full rank: a basis would be looked for in vain
    data = gather([ssdr.MeshSequence(frames, source.faces)], bones=source.bones, compress=False)
    del frames
    rest, bones = data.from_world(source.rest, source.transforms(np.arange(PAPER_FRAMES)))
    assert bones is not None
    largest = source.indices[np.arange(len(rest)), source.weights.argmax(axis=1)]
    model = Model.start(bones, rest, largest.astype(np.intp), paper_size.INFLUENCES)
    for _ in range(2):
        alternation.vertex_step(data, model)
        alternation.bone_step(data, model, sweeps=SWEEPS)
    alternation.vertex_step(data, model)
    return data, model


def bounds(
    data: Trajectories, model: Model, flop: dict[str, float], rates: dict[str, Any]
) -> dict[str, float]:
    """Seconds by part of an outer iteration that its operations or its bytes need."""
    f, b, v, r = data.n_frames, model.n_bones, data.n_vertices, data.z.shape[1]
    shared = np.zeros((b, b), dtype=bool)
    for q in range(model.n_influences):
        for s in range(model.n_influences):
            both = (model.weights[:, q] > 0) & (model.weights[:, s] > 0)
            shared[model.indices[both, q], model.indices[both, s]] = True
    np.fill_diagonal(shared, False)
    z, y, per_frame = 8.0 * v * r, 8.0 * v * 4 * b, 8.0 * 12 * f * b
    support = float(model.count.sum())
    need = {
        "bones: sums U, AᵀZ": (flop["C"], z),
        "bones: expansion to C": (flop["Q(AᵀZ)ᵀ"], 8.0 * 4 * b * r + per_frame),
        "bones: sweeps": (SWEEPS * f * 96.0 * shared.sum(), 3 * per_frame),
        "vertices: G and QᵀM": (flop["G"] + flop["QᵀM"], 2 * per_frame),
        "vertices: Y": (flop["Y"], z + y),
        "vertices: kernel": (20.0 * support * b, y),
    }
    return {
        part: max(1e-9 * ops / rates["gemm_1"], 1e-9 * size / rates["memory"])
        for part, (ops, size) in need.items()
    }


def products(data: Trajectories, model: Model) -> dict[str, float]:
    """Floating-point operations of the products of each step.

    G is counted whole (a product with its own transpose could save half), C = Aᵀ X through the
    reduced basis and only where A is not zero.
    """
    f, b, v, r = data.n_frames, model.n_bones, data.n_vertices, data.z.shape[1]
    nonzero = float((model.weights > 0).sum())
    through = 0.0 if data.q is None else 2.0 * 3 * f * r * 4 * b
    table_g = 2.0 * 3 * f * (4 * b) ** 2
    return {
        "G": table_g,
        "QᵀM": through,
        "Y": 2.0 * v * r * 4 * b,
        "C": 2.0 * 4 * nonzero * r,
        "Q(AᵀZ)ᵀ": through,
        "Schur product": 3 * table_g,
        "Y over all frames": 2.0 * v * 3 * f * 4 * b,
    }


def outer_iterations(name: str, bones: int, repeats: int) -> list[dict[str, Any]]:
    rows = []
    data, model = prepare(name, bones)
    flop = products(data, model)
    case = {
        "case": f"{name}-{bones}",
        "V": data.n_vertices,
        "F": data.n_frames,
        "r": data.z.shape[1],
    }
    for threads in (1, 2):
        ssdr.set_threads(threads)
        rates = machine()
        rate = rates["gemm_1"] if threads == 1 else rates["gemm_2"]
        bone, vertex = model.copy(), model.copy()
        b = fastest(lambda _, m=bone: alternation.bone_step(data, m, sweeps=SWEEPS), BONE, repeats)
        v = fastest(lambda _, m=vertex: alternation.vertex_step(data, m), VERTEX, repeats)
        whole = b.seconds["all"] + v.seconds["all"]
        parts: dict[str, float] = {}
        if threads == 1:
            parts = {
                "bones: sums U, AᵀZ": b.seconds["sums"],
                "bones: expansion to C": b.seconds["expansion"],
                "bones: sweeps": b.seconds["sweeps"],
                "vertices: G and QᵀM": v.seconds["sums"],
                "vertices: Y": v.seconds["chunks"] - v.seconds["kernel"],
                "vertices: kernel": v.seconds["kernel"],
            }
            parts["rest"] = whole - sum(parts.values())
        needed = sum(flop[k] for k in ("G", "QᵀM", "Y", "C", "Q(AᵀZ)ᵀ"))
        rows.append({
            **case, "step": "outer iteration", "threads": threads,
            "ms": 1e3 * whole, "bone step ms": 1e3 * b.seconds["all"],
            "vertex step ms": 1e3 * v.seconds["all"],
            "parts ms": {k: 1e3 * s for k, s in parts.items()},
            "bounds ms": {k: 1e3 * s for k, s in bounds(data, model, flop, rates).items()},
            "GFLOP": 1e-9 * needed, "floor ms": 1e-6 * needed / rate,
            "times floor": whole / (1e-9 * needed / rate), **rates,
        })  # fmt: skip
    ssdr.set_threads(None)
    return rows


def polish_steps(name: str, bones: int, repeats: int) -> list[dict[str, Any]]:
    rows = []
    data, model = prepare(name, bones)
    flop = products(data, model)
    case = {
        "case": f"{name}-{bones}",
        "V": data.n_vertices,
        "F": data.n_frames,
        "r": data.z.shape[1],
    }
    for threads in (1, 2):
        ssdr.set_threads(threads)
        rates = machine()
        rate = rates["gemm_1"] if threads == 1 else rates["gemm_2"]
        state = GaussNewton(data, model.copy())
        state.step()
        w = fastest(lambda _, s=state: s.step(), POLISH, repeats)
        s = w.seconds
        # once for the gradient, once to go back to the vertices, else once a product
        conjugate = w.calls["elimination"] - 2
        parts: dict[str, float] = {}
        if threads == 1:
            parts = {
                "sums U, C": s["bone sums"],
                "preconditioner": s["preconditioner"],
                "elimination of vertices": s["elimination"],
                "tangents": s["tangents"],
                "vertices: kernel": s["vertex kernel"],
                "vertices: G, QᵀM, Y": s["vertex step"] - s["vertex kernel"],
            }
            parts["CG: matrix products"] = s["all"] - sum(parts.values())
        needed = sum(flop[k] for k in ("G", "QᵀM", "Y", "C", "Q(AᵀZ)ᵀ"))
        needed += (conjugate + 1) * flop["Schur product"]
        needed += (conjugate + 1) * 2.0 * data.n_frames * (6 * model.n_bones) ** 2
        rows.append(
            {
                **case,
                "step": "polish step",
                "threads": threads,
                "ms": 1e3 * s["all"],
                "CG products": conjugate,
                "parts ms": {k: 1e3 * value for k, value in parts.items()},
                "GFLOP": 1e-9 * needed,
                "floor ms": 1e-6 * needed / rate,
                "times floor": s["all"] / (1e-9 * needed / rate),
                **rates,
            }
        )
    ssdr.set_threads(None)
    return rows


def peak() -> float:
    """Most memory that this process ever held, MiB."""
    status = Path("/proc/self/status")
    if status.exists():
        # what getrusage reports starts, on Linux, from the memory of the parent process
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def memory(name: str, bones: int) -> dict[str, Any]:
    """Peak before and after the run; the kernels are loaded before."""
    frames, faces = load(name)
    ssdr.decompose(frames[:4, :64], bones=2, effort="fast", max_iterations=1)
    before = peak()
    ssdr.decompose(frames, faces, bones=bones, influences=INFLUENCES)
    return {
        "case": f"{name}-{bones}",
        "input MiB": frames.nbytes / 2**20,
        "float64 MiB": frames.size / 2**17,
        "before MiB": before,
        "peak MiB": peak(),
    }


def memory_apart(name: str, bones: int) -> dict[str, Any]:
    command = [sys.executable, __file__, "--memory", name, str(bones)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def chart(rows: list[dict[str, Any]], path: Path) -> None:
    plt = pyplot()
    shown = [row for row in rows if row["threads"] == 1]
    figure, axes = plt.subplots(-(-len(shown) // 2), 2, figsize=(11, 8))
    for axis in axes.flat[len(shown) :]:
        axis.axis("off")
    for axis, row in zip(axes.flat, shown, strict=False):
        names = list(row["parts ms"])
        axis.barh(names, [row["parts ms"][n] for n in names], color="#0072b2")
        axis.barh(["all products, at the GEMM rate"], [row["floor ms"]], color="#e69f00")
        axis.invert_yaxis()
        axis.set(title=f"{row['step']}, {row['case']}: {row['ms']:.0f} ms", xlabel="ms, one thread")
    save_figure(figure, path)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=8)
    parser.add_argument("--short", action="store_true", help="without the paper's size")
    parser.add_argument("--memory", nargs=2, metavar=("DATA", "BONES"), help="of this one alone")
    parser.add_argument("--out", type=Path, default=RESULTS / "steps.json")
    parser.add_argument("--chart", type=Path, default=IMAGES / "steps.png")
    args = parser.parse_args()
    if args.memory:
        print(json.dumps(memory(args.memory[0], int(args.memory[1]))))
        return
    frames, _ = load("fox")
    ssdr.decompose(frames[:4], bones=2, effort="fast", max_iterations=1)  # kernels ready
    rows: list[dict[str, Any]] = []
    with serial_blas():
        for name, bones in CASES:
            rows += outer_iterations(name, bones, args.repeats)
        if not args.short:
            rows += outer_iterations(*PAPER, max(2, args.repeats // 4))
        for name, bones in CASES:
            rows += polish_steps(name, bones, max(3, args.repeats // 2))
        if not args.short:
            rows += polish_steps(*PAPER, 3)
    peaks = [memory_apart(name, bones) for name, bones in CASES]
    write_json(args.out, {"question": __doc__.splitlines()[0], "steps": rows, "memory": peaks})
    chart(rows, args.chart)
    columns = (
        "case", "V", "F", "r", "step", "threads", "ms", "bone step ms", "vertex step ms",
        "CG products", "GFLOP", "floor ms", "times floor", "gemm_1", "gemm_2", "load",
    )  # fmt: skip
    print(table(rows, columns))
    for row in rows:
        if row["parts ms"]:
            print(f"\n{row['case']}, {row['step']}, one thread:")
            for part, ms in row["parts ms"].items():
                bound = row.get("bounds ms", {}).get(part)
                beside = ""
                if bound is not None:
                    beside = f"  bound {bound:8.2f} ms, {ms / bound:5.1f} times"
                print(f"  {part:28} {ms:8.2f} ms  {100 * ms / row['ms']:5.1f} %{beside}")
    print("\n" + table(peaks, list(peaks[0])))
    print(tell(rows[-1]))


if __name__ == "__main__":
    main()
