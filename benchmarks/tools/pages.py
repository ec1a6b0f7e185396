"""Put the results into the pages: what stands between two markers is written anew.

    python benchmarks/tools/pages.py [--check]

Markers are <!-- NAME --> and <!-- end NAME -->; --check only says whether a page is out of date.
BLOCKS holds their tables.  A table is rows of benchmarks/results and, for each column, its head and
a format string for the row; a value that a row lacks leaves the cell empty.  Every case of the
leaderboard goes into results/leaderboard.csv.
"""

from __future__ import annotations

import argparse
import dataclasses
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.accuracy.errors import AUTHOR, FLOATS, PLAIN, millimetres
from benchmarks.common import EFFORTS, RESULTS, ROOT, Row, read_rows
from benchmarks.leaderboard import tables as leaderboard
from benchmarks.peers import tables

PAGES = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
SEQUENCE = "{sequence}, {bones}"
REST_POSES = {
    "free, no normals": "free, `normals=False`",
    "free": "free",
    "surface, no normals": "surface, `normals=False`",
    "surface": "surface, the default",
    "frame 0": "fixed at frame 0",
}


@dataclasses.dataclass
class Table:
    rows: Callable[[], Iterable[Row]]
    columns: dict[str, str]

    def __call__(self) -> str:
        lines = ["| " + " | ".join(self.columns) + " |", "|" + "---|" * len(self.columns)]
        for row in self.rows():
            cells = [cell(template, row) for template in self.columns.values()]
            lines.append("| " + " | ".join(cells) + " |")
        return "\n".join(lines)


def cell(template: str, row: Row) -> str:
    try:
        text = template.format_map(row)
    except (KeyError, TypeError):
        return ""
    return "" if text == "None" else text


def same(*heads: str) -> dict[str, str]:
    """Columns whose heads are the keys of the row."""
    return {head: f"{{{head}}}" for head in heads}


# --- rows ----------------------------------------------------------------------------------------


def rows(name: str, **wanted: Any) -> list[Row]:
    """Rows of a results file that have the wanted values, each with its case."""
    every = [{"case": case} | row for case, row in read_rows(RESULTS / f"{name}.json").items()]
    return [r for r in every if all(r.get(key) == value for key, value in wanted.items())]


def pivot(rows: Iterable[Row], line: str, column: str, value: str) -> list[Row]:
    """Rows grouped into one for each `line`, with a `value` for each `column`."""
    found: dict[str, Row] = {}
    for row in rows:
        first = found.setdefault(cell(line, row), row | {"line": cell(line, row)})
        first[cell(column, row)] = cell(value, row)
    return [*found.values()]


def effort_rows() -> list[Row]:
    """Rows of errors.py, or of the race where that runs the case."""
    found = []
    for (sequence, bones, influences), plain in PLAIN.items():
        case = {"sequence": sequence, "bones": bones, "influences": influences}
        for effort in EFFORTS:
            own = rows("errors", group="efforts", effort=effort, **case)
            for row in own or rows("race", solver=f"ssdr {effort}", threads=1, **case):
                row |= {"plain": plain, "effort": effort}
                row.setdefault("cpu seconds", row.get("total cpu"))
                found.append(row)
    return found


def choice_rows(group: str) -> list[Row]:
    """RMSE in millimetres, also of the model of most influences after pruning."""
    found = rows("errors", group=group)
    pruned = found[-1].get("E pruned", {})
    for r in found:
        r["mm"], e = millimetres(r["E"]), pruned.get(str(r["influences"]))
        r["pruned"] = e and millimetres(e)
    return found


def kind_rows() -> list[Row]:
    """E by sequence and kind of bones."""
    equal = rows("errors", group="kinds, equal bytes")
    found = rows("errors", group="kinds", effort="balanced") + equal
    for r in found:
        r["author"] = AUTHOR.get((r["sequence"], r["rigid"]))
        r["shown"] = f"{r['E']:.3f}"
        if r in equal:
            r["bone_model"] += ", equal bytes"
            r["shown"] += f" ({r['bones']} bones)"
    return pivot(found, "{sequence}, {rigid}", "{bone_model}", "{shown}")


def parsimony_rows() -> list[Row]:
    found = rows("parsimony")
    for r in found:
        if r["one less"]:
            r["least"] = min(r["one less"])
            r["effort"] = f"{r['effort']:.1f} times" if r["effort"] else "proven"
    return found


def rest_rows() -> list[Row]:
    found = rows("rest_poses")
    for r in found:
        r["pose"] = REST_POSES[r["case"].partition(" ")[2]]
    shown = "{E:.3f}, {drawn:.1f}° ({bent:.1f}°)"
    return pivot(found, SEQUENCE, "{pose}", shown)


def seen_rows() -> list[Row]:
    found = rows("sheets")
    for r in found:
        r["given"] = "True" if r["normals"] is True else "length"
    return pivot(found, SEQUENCE, "{given}", "{percent:.3f} %, {drawn:.1f}°, {cpu seconds:.1f} s")


# --- pages ---------------------------------------------------------------------------------------


IN_README = ("horse_gallop-20", "samba-20", "cow_elastic-24", "mannequin_rumba-30")


SOLVERS = {
    "Dem Bones": "best peer", "SSDR 2012": "2012", "ssdr fast": "ssdr fast",
    "balanced": "ssdr balanced", "best": "ssdr best",
}  # fmt: skip
BLOCKS: dict[str, Callable[[], str]] = {
    "readme": Table(lambda: tables.best_known_rows(rows("race"), IN_README), {
        "sequence, bones": SEQUENCE,
        "error of positions: Dem Bones": "100%", "SSDR 2012": "{2012 ratio:.0%}",
        "ssdr": "{balanced ratio:.0%}", "ssdr, `--effort best`": "{best ratio:.0%}",
        "error of normals: Dem Bones": "{best peer normals}", "ssdr ": "{ssdr balanced normals}",
        "revision": "{machine[revision]}",
    }),
    "race": Table(lambda: tables.best_known_rows(rows("race")), {
        "sequence, bones": SEQUENCE,
        **{head: f"{{{name} E}}, {{{name} normals}}" for head, name in SOLVERS.items()},
        "Dem Bones, CPU s": "{Dem Bones cpu:.1f}", "ssdr, CPU s": "{balanced cpu:.1f}",
        "revision": "{machine[revision]}",
    }),
    "efforts": Table(
        lambda: pivot(effort_rows(), SEQUENCE, "{effort}", "{E:.2f} in {cpu seconds:.1f} s"),
        {"sequence, bones": "{line}", **same(*EFFORTS), "plain alternation": "{plain}"},
    ),
    "choose_bones": Table(lambda: choice_rows("bones"), {
        "bones": "{bones}", "RMSE, mm": "{mm:.2f}", "s": "{seconds:.1f}",
    }),
    "choose_influences": Table(lambda: choice_rows("influences"), {
        "influences": "{influences}", "RMSE, mm": "{mm:.2f}", "pruned from 8, mm": "{pruned:.2f}",
        "s": "{seconds:.1f}",
    }),
    "bone_models": Table(kind_rows, {
        "sequence, rigid bones": "{line}",
        **same(*FLOATS, "similarity, equal bytes", "affine, equal bytes"),
        "the 2012 author's affine": "{author}",
    }),
    "recovery": Table(lambda: rows("errors", group="recovery"), {
        "data": "{sequence}", "B": "{bones}", "effort": "{effort}",
        "RMSE / diagonal": "{rmse / diagonal:.1e}", "max / diagonal": "{max / diagonal:.1e}",
        "E": "{E:.2f}", "s": "{seconds:.1f}",
    }),
    "parsimony": Table(parsimony_rows, {
        "scene": "{scene}", "tolerance": "{tolerance}", "made with": "{made with}",
        "bones": "{bones}", "proven least": "{proven}", "influences": "{influences}",
        "error": "{error / tolerance:.2f}", "one bone less, best of all tries": "{least:.3g}",
        "effort on it": "{effort}", "bytes before and after pruning": "{bytes before:,}, {bytes:,}",
        "CPU s": "{cpu seconds:.1f}",
    }),
    "steps": Table(lambda: rows("steps", threads=1), {
        "case": "{data}-{bones}", "step": "{step}", "ms": "{ms:.1f}",
        "products, GFLOP": "{GFLOP:.2f}", "products at the GEMM rate, ms": "{floor ms:.1f}",
        "ratio": "{ratio:.1f}", "GEMM, GFLOP/s": "{rate}", "revision": "{machine[revision]}",
    }),
    "rest_poses": Table(rest_rows, {"sequence, bones": "{line}", **same(*REST_POSES.values())}),
    "seen": Table(seen_rows, {
        "sequence, bones": "{line}", "`normals=True`": "{True}",
        '`normals="0.05%"`': "{length}",
    }),
    **{name: Table(*table) for name, table in leaderboard.TABLES.items()},
}  # fmt: skip


def renew(text: str) -> str:
    def put(match: re.Match[str]) -> str:
        name = match[1]
        return f"<!-- {name} -->\n\n{BLOCKS[name]()}\n\n<!-- end {name} -->"

    return re.sub(r"<!-- (\w+) -->\n.*?<!-- end \1 -->", put, text, flags=re.DOTALL)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true")
    args = parser.parse_args()
    files = {page: renew(page.read_text(encoding="utf-8")) for page in PAGES}
    files[RESULTS / "leaderboard.csv"] = leaderboard.every_case()
    for page, new in files.items():
        old = page.read_text(encoding="utf-8") if page.is_file() else ""
        if new != old and args.check:
            sys.exit(f"{page.relative_to(ROOT)} is out of date: run benchmarks/tools/pages.py")
        if new != old:
            page.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
