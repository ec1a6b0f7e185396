"""Input on which methods fail: what this package does with it, and what Dem Bones does.

    python benchmarks/robustness/stability.py
    python benchmarks/robustness/stability.py --only soup "a NaN"

The cases are those of tests/helpers/stability_cases.py.  Dem Bones gets its better setting of
regularisers (as they come, and 0) and the bones of its result are skinned here; each of its runs
is a process of its own, so that a hang and a crash have an outcome too.  Where its binding refuses
an input, the solver behind the binding gets it as well.
"""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from benchmarks.common import Row
from benchmarks.peers import dem_bones
from helpers import motions
from helpers.stability_cases import CASES, GROUPS, Case, Problem, plain, run

ITERATIONS = 30
LIMIT = 30.0  # seconds of a run of Dem Bones; runs that end take about one
PLAIN = next(case for case in CASES if case.name == "column order")  # an undisturbed mesh


def measure(name: str) -> Row:
    case = next(case for case in CASES if case.name == name)
    group = next(group for group in GROUPS if case in group.cases)
    outcome = run(case)
    row = {k: v for k, v in dataclasses.asdict(outcome).items() if k != "case"}
    row |= {"number": group.number, "catches": group.catches, "passed": outcome.passed}
    if case.check is None:
        found = attempts(case)
        right, words = judge(case, found)
        seen = found.get("behind", found)
        row |= {"Dem Bones": words, "right": right, "theirs": seen.get("error")}
        row["bones"] = [seen.get("bones"), seen.get("asked")]
    return row


# --- Dem Bones -----------------------------------------------------------------------------------


def attempts(case: Case, before: bool = False) -> Row:
    """Outcome of the better setting; where the binding refuses, also that without its checks."""

    def better(checked: bool) -> Row:
        ways = [{"setting": s, "checked": checked, "before": before} for s in ("default", "0")]
        return min((attempt(case.name, way) for way in ways), key=rank)

    found = better(True)
    return found | {"behind": better(False)} if "refused" in found else found


def rank(found: Row) -> tuple[bool, bool, float]:
    """Sort key: runs with a result first, then those with all bones, then by error."""
    error = found.get("error")
    return error is None, found.get("bones") != found.get("asked"), error or 0.0


def attempt(name: str, options: Row) -> Row:
    command = [sys.executable, __file__, "--dem-bones", json.dumps({"name": name, **options})]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=LIMIT, check=False, env=environment
        )
    except subprocess.TimeoutExpired:
        return {"hangs": LIMIT}
    if done.returncode:
        name = signal.Signals(-done.returncode).name if done.returncode < 0 else ""
        return {"crashes": name or done.stderr.strip().splitlines()[-1][:200]}
    return dict(json.loads(done.stdout.strip().splitlines()[-1]))


def solved(name: str, setting: str, checked: bool, before: bool) -> Row:
    """Outcome of one run, on the case or on the mesh before the disturbance."""
    case = next(case for case in CASES if case.name == name)
    problem = case.undisturbed() if before and case.undisturbed else case.disturbed()
    assert isinstance(problem, Problem)
    try:
        frames = problem.positions()
        rest = getattr(problem.options.get("start"), "rest", None)
        rest = np.asarray(frames[0] if rest is None else rest, dtype=np.float64)
        faces = problem.frames[0].faces if isinstance(problem.frames, list) else problem.faces
        bones = problem.options.get("bones", 4)
        if rest.ndim != 2 or rest.shape[1] != 3:
            return {"refused": "not points in space"}
        make = dem_bones.prepared if checked else unchecked
        solver = make(frames, faces, bones, 4, rest=rest, regularised=setting == "default")
        solver.nIters = ITERATIONS
    except Exception as error:
        return {"refused": str(error).splitlines()[0]}
    solver.compute()
    weights, m = dem_bones.model_of(solver, len(frames))
    out: Row = {"bones": int(solver.nB), "asked": int(bones)}
    if not (np.isfinite(weights).all() and np.isfinite(m).all()):
        return out | {"not finite": True}
    if weights.shape != (len(rest), solver.nB) or not solver.nB:
        return out | {"error": None}
    indices = np.broadcast_to(np.arange(solver.nB), weights.shape)
    gap = motions.blend(rest, indices, weights, m) - frames
    with np.errstate(over="ignore"):
        error = float(np.sqrt((gap**2).sum(axis=-1).mean())) / problem.size
    out["mirrored"] = bool(np.linalg.det(m[..., :3]).min() < 0)
    return out | {"error": error if np.isfinite(error) else None}


def unchecked(
    frames: np.ndarray, faces: Any, bones: int, influences: int, *, rest: Any, regularised: bool
) -> Any:
    """Solver set as by the binding, without its checks."""
    from py_dem_bones._py_dem_bones import DemBones

    solver = DemBones()
    if not regularised:
        solver.weightsSmooth = solver.transAffine = 0.0
    solver.clear()
    solver.nV, solver.nF, solver.nS = rest.shape[0], frames.shape[0], 1
    solver.nB, solver.nnz = int(bones), int(max(1, min(influences, bones)))
    solver.fStart = np.array([0, frames.shape[0]], dtype=np.int32)
    solver.subjectID = np.zeros(frames.shape[0], dtype=np.int32)
    solver.u = np.ascontiguousarray(rest.T)
    solver.v = np.ascontiguousarray(frames.transpose(0, 2, 1).reshape(-1, rest.shape[0]))
    solver.fv = [] if faces is None else np.asarray(faces).tolist()
    return solver


def judge(case: Case, found: Row) -> tuple[bool, str]:
    """True if Dem Bones is right, and its outcome in words."""
    if "behind" in found:
        if "refused" in found["behind"]:
            return case.refused is not None, "its binding refuses"
        words = judge(case, found["behind"])[1]
        return case.refused is not None, f"its binding refuses; behind it: {words}"
    if "hangs" in found:
        return False, f"hangs (stopped after {found['hangs']:g} s)"
    if "crashes" in found:
        return False, f"crashes ({found['crashes']})"
    if "not finite" in found:
        return False, "NaN"
    if found.get("error") is None:
        return False, "no bones at all" if not found["bones"] else "an error beyond numbers"
    error, before, parts = found["error"], undisturbed(case), []
    if found["bones"] != found["asked"]:
        parts.append(f"{found['bones']} of {found['asked']} bones")
    if found["mirrored"]:
        parts.append("bones turned inside out")
    if case.refused is not None:
        parts.append("accepted")
    elif before is not None and error > case.factor * before + case.slack:
        what = "what the noise leaves" if case.name == "noise" else "its error undisturbed"
        parts.append(f"{error / before:.3g} times {what}")
    elif case.undisturbed is None and not case.only_valid and error > max(case.slack, 1e-4):
        parts.append(f"error {100 * error:.2g} % of the size where 0 is possible")
    return not parts, ", ".join(parts) or "solved"


def undisturbed(case: Case) -> float | None:
    """Dem Bones' error on the mesh before the disturbance, or the known least error."""
    if case.undisturbed is None:
        return None
    known = case.undisturbed()
    if not isinstance(known, Problem):
        return known
    found = attempts(PLAIN if case.undisturbed is plain else case, before=True)
    return found.get("behind", found).get("error")


# --- the chart ----------------------------------------------------------------------------------


def charts(rows: dict[str, Row], images: Path) -> None:
    """Errors of both, case by case; the outcome in words where there is no error."""
    both = {k: r for k, r in rows.items() if r["figure"] is not None and "Dem Bones" in r}
    figure, axes = common.pyplot().subplots(figsize=(8, 0.19 * len(both) + 1.2))
    floor, wall = 1e-10, 30.0
    for y, row in enumerate(both.values()):
        ours = max(row["figure"], floor)
        axes.plot(ours, y, "o", color="tab:blue", ms=4, label="ssdr" if y == 0 else None)
        if row["theirs"] is None:
            word = next((w for w in ("hangs", "crashes") if w in row["Dem Bones"]), "NaN")
            axes.text(wall, y, word, color="tab:red", va="center", fontsize=7)
            continue
        theirs = min(max(row["theirs"], floor), wall)
        found, asked = row["bones"]
        axes.plot([ours, theirs], [y, y], color="0.8", lw=1, zorder=0)
        axes.plot(theirs, y, "x" if found != asked else "s", color="tab:red", ms=4)
        if found != asked:
            words = f"{found} of {asked} bones"
            axes.text(theirs * 1.6, y, words, color="tab:red", va="center", fontsize=6)
    axes.plot([], [], "s", color="tab:red", ms=4, label="Dem Bones")
    axes.plot([], [], "x", color="tab:red", ms=4, label="Dem Bones, fewer bones than asked for")
    axes.set_xscale("log")
    axes.set_xlim(0.5 * floor, 10 * wall)
    axes.set_yticks(range(len(both)), [f"{r['number']}. {k}" for k, r in both.items()], fontsize=7)
    axes.set_ylim(len(both) - 0.3, -0.7)
    axes.set_xlabel("RMSE over the size of the mesh (1e-10: that or less)")
    axes.legend(loc="upper center", bbox_to_anchor=(0.35, 1.07), ncols=3, fontsize=7, frameon=False)
    common.save_figure(figure, images / "stability.png")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--dem-bones"]:
        print(json.dumps(solved(**json.loads(sys.argv[2]))))
    else:
        columns = ("outcome", "figure", "bound", "passed", "Dem Bones", "right")
        cases = {case.name: {"name": case.name} for case in CASES}
        common.run(__file__, __doc__, cases, measure, columns, charts)
