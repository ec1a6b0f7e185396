"""Rows of the tables, points of the charts and figures of sentences, computed from bench.json."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from benchmarks import bench
from benchmarks.common import Row

WITHIN = 1.01  # times of Dem Bones and ssdr are those until this times Dem Bones' best error
CPU = 2  # in a point of a curve: iteration, wall, CPU seconds, E
# of the race: names in the tables, and solvers
SHORT = {"le_deng": "2012", "fast": "ssdr fast", "balanced": "ssdr balanced", "free": bench.FREE,
         "best": "ssdr best"}  # fmt: skip
Rows = Mapping[str, Row]


def find(rows: Rows, solver: str, sequence: str, bones: int, influences: int = 4) -> Row | None:
    """Row of a job, if it has been measured and has an error."""
    row = rows.get(bench.key_of(bench.job(solver, sequence, bones, influences)))
    return row if row is not None and row.get("E") is not None else None


def soonest(rows: Iterable[Row], level: float) -> float | None:
    """CPU seconds of the solver's own work until the error was first at or below a level."""
    return min((p[CPU] for r in rows for p in r["curve"] if p[3] <= level), default=None)


def race_rows(rows: Rows, own: Iterable[str] = ()) -> list[Row]:
    """A row for each case of the race: its solvers, and ratios to Dem Bones at its best."""
    found = []
    for sequence, bones in bench.NINE:
        solvers = SHORT | {name: name for name in own}
        mine = {n: r for n, s in solvers.items() if (r := find(rows, s, sequence, bones))}
        peers = [r for s in bench.PEERS if (r := find(rows, s, sequence, bones))]
        row: Row = {"sequence": sequence, "bones": bones, **mine}
        if peers:
            peer = row["peer"] = min(peers, key=lambda r: r["E"])
            row["ratio"] = {name: r["E"] / peer["E"] for name, r in mine.items()}
            level = WITHIN * peer["E"]
            row["peer seconds"] = soonest(peers, level)
            row["seconds"] = {n: soonest([r], level) for n, r in mine.items()}
            if ours := row["seconds"].get("balanced"):
                row["sooner"] = row["peer seconds"] / ours
        if mine or peers:
            found.append(row)
    return found


def rest_rows(rows: Rows) -> list[Row]:
    """Each sequence with each kind of rest pose."""
    return [
        {"sequence": sequence, "bones": bones}
        | {
            head: row
            for head, options in bench.RESTS.items()
            if (row := find(rows, f"ssdr balanced{options}", sequence, bones))
        }
        for sequence, bones in bench.RESTED
    ]


def kind_rows(rows: Rows) -> list[Row]:
    """E of each kind of bones, with equal numbers of bones and with equal bytes."""
    found = []
    for sequence, bones in bench.STRETCH:
        row: Row = {"sequence": sequence, "bones": bones}
        for kind, floats in bench.FLOATS.items():
            solver = "ssdr balanced" + f" bone_model={kind}" * (kind != "rigid")
            row[kind] = find(rows, solver, sequence, bones)
            few = bones * bench.FLOATS["rigid"] // floats
            row[f"{kind}, equal bytes"] = find(rows, solver, sequence, few)
        found.append(row)
    return found


def dancer_rows(rows: Rows, word: str) -> list[Row]:
    """The dancer over bones or over influences; `pruned` is the model of eight influences."""
    found = [
        r for r in rows.values()
        if r["sequence"] == "dancer" and r["solver"] == "ssdr balanced" and r.get("E") is not None
        and (r["influences"] == 4 if word == "bones" else r["bones"] == 20) and r["bones"] != 24
    ]  # fmt: skip
    pruned = next((r["E pruned"] for r in found if "E pruned" in r), {})
    return [
        r | {"mm": 3**0.5 * r["E"]} | ({"pruned": 3**0.5 * e} if (e := pruned.get(str(k))) else {})
        for r in sorted(found, key=lambda r: r[word])
        for k in [r["influences"]]
    ]


def recovery_rows(rows: Rows) -> list[Row]:
    every = ((name, effort) for name in bench.EXACT for effort in bench.EFFORTS)
    found = ((effort, find(rows, f"ssdr {effort}", *name)) for name, effort in every)
    return [row | {"effort": effort} for effort, row in found if row]


def seen_rows(rows: Rows) -> list[Row]:
    """Each sheet and sequence with normals counted always, and beyond a length."""
    options = {"always": "", "length": " normals=0.05%"}
    return [
        {"sequence": sequence, "bones": bones}
        | {k: find(rows, f"ssdr balanced{more}", sequence, bones) for k, more in options.items()}
        for sequence, bones in bench.SEEN
    ]


def sweeps(rows: Rows) -> list[Row]:
    """Sweeps over F, V and B: sizes, seconds of a call and the fitted exponent.

    Of Dem Bones, its start and 30 iterations, its default.
    """
    sizes = [r | {"B": r["bones"]} for k, r in rows.items() if k.startswith("tube:") and r.get("V")]
    found = []
    for solver in ("ssdr balanced", "dembones 0"):
        for sweep, word in {"F": "frames", "V": "vertices", "B": "bones"}.items():
            base = {k: size for k, size in bench.BASE.items() if k != sweep}
            line = sorted(
                (r[sweep], _seconds(r)) for r in sizes
                if r["solver"] == solver and all(abs(r[k] / n - 1) < 0.03 for k, n in base.items())
            )  # fmt: skip
            if len(line) > 1:
                exponent = float(np.polyfit(*np.log(line).T, 1)[0])
                found.append({"solver": solver, "over": word, "line": line, "exponent": exponent})
    return found


def _seconds(row: Row) -> float:
    if not row["solver"].startswith("dembones"):
        return float(row["cpu"])
    first, last = row["curve"][0], row["curve"][-1]
    return float(first[CPU] + 30 * (last[CPU] - first[CPU]) / (last[0] - first[0]))


# --- figures in sentences ------------------------------------------------------------------------


def figures(rows: Rows) -> dict[str, str]:
    """Figures by name, as the pages state them."""
    race = race_rows(rows)
    found: dict[str, str] = {}

    def state(name: str, values: Iterable[float | None], shown: Callable[[float], str]) -> None:
        """The least, the most and the median of some values."""
        known = [v for v in values if v is not None]
        if known:
            each = {"least": min(known), "most": max(known), "median": statistics.median(known)}
            found.update({f"{name} {which}": shown(value) for which, value in each.items()})

    def percent(value: float) -> str:
        return f"{100 * value:.0f} %"

    def over(a: str, b: str, key: str = "E") -> list[float]:
        return [r[a][key] / r[b][key] for r in race if a in r and b in r]

    for name in SHORT:
        state(name, [r["ratio"].get(name) for r in race if "ratio" in r], percent)
    state("sooner", [r.get("sooner") for r in race], "{:.0f}".format)
    state("fast cpu", over("fast", "balanced", "cpu"), percent)
    state("best cpu", over("best", "balanced", "cpu"), "{:.0f}".format)
    state("fast E", [x - 1 for x in over("fast", "balanced")], percent)
    state("best E", [1 - x for x in over("best", "balanced")], percent)
    state("surface E", [x - 1 for x in over("balanced", "free")], percent)
    affine = [r["affine"]["cpu"] / r["rigid"]["cpu"] for r in kind_rows(rows)
              if r["affine"] and r["rigid"]]  # fmt: skip
    state("affine cpu", affine, "{:.1f}".format)
    every = [r for row in rest_rows(rows) for r in row.values() if isinstance(r, dict)]
    for name, is_free in {"over free": True, "over": False}.items():
        some = [r for r in every if ("rest_pose=free" in r["solver"]) == is_free]
        state(name, [r.get("turned over") for r in some], "{:.0f}".format)
    seen = [r for r in seen_rows(rows) if r["always"] and r["length"]]
    state("seen cpu", [r["length"]["cpu"] / r["always"]["cpu"] for r in seen], "{:.1f}".format)
    state("gemm", [r.get("gemm") for r in rows.values()], "{:.0f}".format)
    state("load", [r.get("load") for r in rows.values()], "{:.1f}".format)
    return found
