"""Stability suite: solve a case and check its result by code of the tests alone."""

from __future__ import annotations

import dataclasses
import functools
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import ssdr
from helpers.measures import bits_on_threads, broken, rmse_of

SEEDS = 3


@dataclasses.dataclass(frozen=True)
class Problem:
    """Arguments of one call of ``decompose``, and the length that its error is divided by."""

    frames: Any
    size: float
    faces: Any = None
    options: dict[str, Any] = dataclasses.field(default_factory=dict)

    def positions(self) -> np.ndarray:
        """All frames (F, V, 3) in float64."""
        parts = self.frames if isinstance(self.frames, list) else [self.frames]
        arrays = [getattr(part, "vertices", part) for part in parts]
        return np.concatenate([np.asarray(array, dtype=np.float64) for array in arrays])

    def solve(self, seeds: int = 1) -> ssdr.Decomposition:
        """Result of lowest error among this many seeds."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ssdr.SsdrWarning)  # fewer bones would often do
            results = [
                ssdr.decompose(self.frames, self.faces, rng=seed, **({"bones": 4} | self.options))
                for seed in range(seeds)
            ]
        return min(results, key=lambda result: result.rmse)


@dataclasses.dataclass(frozen=True)
class Case:
    """A disturbed problem and what is expected of it.

    `refused` names the argument of the expected error. Otherwise the relative error must be at
    most `factor` times that of `undisturbed`, plus `slack` for the precision of the storage.
    `undisturbed` is a problem, a known error, or None where exact data leave no error. Where two
    problems are compared, each counts by the best of three seeds, since rounding alone can lead a
    single run to another local minimum. `check` tests anything but the error and returns what is
    wrong.
    """

    name: str
    disturbed: Callable[[], Problem]
    undisturbed: Callable[[], Problem | float] | None = None
    refused: str | None = None
    factor: float = 1.1
    slack: float = 1e-9
    only_valid: bool = False
    check: Callable[[Problem], str] | None = None


@dataclasses.dataclass(frozen=True)
class Group:
    """Cases of one kind; `catches` is the mistake that they detect."""

    number: int
    title: str
    catches: str
    cases: list[Case]


MEMORY = """
import sys
from helpers.stability import memory_used
from helpers.stability_cases import large
import ssdr
ssdr.decompose([[[0.0, 0, 0]] * 3] * 3, bones=1)
vertices, frames = int(sys.argv[1]), int(sys.argv[2])
problem = large(vertices, frames)
before = memory_used("VmRSS")
found = ssdr.decompose(problem.frames, **problem.options)
assert found.rmse < 0.05 * problem.size, found.rmse
print((memory_used("VmHWM") - before) / (24 * vertices * frames), memory_used("VmHWM") - before)
"""
MOST_MEMORY = 6.0  # times the positions in float64


def memory_used(what: str) -> float:
    """Bytes of this process, now (VmRSS) or at most (VmHWM)."""
    with open("/proc/self/status") as file:
        line = next(line for line in file if line.startswith(what))
    return 1024 * float(line.split()[1])


def memory(problem: Problem) -> str:
    """Check peak memory in a new process, since a process cannot reset its peak."""
    n_frames, n = np.asarray(problem.frames).shape[:2]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", MEMORY, str(n), str(n_frames)],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p or "." for p in sys.path)},
    )
    if done.returncode:
        return done.stderr.strip().splitlines()[-1]
    times, used = (float(x) for x in done.stdout.split())
    fits = times < MOST_MEMORY or used < 2**28
    return "" if fits else f"{times:.1f} times the positions in float64"


def same_bits(problem: Problem) -> str:
    return "" if len(bits_on_threads(problem.solve)) == 1 else "other bits"


def taken_up(problem: Problem) -> str:
    """Stop a run half way, start another from its checkpoint, and compare the errors."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.npz"
        stop = {"callback": lambda p: p.fraction >= 0.5, "checkpoint": path}
        part = dataclasses.replace(problem, options=problem.options | stop).solve()
        if part.stop_reason != "cancelled":
            return f"did not stop: {part.stop_reason}"
        start = {"start": ssdr.load_skinning(path)}
        again = dataclasses.replace(problem, options=problem.options | start).solve()
    # by one function, since sums in another order round differently
    before, after = (rmse_of(s, problem.positions()) for s in (start["start"], again.skinning))
    return "" if after <= before else "a higher error"


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Outcome of a case; `bound` is the largest relative error that passes."""

    case: str
    outcome: str
    figure: float | None = None
    undisturbed: float | None = None
    bound: float | None = None

    @property
    def passed(self) -> bool:
        if self.outcome != "solved":
            return self.outcome.startswith("refused: ")
        return self.bound is None or bool(self.figure is not None and self.figure <= self.bound)


@functools.cache
def _figure(make: Callable[[], Problem | float]) -> float:
    problem = make()
    if isinstance(problem, float):
        return problem
    return problem.solve(SEEDS).rmse / problem.size


def run(case: Case) -> Outcome:
    """Solve a case and check the returned model independently."""
    problem = case.disturbed()
    if case.check is not None:
        fault = case.check(problem)
        return Outcome(case.name, f"FAILED: {fault}" if fault else "solved")
    try:
        result = problem.solve(1 if case.undisturbed is None else SEEDS)
    except ssdr.InputError as error:
        if error.argument != case.refused:
            return Outcome(case.name, f"WRONG ERROR: {error}")
        return Outcome(case.name, f"refused: {error}")
    if case.refused is not None:
        return Outcome(case.name, "NOT REFUSED")
    frames = problem.positions()
    falls = not problem.options.get("smoothness")
    if fault := broken(result, frames, problem.options.get("bones", 4), falls=falls):
        return Outcome(case.name, f"INVALID: {fault}")
    figure = rmse_of(result.skinning, frames) / problem.size
    before = 0.0 if case.undisturbed is None else _figure(case.undisturbed)
    bound = None if case.only_valid else float(case.factor * before + case.slack)
    return Outcome(case.name, "solved", figure, before, bound)
