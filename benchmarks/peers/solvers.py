"""One named solver on one animation, in a process of its own, in slices of time.

Started by bench.py, which writes a line to the standard input for every slice: so solvers take
turns, and what slows the machine down slows all of them.  Only the solver's own work is timed;
loading, compiling, measuring the error and waiting for the turn are not: every solver first does a
small tube, which is not counted.  The last line that is printed is a row (JSON).

Solvers: "ssdr EFFORT [NAME=VALUE ...]" with options of `ssdr.decompose`, where ``rest=0`` keeps
frame 0 as the rest pose; "smooth SHARE", a smoothness in shares of the diagonal; "2012"; "dembones
default" and "dembones 0" (no regularisers); "published"; "pca"; and what slot.py takes.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common, scenes
from benchmarks.common import Row
from benchmarks.peers import dem_bones, rest_mesh, slot
from benchmarks.peers.model_size import dense, pca_curve, skinned_errors, sparse, stored
from benchmarks.record import load_average

Point = tuple[int, float, float, float]  # iteration, wall, CPU seconds, E
ITERATIONS = 100  # of Dem Bones and of SSDR 2012


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
                sys.exit("bench.py has gone")
            self._left = self.slice
        self._from = time.perf_counter(), time.process_time()

    def end(self) -> None:
        wall = time.perf_counter() - self._from[0]
        self.wall += wall
        self.cpu += time.process_time() - self._from[1]
        self._left -= wall


class Unpaced(Pace):
    """Clock of what has no turns."""

    def __init__(self) -> None:
        super().__init__(np.inf)
        self._left = np.inf


def run_dem_bones(job: Row, frames: np.ndarray, faces: np.ndarray, pace: Pace) -> Row:
    """Dem Bones, iteration by iteration; frame 0 is the rest pose.

    The result is the best of its models, each of which is measured.
    """
    rest = np.asarray(frames[0], dtype=np.float64)
    solver = dem_bones.prepared(
        frames, faces, job["bones"], job["influences"],
        regularised=not job["solver"].endswith(" 0"),
    )  # fmt: skip
    count = job.get("iterations", ITERATIONS)
    times: list[tuple[int, float, float]] = []

    def paced() -> Iterator[dem_bones.Found]:
        models = dem_bones.iterates(solver, len(frames), count)
        for k in range(count + 1):
            pace.begin()
            model = next(models)
            pace.end()
            times.append((k, pace.wall, pace.cpu))
            yield model

    errors, best = dem_bones.lowest(frames, rest, paced())
    curve = [(*time, e) for time, e in zip(times, errors, strict=True)]
    if best is None:
        raise SystemExit("no finite model")
    return {"curve": curve, **other(job, frames, faces, slot.Parts(rest, *best))}


def run_own(job: Row, frames: np.ndarray, faces: np.ndarray, pace: Pace) -> Row:
    """A function of one's own, called once."""
    solve = slot.solver_of(job["solver"])
    asked = {"bones": job["bones"], "influences": job["influences"], "bone_model": "rigid"}
    pace.begin()
    parts = solve(frames, faces, **asked, rest=None)
    pace.end()
    found = other(job, frames, faces, parts)
    return {"curve": [(1, pace.wall, pace.cpu, found["E"])], **found}


def run_2012(job: Row, frames: np.ndarray, faces: np.ndarray, pace: Pace) -> Row:
    """`ssdr.ssdr2012`; frame 0 is the rest pose."""
    import ssdr

    points: list[Point] = []
    options = {"bones": job["bones"], "influences": job["influences"], "iterations": ITERATIONS}
    pace.begin()
    fit = ssdr.ssdr2012(frames, faces, rng=0, callback=marks(pace, points), **options)
    pace.end()
    parts = slot.parts_of(fit.skinning, "2012")
    return {"curve": points, **other(job, frames, faces, parts)}


def run_published(job: Row, frames: np.ndarray, faces: np.ndarray, pace: Pace) -> Row:
    """What the authors of Dem Bones published for their own sample, of up to 8 influences."""
    return {"curve": [], **other(job, frames, faces, slot.read(published_file(job["bones"])))}


def published_file(bones: int) -> Path:
    return common.data_file(f"reference/ea_ref_Decomposition_{bones:02}.npz")


def run_ssdr(job: Row, frames: np.ndarray, faces: np.ndarray | None, pace: Pace) -> Row:
    import ssdr

    _, effort, *words = job["solver"].split()
    options: Row = {"effort": effort, "bones": job["bones"], "influences": job["influences"]}
    for word in words:
        name, _, value = word.partition("=")
        with contextlib.suppress(ValueError, SyntaxError):  # else it is text
            value = ast.literal_eval(value)
        options[name] = value
    if (frame := options.pop("rest", None)) is not None:
        options["start"] = ssdr.Kept(rest=np.asarray(frames[frame], dtype=np.float64))
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
    found = {"curve": curve, "stated E": 1000 * result.rmse / 3**0.5}
    if job["influences"] == 8 and job["sequence"] == "dancer":
        cut = {k: model.prune(k) for k in (1, 2, 3, 4, 6, 8)}
        found["E pruned"] = {str(k): common.e_of(frames, one) for k, one in cut.items()}
    return found | measured(job, frames, faces, model, model)


def run_smooth(job: Row, frames: np.ndarray, faces: np.ndarray, pace: Pace) -> Row:
    """Every second frame is fitted, with a smoothness that is a share of the diagonal; on the
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
    again = ssdr.fit_bones(others, model).skinning
    kept_out = {"E kept out": common.e_of(others, again), "jump": float(jump)}
    return {"curve": [], "E": common.e_of(fitted, model), **kept_out}


def run_pca(job: Row, frames: np.ndarray, faces: np.ndarray, pace: Pace) -> Row:
    return {"curve": [], "pca": pca_curve(frames)}


def marks(pace: Pace, points: list[Point]) -> Callable[[Any], None]:
    """Callback that adds a point a step and lets others have their turn."""

    def turn(progress: Any) -> None:
        pace.end()
        points.append((progress.iteration, pace.wall, pace.cpu, 1000 * progress.rmse / 3**0.5))
        pace.begin()

    return turn


def other(job: Row, frames: np.ndarray, faces: np.ndarray, parts: slot.Parts) -> Row:
    """Row of another solver's model, whose rest normals are those of its rest pose."""
    import ssdr

    skin = parts.rest, *sparse(parts.weights), parts.transforms
    drawn = ssdr.Skinning(*skin, faces=faces, bone_model="affine")
    return measured(job, frames, faces, drawn, parts)


def measured(job: Row, frames: np.ndarray, faces: Any, model: Any, asked: Any) -> Row:
    """Errors, bytes and defects; of a surface the normals that an engine draws of a model, too.

    `asked` has the bone model by whose rules defects are found.
    """
    import ssdr

    skin = model.rest, model.indices, model.weights, model.transforms
    e, largest = skinned_errors(
        frames, model.rest, dense(*skin[1:3], model.n_bones), model.transforms
    )
    mesh = ssdr.MeshSequence(frames, faces)
    row: Row = {
        "E": e,
        "rmse / diagonal": 3**0.5 * e / 1000 / mesh.diagonal(),
        "max / diagonal": largest / mesh.diagonal(),
        "bones found": model.n_bones,
        "defects": common.defects(asked, job["bones"], job["influences"]),
        **stored(frames, *skin, asked.bone_model),
    }
    if faces is None or job["sequence"].startswith("tube:"):
        return row
    angles = ssdr.metrics.normals(mesh, model)
    row |= {"normals": angles.mean, "normals p95": angles.p95, "inwards": angles.inwards}
    return row | rest_mesh.measured(model, frames, faces)


SOLVERS: dict[str, Callable[..., Row]] = {
    "dembones": run_dem_bones,
    "2012": run_2012,
    "ssdr": run_ssdr,
    "smooth": run_smooth,
    "published": run_published,
    "pca": run_pca,
}


def warm_up(run: Callable[..., Row], job: Row) -> None:
    """Have a solver import and compile what it needs, on a small tube."""
    small = {"sequence": "tube:64:6", "bones": 3, "influences": 2, "iterations": 1}
    small["solver"] = job["solver"].replace("best", "fast").replace("balanced", "fast")
    with contextlib.suppress(Exception, SystemExit):  # the case itself will say what is wrong
        run(job | small, *scenes.load("tube:64:6"), Unpaced())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("job", type=json.loads, help="JSON: solver, sequence, bones, ...")
    job = parser.parse_args().job
    core, pace = job.pop("core"), Pace(job.pop("slice"))
    if core is not None:
        os.sched_setaffinity(0, {core})
    kind = job["solver"].split()[0]
    run = run_own if slot.is_own(job["solver"]) else SOLVERS[kind]
    if kind not in ("published", "pca"):
        warm_up(run, job)
    frames, faces = scenes.load(job["sequence"])
    pace.begin()  # all wait here until the last has loaded
    pace.end()
    pace.wall = pace.cpu = 0.0
    found = run(job, frames, faces, pace)
    # the error of a solver that fails may be NaN, which is no JSON
    curve = [point for point in found["curve"] if np.isfinite(point[3])]
    row = {
        **job,
        "V": frames.shape[1],
        "F": frames.shape[0],
        "peak MiB": round(common.peak_memory()),
        **found,
        # rounded as the curve is, so that its last point is not after the end
        "curve": [[k, round(w, 4), round(c, 4), float(f"{e:.6g}")] for k, w, c, e in curve],
        "wall": round(pace.wall, 4),
        "cpu": round(pace.cpu, 4),
        "load": load_average(),
    }
    print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
