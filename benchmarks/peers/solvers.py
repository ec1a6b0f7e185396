"""One named solver on one sequence, in a process of its own, in slices of time.

Started by race.py, which writes a line to the standard input for every slice: so solvers take
turns, and what slows the machine down slows all of them.  Only the solver's own work is timed;
loading, compiling, measuring the error and waiting for the turn are not.  A record (JSON) is
written at the end.

    python benchmarks/peers/solvers.py '{"solver": "ssdr balanced", "sequence": "fox", ...}'
"""

from __future__ import annotations

import argparse
import bisect
import importlib.metadata
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.common import data_folder, defects, e_of, load, write_json
from benchmarks.peers.model_size import dense, pca_curve, skinned_e, sparse, stored

Point = tuple[int, float, float, float]  # iteration, wall, CPU seconds, E


class Pace:
    """The clock of the solver's own work, stopped while others have their turn."""

    def __init__(self, slice_seconds: float) -> None:
        self.slice = slice_seconds
        self.wall = self.cpu = 0.0
        self._left = 0.0

    def begin(self) -> None:
        if self._left <= 0:
            print("ready", flush=True)
            if not sys.stdin.readline():
                sys.exit("race.py has gone")
            self._left = self.slice
        self._from = time.perf_counter(), time.process_time()

    def end(self) -> None:
        wall = time.perf_counter() - self._from[0]
        self.wall += wall
        self.cpu += time.process_time() - self._from[1]
        self._left -= wall


def tube(vertices: int, frames: int, joints: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """A tube on a chain that swings, with waves that travel along it: of full rank."""
    around = max(8, round((vertices / 8) ** 0.5))
    rings = max(4, round(vertices / around))
    along = np.linspace(0.0, joints, rings)
    angle = np.linspace(0.0, 2 * np.pi, around, endpoint=False)
    x, a = (m.ravel() for m in np.meshgrid(along, angle, indexing="ij"))
    rng = np.random.default_rng(3)
    time_ = np.arange(frames) / 24.0
    out = np.empty((frames, len(x), 3))
    speed, phase = rng.uniform(1, 4, joints), rng.uniform(0, 6.28, joints)
    rate = np.sin(time_[:, None] * speed + phase)  # curvature along each link
    share = np.clip(along[:, None] - np.arange(joints), 0, 1)  # of each link that lies behind
    bend = 0.5 * rate @ share.T
    dx = np.diff(along, prepend=0.0)
    px, py = np.cumsum(np.cos(bend) * dx, axis=1), np.cumsum(np.sin(bend) * dx, axis=1)
    ring = np.repeat(np.arange(rings), around)
    radius = 0.4 * (1 + 0.04 * np.sin(5 * x - 7 * time_[:, None] + 2 * a))
    side, up = radius * np.cos(a), radius * np.sin(a)
    out[..., 0] = px[:, ring] - np.sin(bend)[:, ring] * side
    out[..., 1] = py[:, ring] + np.cos(bend)[:, ring] * side
    out[..., 2] = up + 0.002 * rng.standard_normal(up.shape)
    i, k = np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij")
    p, q = (i * around + k).ravel(), (i * around + (k + 1) % around).ravel()
    faces = np.concatenate([np.c_[p, q, q + around], np.c_[p, q + around, p + around]])
    return out.astype(np.float32), faces.astype(np.int32)


def sequence(name: str) -> tuple[np.ndarray, np.ndarray]:
    """A file of the data folder, "sample:NAME" of the package, or "tube:VERTICES:FRAMES"."""
    kind, _, rest = name.partition(":")
    if kind == "tube":
        vertices, frames = (int(part) for part in rest.split(":"))
        return tube(vertices, frames)
    if kind == "sample":
        import ssdr

        sample = ssdr.samples.load(rest)
        return np.asarray(sample.vertices), np.asarray(sample.faces)
    return load(name)


def run_dem_bones(
    job: dict[str, Any], frames: np.ndarray, faces: np.ndarray, pace: Pace
) -> dict[str, Any]:
    """Dem Bones through its binding, iteration by iteration; frame 0 is the rest pose."""
    from py_dem_bones._py_dem_bones import DemBones
    from py_dem_bones.portable import _prepare_solver

    if set(faces.ravel().tolist()) != set(range(frames.shape[1])):
        print("some vertices have no face", file=sys.stderr)
    rest = np.asarray(frames[0], dtype=np.float64)
    solver = DemBones()
    if job["solver"].endswith(" 0"):
        solver.weightsSmooth = 0.0
        solver.transAffine = 0.0
    _prepare_solver(
        rest, frames, job["bones"], faces=faces, max_influences=job["influences"], solver=solver
    )
    curve: list[Point] = []
    best: tuple[float, Any] = (np.inf, None)

    def note(iteration: int) -> None:
        nonlocal best
        weights = np.asarray(solver.get_weights(), dtype=np.float64).T
        m = np.asarray(solver.m, dtype=np.float64)
        m = m.reshape(len(frames), 4, solver.nB, 4).transpose(0, 2, 1, 3)[:, :, :3]
        e = skinned_e(frames, rest, weights, m)
        if np.isfinite(e) and e < best[0]:
            best = e, (weights.copy(), m.copy())
        curve.append((iteration, pace.wall, pace.cpu, e))

    pace.begin()
    solver.init()
    pace.end()
    note(0)
    for k in range(job["iterations"]):
        pace.begin()
        solver.computeTranformations()
        solver.computeWeights()
        pace.end()
        note(k + 1)
    out: dict[str, Any] = {
        "curve": curve,
        "bones found": int(solver.nB),
        "total wall": pace.wall,
        "total cpu": pace.cpu,
        "version": importlib.metadata.version("py-dem-bones"),
    }
    if best[1] is not None:
        weights, m = best[1]
        indices, w = sparse(weights)
        out |= {"E": best[0], "stated E": None, **stored(frames, rest, indices, w, m)}
        out["influences found"] = indices.shape[1]
        out["rows sum to"] = [float(weights.sum(axis=1).min()), float(weights.sum(axis=1).max())]
    return out


def run_2012(
    job: dict[str, Any], frames: np.ndarray, faces: np.ndarray, pace: Pace
) -> dict[str, Any]:
    """The method of Le and Deng 2012, from the parts of this package.

    Frame 0 is the rest pose; weights of all vertices and rigid bones alternate; no re-seeding, no
    polish.  The start is this package's own, better than that of the paper.
    """
    import ssdr
    from ssdr.solver.alternation import bone_step, vertex_step
    from ssdr.solver.initialization import start_model
    from ssdr.solver.model import Fixed
    from ssdr.solver.trajectories import gather

    rng = np.random.default_rng(job["seed"])
    rest = np.asarray(frames[0], dtype=np.float64)
    bones, influences = job["bones"], job["influences"]
    curve: list[Point] = []
    fixed = Fixed(rest=True)
    best: tuple[float, Any] = (np.inf, None)

    def note(iteration: int) -> None:
        nonlocal best
        p, m = data.to_world(model.rest, model.transforms)
        e = skinned_e(frames, p, dense(model.indices, model.weights, bones), m)
        if e < best[0]:
            best = e, (p, model.indices.copy(), model.weights.copy(), m)
        curve.append((iteration, pace.wall, pace.cpu, e))

    pace.begin()
    data = gather([ssdr.MeshSequence(frames, faces)], bones=bones)
    inner, _ = data.from_world(rest, None)
    model = start_model(data, inner, bones, min(influences, bones), rng)
    vertex_step(data, model, fixed=fixed)
    pace.end()
    note(0)
    for k in range(job["iterations"]):
        pace.begin()
        bone_step(data, model, fixed=fixed)
        vertex_step(data, model, fixed=fixed)
        pace.end()
        note(k + 1)
    p, indices, weights, m = best[1]
    return {
        "curve": curve,
        "bones found": m.shape[1],
        "total wall": pace.wall,
        "total cpu": pace.cpu,
        "E": best[0],
        **stored(frames, p, indices, weights, m),
    }


def run_ssdr(
    job: dict[str, Any], frames: np.ndarray, faces: np.ndarray, pace: Pace
) -> dict[str, Any]:
    """`ssdr.decompose`; "fixed" keeps the rest pose at frame 0, "middle" takes that frame;
    "similarity" and "affine" are bone models."""
    import ssdr

    _, effort, *more = job["solver"].split()
    options: dict[str, Any] = {
        "bones": job["bones"],
        "influences": job["influences"],
        "effort": effort,
        "rng": job["seed"],
        **job.get("options", {}),
    }
    for bone_model in {"similarity", "affine"} & set(more):
        options["bone_model"] = bone_model
    rest_frame = len(frames) // 2 if "middle" in more else 0
    if "fixed" in more:
        options["rest"] = np.asarray(frames[rest_frame], dtype=np.float64)
    else:
        options["rest_frame"] = rest_frame
    began: float | None = None  # of the solver's own clock
    left: list[float] = [0.0]  # that clock when the callback was left
    walls, cpus = [0.0], [0.0]

    def turn(progress: ssdr.Progress) -> None:
        nonlocal began
        pace.end()
        if began is None:
            began = time.perf_counter() - progress.elapsed
            left[0] = progress.elapsed - pace.wall  # what the call did before its clock began
        walls.append(pace.wall)
        cpus.append(pace.cpu)
        pace.begin()
        left.append(time.perf_counter() - began)

    pace.begin()
    result = ssdr.decompose(frames, faces, callback=turn, **options)
    pace.end()
    walls.append(pace.wall)
    cpus.append(pace.cpu)
    curve: list[Point] = []
    for record in result.history:
        k = bisect.bisect_right(left, record.elapsed) - 1
        wall = min(walls[k] + record.elapsed - left[k], walls[k + 1])
        share = (wall - walls[k]) / max(walls[k + 1] - walls[k], 1e-9)
        cpu = cpus[k] + share * (cpus[k + 1] - cpus[k])
        curve.append((record.iteration, wall, cpu, per_rmse(record.rmse)))
    model = result.skinning
    wrong = defects(model, job["bones"], job["influences"])
    e = e_of(frames, model)
    again = skinned_e(
        frames, model.rest, dense(model.indices, model.weights, job["bones"]), model.transforms
    )
    if abs(e - again) > 1e-7 * e + 1e-9:
        wrong.append(f"two ways of skinning differ: {e}, {again}")
    out = {
        "curve": curve,
        "bones found": model.transforms.shape[1],
        "total wall": pace.wall,
        "total cpu": pace.cpu,
        "E": e,
        "stated E": per_rmse(result.rmse),
        "defects": wrong,
        "stopped": result.stop_reason,
        **stored(
            frames, model.rest, model.indices, model.weights, model.transforms, model.bone_model
        ),
    }
    if job.get("stops"):
        out["walk"] = walk(job["stops"], options, frames, faces, result)
    return out


def walk(
    shares: list[float], options: dict[str, Any], frames: np.ndarray, faces: np.ndarray, whole: Any
) -> list[dict[str, float]]:
    """The run again, stopped along its history and skinned: does the history state true errors?"""
    import ssdr

    state = None
    out = []
    for share in shares:
        wanted = whole.history[round(share * (len(whole.history) - 1))]

        def enough(progress: ssdr.Progress, wanted: Any = wanted) -> bool:
            there = progress.rmse <= wanted.rmse * (1 + 1e-9)
            return there or progress.iteration > wanted.iteration

        found = ssdr.decompose(frames, faces, callback=enough, resume=state, **options)
        state = found.state
        e = e_of(frames, found.skinning)
        # the run may have stopped one record earlier or later: compare at the same iteration
        at = found.history[-1].iteration
        before = [r for r in whole.history if r.iteration <= at]
        out.append({"iteration": at, "E": e, "history": per_rmse(before[-1].rmse)})
    return out


def per_rmse(rmse: float) -> float:
    return 1000.0 * rmse / float(np.sqrt(3))


def run_smooth(
    job: dict[str, Any], frames: np.ndarray, faces: np.ndarray, pace: Pace
) -> dict[str, Any]:
    """Every second frame is fitted, with a smoothness that is a fraction of the diagonal; on the
    others rest pose and weights are kept and only the bones are found."""
    import ssdr

    length = float(job["solver"].split()[1]) * ssdr.MeshSequence(frames, faces).diagonal()
    fitted, kept = np.ascontiguousarray(frames[::2]), np.ascontiguousarray(frames[1::2])
    pace.begin()
    model = ssdr.decompose(
        fitted, faces, bones=job["bones"], influences=job["influences"], smoothness=length
    ).skinning
    pace.end()
    carried = ssdr.fit_bones(kept, rest=model.rest, indices=model.indices, weights=model.weights)
    weights = dense(model.indices, model.weights, job["bones"])
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    jump = 0.5 * np.abs(weights[edges[:, 0]] - weights[edges[:, 1]]).sum(axis=1).mean()
    return {
        "curve": [],
        "bones found": model.transforms.shape[1],
        "jump": float(jump),
        "E": e_of(fitted, model),
        "E kept out": skinned_e(kept, model.rest, weights, carried.transforms),
        "total wall": pace.wall,
        "total cpu": pace.cpu,
    }


def run_published(
    job: dict[str, Any], frames: np.ndarray, faces: np.ndarray, pace: Pace
) -> dict[str, Any]:
    """What the authors of Dem Bones published for their own sample."""
    file = data_folder() / "reference" / f"ea_ref_Decomposition_{job['bones']:02}.npz"
    with np.load(file, allow_pickle=False) as z:
        rest, weights, transforms = z["rest"], z["weights"], z["transforms"]
    pace.begin()
    indices, w = sparse(weights)
    e = skinned_e(frames, rest, weights, transforms)
    return {
        "curve": [],
        "bones found": transforms.shape[1],
        "E": e,
        "influences found": indices.shape[1],
        **stored(frames, rest, indices, w, transforms),
    }


def run_pca(
    job: dict[str, Any], frames: np.ndarray, faces: np.ndarray, pace: Pace
) -> dict[str, Any]:
    pace.begin()
    return {"curve": [], "pca": pca_curve(frames)}


def solver_named(name: str) -> Callable[..., dict[str, Any]]:
    return {
        "dembones": run_dem_bones,
        "2012": run_2012,
        "ssdr": run_ssdr,
        "smooth": run_smooth,
        "published": run_published,
        "pca": run_pca,
    }[name.split()[0]]


def ready(name: str) -> dict[str, float]:
    """Everything that is loaded or compiled before the first call: seconds of each."""
    out: dict[str, float] = {}

    def lap(what: str, since: tuple[float, float]) -> tuple[float, float]:
        now = time.perf_counter(), time.process_time()
        out[what], out[f"{what} cpu"] = now[0] - since[0], now[1] - since[1]
        return now

    now = time.perf_counter(), time.process_time()
    if name.startswith("dembones"):
        import py_dem_bones  # noqa: F401

        lap("import", now)
    elif name.startswith(("ssdr", "2012", "smooth")):
        import ssdr

        points = np.random.default_rng(0).standard_normal((4, 30, 3))
        now = lap("import", now)
        ssdr.decompose(points, bones=2, effort="fast", max_iterations=1)
        lap("kernels", now)
    return out


def peak_megabytes() -> float:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1024
    return 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("job", type=json.loads, help="JSON: solver, sequence, bones, ...")
    job = parser.parse_args().job
    waits = ready(job["solver"])
    frames, faces = sequence(job["sequence"])
    if job.get("part") == "seeds":
        order = np.random.default_rng(job["seed"]).permutation(frames.shape[1])
        frames, faces = np.ascontiguousarray(frames[:, order]), np.argsort(order)[faces]
    pace = Pace(job["slice"])
    if "threads" in job and "ssdr" in sys.modules:
        import ssdr

        ssdr.set_threads(job["threads"])
    load_before = os.getloadavg()[0]
    found = solver_named(job["solver"])(job, frames, faces, pace)
    curve = [[k, round(w, 4), round(c, 4), float(f"{e:.6g}")] for k, w, c, e in found["curve"]]
    # a solver that fails may leave NaN behind, which is no JSON
    record = {
        **{k: v for k, v in job.items() if k not in ("out", "slice", "rates")},
        "V": frames.shape[1],
        "F": frames.shape[0],
        "waits": waits,
        **job.get("rates", {}),
        "load": round(load_before, 2),
        "load after": round(os.getloadavg()[0], 2),
        "peak MiB": round(peak_megabytes()),
        **found,
        "curve": [point for point in curve if np.isfinite(point[3])],
        # rounded as those of the curve are, so that its last point is not after the end
        **{k: round(found[k], 4) for k in ("total wall", "total cpu") if k in found},
    }
    record["NaN"] = len(curve) - len(record["curve"])
    out = Path(job["out"])
    write_json(out.with_suffix(".part"), record)
    out.with_suffix(".part").replace(out)
    print("done", flush=True)


if __name__ == "__main__":
    main()
