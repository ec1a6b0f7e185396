"""Input on which decompositions fail: what `ssdr` does with it, and what Dem Bones does.

    python benchmarks/robustness/stability.py              # the table and the chart
    python benchmarks/robustness/stability.py --only ssdr  # 68 cases in a minute
    python benchmarks/tools/pages.py                        # puts the table into docs/stability.md

The cases are those that the tests run, tests/helpers/stability_cases.py.  Every case of Dem Bones
is a process of its own with a limit of time, so that a hang or a crash is a line of the table; it
is run with its regularisers at their defaults and at 0, and the better result counts.  Its binding
checks some of its input: where it refuses, the solver behind it is tried as well.  Errors are
measured here, relative to the size of the undisturbed mesh.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.common import IMAGES, RESULTS, machine, pyplot, save_figure, write_csv, write_json
from helpers import motions
from helpers.measures import diagonal
from helpers.stability_cases import CASES, GROUPS, Case, Problem, plain, run

ITERATIONS = 30
SETTINGS = ("default", "0")
PLAIN = "column order"  # a case whose mesh is the undisturbed one


# one case of Dem Bones, in a process of its own


def arguments(problem: Problem) -> tuple[np.ndarray, np.ndarray, Any, int]:
    """Rest pose, frames, faces and bones as Dem Bones takes them."""
    frames = problem.positions()
    rest = np.asarray(problem.options.get("rest", frames[0]), dtype=np.float64)
    faces = problem.faces
    if isinstance(problem.frames, list):
        faces = problem.frames[0].faces
    return rest, frames, faces, problem.options.get("bones", 4)


def unchecked(solver: Any, rest: np.ndarray, frames: np.ndarray, faces: Any, bones: int) -> None:
    """What the binding sets, without its checks."""
    solver.clear()
    solver.nV, solver.nF, solver.nS = rest.shape[0], frames.shape[0], 1
    solver.nB, solver.nnz = int(bones), int(max(1, min(4, bones)))
    solver.nIters = ITERATIONS
    solver.fStart = np.array([0, frames.shape[0]], dtype=np.int32)
    solver.subjectID = np.zeros(frames.shape[0], dtype=np.int32)
    solver.u = np.ascontiguousarray(rest.T)
    solver.v = np.ascontiguousarray(frames.transpose(0, 2, 1).reshape(-1, rest.shape[0]))
    solver.fv = [] if faces is None else np.asarray(faces).tolist()


def dem_bones(name: str, setting: str, checked: bool, before: bool) -> dict[str, Any]:
    """One run, of the case or of the mesh before the disturbance; what it found or said."""
    from py_dem_bones._py_dem_bones import DemBones
    from py_dem_bones.portable import _prepare_solver

    case = next(case for case in CASES if case.name == name)
    problem = case.undisturbed() if before and case.undisturbed else case.disturbed()
    assert isinstance(problem, Problem)
    solver = DemBones()
    if setting == "0":
        solver.weightsSmooth = solver.transAffine = 0.0
    try:
        rest, frames, faces, bones = arguments(problem)
        if rest.ndim != 2 or rest.shape[1] != 3:
            return {"refused": "not points in space"}
        if checked:
            _prepare_solver(
                rest,
                frames,
                bones,
                faces=faces,
                max_influences=4,
                iterations=ITERATIONS,
                solver=solver,
            )
        else:
            unchecked(solver, rest, frames, faces, bones)
    except Exception as error:
        return {"refused": str(error).splitlines()[0]}
    print("ready", flush=True)
    solver.compute()
    weights = np.asarray(solver.get_weights(), dtype=np.float64).T
    m = np.asarray(solver.m, dtype=np.float64).reshape(len(frames), 4, -1, 4)
    m = m.transpose(0, 2, 1, 3)[:, :, :3]
    out: dict[str, Any] = {"bones": int(solver.nB), "asked": int(bones)}
    if not (np.isfinite(weights).all() and np.isfinite(m).all()):
        return out | {"not finite": True}
    if weights.shape != (len(rest), solver.nB) or not solver.nB:
        return out | {"error": None}
    indices = np.broadcast_to(np.arange(solver.nB), weights.shape)
    gap = motions.blend(rest, indices, weights, m) - frames
    with np.errstate(over="ignore"):
        figure = float(np.sqrt((gap**2).sum(axis=-1).mean())) / problem.size
    out["mirrored"] = bool(np.linalg.det(m[..., :3]).min() < 0)
    return out | {"error": figure if np.isfinite(figure) else None}


def attempt(
    name: str, setting: str, checked: bool, limit: float, before: bool = False
) -> dict[str, Any]:
    """One run in a process of its own, so that a hang and a crash have an outcome too."""
    how = [str(int(checked)), str(int(before))]
    command = [sys.executable, __file__, "--dem-bones", name, setting, *how]
    began = time.perf_counter()
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=limit, check=False, env=environment
        )
    except subprocess.TimeoutExpired as late:
        # nothing but the solver takes long: what came before it is over in a second
        return {"hangs": limit, "ready": b"ready" in (late.stdout or b"")}
    seconds = round(time.perf_counter() - began, 2)
    if done.returncode < 0:
        return {"crashes": signal.Signals(-done.returncode).name, "seconds": seconds}
    if done.returncode:
        return {"crashes": done.stderr.strip().splitlines()[-1][:200], "seconds": seconds}
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return found | {"seconds": seconds}


def better(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """The run that counts: one that ended, then one with all its bones, then the least error."""

    def rank(found: dict[str, Any]) -> tuple[bool, bool, float]:
        error = found.get("error")
        wrong = error is None
        return wrong, found.get("bones") != found.get("asked"), np.inf if wrong else error

    return min(runs, key=rank)


def try_dem_bones(case: Case, limit: float, before: bool = False) -> dict[str, Any]:
    found = better([attempt(case.name, setting, True, limit, before) for setting in SETTINGS])
    if "refused" in found:
        behind = better([attempt(case.name, setting, False, limit, before) for setting in SETTINGS])
        found = found | {"behind": behind}
    return found


@functools.cache
def undisturbed(case: Case, limit: float) -> float | None:
    """Dem Bones' error on the mesh before the disturbance, or what is known to be left."""
    if case.undisturbed is None:
        return None
    if case.undisturbed is plain and case.name != PLAIN:
        return undisturbed(next(c for c in CASES if c.name == PLAIN), limit)
    known = case.undisturbed()
    if not isinstance(known, Problem):
        return known
    return figure_of(try_dem_bones(case, limit, before=True))


def figure_of(found: dict[str, Any]) -> float | None:
    return found.get("behind", found).get("error")


def judge(case: Case, found: dict[str, Any], before: float | None) -> tuple[bool, str]:
    """Whether Dem Bones is right, and its outcome in words."""
    if "refused" in found:
        if "refused" in found["behind"]:
            return case.refused is not None, "its binding refuses"
        _, words = judge(case, found["behind"], before)
        return case.refused is not None, f"its binding refuses; behind it: {words}"
    if "hangs" in found:
        return False, f"hangs (stopped after {found['hangs']:g} s)"
    if "crashes" in found:
        return False, f"crashes ({found['crashes']})"
    if "not finite" in found:
        return False, "NaN"
    if found.get("error") is None:
        return False, "no bones at all" if not found["bones"] else "an error beyond numbers"
    error: float = found["error"]
    parts: list[str] = []
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


# all cases


def measure(only: str | None, limit: float, names: list[str] | None) -> list[dict[str, Any]]:
    rows = []
    for group in GROUPS:
        for case in group.cases:
            if names and case.name not in names:
                continue
            row: dict[str, Any] = {
                "number": group.number,
                "group": group.title,
                "case": case.name,
                "catches": group.catches,
            }
            began = time.perf_counter()
            outcome = run(case)
            row |= {k: v for k, v in dataclasses.asdict(outcome).items() if k != "case"}
            row |= {"passed": outcome.passed, "seconds": round(time.perf_counter() - began, 3)}
            if only != "ssdr" and case.check is None:
                found = try_dem_bones(case, limit)
                before = undisturbed(case, limit)
                right, words = judge(case, found, before)
                row |= {
                    "Dem Bones": words,
                    "Dem Bones right": right,
                    "Dem Bones error": figure_of(found),
                    "Dem Bones undisturbed": before,
                    "Dem Bones run": found,
                }
            rows.append(row)
            error = "" if row["figure"] is None else f"{row['figure']:.2e}"
            print(
                f"{group.number:3} {case.name:40} {error:>9}  "
                f"{'' if outcome.passed else 'FAILED '}{outcome.outcome[:60]:60} "
                f"{row.get('Dem Bones', '')}",
                flush=True,
            )
    return rows


def chart(rows: list[dict[str, Any]], path: Path) -> None:
    """Errors of both, case by case; what has no error has its word at the right."""
    plt = pyplot()
    shown = [r for r in rows if r["figure"] is not None and "Dem Bones" in r]
    figure, axes = plt.subplots(figsize=(8, 0.19 * len(shown) + 1.2))
    floor, wall = 1e-10, 30.0
    for y, row in enumerate(shown):
        ours = max(row["figure"], floor)
        axes.plot(ours, y, "o", color="tab:blue", ms=4, label="ssdr" if y == 0 else None)
        theirs = row["Dem Bones error"]
        found = row["Dem Bones run"]
        found = found.get("behind", found)
        if theirs is None:
            word = next((k for k in ("hangs", "crashes") if k in found), "NaN")
            axes.text(wall, y, word, color="tab:red", va="center", fontsize=7)
            continue
        theirs = min(max(theirs, floor), wall)
        axes.plot([ours, theirs], [y, y], color="0.8", lw=1, zorder=0)
        short = found["bones"] != found["asked"]
        axes.plot(theirs, y, "x" if short else "s", color="tab:red", ms=4)
        if short:
            axes.text(
                theirs * 1.6,
                y,
                f"{found['bones']} of {found['asked']} bones",
                color="tab:red",
                va="center",
                fontsize=6,
            )
    axes.plot([], [], "s", color="tab:red", ms=4, label="Dem Bones")
    axes.plot([], [], "x", color="tab:red", ms=4, label="Dem Bones, fewer bones than asked for")
    axes.set_xscale("log")
    axes.set_xlim(0.5 * floor, 10 * wall)
    axes.set_yticks(range(len(shown)), [f"{r['number']}. {r['case']}" for r in shown], fontsize=7)
    axes.set_ylim(len(shown) - 0.3, -0.7)
    axes.set_xlabel("RMSE over the size of the mesh (1e-10: that or less)")
    axes.legend(loc="upper center", bbox_to_anchor=(0.35, 1.07), ncols=3, fontsize=7, frameon=False)
    save_figure(figure, path)


def collapse(path: Path, bones: int = 12, at: int = 12) -> None:
    """The sample as unwelded triangles: a frame, what Dem Bones makes of it, what ssdr does."""
    from PIL import Image, ImageDraw, ImageFont
    from py_dem_bones.portable import solve_skinning

    import ssdr
    from ssdr import render

    welded = ssdr.samples.load("dancer_small")
    soup = np.asarray(welded.vertices, dtype=np.float64)[:, welded.faces.ravel()]
    faces = np.arange(soup.shape[1]).reshape(-1, 3)
    theirs = solve_skinning(soup[0], soup, bones, faces=faces, iterations=ITERATIONS)
    weights = theirs.weights.T
    indices = np.broadcast_to(np.arange(weights.shape[1]), weights.shape)
    bent = motions.blend(soup[0], indices, weights, theirs.transforms[:, :, :3])
    ours = ssdr.decompose(soup, faces, bones=bones)
    size = diagonal(soup)

    def error(frames: np.ndarray) -> str:
        return f"{100 * float(np.sqrt(((frames - soup) ** 2).sum(-1).mean())) / size:.2g} %"

    panels = [
        ("the animation, triangles unwelded", soup),
        (f"Dem Bones: {weights.shape[1]} of {bones} bones, error {error(bent)}", bent),
        (f"ssdr: {bones} bones, error {error(ours.reconstruct())}", ours.reconstruct()),
    ]
    width, height = 340, 430
    sheet = Image.new("RGB", (width * len(panels), height + 30), "white")
    for k, (title, frames) in enumerate(panels):
        shown = ssdr.MeshSequence(frames, faces)
        picture = render.render_frame(shown, at, size=(width, height))
        sheet.paste(picture.convert("RGB"), (width * k, 30))
        ImageDraw.Draw(sheet).text(
            (width * k + 10, 6), title, fill="black", font=ImageFont.load_default(14)
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--only", choices=["ssdr"])
    parser.add_argument("--case", nargs="+", help="names of cases; nothing is written")
    parser.add_argument("--limit", type=float, default=30.0, help="seconds of one Dem Bones run")
    parser.add_argument("--dem-bones", nargs=4, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.dem_bones:
        name, setting, checked, before = args.dem_bones
        resource.setrlimit(resource.RLIMIT_CPU, (120, 120))  # should nobody be left to stop it
        found = dem_bones(name, setting, checked == "1", before == "1")
        print(json.dumps(found), flush=True)
        return 0
    rows = measure(args.only, args.limit, args.case)
    failed = sum(not row["passed"] for row in rows)
    print(f"{len(rows) - failed} of {len(rows)} cases as they should be")
    if args.case:
        return 1 if failed else 0
    if args.only != "ssdr":
        others = [row for row in rows if "Dem Bones right" in row]
        wrong = sum(not row["Dem Bones right"] for row in others)
        print(f"Dem Bones: {len(others) - wrong} of {len(others)}")
        write_json(args.out / "stability.json", {"machine": machine(), "rows": rows})
        write_csv(
            args.out / "stability.csv",
            [{k: r.get(k) for k in rows[0] if k != "Dem Bones run"} for r in rows],
        )
        images = IMAGES if args.out == RESULTS else args.out
        chart(rows, images / "stability.png")
        collapse(images / "collapse.png")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
