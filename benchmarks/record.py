"""Records: what was measured, of one revision on one machine.

A record is a JSON file, ``{"revision", "date", "machine", "minutes", "rows": {case: row}}``.  Every
row is written at once, so that a run can be stopped and go on; what was measured of another
revision or on another machine is never mixed in.
"""

from __future__ import annotations

import datetime
import functools
import json
import os
import platform
import re
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import threadpoolctl

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
# what decides about the rows: the package, and all that measures it
MEASURED = ("ssdr", "benchmarks/common.py", "benchmarks/scenes.py", "benchmarks/peers")

Row = dict[str, Any]


class Record:
    """Rows by case, of one revision and one machine.

    Attributes
    ----------
    rows : dict
    revision, date : str
        Commit that last changed what is measured, and the day of the first row.
    machine : dict
        Processor, cores, Python, NumPy, and rates when the record was begun.
    minutes : float
        How long all runs took that added to it.
    """

    def __init__(self, path: Path) -> None:
        content = json.loads(path.read_text("utf-8")) if path.is_file() else {}
        self.path = path
        self.rows: dict[str, Row] = content.get("rows", {})
        self.revision: str = content.get("revision", "")
        self.date: str = content.get("date", "")
        self.machine: Row = content.get("machine", {})
        self.minutes: float = content.get("minutes", 0.0)
        self._lock, self._last = threading.Lock(), time.monotonic()

    @classmethod
    def open(cls, path: Path, *, anew: bool = False) -> Record:
        """Record to add to; ends with a word where its rows are of another revision or machine.

        In the folder of results also where something that is measured is not committed.
        """
        here = revision()
        if here.endswith("+") and RESULTS in path.parents:
            raise SystemExit(
                f"{', '.join(MEASURED)}: some of it is not committed: a record is of a revision"
            )
        record = cls(path)
        if anew or not record.rows:
            record.rows, record.minutes = {}, 0.0
            record.revision, record.machine = here, machine()
            record.date = datetime.date.today().isoformat()
            return record
        present = _identity()
        old = {key: record.machine.get(key) for key in present}
        for what, was, now in (("revision", record.revision, here), ("machine", old, present)):
            if was != now:
                raise SystemExit(
                    f"{path.name} is of {what} {was}, this is {now}, and a record has one {what}: "
                    "--anew (make bench ANEW=1) starts over"
                )
        return record

    def add(self, case: str, row: Row) -> None:
        """Add a row, and write the file, whole or not at all."""
        with self._lock:
            now = time.monotonic()
            self.minutes, self._last = self.minutes + (now - self._last) / 60, now
            self.rows[case] = row
            head = {"revision": self.revision, "date": self.date, "machine": self.machine}
            write_json(self.path, {**head, "minutes": round(self.minutes, 1), "rows": self.rows})


def read_rows(path: Path) -> dict[str, Row]:
    """Rows of a file by case; none where there is no file."""
    return Record(path).rows


def write_rows(path: Path, rows: Mapping[str, Row]) -> None:
    write_json(path, {"rows": rows})


def write_json(path: Path, content: Any) -> None:
    """Write a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(content, indent=1, ensure_ascii=False)
    # lists of numbers, and of pairs of them, on one line each
    flat = r"\[(?:[^\[\]{}]|\[[^\[\]{}]*\])*\]"
    text = re.sub(flat, lambda match: re.sub(r"\s+", " ", match.group()), text)
    part = path.with_suffix(".part")
    part.write_text(text + "\n", encoding="utf-8")
    part.replace(path)


@functools.cache
def revision() -> str:
    """Commit that last changed what is measured, with a plus if it has been changed since."""
    results = f":!{RESULTS.relative_to(ROOT)}"

    def git(*words: str) -> str:
        command = ["git", *words, "--", *MEASURED, results]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        return done.stdout.strip()

    return git("log", "-1", "--format=%h", "--abbrev=8") + "+" * bool(git("status", "-s"))


def quickest(function: Callable[[], object], repeats: int) -> float:
    """Least seconds of several calls, after one that is not counted."""
    function()
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def gemm(threads: int = 1, n: int = 1024, repeats: int = 4) -> float:
    """GFLOP/s of float64 matrix products, in one thread or in several at once."""
    a, b = np.random.default_rng(0).standard_normal((2, n, n))
    alone = threadpoolctl.threadpool_limits(limits=1, user_api="blas")
    with alone, ThreadPoolExecutor(threads) as pool:
        seconds = quickest(lambda: list(pool.map(lambda m: m @ b, [a] * threads)), repeats)
    return round(2e-9 * threads * n**3 / seconds, 1)


def machine() -> Row:
    """This machine and its rates, measured now.

    GFLOP/s of float64 matrix products in one thread and in two at once, GB/s read and written by a
    copy in one thread, and the load.
    """
    source = np.ones(1 << 25)
    target = np.zeros_like(source)
    copy = quickest(lambda: np.copyto(target, source), 4)
    return _identity() | {
        "load": load_average(),
        "gemm_1": gemm(1),
        "gemm_2": gemm(2),
        "memory": round(2e-9 * source.nbytes / copy, 1),
    }


def load_average() -> float:
    """Processes that ran or waited in the last minute, on average."""
    return round(os.getloadavg()[0], 2)


def _identity() -> Row:
    names: Iterable[str] = ()
    if (info := Path("/proc/cpuinfo")).is_file():
        lines = info.read_text().splitlines()
        names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "cpu": next(iter(names), platform.processor() or platform.machine()),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "numpy": np.__version__,
    }


def tell(rates: Row) -> str:
    return (
        f"{rates['cpu']}, {rates['cores']} cores, load {rates['load']}; GEMM float64 "
        f"{rates['gemm_1']} GFLOP/s in one thread, {rates['gemm_2']} in two; "
        f"copy {rates['memory']} GB/s"
    )
