"""The record of the pages' tables."""

from benchmarks.garment.figures import commands, tables

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
