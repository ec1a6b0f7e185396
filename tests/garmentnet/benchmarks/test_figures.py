"""The record of the pages' tables."""

import itertools
import re

import pytest

from benchmarks.common import ROOT
from benchmarks.garment.figures import PAGES, commands, tables

PAGE = """# Page

## One

```sh
# needs: a comment, no heading
garmentnet train rooted \\
    --store a.clips
```

| a | b |
|---|---|
| 1 | 2 |

## Two

By `python benchmarks/garment/cuts.py --frames 3`:

| c |
|---|
| 3 |
"""


def test_tables_have_their_section_and_place():
    first, second = tables(PAGE)
    assert (first.section, first.first, first.lines[-1]) == ("One", 11, "| 1 | 2 |")
    assert (second.section, second.lines) == ("Two", ["| c |", "|---|", "| 3 |"])
    assert PAGE.splitlines()[second.first - 1] == "| c |"


def test_commands_of_a_section():
    assert commands(PAGE) == {
        "One": ["garmentnet train rooted --store a.clips"],
        "Two": ["python benchmarks/garment/cuts.py --frames 3"],
    }


@pytest.mark.parametrize("page", PAGES)
def test_commands_of_the_pages_exist(page):
    typer = pytest.importorskip("typer")
    pytest.importorskip("torch")
    from garmentnet.cli.app import app

    known = typer.main.get_command(app).commands
    text = (ROOT / "docs" / f"{page}.md").read_text("utf-8")
    found = list(itertools.chain(*commands(text).values()))
    assert found
    for command in found:
        asked = set(re.findall(r"(?<=\s)--?[a-z][a-z-]*", command.partition(" #")[0]))
        if command.startswith("python"):
            source = (ROOT / command.split()[1].rstrip(")`")).read_text("utf-8")
            there = set(re.findall(r'"(--?[a-z-]+)"', source))
        else:
            there = {
                o for p in known[command.split()[1]].params for o in (*p.opts, *p.secondary_opts)
            }
        assert asked <= there, command
