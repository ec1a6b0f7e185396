"""Named solvers on named sequences in one go, taking turns: error over time, over size, and cost.

    python benchmarks/peers/race.py                 # all of it, hours
    python benchmarks/peers/race.py --short         # ten minutes
    python benchmarks/peers/race.py --parts race --only horse_gallop-20 --threads 1
    python benchmarks/peers/race.py --report        # tables and charts again, no runs

Every solver runs in a process of its own (solvers.py), a slice of time each in turn, so that drift
of the machine hits all alike, and a hang or a crash of one is a line of the table.  Each finished
run is one JSON file under --cache; what is there is not run again, so the work can be done in
pieces.  Parts: "race", error over time; "seeds", best with other seeds and the vertices in
another order; "front", bones × influences × effort; "scaling", cost over frames, vertices and
bones; "choices", rest pose and smoothness.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import selectors
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.common import (
    IMAGES,
    RESULTS,
    ROOT,
    data_folder,
    machine,
    revision,
    tell,
    write_json,
)
from benchmarks.peers.report import file_of, report, restore
from benchmarks.peers.tables import APART, BASE

CASES = [
    ("ea_bone", 10), ("ea_bone", 20), ("horse_gallop", 10), ("horse_gallop", 20),
    ("horse_gallop", 30), ("samba", 20), ("samba", 60), ("cow_elastic", 24),
    ("mannequin_rumba", 30),
]  # fmt: skip
SIDE = [(case.rsplit("-", 1)[0], int(case.rsplit("-", 1)[1])) for case in APART]
PUBLISHED = [("ea_bone", 5), ("ea_bone", 10), ("ea_bone", 20)]
PEERS = ["dembones default", "dembones 0", "2012"]
OURS = ["ssdr fast", "ssdr balanced", "ssdr best", "ssdr balanced fixed", "ssdr best fixed"]
STRETCH = ["ssdr balanced similarity", "ssdr balanced affine"]
FRONT = ["ea_bone", "horse_gallop", "cow_elastic"]
BONES, INFLUENCES, EFFORTS = (5, 10, 20, 40), (1, 2, 4, 8), ("fast", "balanced", "best")
SWEEPS = {"F": (25, 50, 100, 200, 400), "V": (500, 1000, 2000, 4000, 8000), "B": (5, 10, 20, 40)}
SHORT_CASES = [("ea_bone", 10), ("cow_elastic", 24), ("horse_gallop", 20)]
SHORT_SWEEPS = {"F": (25, 50, 100), "V": (500, 1000, 2000), "B": (5, 10, 20)}
SMOOTH = (0.0, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)  # shares of the diagonal
WAIT = 900.0  # seconds without a word after which a solver is taken to hang
TOGETHER = 8  # processes at a time


@dataclasses.dataclass(frozen=True)
class Job:
    part: str
    solver: str
    sequence: str
    bones: int
    influences: int = 4
    threads: int = 1
    seed: int = 0
    iterations: int = 100
    stops: tuple[float, ...] = ()

    @property
    def case(self) -> str:
        return f"{self.sequence}-{self.bones}-{self.influences}"

    @property
    def file(self) -> str:
        return file_of(dataclasses.asdict(self))


def races(args: argparse.Namespace) -> Iterable[Job]:
    cases = SHORT_CASES if args.short else CASES + SIDE
    for name, bones in cases:
        ours = OURS[:2] if args.short else OURS
        if name == "cow_elastic" and not args.short:  # squash and stretch
            ours = [*OURS, *STRETCH, "ssdr best affine"]
        for solver in PEERS + ours:
            for threads in args.threads:
                stops = (0.0, 0.3, 0.7, 1.0) if solver == "ssdr balanced" else ()
                yield Job("race", solver, name, bones, threads=threads, stops=stops)
        yield Job("race", "pca", name, bones)
    for name, bones in PUBLISHED:
        if not args.short or (name, bones) in cases:
            yield Job("race", "published", name, bones)


def front(args: argparse.Namespace) -> Iterable[Job]:
    for name in ["ea_bone"] if args.short else FRONT:
        for bones in BONES:
            for influences in (2, 4) if args.short else INFLUENCES:
                for effort in EFFORTS[: 2 if args.short else None]:
                    # the whole grid costs hours with "best": every other influence there
                    if effort != "best" or influences in (2, 4):
                        yield Job("front", f"ssdr {effort}", name, bones, influences)
            for solver in [] if args.short else STRETCH:
                yield Job("front", solver, name, bones)
        yield Job("front", "pca", name, 0, 0)


def scaling(args: argparse.Namespace) -> Iterable[Job]:
    for sweep, sizes in (SHORT_SWEEPS if args.short else SWEEPS).items():
        for size in sizes:
            at = {**BASE, sweep: size}
            for solver in ("ssdr balanced", "dembones 0"):
                sequence = f"tube:{at['V']}:{at['F']}"
                yield Job("scaling", solver, sequence, at["B"], iterations=3)


def choices(args: argparse.Namespace) -> Iterable[Job]:
    for name, bones in SHORT_CASES[:1] if args.short else SHORT_CASES:
        for share in SMOOTH[:: 2 if args.short else 1]:
            yield Job("choices", f"smooth {share:g}", name, bones)
    for name, bones in [] if args.short else CASES:
        for rest in ("", " middle", " fixed", " fixed middle"):
            yield Job("choices", f"ssdr balanced{rest}", name, bones)


def seeds(args: argparse.Namespace) -> Iterable[Job]:
    """The race's run of seed 0 counts as the first."""
    for name, bones in SHORT_CASES[:1] if args.short else CASES:
        for seed in (1,) if args.short else (1, 2, 3, 4):
            yield Job("seeds", "ssdr best", name, bones, seed=seed)


PARTS = {"race": races, "seeds": seeds, "front": front, "scaling": scaling, "choices": choices}


class Runner:
    """A solver's process and its turn."""

    def __init__(self, job: Job, cache: Path, slice_seconds: float, rates: dict[str, Any]) -> None:
        self.job, self.out = job, cache / job.file
        self.out.parent.mkdir(parents=True, exist_ok=True)
        message = {
            **dataclasses.asdict(job),
            "out": str(self.out),
            "slice": slice_seconds,
            "rates": rates,
        }
        peer = job.solver.startswith("dembones")
        environment = {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "OMP_NUM_THREADS": str(job.threads),
            "SSDR_NUM_THREADS": str(job.threads),
            "OPENBLAS_NUM_THREADS": "1" if peer else str(job.threads),
        }
        self.errors = self.out.with_suffix(".log").open("w+")
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("solvers.py")), json.dumps(message)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            text=True,
            env=environment,
        )
        self.began = time.perf_counter()

    def turn(self, go: bool = True) -> bool:
        """Let it work for a slice; whether there is more to do."""
        try:
            if go:
                self.process.stdin.write("go\n")
                self.process.stdin.flush()
            said = self._hear()
        except BrokenPipeError:
            said = ""
        if said == "ready":
            return True
        if said == "done":
            self.process.wait()
            self.errors.close()
            self.out.with_suffix(".log").unlink()
        else:
            self._failed("hung" if said is None else f"ended with status {self.process.wait()}")
        return False

    def _hear(self) -> str | None:
        with selectors.DefaultSelector() as wait:
            wait.register(self.process.stdout, selectors.EVENT_READ)
            if not wait.select(WAIT):
                return None
        return self.process.stdout.readline().strip()

    def _failed(self, how: str) -> None:
        self.process.kill()
        self.process.wait()
        self.errors.seek(0)
        last = self.errors.read().strip().splitlines()[-1:]
        self.errors.close()
        record = {**dataclasses.asdict(self.job), "failed": how, "said": last, "curve": []}
        write_json(self.out, record)

    def stop(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


def take_turns(jobs: list[Job], args: argparse.Namespace) -> None:
    rates = machine()
    print(f"{jobs[0].part} {jobs[0].case}: {len(jobs)} solvers; {tell(rates)}", flush=True)
    running: list[Runner] = []
    try:
        for job in jobs:  # each gets ready alone: compiling disturbs nobody
            runner = Runner(job, args.cache, args.slice, rates)
            running.append(runner)
            if not runner.turn(go=False):
                running.remove(runner)
                tell_record(runner)
        while running:
            for runner in list(running):
                if not runner.turn():
                    running.remove(runner)
                    tell_record(runner)
    finally:
        for runner in running:
            runner.stop()


def tell_record(runner: Runner) -> None:
    record = json.loads(runner.out.read_text())
    if "failed" in record:
        print(f"  {runner.job.solver:22} {record['failed']}: {record['said']}", flush=True)
        return
    e, found = record.get("E", float("nan")), record.get("bones found", "")
    print(
        f"  {runner.job.solver:22} threads {runner.job.threads}  E {e:9.4f}  bones {found}  "
        f"wall {record.get('total wall', 0):7.2f} s  CPU {record.get('total cpu', 0):7.2f} s  "
        f"{record.get('defects') or ''}",
        flush=True,
    )


def finished(file: Path, job: Job, stale: bool) -> bool:
    if not file.exists():
        return False
    ours = job.solver.startswith(("ssdr", "2012", "smooth"))
    return not (stale and ours) or json.loads(file.read_text()).get("revision") == revision()


def groups(jobs: Iterable[Job], args: argparse.Namespace) -> list[list[Job]]:
    """What is still to do, case by case."""
    found: dict[str, list[Job]] = {}
    for job in dict.fromkeys(jobs):  # sweeps cross
        if args.only and f"{job.sequence}-{job.bones}" not in args.only:
            continue
        if args.solvers and job.solver not in args.solvers:
            continue
        if not args.again and finished(args.cache / job.file, job, args.stale):
            continue
        key = job.case if job.part in ("race", "seeds") else job.sequence.split(":")[0]
        found.setdefault(key, []).append(job)
    return [
        jobs[k : k + TOGETHER] for jobs in found.values() for k in range(0, len(jobs), TOGETHER)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--short", action="store_true", help="less of everything")
    parser.add_argument("--report", action="store_true", help="no runs")
    parser.add_argument(
        "--restore",
        action="store_true",
        help="begin with the records of the tables, where the cache has none",
    )
    parser.add_argument("--only", nargs="+", metavar="SEQUENCE-BONES")
    parser.add_argument("--solvers", nargs="+")
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--slice", type=float, default=2.0, help="seconds of a turn")
    parser.add_argument("--again", action="store_true", help="run what has a record, too")
    parser.add_argument(
        "--stale", action="store_true", help="run again what another revision of ssdr has made"
    )
    parser.add_argument("--limit", type=float, help="start no case after so many seconds")
    parser.add_argument(
        "--clock",
        choices=("wall", "cpu"),
        default="wall",
        help="of the charts; cpu where other work shares the machine",
    )
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "bench")
    parser.add_argument("--results", type=Path, help="where tables go")
    parser.add_argument("--images", type=Path, help="where charts go")
    args = parser.parse_args()
    if args.short:
        args.cache = args.cache.with_name(args.cache.name + "-short")
    results = args.results or (args.cache / "results" if args.short else RESULTS)
    images = args.images or (args.cache / "images" if args.short else IMAGES)
    data_folder()
    if args.restore:
        print(f"{restore(results, args.cache)} records of {results.name}/")
    began = time.perf_counter()
    left: list[str] = []
    if not args.report:
        for part in args.parts:
            for jobs in groups(PARTS[part](args), args):
                if args.limit and time.perf_counter() - began > args.limit:
                    left.append(f"{part} {jobs[0].case}")
                else:
                    take_turns(jobs, args)
    if left:
        print(f"out of time, the same command goes on with {len(left)} more: {', '.join(left)}")
    report(args.cache, results, images, args.clock)


if __name__ == "__main__":
    main()
