"""Named solvers on named sequences, taking turns: error over time, over size, and cost.

    python benchmarks/peers/race.py                 # all of it, hours
    python benchmarks/peers/race.py --short         # ten minutes, into out/bench-short
    python benchmarks/peers/race.py --parts race --only horse_gallop-20 --threads 1
    python benchmarks/peers/race.py --parts race --solvers mine.py   # a solver of one's own
    python benchmarks/peers/race.py --report        # the charts again, no runs

Every solver runs in a process of its own (solvers.py), a slice of time each in turn, so that drift
of the machine hits all alike, and a hang or a crash of one is a line of the table.  Parts, each a
file of results: "race", error over time; "seeds", best with other seeds and the vertices in
another order; "front", bones × influences × effort; "scaling", cost over frames, vertices and
bones; "choices", rest pose and smoothness.  What is missing, a sequence or a package, is named
before the first solver starts.  A file in --solvers runs the cases of "race" (slot.py says what it
holds).
"""

from __future__ import annotations

import argparse
import json
import os
import selectors
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from benchmarks.common import Row
from benchmarks.peers import slot, solvers, tables
from benchmarks.peers.tables import APART, BASE, summaries

CASES = [
    ("ea_bone", 10), ("ea_bone", 20), ("horse_gallop", 10), ("horse_gallop", 20),
    ("horse_gallop", 30), ("samba", 20), ("samba", 60), ("cow_elastic", 24),
    ("mannequin_rumba", 30),
]  # fmt: skip
SIDE = [(case.rsplit("-", 1)[0], int(case.rsplit("-", 1)[1])) for case in APART]
PEERS = ["dembones default", "dembones 0", "2012"]
OURS = ["ssdr fast", "ssdr balanced", "ssdr best", "ssdr balanced free"]
STRETCH = ["ssdr balanced similarity", "ssdr balanced affine"]
SWEEPS = {"F": (25, 50, 100, 200, 400), "V": (500, 1000, 2000, 4000, 8000), "B": (5, 10, 20, 40)}
SHORT_CASES = [("ea_bone", 10), ("cow_elastic", 24), ("horse_gallop", 20)]
SMOOTH = (0.0, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)  # shares of the diagonal
WAIT = 900.0  # seconds without output after which a solver counts as hung
TOGETHER = 8  # processes at a time
SHOWN = ("failed", "said", "E", "bones found", "total wall", "total cpu", "defects")


def job(part: str, solver: str, sequence: str, bones: int, influences: int = 4, **more: Row) -> Row:
    named = {"part": part, "solver": solver, "sequence": sequence, "bones": bones}
    return named | {"influences": influences, "threads": 1, "seed": 0, "iterations": 100} | more


def key_of(job: Row) -> str:
    return (
        f"{job['sequence']}-{job['bones']} K{job['influences']} {job['solver']} "
        f"t{job['threads']} s{job['seed']}"
    )


def races(short: bool, threads: list[int], own: Sequence[str] = ()) -> Iterator[Row]:
    for name, bones in SHORT_CASES if short else CASES + SIDE:
        ours = OURS[:2] if short else OURS
        if name == "cow_elastic" and not short:  # squash and stretch
            ours = [*OURS, *STRETCH, "ssdr best affine"]
        for solver in [*PEERS, *ours, *own]:
            for count in threads:
                yield job("race", solver, name, bones, threads=count)
    for bones in (5, 10, 20):
        yield job("race", "published", "ea_bone", bones)


def front(short: bool, threads: list[int]) -> Iterator[Row]:
    for name in ["ea_bone"] if short else ["ea_bone", "horse_gallop", "cow_elastic"]:
        for bones in (5, 10, 20, 40):
            for influences in (2, 4) if short else (1, 2, 4, 8):
                for effort in common.EFFORTS[: 2 if short else None]:
                    # the whole grid costs hours with "best": every other influence there
                    if effort != "best" or influences in (2, 4):
                        yield job("front", f"ssdr {effort}", name, bones, influences)
            for solver in [] if short else STRETCH:
                yield job("front", solver, name, bones)
        yield job("front", "pca", name, 0, 0)


def scaling(short: bool, threads: list[int]) -> Iterator[Row]:
    for sweep, sizes in SWEEPS.items():
        for size in sizes[: 3 if short else None]:
            at = {**BASE, sweep: size}
            for solver in ("ssdr balanced", "dembones 0"):
                yield job("scaling", solver, f"tube:{at['V']}:{at['F']}", at["B"], iterations=3)


def choices(short: bool, threads: list[int]) -> Iterator[Row]:
    for name, bones in SHORT_CASES[:1] if short else SHORT_CASES:
        for share in SMOOTH[:: 2 if short else 1]:
            yield job("choices", f"smooth {share:g}", name, bones)
    for name, bones in [] if short else CASES:
        for rest in ("", " middle", " fixed", " fixed middle"):
            yield job("choices", f"ssdr balanced{rest}", name, bones)


def seeds(short: bool, threads: list[int]) -> Iterator[Row]:
    """Seeds beside seed 0, which is a run of the race."""
    for name, bones in SHORT_CASES[:1] if short else CASES:
        for seed in (1,) if short else (1, 2, 3, 4):
            yield job("seeds", "ssdr best", name, bones, seed=seed)


def jobs_of(args: argparse.Namespace) -> dict[str, list[Row]]:
    """Jobs that the command line asks for, each once, by part."""
    own = [solver for solver in args.solvers or () if slot.is_file(solver)]
    found = {}
    for part in args.parts:
        jobs = PARTS[part](args.short, args.threads, *([own] if part == "race" else []))
        found[part] = [*{key_of(job): job for job in jobs}.values()]  # two sweeps may share a job
    for option, name_of in (("only", tables.case_of), ("solvers", lambda job: job["solver"])):
        if asked := getattr(args, option):
            known = {name_of(job): None for jobs in found.values() for job in jobs}
            if unknown := set(asked) - set(known):
                raise SystemExit(f"--{option}: {', '.join(unknown)}: there are {', '.join(known)}")
            found = {k: [j for j in jobs if name_of(j) in asked] for k, jobs in found.items()}
    return found


def folders(args: argparse.Namespace) -> tuple[Path, Path, Path]:
    """Folders of the records, of the charts, and of the records that a first run goes on from.

    What a solver of one's own adds lies in `out`, beside a copy of the records that there are.
    """
    own = any(map(slot.is_file, args.solvers or ()))
    results, images = common.RESULTS, common.IMAGES
    if args.short or own:
        results = images = common.ROOT / "out" / ("bench-short" if args.short else "race")
    results = args.results or results
    copied = own and not args.short and not args.results
    return results, args.images or images, common.RESULTS if copied else results


def require(jobs: list[Row]) -> None:
    """End with a word about what the jobs need and is missing, before any of them starts."""
    for solver in {job["solver"] for job in jobs}:
        if solver.startswith("dembones"):
            common.require_package("py_dem_bones", "bench")
        elif slot.is_file(solver):
            slot.solver_of(solver)
    common.require(job["sequence"] for job in jobs if ":" not in job["sequence"])
    for job in jobs:
        if job["solver"] == "published":
            slot.read(solvers.published_file(job["bones"]))
    common.require_package("matplotlib", "bench")  # of the charts at the end


PARTS = {"race": races, "seeds": seeds, "front": front, "scaling": scaling, "choices": choices}


class Runner:
    """Process of a solver, which works in slices of time and ends with a record."""

    def __init__(self, job: Row, slice_seconds: float, rates: Row) -> None:
        self.job, self.record = job, None
        threads = str(job["threads"])
        environment = {
            "PYTHONPATH": str(common.ROOT),
            "OMP_NUM_THREADS": threads,
            "SSDR_NUM_THREADS": threads,
            "OPENBLAS_NUM_THREADS": "1" if job["solver"].startswith("dembones") else threads,
        }
        message = json.dumps({**job, "slice": slice_seconds, "machine": rates})
        self.errors = tempfile.TemporaryFile("w+")  # noqa: SIM115
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("solvers.py")), message],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            text=True,
            env=os.environ | environment,
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
            self.record = json.loads(said)
        else:
            how = "hung" if said is None else f"ended with status {self.process.wait()}"
            self.errors.seek(0)
            last = self.errors.read().strip().splitlines()[-1:]
            self.record = self.job | {"failed": how, "said": last, "curve": []}
        self.stop()
        return False

    def _hear(self) -> str | None:
        with selectors.DefaultSelector() as wait:
            wait.register(self.process.stdout, selectors.EVENT_READ)
            if not wait.select(WAIT):
                return None
        return self.process.stdout.readline().strip()

    def stop(self) -> None:
        if self.process.poll() is None and self.record is None:
            self.process.kill()
        self.process.communicate()  # closes the pipes
        self.errors.close()


def take_turns(jobs: list[Row], slice_seconds: float) -> Iterator[Row]:
    """Run jobs in turns; yields the record of each when it ends."""
    rates = common.machine()
    print(f"{len(jobs)} solvers; {common.tell(rates)}", flush=True)
    running: list[Runner] = []
    try:
        for job in jobs:  # one after the other, so that compiling disturbs no solver
            running.append(Runner(job, slice_seconds, rates))
            if not running[-1].turn(go=False):
                yield running.pop().record
        while running:
            for runner in list(running):
                if not runner.turn():
                    running.remove(runner)
                    yield runner.record
    finally:
        for runner in running:
            runner.stop()


def groups(jobs: list[Row]) -> list[list[Row]]:
    """Jobs grouped by case, at most as many as run together."""
    found: dict[str, list[Row]] = {}
    for job in jobs:
        name = job["sequence"].split(":")[0]
        case = f"{name}-{job['bones']}" if job["part"] in ("race", "seeds") else name
        found.setdefault(case, []).append(job)
    return [
        jobs[k : k + TOGETHER] for jobs in found.values() for k in range(0, len(jobs), TOGETHER)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--short", action="store_true", help="less of everything")
    parser.add_argument("--report", action="store_true", help="the charts, no runs")
    parser.add_argument("--only", nargs="+", metavar="SEQUENCE-BONES")
    parser.add_argument("--solvers", nargs="+", metavar="NAME", help="names, or Python files")
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--slice", type=float, default=2.0, help="seconds of a turn")
    parser.add_argument("--again", action="store_true", help="run what has a record, too")
    parser.add_argument("--limit", type=float, help="start no case after so many seconds")
    parser.add_argument("--results", type=Path, help="folder of the records")
    parser.add_argument("--images", type=Path, help="folder of the charts")
    args = parser.parse_args()
    results, images, known = folders(args)
    began = time.perf_counter()
    todo = {} if args.report else jobs_of(args)
    kept = {
        part: common.read_rows(results / f"{part}.json") or common.read_rows(known / f"{part}.json")
        for part in todo
    }
    for part, jobs in todo.items():
        rows = kept[part]
        todo[part] = [job for job in jobs if args.again or key_of(job) not in rows]
    require([job for jobs in todo.values() for job in jobs])
    for part, missing in todo.items():
        file, rows = results / f"{part}.json", kept[part]
        for jobs in groups(missing):
            if args.limit and time.perf_counter() - began > args.limit:
                print(f"out of time, the same command goes on: {part} {key_of(jobs[0])}")
                break
            for record in take_turns(jobs, args.slice):
                rows[key_of(record)] = record
                common.write_rows(file, rows)
                words = {k: record[k] for k in SHOWN if record.get(k)}
                print(f"  {key_of(record)}: {words}", flush=True)
    from benchmarks.peers.charts import draw  # needs matplotlib, which the runs do not

    draw(results, images)
    columns = ["case", "Dem Bones", "balanced", "best", "balanced ratio", "balanced cpu ratio"]
    print(common.table(summaries(common.read_rows(results / "race.json").values()), columns))


if __name__ == "__main__":
    main()
