"""How long does a user wait for the first result, with nothing compiled and with all cached?

    python benchmarks/speed/first_call.py
    python benchmarks/speed/first_call.py --only call --out out/wheel.json --set python=PYTHON

Each figure is the median of processes from their start to their end, in seconds and in CPU seconds
(of all processes, whatever else the machine does): Python alone, `import ssdr`, the command
`ssdr decompose` with an empty cache of kernels, the same with a filled one.  The second line
measures the ssdr of another Python, such as one where a wheel with machine code is installed.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from benchmarks.common import Row, fresh

REPEATS = 5
COMMAND = """
import contextlib, io, json, tempfile
from ssdr.cli import main
with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()) as said:
    words = f"decompose sample:dancer_small --bones 12 --effort fast --json -o {folder}/a.npz"
    assert main(words.split()) == 0
document = json.loads(said.getvalue())
print(json.dumps({"kernels": document["compile_seconds"], "solve": document["seconds"]}))
"""
CASES = {
    "python alone": "print({})",
    "import ssdr": "import ssdr; print({})",
    "first call, nothing compiled": COMMAND,
    "first call, kernels cached": COMMAND,
}


def measure(what: str, python: str = "") -> Row:
    with tempfile.TemporaryDirectory() as cache:
        runs = []
        for k in range(REPEATS + (what.endswith("cached"))):
            folder = cache if what.endswith("cached") else str(Path(cache, str(k)))
            began, before = time.perf_counter(), os.times()
            other = {"python": python, "PYTHONPATH": ""} if python else {}
            # a user's modules are compiled to bytecode, also where the environment forbids it
            other |= {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(Path(cache, "pyc"))}
            said = fresh(["-P", "-c", CASES[what]], threads=2, NUMBA_CACHE_DIR=folder, **other)
            seconds, after = time.perf_counter() - began, os.times()
            cpu = sum(after[2:4]) - sum(before[2:4])  # user and system, of ended children
            runs.append({"process": seconds, "cpu": cpu, **said})
    return sorted(runs[-REPEATS:], key=lambda run: run["process"])[REPEATS // 2]


if __name__ == "__main__":
    cases = {case: {"what": case} for case in CASES}
    common.run(__file__, __doc__, cases, measure, ["process", "cpu", "kernels", "solve"])
