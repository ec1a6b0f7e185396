"""Random small problems for an hour: nothing may hang, crash, lie or leak.

    python benchmarks/robustness/soak.py --hours 1 --out out/soak
    python benchmarks/robustness/soak.py --case 1234  # one problem again, and what is wrong with it
    python benchmarks/robustness/soak.py --leak       # the same problems again and again: memory

Each seed is a problem: shape and motion (degenerate ones among them), precision, bones,
influences, bone model, effort, fixed parts, importance, smoothness, tolerance, limits, threads,
and for some a stop at a random point and a resumption from a file.  Every result is checked by
plain NumPy.  A process does the work and a second one watches it: a case that takes too long
leaves all its stacks behind and is counted as a hang, a crash as a crash, and the next case
follows.  cases.jsonl has a line a case, summary.json the counts and the memory; a run that was
stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import faulthandler
import gc
import itertools
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import defects, reskin, revision, write_json
from benchmarks.robustness.soak_problems import draw

CPU_LIMIT = 240.0  # seconds of one case: many times what the slowest takes
WALL_LIMIT = 3600.0  # for what waits for ever without computing
WARM = 150  # cases after which memory is first measured


# one case


def solve(problem: dict[str, Any], folder: Path) -> tuple[ssdr.Decomposition, list[str]]:
    """The result, and what was wrong on the way."""
    frames, faces, options = problem["frames"], problem["faces"], problem["options"]
    cuts = problem["shots"]
    given: Any = [ssdr.MeshSequence(frames[a:b], faces) for a, b in itertools.pairwise(cuts)]
    wrong = []
    ssdr.set_threads(problem["threads"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", ssdr.SsdrWarning)
        whole = ssdr.decompose(given, **options)
        if not problem["stops"] or "time_limit" in options:
            return whole, wrong
        state: Any = None
        last = whole.state.progress["iteration"]
        for k, share in enumerate(sorted(problem["stops"])):
            at = 1 + int(share * max(last, 1))

            def enough(progress: ssdr.Progress, at: int = at) -> bool:
                return progress.iteration >= at and np.isfinite(progress.rmse)

            part = ssdr.decompose(given, callback=enough, resume=state, **options)
            path = folder / "state.npz"
            part.state.save(path)
            state = path if k else ssdr.SolverState.load(path)
            wrong += [f"stopped: {fault}" for fault in faults(part, problem, ended=False)]
        again = ssdr.decompose(given, resume=state, **options)
        if "tolerance" not in options and _bits(again) != _bits(whole):
            wrong.append("resumed: other bits")
    return whole, wrong


def _bits(result: ssdr.Decomposition) -> list[bytes]:
    s = result.skinning
    return [a.tobytes() for a in (s.rest, s.indices, s.weights, s.transforms)]


def faults(result: ssdr.Decomposition, problem: dict[str, Any], ended: bool = True) -> list[str]:
    """What is wrong with a result, by plain NumPy; its error counts only if the run ended."""
    options, s = problem["options"], result.skinning
    frames = np.array(problem["frames"], dtype=np.float64)
    f, v = frames.shape[:2]
    searched = "tolerance" in options
    bones = s.transforms.shape[1] if searched else options["bones"]
    wrong = defects(s, bones, options["influences"])
    if searched and not 1 <= bones <= options["bones"]:
        wrong.append(f"{bones} bones, at most {options['bones']} were asked for")
    if s.transforms.shape[0] != f or s.rest.shape != (v, 3) or len(s.weights) != v:
        return [*wrong, "wrong shapes"]
    if s.indices.min() < 0 or s.indices.max() >= bones:
        return [*wrong, "joints out of range"]
    difference = reskin(s.rest, s.indices, s.weights, s.transforms) - frames
    squared = (difference**2).sum(axis=-1)
    rmse = float(np.sqrt(squared.mean()))
    # what rounding may do depends on everything that is added up
    size = float(max(np.abs(a).max() for a in (frames, s.rest, s.transforms[..., 3])))
    if not abs(rmse - result.rmse) <= 1e-6 * rmse + 1e-12 * size:
        wrong.append(f"says rmse {result.rmse:.6g}, is {rmse:.6g}")
    errors = [record.rmse for record in result.history]
    # a search tells of models of several sizes; with smoothness the penalty may fall instead
    if "smoothness" not in options and not searched and (np.diff(errors) > 0).any():
        wrong.append("history rises")
    if errors[-1] != result.rmse:
        wrong.append("history does not end at the result")
    if searched:
        found = result.parsimony
        worst = float(np.sqrt(squared.max())) if options["tolerance_of"] == "max" else rmse
        if found is None or (found.held and worst > found.tolerance * (1 + 1e-6) + 1e-12 * size):
            wrong.append("the tolerance is not held")
        return wrong
    if "transforms" in options:
        count = options["transforms"].shape[1]
        locked = np.asarray(options.get("locked_bones", np.arange(count)), dtype=int)
        moved = np.abs(s.transforms[:, locked] - options["transforms"][:, locked])
        if moved.size and moved.max() > 1e-7 * max(size, 1.0):
            wrong.append("locked bones moved")
    elif ended and rmse > 1.001 * (bound := one_motion(frames, options)) + 1e-7 * size:
        wrong.append(f"rmse {rmse:.6g}, one motion for all has {bound:.6g}")
    if "rest" in options and np.abs(s.rest - options["rest"]).max() > 1e-9 * size:
        wrong.append("the given rest pose moved")
    if "weights" in options:
        kept = options.get("locked_vertices", np.ones(v, dtype=bool))
        a, b = np.zeros((2, v, bones))
        np.add.at(a, (np.arange(v)[:, None], s.indices), s.weights)
        np.add.at(b, (np.arange(v)[:, None], options["indices"]), options["weights"])
        if kept.any() and np.abs(a - b)[kept].max() > 1e-9:
            wrong.append("locked weights changed")
    return wrong


def one_motion(frames: np.ndarray, options: dict[str, Any]) -> float:
    """RMSE of the best rigid motion of the whole mesh, which every model contains.

    Where importances or a penalty weigh the two differently, or a limit leaves no time for a
    second step, they are not compared; an affine bone that must not turn inside out may stop at
    a wall that a rigid one never meets.
    """
    weighed = {"vertex_importance", "frame_importance", "smoothness", "time_limit"} & set(options)
    short = options.get("max_iterations", 100) < 10
    if weighed or short or options["bone_model"] == "affine":
        return np.inf
    rest = options.get("rest", frames[options["rest_frame"]])
    p = rest - rest.mean(axis=0)
    total = 0.0
    for frame in frames:
        x = frame - frame.mean(axis=0)
        u, _, vt = np.linalg.svd(p.T @ x)
        u[:, 2] *= np.sign(np.linalg.det(u @ vt))
        total += float(((p @ u @ vt - x) ** 2).sum())
    return float(np.sqrt(total / (len(frames) * len(rest))))


def run_case(seed: int) -> dict[str, Any]:
    problem = draw(seed)
    plain = {
        key: value if isinstance(value, (int, float, str)) else "given"
        for key, value in problem["options"].items()
    }
    line: dict[str, Any] = {
        "seed": seed,
        **problem["kind"],
        "options": plain,
        "stops": len(problem["stops"]),
        "threads": problem["threads"],
    }
    began = time.process_time()
    try:
        with tempfile.TemporaryDirectory() as folder:
            result, wrong = solve(problem, Path(folder))
        wrong += faults(result, problem)
        line |= {"iterations": result.state.progress.get("iteration"), "rmse": result.rmse}
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        wrong = [f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"]
    line |= {"cpu": round(time.process_time() - began, 3), "wrong": wrong}
    return line


# the worker and its watcher


def resident() -> float:
    """MiB of this process in memory, once the allocator has returned what it can."""
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):  # where it is not glibc
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


class Watchdog:
    """Ends this process, its stacks written down, where a case takes too long.

    By CPU time, since a busy machine is no fault; by the clock only what waits for ever.
    """

    def __init__(self, out: Path, cpu: float, wall: float) -> None:
        self.out, self.cpu, self.wall = out, cpu, wall
        self.stacks = (out / "stacks.txt").open("a")
        self.began: float | None = None
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while True:
            time.sleep(2)
            began = self.began
            if began is not None and time.process_time() - began > self.cpu:
                faulthandler.dump_traceback(self.stacks)
                os._exit(1)

    @contextlib.contextmanager
    def over(self, seed: int) -> Iterator[None]:
        (self.out / "running").write_text(str(seed))
        # this one needs no lock of the interpreter, and so sees even what holds it for ever
        faulthandler.dump_traceback_later(self.wall, exit=True, file=self.stacks)
        self.began = time.process_time()
        try:
            yield
        finally:
            self.began = None
            faulthandler.cancel_dump_traceback_later()


def work(out: Path, first: int, seconds: float) -> None:
    """Case after case until the time is over."""
    watchdog = Watchdog(out, CPU_LIMIT, WALL_LIMIT)
    end = time.monotonic() + seconds
    seed = first
    with (out / "cases.jsonl").open("a") as log:
        while time.monotonic() < end:
            with watchdog.over(seed):
                line = run_case(seed)
            if (seed - first) % 25 == 24:
                line |= {
                    "process": os.getpid(),
                    "done": seed - first + 1,
                    "MiB": round(resident(), 1),
                }
            log.write(json.dumps(line) + "\n")
            log.flush()
            seed += 1


def watch_over(out: Path, seconds: float, first: int) -> None:
    """Workers, one after the other, each from the case after the last."""
    out.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    before = (
        json.loads((out / "summary.json").read_text()) if (out / "summary.json").exists() else {}
    )
    while (left := seconds - (time.monotonic() - began)) > 0:
        done = [json.loads(line)["seed"] for line in _lines(out)]
        seed = max(done, default=first - 1) + 1
        child = subprocess.Popen(
            [sys.executable, __file__, "--out", str(out), "--work", str(seed), str(left)]
        )
        try:
            while child.poll() is None:
                time.sleep(min(20, max(1.0, seconds / 50)))
                summarise(out, before, time.monotonic() - began)
        except KeyboardInterrupt:
            child.terminate()
            child.wait()
            break
        if child.returncode == 70:
            raise SystemExit(70)
        if child.returncode:
            seed = int((out / "running").read_text())
            what = "hang" if child.returncode == 1 else f"crash ({child.returncode})"
            with (out / "cases.jsonl").open("a") as log:
                log.write(json.dumps({"seed": seed, "cpu": None, "wrong": [what]}) + "\n")
    summary = summarise(out, before, time.monotonic() - began)
    print(json.dumps({k: v for k, v in summary.items() if k != "counts"}, indent=1))


def leak(cases: int = 12, rounds: int = 25) -> list[float]:
    """MiB after each round of the same cases, so that no new kind of problem adds to it."""
    found = []
    for _ in range(rounds):
        for seed in range(cases):
            run_case(seed)
        found.append(round(resident(), 1))
    return found


def recheck(out: Path) -> int:
    """The failed cases again, after a fix; those that still fail are counted."""
    lines = [json.loads(line) for line in _lines(out)]
    for k, line in enumerate(lines):
        if line["wrong"]:
            kept = {key: line[key] for key in ("process", "done", "MiB") if key in line}
            first = line.get("at first", line["wrong"])
            lines[k] = run_case(line["seed"]) | kept | {"at first": first}
    part = out / "cases.part"
    part.write_text("".join(json.dumps(line) + "\n" for line in lines))
    part.replace(out / "cases.jsonl")
    summary = summarise(out, json.loads((out / "summary.json").read_text()), 0.0)
    return len(summary["failures"])


def _lines(out: Path) -> list[str]:
    path = out / "cases.jsonl"
    return [x for x in path.read_text().splitlines() if x] if path.exists() else []


def summarise(out: Path, before: dict[str, Any], seconds: float) -> dict[str, Any]:
    cases = [json.loads(line) for line in _lines(out)]
    counts: dict[str, Counter[str]] = {}
    for case in cases:
        for key in ("shape", "motion", "threads"):
            counts.setdefault(key, Counter())[str(case.get(key))] += 1
        counts.setdefault("changes", Counter()).update(case.get("changes", []))
        for key, value in case.get("options", {}).items():
            named = key in ("bone_model", "effort", "influences", "tolerance", "tolerance_of")
            if named or value == "given" or key in ("smoothness", "max_iterations", "time_limit"):
                name = f"{key} {value}" if named else key
                counts.setdefault("options", Counter())[name] += 1
        counts.setdefault("resumed", Counter())[str(case.get("stops", 0))] += 1
    measured: dict[int, list[tuple[int, float]]] = {}
    for case in cases:
        if "MiB" in case:
            measured.setdefault(case["process"], []).append((case["done"], case["MiB"]))
    memory = []
    for points in measured.values():
        warm = [m for n, m in points if n >= WARM]
        if len(warm) >= 8:
            quarter = len(warm) // 4
            memory.append(
                {
                    "cases": points[-1][0],
                    "first MiB": points[0][1],
                    "warm MiB": warm[0],
                    "median of the first quarter": float(np.median(warm[:quarter])),
                    "median of the last quarter": float(np.median(warm[-quarter:])),
                    "most MiB": max(warm),
                    "end MiB": warm[-1],
                }
            )
    cpu = [case["cpu"] for case in cases if case["cpu"] is not None]
    summary = {
        "revision": before.get("revision") or revision(),
        "seconds": round(before.get("seconds", 0.0) + seconds, 1), "cases": len(cases),
        "cpu seconds": round(sum(cpu), 1), "slowest case, cpu seconds": max(cpu, default=0.0),
        "iterations": sum(case.get("iterations") or 0 for case in cases),
        "failures": [case for case in cases if case["wrong"]],
        "failed at first": [[c["seed"], *c["at first"]] for c in cases if "at first" in c],
        "hangs": sum("hang" in case["wrong"] for case in cases),
        "crashes": sum(any(w.startswith("crash") for w in case["wrong"]) for case in cases),
        "memory": memory,
        "counts": {key: dict(counter.most_common()) for key, counter in counts.items()},
    }  # fmt: skip
    write_json(out / "summary.part", summary)
    (out / "summary.part").replace(out / "summary.json")
    return summary


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--out", type=Path, default=Path("out/soak"))
    parser.add_argument("--first", type=int, default=0, help="first seed of a new run")
    parser.add_argument("--case", type=int, metavar="SEED", help="one case again")
    parser.add_argument("--recheck", action="store_true", help="failed cases of --out again")
    parser.add_argument("--leak", action="store_true", help="memory over the same cases again")
    parser.add_argument("--work", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.case is not None:
        line = run_case(args.case)
        print(json.dumps(line, indent=1))
        return 1 if line["wrong"] else 0
    if args.work:
        try:
            work(args.out, int(args.work[0]), float(args.work[1]))
        except Exception:
            traceback.print_exc()
            return 70  # a fault of this program, not of the solver
        return 0
    if args.leak:
        print(*leak())
        return 0
    if args.recheck:
        return 1 if recheck(args.out) else 0
    watch_over(args.out, 3600 * args.hours, args.first)
    return 0


if __name__ == "__main__":
    sys.exit(main())
