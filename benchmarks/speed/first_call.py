"""How long does a user wait for the first result, with nothing compiled and with all cached?

    python benchmarks/speed/first_call.py

Each figure is from a process of its own, from its start to its end: `import ssdr`; the first
`decompose` with an empty cache of kernels; the same with that cache filled.  Then the time that
each kernel takes to compile in one process, from Numba's own events; what a kernel calls is
compiled with the first kernel that needs it.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.common import (
    IMAGES,
    RESULTS,
    ROOT,
    machine,
    pyplot,
    save_figure,
    table,
    tell,
    write_json,
)

IMPORT = "import ssdr"
FIRST = """
import json, time
began = time.perf_counter()
import ssdr
imported = time.perf_counter()
seq = ssdr.samples.load("dancer_small")
result = ssdr.decompose(seq, bones=12, effort="fast")
done = time.perf_counter()
print(json.dumps({
    "import": imported - began, "kernels": result.compile_seconds, "first result": done - began,
    "solve": result.state.progress["elapsed"],
}))
"""
KERNELS = """
import json, time
from numba.core import event

class Listener(event.Listener):
    def __init__(self):
        self.stack, self.found = [], []
    def on_start(self, e):
        self.stack.append((e.data["dispatcher"].__name__, e.data["dispatcher"].__module__,
                           time.perf_counter()))
    def on_end(self, e):
        name, module, began = self.stack.pop()
        self.found.append((module, name, len(self.stack), time.perf_counter() - began))

listener = Listener()
event.register("numba:compile", listener)
import ssdr
from ssdr.solver.warmup import compile_kernels
seconds = compile_kernels()
print(json.dumps({"found": listener.found, "all": seconds}))
"""
SAMPLE = "dancer_small, 12 bones, effort fast"


def run(program: str, cache: str) -> tuple[float, dict[str, Any]]:
    """Wall time of a process that runs the program, and what it printed last."""
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": cache,
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
    }
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    wall = time.perf_counter() - began
    lines = done.stdout.splitlines()
    return wall, json.loads(lines[-1]) if lines else {}


def middle(program: str, cache: str, repeats: int) -> dict[str, float]:
    """The run of median wall time."""
    runs = sorted(
        ({"process": wall, **said} for wall, said in (run(program, cache) for _ in range(repeats))),
        key=lambda r: r["process"],
    )
    return runs[len(runs) // 2]


def kernels(cache: str) -> tuple[list[dict[str, Any]], float]:
    _, said = run(KERNELS, cache)
    rows = []
    for module, name, depth, seconds in said["found"]:
        if depth == 0 and module.startswith("ssdr."):
            rows.append({"kernel": f"{module.removeprefix('ssdr.kernels.')}.{name}", "s": seconds})
    return sorted(rows, key=lambda r: -float(r["s"])), float(said["all"])


def chart(rows: list[dict[str, Any]], path: Path) -> None:
    plt = pyplot()
    figure, axis = plt.subplots(figsize=(7, 3.6))
    axis.barh([r["kernel"] for r in rows], [r["s"] for r in rows], color="#0072b2")
    axis.invert_yaxis()
    axis.set(xlabel="seconds to compile", title="Kernels of the solver")
    save_figure(figure, path)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--out", type=Path, default=RESULTS / "first_call.json")
    parser.add_argument("--chart", type=Path, default=IMAGES / "first_call.png")
    args = parser.parse_args()
    rates = machine()
    with tempfile.TemporaryDirectory() as cache:
        bare = statistics.median(run("pass", cache)[0] for _ in range(args.repeats))
        imports = statistics.median(run(IMPORT, cache)[0] for _ in range(args.repeats))
        cold = []
        for _ in range(args.repeats):
            with tempfile.TemporaryDirectory() as empty:
                cold.append(run(FIRST, empty))
        wall, said = sorted(cold, key=lambda c: c[0])[len(cold) // 2]
        run(FIRST, cache)
        rows = [
            {"what": "python alone", "process": bare},
            {"what": "import ssdr", "process": imports},
            {"what": "first call, nothing compiled", "process": wall, **said},
            {"what": "first call, kernels cached", **middle(FIRST, cache, args.repeats)},
        ]
    with tempfile.TemporaryDirectory() as cache:
        each, total = kernels(cache)
    write_json(
        args.out,
        {
            "question": __doc__.splitlines()[0],
            "sample": SAMPLE,
            "waits": rows,
            "kernels": each,
            "all kernels": total,
            **rates,
        },
    )
    chart(each, args.chart)
    print(f"seconds; {SAMPLE}\n")
    print(table(rows, ("what", "process", "import", "kernels", "solve", "first result")))
    print(f"\n{len(each)} kernels, {total:.1f} s with the toy run that they are compiled for\n")
    print(table(each, ("kernel", "s")))
    print(tell(rates))


if __name__ == "__main__":
    main()
