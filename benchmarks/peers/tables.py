"""Rows of the tables and points of the charts, computed from the records of race.py."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

import numpy as np

from benchmarks.common import RESULTS, Row, read_rows

WITHIN = 1.01  # times of Dem Bones and ssdr are those until this times Dem Bones' best error
# where Dem Bones returns fewer bones than it is asked for, or no usable model
APART = ("fox-24", "ict_face_expressions-20", "morph_stress-20")
BASE = {"V": 2000, "F": 100, "B": 20}  # each sweep changes one of these
COLUMN = {"wall": 1, "cpu": 2}  # in a point of a curve


def read(part: str) -> list[Row]:
    return [*read_rows(RESULTS / f"{part}.json").values()]


def case_of(record: Row) -> str:
    return f"{record['sequence']}-{record['bones']}"


def by_case(records: Iterable[Row]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = defaultdict(list)
    for record in records:
        if record["bones"]:
            found[case_of(record)].append(record)
    names = sorted(found, key=lambda n: (n.rsplit("-", 1)[0], int(n.rsplit("-", 1)[1])))
    return {name: found[name] for name in names}


def only(records: Iterable[Row], solver: str) -> list[Row]:
    return [r for r in records if r["solver"] == solver and r.get("E") is not None]


def least(records: Iterable[Row], solver: str) -> float | None:
    return min((float(r["E"]) for r in only(records, solver)), default=None)


def divide(a: float | None, b: float | None) -> float | None:
    return None if a is None or not b else a / b


def soonest(records: Iterable[Row], level: float, clock: str) -> float | None:
    """Seconds of the solver's own work until the error was first at or below a level."""
    times = [p[COLUMN[clock]] for r in records for p in r["curve"] if p[3] <= level]
    return min(times, default=None)


def collapsed(records: Iterable[Row]) -> bool:
    """True if a run of Dem Bones returned fewer bones than asked for, or nothing."""
    peers = [r for r in records if r["solver"].startswith("dembones")]
    return any(r.get("bones found") != r["bones"] for r in peers)


def level_and_apart(records: Iterable[Row]) -> tuple[dict[str, list[Row]], dict[str, list[Row]]]:
    """Cases that are compared, and cases in which Dem Bones has no comparable model."""
    cases = by_case(records)
    apart = {k: rs for k, rs in cases.items() if k in APART or collapsed(rs)}
    ours = {k: rs for k, rs in cases.items() if any(r["solver"].startswith("ssdr") for r in rs)}
    return {k: rs for k, rs in ours.items() if k not in apart}, apart


def summary(records: list[Row]) -> Row | None:
    """Row of a case: Dem Bones at its best, each effort of ssdr, and their ratios."""
    peers = [r for s in ("dembones default", "dembones 0") for r in only(records, s)]
    if not peers:
        return None
    best = min(peers, key=lambda r: r["E"])
    row: Row = {
        "case": case_of(best),
        "sequence": best["sequence"],
        "bones": best["bones"],
        "Dem Bones": best["E"],
        "setting": best["solver"].removeprefix("dembones "),
        "SSDR 2012": least(records, "2012"),
        "threads": ", ".join(map(str, sorted({r["threads"] for r in peers}))),
        "machine": best["machine"],
    }
    for solver in ("fast", "balanced", "best"):
        row[solver] = least(records, f"ssdr {solver}")
        row[f"{solver} ratio"] = divide(row[solver], best["E"])
    row["2012 ratio"] = divide(row["SSDR 2012"], best["E"])
    for clock in COLUMN:
        theirs = soonest(peers, WITHIN * best["E"], clock)
        row[f"Dem Bones {clock}"] = theirs
        ours = soonest(only(records, "ssdr balanced"), WITHIN * best["E"], clock)
        row[f"balanced {clock}"], row[f"balanced {clock} ratio"] = ours, divide(theirs, ours)
    return row


def summaries(records: Iterable[Row]) -> list[Row]:
    level, _ = level_and_apart(records)
    return [row for records in level.values() if (row := summary(records))]


def drawn_rows(records: Iterable[Row]) -> list[Row]:
    """Errors of positions, and mean angles of the normals that engines draw, of each solver."""
    found = []
    for mine in level_and_apart(records)[0].values():
        mine = [r for r in mine if "normals" in r and r["threads"] == 1]
        row = dict(next(r for r in mine if r["solver"] == "ssdr balanced"))
        for record in mine:
            row[f"{record['solver']} E"] = f"{record['E']:.3f}"
            row[f"{record['solver']} normals"] = f"{record['normals']:.1f}°"
        found.append(row)
    return found


def best_known_rows(records: Iterable[Row], cases: Iterable[str] | None = None) -> list[Row]:
    """Rows of `summaries` and `drawn_rows` in one, of some cases or all; Dem Bones at its best."""
    records = list(records)
    sums, drawn = ({case_of(r): r for r in f(records)} for f in (summaries, drawn_rows))
    rows = [sums[case] | drawn[case] for case in cases or sums]
    for row in rows:
        for key in ("E", "normals"):
            row[f"best peer {key}"] = row[f"dembones {row['setting']} {key}"]
    return rows


def front_of(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Pareto front of points (x, y)."""
    out: list[tuple[float, float]] = []
    for x, y in sorted(points):
        if not out or y < out[-1][1]:
            out.append((x, y))
    return out


def seconds_of(record: Row) -> float:
    """Seconds of one call; of Dem Bones its start and 30 iterations, its default."""
    if not record["solver"].startswith("dembones"):
        return float(record["total wall"])
    first, last = record["curve"][0], record["curve"][-1]
    return float(first[1] + 30 * (last[1] - first[1]) / (last[0] - first[0]))


def sweeps(records: Iterable[Row]) -> list[Row]:
    """Sweeps of F, V and B through BASE: sizes, seconds, errors and the fitted exponent."""
    sizes = [r | {"B": r["bones"]} for r in records if r.get("curve")]
    rows = []
    for solver in ("ssdr balanced", "dembones 0"):
        for sweep, word in {"F": "frames", "V": "vertices", "B": "bones"}.items():
            line = [
                r
                for r in sorted(only(sizes, solver), key=lambda r, sweep=sweep: r[sweep])
                if all(abs(r[k] / BASE[k] - 1) < 0.03 for k in BASE if k != sweep)
            ]
            if len(line) < 2:
                continue
            x, y = [r[sweep] for r in line], [seconds_of(r) for r in line]
            points = zip(x, y, [r["E"] for r in line], strict=True)
            rows.append({
                "solver": solver, "over": word, "size": x, "seconds": y,
                "exponent": float(np.polyfit(np.log(x), np.log(y), 1)[0]),
                "points": ", ".join(f"{n}: {s:.1f} ({e:.1f})" for n, s, e in points),
                "machine": line[-1]["machine"],
            })  # fmt: skip
    return rows
