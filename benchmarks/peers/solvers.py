"""One named solver on one sequence, in a process of its own, in slices of time.

Started by race.py, which writes a line to the standard input for every slice: so solvers take
turns, and what slows the machine down slows all of them.  Only the solver's own work is timed;
loading, compiling, measuring the error and waiting for the turn are not.  The last line that is
printed is a record (JSON).

    python benchmarks/peers/solvers.py '{"solver": "ssdr balanced", "sequence": "fox", ...}'
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from benchmarks.common import Row, e_of
from benchmarks.peers import dem_bones, slot
from benchmarks.peers.model_size import dense, pca_curve, skinned_e, sparse, stored

Point = tuple[int, float, float, float]  # iteration, wall, CPU seconds, E


class Pace:
    """Clock of the solver's own work, which stops while others have their turn."""

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
    clock = np.arange(frames)[:, None] / 24.0
    out = np.empty((frames, len(x), 3))
    speed, phase = rng.uniform(1, 4, joints), rng.uniform(0, 6.28, joints)
    curvature = np.sin(clock * speed + phase)  # along each link
    share = np.clip(along[:, None] - np.arange(joints), 0, 1)  # of each link that lies behind
    bend = 0.5 * curvature @ share.T
    dx = np.diff(along, prepend=0.0)
    px, py = np.cumsum(np.cos(bend) * dx, axis=1), np.cumsum(np.sin(bend) * dx, axis=1)
    ring = np.repeat(np.arange(rings), around)
    radius = 0.4 * (1 + 0.04 * np.sin(5 * x - 7 * clock + 2 * a))
    side, up = radius * np.cos(a), radius * np.sin(a)
    out[..., 0] = px[:, ring] - np.sin(bend)[:, ring] * side
    out[..., 1] = py[:, ring] + np.cos(bend)[:, ring] * side
    out[..., 2] = up + 0.002 * rng.standard_normal(up.shape)
    i, k = np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij")
    p, q = (i * around + k).ravel(), (i * around + (k + 1) % around).ravel()
    faces = np.concatenate([np.c_[p, q, q + around], np.c_[p, q + around, p + around]])
    return out.astype(np.float32), faces.astype(np.int32)


def run_dem_bones(job: Row, frames: np.ndarray, faces: np.ndarray, pace: Pace) -> Row:
    """Dem Bones, iteration by iteration; frame 0 is the rest pose.

    The result is the best of its models, each of which is measured.
    """
    rest = np.asarray(frames[0], dtype=np.float64)
    solver = dem_bones.prepared(
        frames, faces, job["bones"], job["influences"],
        regularised=not job["solver"].endswith(" 0"),
    )  # fmt: skip

    times: list[tuple[int, float, float]] = []

    def paced() -> Iterator[dem_bones.Found]:
        models = dem_bones.iterates(solver, len(frames), job["iterations"])
        for k in range(job["iterations"] + 1):
            pace.begin()
            model = next(models)
            pace.end()
            times.append((k, pace.wall, pace.cpu))
            yield model

    errors, best = dem_bones.lowest(frames, rest, paced())
    bones = dem_bones.model_of(solver, len(frames))[1].shape[1]
    curve = [(*time, e) for time, e in zip(times, errors, strict=True)]
    found = {} if best is None else measured(job, frames, slot.Parts(rest, *best))
    return {"curve": curve, "bones found": bones, **found}


def run_own(job: Row, frames: np.ndarray, faces: np.ndarray, pace: Pace) -> Row:
    """The function of a Python file, called once."""
    solve = slot.solver_of(job["solver"])
    pace.begin()
    parts = solve(
        frames, faces, bones=job["bones"], influences=job["influences"], bone_model="rigid",
        rest=None,
    )  # fmt: skip
    pace.end()
    found = measured(job, frames, parts)
    return {
        "curve": [(1, pace.wall, pace.cpu, found["E"])],
        "bones found": parts.transforms.shape[1],
        "defects": common.defects(parts, job["bones"], job["influences"]),
        **found,
    }


def measured(job: Row, frames: np.ndarray, parts: slot.Parts) -> Row:
    """Error, bytes and normals of another solver's model."""
    skin = parts.rest, *sparse(parts.weights), parts.transforms
    e = skinned_e(frames, *parts[:3])
    return {"E": e, **stored(frames, *skin), **drawn(frames, job["sequence"], *skin)}


def run_2012(job: Row, frames: np.ndarray, faces: np.ndarray, pace: Pace) -> Row:
    """`ssdr.ssdr2012`; frame 0 is the rest pose."""
    import ssdr

    points: list[Point] = []
    options = {key: job[key] for key in ("bones", "influences", "iterations")}
    pace.begin()
    fit = ssdr.ssdr2012(frames, faces, rng=job["seed"], callback=marks(pace, points), **options)
    pace.end()
    model = fit.skinning
    skin = model.rest, model.indices, model.weights, model.transforms
    return {
        "curve": points,
        "bones found": model.n_bones,
        "E": e_of(frames, model),
        **stored(frames, *skin),
        **drawn(frames, job["sequence"], *skin),
    }


def marks(pace: Pace, points: list[Point]) -> Callable[[Any], None]:
    """Callback that adds a point a step and lets others have their turn."""

    def turn(progress: Any) -> None:
        pace.end()
        points.append((progress.iteration, pace.wall, pace.cpu, 1000 * progress.rmse / 3**0.5))
        pace.begin()

    return turn


def drawn(frames: np.ndarray, sequence: str, *skin: np.ndarray, normals: Any = None) -> Row:
    """Angles in degrees from the input's normals to those that an engine draws.

    `normals` are the model's rest normals; without them, those of its rest pose are drawn.
    """
    import ssdr

    if sequence.startswith("tube:"):  # of the sweeps over sizes
        return {}
    faces = common.load(sequence)[1]
    surface = None if normals is None else ssdr.Surface(normals=normals)
    model = ssdr.Skinning(*skin, faces=faces, surface=surface, bone_model="affine")
    found = ssdr.metrics.normals(ssdr.MeshSequence(frames, faces), model)
    return {"normals": found.mean, "normals p95": found.p95, "inwards": found.inwards}


def run_ssdr(job: Row, frames: np.ndarray, faces: np.ndarray, pace: Pace) -> Row:
    """`ssdr.decompose`; "fixed" keeps the rest pose at frame 0, "middle" takes that frame, "free"
    lets it be no surface; "similarity" and "affine" are bone models."""
    import ssdr

    _, effort, *more = job["solver"].split()
    options: Row = {key: job[key] for key in ("bones", "influences")}
    options |= {"effort": effort, "rng": job["seed"]}
    for bone_model in {"similarity", "affine"} & set(more):
        options["bone_model"] = bone_model
    middle = len(frames) // 2 if "middle" in more else None
    rest = np.asarray(frames[middle or 0], dtype=np.float64) if "fixed" in more else None
    options["start"] = None if rest is None else ssdr.Start(rest=rest)
    options["rest_frame"] = None if rest is not None else middle
    if "free" in more:
        options |= {"rest_pose": "free", "normals": False}
    times: list[Point] = []
    pace.begin()
    result = ssdr.decompose(frames, faces, callback=marks(pace, times), **options)
    pace.end()
    curve = []
    for record in result.history:
        reached = (t for t in times if t[0] >= record.iteration)
        _, wall, cpu, _ = next(reached, (0, pace.wall, pace.cpu, 0.0))
        curve.append((record.iteration, wall, cpu, 1000 * record.rmse / 3**0.5))
    model = result.skinning
    skin = model.rest, model.indices, model.weights, model.transforms
    return {
        "curve": curve,
        "bones found": model.n_bones,
        "E": e_of(frames, model),
        "stated E": 1000 * result.rmse / 3**0.5,
        "defects": common.defects(model, job["bones"], job["influences"]),
        **stored(frames, *skin, model.bone_model),
        **drawn(frames, job["sequence"], *skin, normals=model.surface and model.surface.normals),
    }


def run_smooth(job: Row, frames: np.ndarray, faces: np.ndarray, pace: Pace) -> Row:
    """Every second frame is fitted, with a smoothness that is a fraction of the diagonal; on the
    others rest pose and weights are kept and only the bones are found."""
    import ssdr

    length = float(job["solver"].split()[1]) * ssdr.MeshSequence(frames, faces).diagonal()
    fitted, others = np.ascontiguousarray(frames[::2]), np.ascontiguousarray(frames[1::2])
    pace.begin()
    model = ssdr.decompose(
        fitted, faces, bones=job["bones"], influences=job["influences"], smoothness=length
    ).skinning
    pace.end()
    weights = dense(model.indices, model.weights, job["bones"])
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    jump = 0.5 * np.abs(weights[edges[:, 0]] - weights[edges[:, 1]]).sum(axis=1).mean()
    return {
        "curve": [],
        "bones found": model.n_bones,
        "jump": float(jump),
        "E": e_of(fitted, model),
        "E kept out": e_of(others, ssdr.fit_bones(others, model).skinning),
    }


def published_file(bones: int) -> Path:
    return common.data_file(f"reference/ea_ref_Decomposition_{bones:02}.npz")


def run_published(job: Row, frames: np.ndarray, faces: np.ndarray, pace: Pace) -> Row:
    """What the authors of Dem Bones published for their own sample."""
    parts = slot.read(published_file(job["bones"]))
    pace.begin()
    found = stored(frames, parts.rest, *sparse(parts.weights), parts.transforms)
    e = skinned_e(frames, *parts[:3])
    return {"curve": [], "bones found": parts.transforms.shape[1], "E": e, **found}


def run_pca(job: Row, frames: np.ndarray, faces: np.ndarray, pace: Pace) -> Row:
    pace.begin()
    return {"curve": [], "pca": pca_curve(frames)}


SOLVERS: dict[str, Callable[..., Row]] = {
    "dembones": run_dem_bones,
    "2012": run_2012,
    "own": run_own,
    "ssdr": run_ssdr,
    "smooth": run_smooth,
    "published": run_published,
    "pca": run_pca,
}


def ready(kind: str) -> Row:
    """Seconds of what is loaded or compiled before the first call."""
    began = time.perf_counter()
    if kind == "dembones":
        import py_dem_bones  # noqa: F401

        return {"import": time.perf_counter() - began}
    if kind in ("ssdr", "2012", "smooth"):
        import ssdr  # noqa: F401

        imported = time.perf_counter()
        common.compile_kernels()
        return {"import": imported - began, "kernels": time.perf_counter() - imported}
    return {}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("job", type=json.loads, help="JSON: solver, sequence, bones, ...")
    job = parser.parse_args().job
    kind = "own" if slot.is_file(job["solver"]) else job["solver"].split()[0]
    waits = ready(kind)
    name, *size = job["sequence"].split(":")  # tube:VERTICES:FRAMES
    frames, faces = tube(*map(int, size)) if size else common.load(name)
    if job["part"] == "seeds":
        order = np.random.default_rng(job["seed"]).permutation(frames.shape[1])
        frames, faces = np.ascontiguousarray(frames[:, order]), np.argsort(order)[faces]
    pace = Pace(job.pop("slice"))
    load = round(os.getloadavg()[0], 2)
    found = SOLVERS[kind](job, frames, faces, pace)
    # the error of a solver that fails may be NaN, which is no JSON
    curve = [point for point in found["curve"] if np.isfinite(point[3])]
    times = {"total wall": round(pace.wall, 4), "total cpu": round(pace.cpu, 4)}
    record = {
        **job,
        "V": frames.shape[1],
        "F": frames.shape[0],
        "waits": waits,
        "peak MiB": round(common.peak_memory()),
        **found,
        # rounded as the curve is, so that its last point is not after the end
        "curve": [[k, round(w, 4), round(c, 4), float(f"{e:.6g}")] for k, w, c, e in curve],
        **times,
        "machine": job["machine"] | {"load": load},
    }
    print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
