"""Odd values in place of every argument: a result of finite numbers, or an error of ssdr's own.

    python benchmarks/robustness/odd_arguments.py  # seconds; exit code 1 where one fails

Every argument of the public functions is replaced in turn by each of some forty values of other
kinds and sizes; so is every number of a state's progress.
"""

from __future__ import annotations

import dataclasses
import inspect
import os
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr

ODD: list[Any] = [
    None, "x", "", b"x", [], {}, (), set(), 1j, True, False, -1, 0, 1, 2.5, 1e308, -1e308,
    float("inf"), float("nan"), 10**30, -(10**30), np.array([]), np.array(1), np.array([1, 2]),
    np.array([[1.0]]), np.zeros((0, 9, 3)), np.zeros((4, 0, 3)), np.full((4, 9, 3), np.nan),
    np.full((4, 9, 3), 1e200), np.zeros((4, 9, 2)), np.array("a"), np.array(None), np.ma.masked,
    np.int8(3), np.uint64(2**63), np.float16(2), np.datetime64("2020"), object(), ..., range(3),
]  # fmt: skip
SOLVING = {"bones": 2, "effort": "fast", "max_iterations": 2}
LEFT_OUT = {("decompose", "checkpoint"), ("save", "path"), ("MeshSequence", "validate")}


def calls() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Name and call of each case."""
    frames = np.random.default_rng(0).normal(size=(4, 9, 3))
    faces = np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8]])
    sequence = ssdr.MeshSequence(frames, faces)
    model = ssdr.initialize(sequence, bones=2)
    parts = {name: getattr(model, name) for name in ("rest", "indices", "weights", "transforms")}
    valid: dict[str, Any] = parts | {
        "sequence": sequence, "reference": frames, "other": frames + 0.1, "vertices": frames[0],
        "faces": faces, "n_vertices": 9, "length": 0.1, "values": frames, "bones": 2,
        "source": frames, "target": frames, "skinning": model, "count": 1, "frames": frames,
    }  # fmt: skip
    functions = {
        name: getattr(module, name)
        for module in (ssdr, ssdr.metrics, ssdr.laplacian)
        for name in module.__all__
        if inspect.isfunction(getattr(module, name))
    }
    del functions["load"], functions["load_skinning"], functions["save"]
    functions |= {"MeshSequence": ssdr.MeshSequence, "Skinning": ssdr.Skinning}
    functions["LaplacianSmoother"] = ssdr.laplacian.LaplacianSmoother
    for name, function in functions.items():
        needed = inspect.signature(function).parameters.values()
        first = {p.name: valid[p.name] for p in needed if p.default is p.empty}
        if name == "MeshSequence":
            first["vertices"] = frames
        if name == "decompose":
            first |= SOLVING
        for parameter in needed:
            for odd in ODD:
                if (name, parameter.name) in LEFT_OUT:
                    continue
                arguments = first | {parameter.name: odd}
                label = f"{name}({parameter.name}={odd!r:.40})"
                yield label, lambda f=function, a=arguments: f(**a)  # type: ignore[misc]
    state = ssdr.decompose(sequence, **SOLVING).state
    for key in state.progress:
        for odd in ODD:
            other = dataclasses.replace(state, progress=state.progress | {key: odd})
            again = SOLVING | {"max_iterations": 4, "resume": other}
            label = f"resume({key}={odd!r:.40})"
            yield label, lambda a=again: ssdr.decompose(sequence, **a)  # type: ignore[misc]


def fault(call: Callable[[], Any]) -> str:
    """What is wrong with what a call did; nothing if nothing is."""
    try:
        result = call()
    except (ssdr.SsdrError, FileNotFoundError):
        return ""
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    error = getattr(result, "rmse", 0.0)
    return "" if not isinstance(error, float) or np.isfinite(error) else f"an error of {error}"


def main() -> int:
    warnings.simplefilter("error")
    warnings.simplefilter("ignore", ssdr.SsdrWarning)
    count: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for label, call in calls():
            found = fault(call)
            ssdr.set_threads(None)
            count["faults" if found else "held"] += 1
            if found:
                print(f"{label}: {' '.join(found.split())[:160]}", flush=True)
        os.chdir("/")
    print(f"{sum(count.values())} cases, {count['faults']} faults")
    return 1 if count["faults"] else 0


if __name__ == "__main__":
    sys.exit(main())
