"""Tables of race.py's records, and what they are computed from."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

Record = dict[str, Any]
WITHIN = 1.01  # of Dem Bones' best error: when its run, and ssdr's, are taken to be there
# where Dem Bones returns fewer bones than it is asked for, or a model that is none
APART = ("fox-24", "ict_face_expressions-20", "morph_stress-20")
BASE = {"V": 2000, "F": 100, "B": 20}  # where the sweeps of cost cross
MACHINE = ("gemm_1", "gemm_2", "memory", "load", "revision")


def read(cache: Path, part: str) -> list[Record]:
    files = sorted((cache / part).glob("*/*.json"))
    return [json.loads(file.read_text(encoding="utf-8")) for file in files]


def case_of(record: Record) -> str:
    return f"{record['sequence']}-{record['bones']}"


def by_case(records: Iterable[Record]) -> dict[str, list[Record]]:
    found: dict[str, list[Record]] = defaultdict(list)
    for record in records:
        found[case_of(record)].append(record)
    names = sorted(found, key=lambda n: (n.rsplit("-", 1)[0], int(n.rsplit("-", 1)[1])))
    return {name: found[name] for name in names}


def reached(record: Record, level: float, clock: str) -> float | None:
    """Seconds of the solver's own work until the error was first at or below a level."""
    column = 1 if clock == "wall" else 2
    return next((p[column] for p in record["curve"] if p[3] <= level), None)


def soonest(records: Iterable[Record], level: float, clock: str) -> float | None:
    times = [t for r in records if (t := reached(r, level, clock)) is not None]
    return min(times, default=None)


def collapsed(records: Iterable[Record]) -> bool:
    """Fewer bones than asked for, or no result, from any run of Dem Bones."""
    peers = [r for r in records if r["solver"].startswith("dembones")]
    return any(r.get("bones found") != r["bones"] for r in peers)


def only(records: Iterable[Record], solver: str) -> list[Record]:
    return [r for r in records if r["solver"] == solver and r.get("E") is not None]


def least(records: Iterable[Record], solver: str, key: str = "E") -> float | None:
    return min((float(r[key]) for r in only(records, solver)), default=None)


def divide(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None or b == 0 else a / b


def summary(case: str, records: list[Record]) -> Record | None:
    """One row: Dem Bones at its best, each effort of ssdr, and their ratios."""
    peers = [r for s in ("dembones default", "dembones 0") for r in only(records, s)]
    if not peers:
        return None
    best = min(peers, key=lambda r: r["E"])
    level = WITHIN * best["E"]
    row: Record = {
        "case": case,
        "K": best["influences"],
        "Dem Bones": best["E"],
        "setting": best["solver"].removeprefix("dembones "),
        "bones found": best["bones found"],
        "2012": least(records, "2012"),
        "published": least(records, "published"),
    }
    for solver in ("fast", "balanced", "best", "balanced fixed", "best fixed"):
        row[solver] = least(records, f"ssdr {solver}")
        row[f"{solver} / Dem Bones"] = divide(row[solver], best["E"])
    for clock in ("wall", "cpu"):
        theirs = soonest(peers, level, clock)
        row[f"Dem Bones {clock} s"] = theirs
        for solver in ("balanced", "balanced fixed"):
            ours = soonest(only(records, f"ssdr {solver}"), level, clock)
            row[f"{solver} {clock} s"] = ours
            row[f"times faster, {solver}, {clock}"] = divide(theirs, ours)
    row["threads tried"] = sorted({r["threads"] for r in peers})
    row |= {key: best.get(key) for key in MACHINE}
    return row


def seed_rows(race: list[Record], seeds: list[Record]) -> list[Record]:
    """How far best differs between seeds, with the vertices in another order each time.

    Of one revision of the package: that of most runs.
    """
    rows = []
    first = [r for r in race if r["solver"] == "ssdr best" and r["threads"] == 1]
    for case, records in by_case(first + seeds).items():
        records = [r for r in records if r.get("E") is not None]
        counts = Counter(r.get("revision") for r in records)
        revision = counts.most_common(1)[0][0] if counts else None
        records = [r for r in records if r.get("revision") == revision]
        found = {r["seed"]: float(r["E"]) for r in records}
        if len(found) > 1:
            low, high = min(found.values()), max(found.values())
            rows.append(
                {
                    "case": case,
                    "runs": len(found),
                    "least": low,
                    "most": high,
                    "revision": revision,
                    "spread": (high - low) / low,
                    "E": [found[k] for k in sorted(found)],
                    "CPU s": float(np.mean([r["total cpu"] for r in records])),
                }
            )
    return rows


def race_rows(records: list[Record]) -> list[Record]:
    keys = ("solver", "threads", "seed", "bones found", "E", "E8", "bytes8", "E16", "bytes16",
            "total wall", "total cpu", "peak MiB", "failed")  # fmt: skip
    return [
        {
            "case": case_of(r),
            "K": r["influences"],
            **{k: r.get(k) for k in keys},
            **{k: r.get(k) for k in MACHINE},
        }
        for r in records
        if r["solver"] != "pca"
    ]


def at_bytes(pca: list[list[float]], size: float) -> float | None:
    """E of PCA at a number of bytes, along straight lines of the log-log chart."""
    x, y = np.log([[p[1], max(p[2], 1e-12)] for p in pca]).T
    if not x[0] <= np.log(size) <= x[-1]:
        return None
    return float(np.exp(np.interp(np.log(size), x, y)))


def front_of(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """What nothing else beats in both."""
    out: list[tuple[float, float]] = []
    for x, y in sorted(points):
        if not out or y < out[-1][1]:
            out.append((x, y))
    return out


def cost_of(record: Record, clock: str) -> float | None:
    """Seconds of one call: of Dem Bones its start and 30 iterations, its default."""
    column = 1 if clock == "wall" else 2
    if not record["curve"]:
        return None
    if record["solver"].startswith("dembones"):
        first, last = record["curve"][0], record["curve"][-1]
        return float(first[column] + 30 * (last[column] - first[column]) / (last[0] - first[0]))
    return float(record[f"total {clock}"])


def scaling_rows(records: list[Record], clock: str) -> list[Record]:
    """Sweeps of F, V and B through BASE, each with its fitted exponent."""
    rows = []
    keys = ("F", "V", "B")
    sizes = [{**r, "B": r["bones"]} for r in records if "V" in r]
    for solver in ("ssdr balanced", "dembones 0"):
        for sweep in keys:
            others = [k for k in keys if k != sweep]
            line = [
                (r[sweep], cost, r)
                for r in sorted(sizes, key=lambda r, sweep=sweep: r[sweep])
                if r["solver"] == solver
                and all(abs(r[k] / BASE[k] - 1) < 0.03 for k in others)
                and (cost := cost_of(r, clock)) is not None
            ]
            if len(line) < 2:
                continue
            x, y = np.log([(size, cost) for size, cost, _ in line]).T
            exponent = float(np.polyfit(x, y, 1)[0])
            for size, cost, r in line:
                rows.append(
                    {
                        "solver": solver,
                        "over": sweep,
                        "size": size,
                        "seconds": cost,
                        "exponent": exponent,
                        "E": r["E"],
                        "bones found": r["bones found"],
                        "peak MiB": r["peak MiB"],
                        "at": {k: r[k] for k in keys},
                        **{k: r.get(k) for k in MACHINE},
                    }
                )
    return rows


def choice_rows(records: list[Record]) -> list[Record]:
    keys = ("sequence", "bones", "solver", "E", "E kept out", "jump", "total cpu")
    return [{k: r.get(k) for k in keys} | {k: r.get(k) for k in MACHINE} for r in records]
