"""Does a part of the solver pay?  The error and the CPU time with the part changed or left out.

    python benchmarks/accuracy/ablation.py --data DIR
    python benchmarks/accuracy/ablation.py --data DIR --variants "no race" --problems fox-24
    python benchmarks/accuracy/ablation.py --report                      # the table again, no runs

Every problem is solved with the same seeds by the code as it is ("as is") and by each variant,
one after the other, on one thread.  A finished run is one line of --runs at once; what is there
is not run again, so the work can be stopped and done in pieces.  The variants are all in
VARIANTS: each replaces a few names of the modules that search, for the time of one run.
"""

from __future__ import annotations

import os

os.environ.setdefault("SSDR_NUM_THREADS", "1")

import argparse
import contextlib
import dataclasses
import json
import math
import statistics
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import (
    RESULTS,
    data_folder,
    e_of,
    machine,
    revision,
    table,
    tell,
    write_json,
)
from helpers.motions import chain, cloth, wings, wobble
from ssdr.drivers import schedule
from ssdr.search import stages
from ssdr.solver.warmup import compile_kernels


@dataclasses.dataclass(frozen=True)
class Problem:
    """A sequence, the size of the model, and steps in which vertices and frames are taken."""

    sequence: str
    bones: int
    influences: int = 4
    every: int = 1
    stride: int = 1

    def frames(self) -> np.ndarray:
        if self.sequence in MADE:
            return MADE[self.sequence]()[:: self.stride, :: self.every]
        if self.sequence in ssdr.samples.names():
            file = ssdr.samples.path(self.sequence)
        else:
            file = data_folder() / f"{self.sequence}.npz"
        with np.load(file, allow_pickle=False) as archive:
            return np.asarray(archive["vertices"][:: self.stride, :: self.every], dtype=np.float64)


MADE: dict[str, Callable[[], np.ndarray]] = {
    "cloth": lambda: cloth()[0],
    "wings": lambda: wings()[0],
    "tube": lambda: wobble(chain(bones=8, frames=40, rows=40, ring=10)),
}
# Vertices and frames are left out so that a run takes some ten seconds of CPU time: seeds differ
# by several per cent, so that many pairs tell more than few long ones.
SMALL = {
    "ea_bone-6, V/3, F/8": Problem("ea_bone", 6, every=3, stride=8),
    "fox-8, F/4": Problem("fox", 8, stride=4),
    "wings-8": Problem("wings", 8),
    "horse_gallop-6, V/32, F/2": Problem("horse_gallop", 6, every=32, stride=2),
    "dancer_small-6, V/2": Problem("dancer_small", 6, every=2),
    "cow_elastic-8, V/16, F/8": Problem("cow_elastic", 8, every=16, stride=8),
    "cloth-6": Problem("cloth", 6),
}
LARGE = {
    "cloth-10": Problem("cloth", 10),
    "tube-8": Problem("tube", 8),
    "dancer_small-8, V/2": Problem("dancer_small", 8, every=2),
    "horse_gallop-10, V/16": Problem("horse_gallop", 10, every=16),
    "ea_bone-10, V/3": Problem("ea_bone", 10, every=3),
    "dancer_small-12": Problem("dancer_small", 12),
    "ea_bone-5, K = 8": Problem("ea_bone", 5, influences=8),
    "ea_bone-10": Problem("ea_bone", 10),
    "fox-24": Problem("fox", 24),
    "horse_gallop-10, V/4": Problem("horse_gallop", 10, every=4),
    "horse_gallop-20, V/4": Problem("horse_gallop", 20, every=4),
    "cow_elastic-24, V/4": Problem("cow_elastic", 24, every=4),
    "ea_bone-20": Problem("ea_bone", 20),
}
PROBLEMS = SMALL | LARGE

# -- the variants: all that knows the solver's insides ------------------------------------------

_CHANGES = stages.Search.kinds
_behind, _best = stages.Search._behind, schedule.best


def _plain_turns(run: Any) -> int:
    return int(run.memory.count % len(stages.Search.kinds))


def _without(name: str) -> AbstractContextManager[Any]:
    """The search without one of its changes; what a race takes for a round stays four tries."""

    def behind(search: Any, run: Any) -> bool:
        with mock.patch.object(stages.Search, "kinds", _CHANGES):
            return _behind(search, run)

    stack = contextlib.ExitStack()
    fewer = tuple(c for c in _CHANGES if c.__name__ != name)
    stack.enter_context(mock.patch.object(stages.Search, "kinds", fewer))
    stack.enter_context(mock.patch.object(stages.Search, "_behind", behind))
    return stack


def _one_generator(*arguments: Any, **options: Any) -> tuple[Any, ...]:
    return tuple(dataclasses.replace(stage, branch=False) for stage in _best(*arguments, **options))


def _no_race() -> AbstractContextManager[Any]:
    return mock.patch.object(schedule, "_RACE", (0.0, 0.0))


def _plain() -> AbstractContextManager[Any]:
    return mock.patch.object(stages.Search, "next_change", staticmethod(_plain_turns))


def _one_stream() -> AbstractContextManager[Any]:
    return mock.patch.object(schedule, "best", _one_generator)


@dataclasses.dataclass(frozen=True)
class Variant:
    """What is patched, and the variant of the same effort that it is compared with."""

    patch: Callable[[], AbstractContextManager[Any]]
    against: str = "as is"


VARIANTS = {
    "as is": Variant(contextlib.nullcontext),
    "plain turns": Variant(_plain),
    "no loosen": Variant(lambda: _without("loosen")),
    "no thin": Variant(lambda: _without("thin")),
    "no kick": Variant(lambda: _without("kick")),
    "no grow_and_shed": Variant(lambda: _without("grow_and_shed")),
    "no race": Variant(_no_race),
    "one generator": Variant(_one_stream),
}
DEFAULT = [
    "as is",
    "plain turns",
    "no loosen",
    "no thin",
    "no race",
    "one generator",
]

# -----------------------------------------------------------------------------------------------


def solve(problem: Problem, frames: np.ndarray, variant: Variant, seed: int) -> dict[str, Any]:
    """E, CPU seconds, and the error over CPU seconds of one run."""
    trace: list[tuple[float, float]] = []
    began = time.process_time()

    def note(progress: ssdr.Progress) -> None:
        if not math.isfinite(progress.rmse):
            return
        if not trace or progress.rmse < trace[-1][1]:
            trace.append((time.process_time() - began, progress.rmse))

    with variant.patch():
        result = ssdr.decompose(
            frames,
            bones=problem.bones,
            influences=problem.influences,
            effort="best",
            rng=seed,
            callback=note,
        )
    seconds = time.process_time() - began
    e = e_of(frames, result.skinning)
    # the trace is of the reduced space: in units of the E that it ended with
    scale = e / trace[-1][1]
    curve = [(round(t, 3), float(f"{scale * value:.6g}")) for t, value in trace]
    iterations = result.state.progress["iteration"]
    return {"E": e, "cpu": seconds, "curve": curve, "iterations": iterations}


def at(curve: list[list[float]], seconds: float) -> float:
    """The lowest error by then."""
    before = [value for t, value in curve if t <= seconds]
    return before[-1] if before else math.nan


def compare(runs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each variant against what it is compared with, pair by pair of problem and seed."""
    found = {(r["variant"], r["problem"], r["seed"]): r for r in runs}
    rows = []
    for name, variant in VARIANTS.items():
        pairs = [
            (found[variant.against, problem, seed], r)
            for (its, problem, seed), r in found.items()
            if its == name != variant.against and (variant.against, problem, seed) in found
        ]
        if not pairs:
            continue
        e = [r["E"] / base["E"] for base, r in pairs]
        equal = []
        for base, r in pairs:
            end = min(base["cpu"], r["cpu"])
            equal.append(at(r["curve"], end) / at(base["curve"], end))
        by_problem: dict[str, list[float]] = {}
        for (_, r), ratio in zip(pairs, e, strict=True):
            by_problem.setdefault(r["problem"], []).append(math.log(ratio))
        means = [statistics.fmean(logs) for logs in by_problem.values()]
        logs = [math.log(ratio) for ratio in e]
        rows.append(
            {
                "variant": name,
                "pairs": len(pairs),
                "E, median": statistics.median(e),
                "E, mean": math.exp(statistics.fmean(logs)),
                "standard error": statistics.stdev(logs) / math.sqrt(len(logs))
                if logs[1:]
                else None,
                "lower": sum(ratio < 1 - 1e-9 for ratio in e),
                "higher": sum(ratio > 1 + 1e-9 for ratio in e),
                "worst": max(e),
                "best": min(e),
                "worst problem": math.exp(max(means)),
                "CPU, median": statistics.median(r["cpu"] / base["cpu"] for base, r in pairs),
                "CPU, all": sum(r["cpu"] for _, r in pairs) / sum(base["cpu"] for base, _ in pairs),
                "E at equal CPU, median": statistics.median(equal),
                "E at equal CPU, mean": math.exp(statistics.fmean(math.log(x) for x in equal)),
            }
        )
    return rows


def problems_table(runs: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[str]]:
    """Mean E over the seeds that all variants have, a line a problem."""
    names = [name for name in VARIANTS if any(r["variant"] == name for r in runs)]
    rows = []
    for problem in PROBLEMS:
        row: dict[str, Any] = {"problem": problem}
        for name in names:
            of = [r for r in runs if r["problem"] == problem and r["variant"] == name]
            if of:
                mean = statistics.fmean(r["E"] for r in of)
                seconds = statistics.fmean(r["cpu"] for r in of)
                row[name] = f"{mean:.4g} ({seconds:.0f} s, {len(of)})"
        if len(row) > 1:
            rows.append(row)
    return rows, names


def read(path: Path) -> list[dict[str, Any]]:
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of the sequences")
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=DEFAULT)
    parser.add_argument("--problems", nargs="+", choices=list(PROBLEMS), default=list(SMALL))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--runs", type=Path, default=RESULTS / "ablation.jsonl")
    parser.add_argument("--out", type=Path, default=RESULTS / "ablation.json")
    parser.add_argument("--report", action="store_true", help="no runs")
    args = parser.parse_args()
    if args.data is not None:
        os.environ["SSDR_TEST_DATA"] = str(args.data)
    if not args.report:
        rates = machine()
        compile_kernels()
        args.runs.parent.mkdir(parents=True, exist_ok=True)
        done = {(r["variant"], r["problem"], r["seed"]) for r in read(args.runs)}
        for seed in args.seeds:
            for name in args.problems:
                problem = PROBLEMS[name]
                frames = problem.frames()
                for variant in args.variants:
                    if (variant, name, seed) in done:
                        continue
                    row = {
                        "variant": variant,
                        "problem": name,
                        "seed": seed,
                        **solve(problem, frames, VARIANTS[variant], seed),
                        "load": round(os.getloadavg()[0], 2),
                        "revision": revision(),
                        "machine": tell(rates),
                    }
                    with args.runs.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(row) + "\n")
                    print(
                        f"{name}, seed {seed}, {variant}: E {row['E']:.5g}, {row['cpu']:.1f} s",
                        flush=True,
                    )
    runs = read(args.runs)
    rows = compare(runs)
    each, names = problems_table(runs)
    write_json(
        args.out,
        {
            "question": __doc__.splitlines()[0],
            "variants": rows,
            "problems": each,
            "runs": [{k: v for k, v in r.items() if k != "curve"} for r in runs],
        },
    )
    if rows:
        print(table(rows, list(rows[0])))
        print()
        print(table(each, ["problem", *names]))


if __name__ == "__main__":
    main()
