"""All tables and charts that the records of race.py allow, and records from the tables again."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from benchmarks.common import table, write_csv, write_json
from benchmarks.peers.charts import (
    bones_chart,
    effort_chart,
    front_chart,
    race_chart,
    scaling_chart,
    size_chart,
    smooth_chart,
)
from benchmarks.peers.tables import (
    APART,
    Record,
    at_bytes,
    by_case,
    case_of,
    choice_rows,
    collapsed,
    race_rows,
    read,
    scaling_rows,
    seed_rows,
    summary,
)


def file_of(record: Record) -> str:
    """Where a run's record lies in the cache."""
    case = f"{record['sequence']}-{record['bones']}-{record['influences']}"
    name = f"{record['solver']} t{record['threads']} s{record['seed']}"
    return "/".join(re.sub(r"[^\w.-]+", "_", p) for p in (record["part"], case, name)) + ".json"


def run_of(case: str, record: Record) -> str:
    """A run's name in the tables of curves and waits."""
    return f"{case} {record['solver']} t{record['threads']} s{record['seed']}"


def restore(results: Path, cache: Path) -> int:
    """Write what the tables of race and front hold back into a lost cache; how many records.

    So that some runs can be made again where there are none of the others.  What is
    in the cache already stays.
    """
    records: list[Record] = []
    for part in ("race", "front"):
        path = results / f"{part}.json"
        if not path.exists():
            continue
        tables = json.loads(path.read_text(encoding="utf-8"))
        records += [_record(part, row, tables) for row in tables["rows"]]
        for sequence, line in tables.get("pca", {}).items():
            records.append(
                {
                    "part": part,
                    "solver": "pca",
                    "sequence": sequence,
                    "bones": 0,
                    "influences": 0,
                    "threads": 1,
                    "seed": 0,
                    "pca": line,
                }
            )
    missing = [r for r in records if not (cache / file_of(r)).exists()]
    for record in missing:
        (cache / file_of(record)).parent.mkdir(parents=True, exist_ok=True)
        write_json(cache / file_of(record), record)
    return len(missing)


def _record(part: str, row: Record, tables: dict[str, Any]) -> Record:
    sequence, bones = row["case"].rsplit("-", 1)
    run = run_of(row["case"], row)
    record = {key: value for key, value in row.items() if value is not None}
    record |= {
        "part": part,
        "sequence": sequence,
        "bones": int(bones),
        "influences": row["K"],
        "curve": tables.get("curves", {}).get(run, []),
    }
    if run in tables.get("waits", {}):
        record["waits"] = tables["waits"][run]
    if row["solver"] == "ssdr balanced" and row["threads"] == 1:  # with those of two threads
        record["walk"] = [
            {key: value for key, value in stop.items() if key != "case"}
            for stop in tables.get("walks", [])
            if stop["case"] == row["case"]
        ]
    return record


def raced_best(race: list[Record], front: list[Record]) -> list[Record]:
    """Runs of "best" on the front's sequences that the race has made already."""
    names = {r["sequence"] for r in front}
    known = {(case_of(r), r["influences"]) for r in front if r["solver"] == "ssdr best"}
    return [
        r
        for r in race
        if r["solver"] == "ssdr best"
        and r["sequence"] in names
        and r["seed"] == 0
        and (case_of(r), r["influences"]) not in known
    ]


def report(cache: Path, results: Path, images: Path, clock: str) -> None:
    """Everything that the records at hand allow."""
    race, front = read(cache, "race"), read(cache, "front")
    scaling, choices = read(cache, "scaling"), read(cache, "choices")
    if race:
        cases = by_case(race)
        apart = {
            case: records for case, records in cases.items() if collapsed(records) or case in APART
        }
        level = {
            case: records
            for case, records in cases.items()
            if case not in apart and any(r["solver"].startswith("ssdr") for r in records)
        }
        rows = race_rows(race)
        ours = [row for case, records in level.items() if (row := summary(case, records))]
        theirs = [row for case, records in apart.items() if (row := summary(case, records))]
        walks = [{"case": case_of(r), **stop} for r in race for stop in r.get("walk", [])]
        write_json(
            results / "race.json",
            {
                "clock": clock,
                "summary": ours,
                "apart": theirs,
                "rows": rows,
                "walks": walks,
                "curves": {run_of(case_of(r), r): r["curve"] for r in race},
                "waits": {run_of(case_of(r), r): r["waits"] for r in race if "waits" in r},
            },
        )
        write_csv(results / "race.csv", rows)
        if ours:
            write_csv(results / "race_summary.csv", ours)
            columns = ("case", "Dem Bones", "balanced", "best", "balanced / Dem Bones",
                       "best / Dem Bones", "best fixed / Dem Bones",
                       f"times faster, balanced, {clock}",
                       f"times faster, balanced fixed, {clock}")  # fmt: skip
            print(table(ours, columns))
            race_chart(level, images / "race.png", clock, race)
            effort_chart(level, images / "effort.png", clock)
        if apart:
            race_chart(apart, images / "race_apart.png", clock, race)
    spread = seed_rows(race, read(cache, "seeds"))
    if spread:
        write_json(results / "seeds.json", {"rows": spread})
        print(table(spread, ("case", "runs", "least", "most", "spread", "CPU s")))
    if front:
        pca = {r["sequence"]: r["pca"] for r in front if "pca" in r}
        rows = race_rows(front)
        for row in rows:
            line = pca.get(row["case"].rsplit("-", 1)[0])
            known = line is not None and row["bytes8"] is not None
            row["PCA at these bytes"] = at_bytes(line, row["bytes8"]) if known else None
        write_json(results / "front.json", {"clock": clock, "rows": rows, "pca": pca})
        write_csv(results / "front.csv", rows)
        front_chart([*front, *raced_best(race, front)], images / "front.png", clock)
        size_chart(front, race, images / "size.png")
        bones_chart(front, images / "bones.png")
    if scaling:
        rows = scaling_rows(scaling, clock)
        write_json(results / "scaling.json", {"clock": clock, "rows": rows})
        write_csv(results / "scaling.csv", rows)
        scaling_chart(rows, images / "scaling.png", clock)
    if choices:
        rows = choice_rows(choices)
        write_json(results / "choices.json", {"rows": rows})
        write_csv(results / "choices.csv", rows)
        smooth = [r for r in choices if r["solver"].startswith("smooth")]
        if smooth:
            smooth_chart(smooth, images / "smooth.png")
