"""Put the results into the pages: what stands between two markers is written anew.

    python benchmarks/tools/pages.py [--check]

Markers of tables are <!-- NAME --> and <!-- end NAME -->, those of a figure in a sentence
<!--NAME--> and <!--/-->; --check only says whether a page is out of date.  A table is rows of a
record and, for each column, its head and a format string for the row; a value that a row lacks
leaves the cell empty.  What has no record yet stays as it is.  Every case of the leaderboard goes
into results/leaderboard.csv.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import bench
from benchmarks.common import RESULTS, ROOT, Record, Row
from benchmarks.leaderboard import tables as leaderboard
from benchmarks.peers import tables

PAGES = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
SEQUENCE = "{sequence}, {bones}"
IN_README = ("horse_gallop-20", "samba-20", "cow_elastic-24", "mannequin_rumba-30")


@dataclasses.dataclass
class Table:
    """Rows made of a record's rows, and a column's heads and formats."""

    rows: Callable[[Mapping[str, Row]], Iterable[Row]]
    columns: dict[str, str]
    record: str = "bench"

    def __call__(self, rows: Mapping[str, Row] | None = None) -> str:
        lines = ["| " + " | ".join(self.columns) + " |", "|" + "---|" * len(self.columns)]
        for row in self.rows(results(self.record).rows if rows is None else rows):
            cells = [cell(template, row) for template in self.columns.values()]
            lines.append("| " + " | ".join(cells) + " |")
        return "\n".join(lines)


@functools.cache
def results(name: str) -> Record:
    return Record(RESULTS / f"{name}.json")


def cell(template: str, row: Row) -> str:
    """A row in the words of a format; empty where the row lacks something."""
    try:
        text = template.format_map(row)
    except (KeyError, TypeError):
        return ""
    return "" if text == "None" else text


def both(name: str) -> str:
    """E and degrees of normals of a solver of the race."""
    return f"{{{name}[E]:.3f}}, {{{name}[normals]:.1f}}°"


# --- rows ----------------------------------------------------------------------------------------


def in_readme(rows: Mapping[str, Row]) -> list[Row]:
    return [r for r in tables.race_rows(rows) if f"{r['sequence']}-{r['bones']}" in IN_README]


def parsimony_rows(rows: Mapping[str, Row]) -> list[Row]:
    found = [dict(row) for row in rows.values()]
    for r in found:
        if r["one less"]:
            r["least"] = min(r["one less"])
            r["effort"] = f"{r['effort']:.1f} times" if r["effort"] else "proven"
    return found


# --- pages ---------------------------------------------------------------------------------------

RACE = {"sequence, bones": SEQUENCE, "Dem Bones": both("peer"), "SSDR 2012": both("le_deng"),
        "ssdr fast": both("fast"), "balanced": both("balanced"), "best": both("best"),
        "balanced, rest pose free": both("free")}  # fmt: skip
SECONDS = {
    "sequence, bones": SEQUENCE, "to Dem Bones' best: Dem Bones": "{peer seconds:.1f}",
    "ssdr": "{seconds[balanced]:.2f}", "times sooner": "{sooner:.0f}",
    "until the end: Dem Bones": "{peer[cpu]:.1f}", "SSDR 2012": "{le_deng[cpu]:.1f}",
    "ssdr fast": "{fast[cpu]:.1f}", "balanced": "{balanced[cpu]:.1f}", "best": "{best[cpu]:.1f}",
}  # fmt: skip
REST = "{%s[E]:.3f}, {%s[normals]:.1f}° ({%s[bent]:.1f}°)"
FEWER = "{%s, equal bytes[E]:.3f} ({%s, equal bytes[bones]} bones)"
GIVEN = "{%s[rmse / diagonal]:.3%%}, {%s[normals]:.1f}°, {%s[cpu]:.1f} s"
BLOCKS: dict[str, Table] = {
    "readme": Table(in_readme, {
        "sequence, bones": SEQUENCE,
        "error of positions: Dem Bones": "100%", "SSDR 2012": "{ratio[le_deng]:.0%}",
        "ssdr": "{ratio[balanced]:.0%}", "ssdr, `--effort best`": "{ratio[best]:.0%}",
        "error of normals: Dem Bones": "{peer[normals]:.1f}°", "ssdr ": "{balanced[normals]:.1f}°",
        "CPU time to Dem Bones' error: Dem Bones": "{peer seconds:.1f} s",
        "ssdr  ": "{seconds[balanced]:.1f} s",
    }),
    "race": Table(tables.race_rows, RACE),
    "seconds": Table(tables.race_rows, SECONDS),
    "choose_bones": Table(lambda rows: tables.dancer_rows(rows, "bones"), {
        "bones": "{bones}", "RMSE, mm": "{mm:.2f}", "s": "{cpu:.1f}",
    }),
    "choose_influences": Table(lambda rows: tables.dancer_rows(rows, "influences"), {
        "influences": "{influences}", "RMSE, mm": "{mm:.2f}", "pruned from 8, mm": "{pruned:.2f}",
        "s": "{cpu:.1f}",
    }),
    "bone_models": Table(tables.kind_rows, {
        "sequence, rigid bones": SEQUENCE, **{k: f"{{{k}[E]:.3f}}" for k in bench.FLOATS},
        **{f"{k}, equal bytes": FEWER % (k, k) for k in ("similarity", "affine")},
    }),
    "recovery": Table(tables.recovery_rows, {
        "data": "{sequence}", "B": "{bones}", "effort": "{effort}",
        "RMSE / diagonal": "{rmse / diagonal:.1e}", "max / diagonal": "{max / diagonal:.1e}",
        "E": "{E:.2f}", "CPU s": "{cpu:.1f}",
    }),
    "parsimony": Table(parsimony_rows, {
        "scene": "{scene}", "tolerance": "{tolerance}", "made with": "{made with}",
        "bones": "{bones}", "proven least": "{proven}", "influences": "{influences}",
        "error": "{error / tolerance:.2f}", "one bone less, best of all tries": "{least:.3g}",
        "effort on it": "{effort}", "bytes before and after pruning": "{bytes before:,}, {bytes:,}",
        "CPU s": "{cpu seconds:.1f}",
    }, "parsimony"),
    "rest_poses": Table(tables.rest_rows, {
        "sequence, bones": SEQUENCE, **{head: REST % (head, head, head) for head in bench.RESTS},
    }),
    "seen": Table(tables.seen_rows, {
        "sequence, bones": SEQUENCE,
        "`normals=True`": GIVEN % (("always",) * 3),
        '`normals="0.05%"`': GIVEN % (("length",) * 3),
    }),
    **{name: Table(*table, "leaderboard") for name, table in leaderboard.TABLES.items()},
}  # fmt: skip
RECORDS = ("bench", "leaderboard", "parsimony", "first_call", "long_sequences")


def race_table(rows: Mapping[str, Row], own: Iterable[str] = ()) -> str:
    """Table of the race, with solvers of one's own at its end."""
    columns = RACE | {name: both(name) for name in own}
    columns |= {f"{name}, CPU s": f"{{{name}[cpu]:.1f}}" for name in own}
    return Table(lambda rows: tables.race_rows(rows, own), columns)(rows)


@functools.cache
def figures() -> dict[str, str]:
    """Figures in sentences: of the run, and where, when and of which revision records are."""
    found = tables.figures(results("bench").rows)
    for name in RECORDS:
        if (record := results(name)).rows:
            found[f"{name} revision"] = record.revision
            found[f"{name} date"] = record.date
            found[f"{name} machine"] = "{cores} cores, {cpu}".format_map(record.machine)
            found[f"{name} minutes"] = f"{record.minutes:.0f}"
    if call := results("first_call").rows.get("first call, nothing compiled"):
        found["first call"] = f"{call['kernels']:.0f} s"
    if long := results("long_sequences").rows.get("40000 frames"):
        found["long minutes"] = f"{long['wall'] / 60:.1f}"
        found["long memory"] = f"{long['anonymous MiB'] / 1024:.1f}"
        found["long ratio"] = f"{long['ratio']:.3f}"
    return found


def renew(text: str) -> str:
    """A page with its tables and figures as the records have them now."""

    def put(match: re.Match[str]) -> str:
        name = match[1]
        if not results(BLOCKS[name].record).rows:
            return match[0]
        return f"<!-- {name} -->\n\n{BLOCKS[name]()}\n\n<!-- end {name} -->"

    def state(match: re.Match[str]) -> str:
        return f"<!--{match[1]}-->{figures().get(match[1], match[2])}<!--/-->"

    text = re.sub(r"<!-- (\w+) -->\n.*?<!-- end \1 -->", put, text, flags=re.DOTALL)
    return re.sub(r"<!--(\w[\w ]*)-->(.*?)<!--/-->", state, text, flags=re.DOTALL)


def write(check: bool = False) -> None:
    """Write the pages, or end with a word about the first that is out of date."""
    files = {page: renew(page.read_text(encoding="utf-8")) for page in PAGES}
    files[RESULTS / "leaderboard.csv"] = leaderboard.every_case()
    for page, new in files.items():
        old = page.read_text(encoding="utf-8") if page.is_file() else ""
        if new != old and check:
            sys.exit(f"{page.relative_to(ROOT)} is out of date: run benchmarks/tools/pages.py")
        if new != old:
            page.write_text(new, encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true")
    write(parser.parse_args().check)


if __name__ == "__main__":
    main()
