"""Everything that README, benchmarks.md and how-to-choose.md state, measured in one run.

    make bench                                          # at most 40 minutes of two idle cores
    make bench ANEW=1                                   # what has been measured is forgotten
    make bench SOLVER=mine.py ONLY="horse_gallop-20 ea_bone-10"      # a solver of one's own
    python benchmarks/bench.py --report                 # charts and pages again, no runs

The rows go to benchmarks/results/bench.json, the record of one revision on one machine; a run that
was stopped goes on.  Cases are grouped; the solvers of a group, each in a process of its own
(peers/solvers.py), take turns on one core, so that drift of the machine hits all alike, and a hang
or a crash of one is a row.  Two groups run at a time, the longest first.  A solver of one's own
(peers/slot.py) races beside its rivals, all of them in one run, into out/bench.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import selectors
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import common, scenes
from benchmarks.common import EFFORTS, RESULTS, ROOT, Record, Row
from benchmarks.peers import slot, solvers
from benchmarks.record import gemm, tell

NINE = [
    ("ea_bone", 10), ("ea_bone", 20), ("horse_gallop", 10), ("horse_gallop", 20),
    ("horse_gallop", 30), ("samba", 20), ("samba", 60), ("cow_elastic", 24),
    ("mannequin_rumba", 30),
]  # fmt: skip
FREE = "ssdr balanced rest_pose=free normals=False"
PEERS = ("dembones default", "dembones 0")
RACERS = (*PEERS, "2012", "ssdr fast", "ssdr balanced", FREE, "ssdr best")
STRETCH = [("cow_elastic", 24), *NINE[2:5], ("ea_bone", 20)]
FLOATS = {"rigid": 7, "similarity": 8, "affine": 12}  # numbers per bone and frame
RESTS = {  # heads of a table, and options
    "free, `normals=False`": " rest_pose=free normals=False",
    "free": " rest_pose=free",
    "surface, `normals=False`": " normals=False",
    "surface, the default": "",
    "fixed at frame 0": " rest=0",
}
RESTED = [("horse_gallop", 20), ("samba", 20), ("cow_elastic", 24), ("mannequin_rumba", 30),
          ("ea_bone", 10), ("dancer", 24)]  # fmt: skip
SEEN = [("flag", 4), ("flag", 8), ("flag", 12), ("skirt", 16), ("sail", 12), ("ea_bone", 20),
        ("mannequin_rumba", 30)]  # fmt: skip
EXACT = [("fox", 24), ("chain", 6)]
SMOOTH = (0.0, 1e-3, 3e-3, 1e-2)  # shares of the diagonal
FRONT = ("ea_bone", "horse_gallop")
GRID = ((5, 10, 20), (1, 2, 4, 8))  # bones, influences
BASE = {"V": 2000, "F": 100, "B": 20}  # each sweep changes one of these
SWEEPS = {"F": (25, 100, 400), "V": (500, 2000, 8000), "B": (5, 20, 40)}
WAIT = 900.0  # seconds without output after which a solver counts as hung
TOGETHER = 8  # processes that take turns
SLICE = 2.0  # seconds of a turn
SHOWN = ("failed", "said", "E", "normals", "cpu", "defects")
# about how long a solver takes, of a case without a record; only the order depends on it
WORTH = {"best": 12.0, "balanced": 1.0, "fast": 0.5, "dembones": 6.0}


def job(solver: str, sequence: str, bones: int, influences: int = 4, **more: int) -> Row:
    named = {"solver": solver, "sequence": sequence, "bones": bones}
    return named | {"influences": influences} | more


def key_of(job: Row) -> str:
    return f"{job['sequence']}-{job['bones']} K{job['influences']} {job['solver']}"


def races(own: Iterable[str] = ()) -> Iterator[list[Row]]:
    for name, bones in NINE:
        yield [job(solver, name, bones) for solver in (*RACERS, *own)]


def tubes() -> list[Row]:
    """Sizes around a base, of ssdr and of three iterations of Dem Bones."""
    sizes = [BASE | {sweep: size} for sweep, sizes in SWEEPS.items() for size in sizes]
    names = dict.fromkeys((f"tube:{at['V']}:{at['F']}", at["B"]) for at in sizes)
    every = (("ssdr balanced", {}), ("dembones 0", {"iterations": 3}))
    return [job(solver, *name, **more) for name in names for solver, more in every]


def choices() -> Iterator[list[Row]]:
    """What the pages show beside the race."""
    for name, bones in EXACT:
        yield [job(f"ssdr {effort}", name, bones) for effort in EFFORTS]
    for name, bones in STRETCH:
        stretch = [(k, n) for k in FLOATS for n in (bones, bones * FLOATS["rigid"] // FLOATS[k])]
        yield [
            job("ssdr balanced" + f" bone_model={k}" * (k != "rigid"), name, n) for k, n in stretch
        ]
    for name in FRONT:
        yield [job("ssdr balanced", name, bones, k) for bones in GRID[0] for k in GRID[1]]
        yield [job("pca", name, 0, 0)]
    yield [job("ssdr balanced", "dancer", bones) for bones in (5, 10, 20, 40, 80)]
    yield [job("ssdr balanced", "dancer", 20, k) for k in (1, 2, 3, 4, 6, 8)]
    for name, bones in RESTED:
        yield [job(f"ssdr balanced{options}", name, bones) for options in RESTS.values()]
    for name, bones in SEEN:
        yield [job(f"ssdr balanced{more}", name, bones) for more in ("", " normals=0.05%")]
    for name, bones in (("ea_bone", 10), ("horse_gallop", 20)):
        yield [job(f"smooth {share:g}", name, bones) for share in SMOOTH]
    yield tubes()
    yield [job("published", "ea_bone", bones, 8) for bones in (5, 10, 20)]


def require(jobs: list[Row]) -> None:
    """End with a word about what the jobs need and is missing, before any of them starts."""
    for solver in {job["solver"] for job in jobs}:
        if slot.is_own(solver):
            slot.solver_of(solver)
        elif solver.startswith("dembones"):
            common.require_package("py_dem_bones", "bench")
    common.require(job["sequence"] for job in jobs if not scenes.is_made(job["sequence"]))
    for job in jobs:
        if job["solver"] == "published":
            slot.read(solvers.published_file(job["bones"]))
    common.require_package("matplotlib", "bench")  # of the charts at the end


class Runner:
    """Process of a solver, which works in slices of time and ends with a row."""

    def __init__(self, job: Row, core: int | None) -> None:
        self.job, self.row = job, None
        counts = ("OMP_NUM_THREADS", "SSDR_NUM_THREADS", "OPENBLAS_NUM_THREADS")
        script = ROOT / "benchmarks" / "peers" / "solvers.py"
        self.errors = tempfile.TemporaryFile("w+")  # noqa: SIM115
        self.process = subprocess.Popen(
            [sys.executable, str(script), json.dumps({**job, "slice": SLICE, "core": core})],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            text=True,
            env=os.environ | {"PYTHONPATH": str(ROOT), **dict.fromkeys(counts, "1")},
        )

    def turn(self, go: bool = True) -> bool:
        """Let the solver work for a slice; True if there is more to do."""
        try:
            if go:
                self.process.stdin.write("go\n")
                self.process.stdin.flush()
            said = self._hear()
        except BrokenPipeError:
            said = ""
        if said == "ready":
            return True
        if said:
            self.row = json.loads(said)
        else:
            how = "hung" if said is None else f"ended with status {self.process.wait()}"
            self.errors.seek(0)
            last = self.errors.read().strip().splitlines()[-1:]
            self.row = self.job | {"failed": how, "said": last, "curve": []}
        self.stop()
        return False

    def _hear(self) -> str | None:
        with selectors.DefaultSelector() as wait:
            wait.register(self.process.stdout, selectors.EVENT_READ)
            if not wait.select(WAIT):
                return None
        return self.process.stdout.readline().strip()

    def stop(self) -> None:
        if self.process.poll() is None and self.row is None:
            self.process.kill()
        self.process.communicate()  # closes the pipes
        self.errors.close()


def take_turns(jobs: list[Row], core: int | None = None) -> Iterator[Row]:
    """Run jobs in turns; yields the row of each when it ends."""
    running: list[Runner] = []
    try:
        for job in jobs:  # one after the other, so that compiling disturbs no solver
            running.append(Runner(job, core))
            if not running[-1].turn(go=False):
                yield running.pop().row
        while running:
            for runner in list(running):
                if not runner.turn():
                    running.remove(runner)
                    yield runner.row
    finally:
        for runner in running:
            runner.stop()


def planned(groups: Iterable[list[Row]], done: dict[str, Row], before: dict[str, Row]) -> list:
    """What is left to do, each job once, the group first that took or may take longest."""
    seen = {key for key, row in done.items() if "failed" not in row}
    left = []
    for jobs in groups:
        new = {key: job for job in jobs if (key := key_of(job)) not in seen}
        seen |= set(new)
        mine = [*new.values()]
        left += [mine[k : k + TOGETHER] for k in range(0, len(mine), TOGETHER)]

    def seconds(job: Row) -> float:
        worth = [w for word, w in WORTH.items() if word in job["solver"]]
        return before.get(key_of(job), {}).get("cpu", job["bones"] * (worth or [0.5])[0] / 3)

    return sorted(left, key=lambda jobs: -sum(map(seconds, jobs)))


def measure(groups: list[list[Row]], record: Record, lanes: int) -> None:
    """Run groups in lanes, each on a core of its own."""
    todo: queue.SimpleQueue[list[Row]] = queue.SimpleQueue()
    for jobs in groups:
        todo.put(jobs)
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    began, wrong = time.monotonic(), []

    def lane(core: int | None) -> None:
        try:
            while not wrong:
                jobs = todo.get_nowait()
                rate = gemm()
                for row in take_turns(jobs, core):
                    record.add(key_of(row), row | {"gemm": rate})
                    words = {k: row[k] for k in SHOWN if row.get(k)}
                    minutes = (time.monotonic() - began) / 60
                    print(f"{minutes:5.1f} min  {key_of(row)}: {words}", flush=True)
        except queue.Empty:
            return
        except BaseException as error:
            wrong.append(error)

    threads = [
        threading.Thread(target=lane, args=[cores[k] if k < len(cores) else None], daemon=True)
        for k in range(lanes)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if wrong:
        raise wrong[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="TEXT", help="cases whose name contains one")
    parser.add_argument("--solver", nargs="+", default=[], metavar="MODULE:FUNCTION")
    parser.add_argument("--anew", action="store_true", help="forget what has been measured")
    parser.add_argument("--report", action="store_true", help="charts and pages, no runs")
    parser.add_argument("--lanes", type=int, default=2, help="groups that run at a time")
    parser.add_argument("--out", type=Path, help="folder of the record and, but for ours, charts")
    args = parser.parse_args()
    out = args.out or (ROOT / "out" / "bench" if args.solver else RESULTS)
    groups = [*races(args.solver), *([] if args.solver else choices())]
    if args.only:
        some = [[j for j in jobs if any(x in key_of(j) for x in args.only)] for jobs in groups]
        groups = [jobs for jobs in some if jobs]
        if not groups:
            names = ", ".join(f"{name}-{bones}" for name, bones in NINE)
            raise SystemExit(f"--only: no case contains {' or '.join(args.only)}: {names}, ...")
    path = out / "bench.json"
    before = {} if args.report else Record(path).rows
    record = Record(path) if args.report else Record.open(path, anew=args.anew)
    todo = [] if args.report else planned(groups, record.rows, before)
    require([job for jobs in todo for job in jobs])
    if todo:
        print(
            f"{sum(map(len, todo))} cases of {record.revision}; {tell(record.machine)}", flush=True
        )
        measure(todo, record, args.lanes)
    from benchmarks.peers.charts import draw  # needs matplotlib, which the runs do not
    from benchmarks.tools import pages

    draw(record.rows, common.IMAGES if out == RESULTS else out, args.solver)
    print(pages.race_table(record.rows, args.solver))
    if out == RESULTS:
        pages.write()


if __name__ == "__main__":
    main()
