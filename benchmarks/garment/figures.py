"""Record of the tables on garmentnet's pages, each with the commands beside it and its revision.

Tables are taken from the pages as they stand, with the commands of their section and the newest
commit that changed them; ``--check`` says where page and record differ::

    python benchmarks/garment/figures.py            # after a page was changed
    python benchmarks/garment/figures.py --check

``modules.py`` and ``mixing.py`` write records of their own when they measure.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


from benchmarks import common

PAGES = ("garmentnet", "garmentnet-results", "garment-scenes", "garmentnet-live")
RECORD = common.RESULTS / "garment-pages.json"
_COMMAND = re.compile(r"(?:python benchmarks|garmentnet [a-z])\S[^`\n]*")


class Table(NamedTuple):
    """Lines of a table under a heading; `first` counts from 1."""

    section: str
    first: int
    lines: list[str]


def lines(text: str) -> Iterator[tuple[int, str, str]]:
    """Number, heading above, and text of every line, with an empty one at the end."""
    section, fenced = "", False
    for number, line in enumerate([*text.splitlines(), ""], start=1):
        fenced ^= line.startswith("```")
        if line.startswith("#") and not fenced:
            section = line.lstrip("# ")
        yield number, section, line


def tables(text: str) -> Iterator[Table]:
    """The tables of a page."""
    found: list[str] = []
    for number, section, line in lines(text):
        if line.startswith("|"):
            found.append(line)
        elif found:
            yield Table(section, number - len(found), found)
            found = []


def commands(text: str) -> dict[str, list[str]]:
    """Commands in the code and the text of every section."""
    found: dict[str, list[str]] = {}
    for _, section, line in lines(text.replace("\\\n", " ")):
        for match in _COMMAND.findall(line):
            found.setdefault(section, []).append(" ".join(match.split()))
    return found


def figures(page: str) -> dict[str, dict[str, object]]:
    """Tables of a page, by section and place in it: lines and commands."""
    text = (common.ROOT / "docs" / f"{page}.md").read_text("utf-8")
    known, found, count = commands(text), {}, dict[str, int]()
    for table in tables(text):
        place = count[table.section] = count.get(table.section, 0) + 1
        found[f"{page}: {table.section}, {place}"] = {
            "lines": table.lines,
            "commands": known.get(table.section, []),
            "at": [table.first, table.first + len(table.lines) - 1],
        }
    return found


def revision(page: str, first: int, last: int) -> str:
    """The newest commit that changed some lines of a page."""
    words = ["git", "log", "-1", "--format=%h", "-s", f"-L{first},{last}:docs/{page}.md"]
    done = subprocess.run(words, cwd=common.ROOT, capture_output=True, text=True, check=True)
    return done.stdout.split()[0]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--check", action="store_true", help="compare, and write nothing")
    given = options.parse_args()
    there = json.loads(RECORD.read_text("utf-8"))["rows"] if RECORD.is_file() else {}
    rows, differ = {}, []
    for page in PAGES:
        for name, found in figures(page).items():
            first, last = found.pop("at")  # type: ignore[misc]
            old = there.get(name, {})
            if {k: old.get(k) for k in found} == found:
                rows[name] = old
                continue
            differ.append(name)
            if not given.check:
                rows[name] = {**found, "revision": revision(page, first, last)}
    if given.check:
        differ += sorted(set(there) - set(rows) - set(differ))
        if differ:
            raise SystemExit("not as recorded: " + "; ".join(differ))
        return
    common.write_rows(RECORD, rows)


if __name__ == "__main__":
    main()
