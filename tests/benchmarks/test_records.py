"""Records are of one revision; pages state what is in them; a run goes from cases to pages."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks import bench, common, record
from benchmarks.record import Record
from benchmarks.tools import pages

DOCS = common.ROOT / "docs"
PAGES = [
    common.ROOT / "README.md",
    *(DOCS / f"{name}.md" for name in ("benchmarks", "how-to-choose", "leaderboard")),
]
# what is not prose, and what a record has
RECORDED = re.compile(
    r"<!-- (\w+) -->.*?<!-- end \1 -->|<!--\w[\w ]*-->.*?<!--/-->"
    r"|^```.*?^```$|`[^`]*`|doi:\S+|\(http[^)]*\)",
    re.DOTALL | re.MULTILINE,
)
# a number with a decimal point, or with a unit that something is measured in
FIGURE = re.compile(
    r"\d[\d,]*\.\d+(?:e-?\d+)?"
    r"|\d[\d,.]*(?:e-?\d+)? ?(?:%|°|m?s\b|mm\b|seconds|minutes|hours|times|[GMK]i?B\b|GFLOP)"
)
# What the pages state that nobody measured here: limits, definitions, figures of others.
STATED = {
    "README.md": {"1 %", "3.11", "3.13"},
    "benchmarks.md": {"0.13", "100 times", "1 %"},
    "how-to-choose.md": {"1000 times", "0.05", "20°", "0.01", "10°"},
    "leaderboard.md": {"5.65", "10.75", "4.80", "8.26"},
}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_figure_of_a_page_is_in_a_record_or_stated(page: Path) -> None:
    prose = RECORDED.sub("", page.read_text("utf-8"))
    found = {figure.strip() for figure in FIGURE.findall(prose)}
    assert found == STATED[page.name]


@pytest.mark.parametrize("page", pages.PAGES, ids=lambda page: page.name)
def test_marks_of_a_page_are_known_and_what_they_hold_is_up_to_date(page: Path) -> None:
    text = page.read_text("utf-8")
    assert set(re.findall(r"<!-- (\w+) -->", text)) <= set(pages.BLOCKS)
    names = set(re.findall(r"<!--(\w[\w ]*)-->", text))
    # a comment that begins a line would begin a block of HTML, whose Markdown is not read
    assert re.findall(r"^ *<!--\w.*", text, re.MULTILINE) == []
    if pages.results("bench").rows:
        assert names <= set(pages.figures())
    assert pages.renew(text) == text, "run benchmarks/tools/pages.py"


def test_a_record_is_of_one_revision_and_one_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "rows.json"
    monkeypatch.setattr(record, "revision", lambda: "aaaa")
    first = Record.open(path)
    first.add("one", {"E": 1.0})
    first.add("two", {"E": 2.0})
    again = Record.open(path)
    assert (again.rows, again.revision) == ({"one": {"E": 1.0}, "two": {"E": 2.0}}, "aaaa")
    assert again.machine["gemm_1"] > 0
    monkeypatch.setattr(record, "revision", lambda: "bbbb")
    with pytest.raises(SystemExit, match=r"rows.json is of revision aaaa, this is bbbb.*ANEW=1"):
        Record.open(path)
    assert Record.open(path, anew=True).rows == {}
    monkeypatch.setattr(record, "revision", lambda: "aaaa")
    monkeypatch.setattr(record, "_identity", lambda: {"cpu": "another"})
    with pytest.raises(SystemExit, match="is of machine"):
        Record.open(path)
    monkeypatch.setattr(record, "revision", lambda: "aaaa+")
    monkeypatch.setattr(record, "RESULTS", tmp_path)
    with pytest.raises(SystemExit, match="not committed"):
        Record.open(path, anew=True)


def test_a_job_is_measured_once_and_the_longest_group_first() -> None:
    a, b, c = (bench.job("ssdr fast", "ea_bone", bones) for bones in (3, 4, 5))
    done = {bench.key_of(a): {"E": 1.0}, bench.key_of(b): {"failed": "hung"}}
    before = {bench.key_of(b): {"cpu": 1.0}, bench.key_of(c): {"cpu": 9.0}}
    assert bench.planned([[a, b], [b, c]], done, before) == [[c], [b]]
    keys = [bench.key_of(job) for group in bench.races() for job in group]
    assert len(keys) == len(set(keys)) == len(bench.NINE) * len(bench.RACERS)


@pytest.mark.slow
def test_a_run_from_cases_to_chart_and_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    own = str(common.ROOT / "benchmarks" / "leaderboard" / "example_solver.py")
    monkeypatch.setattr(bench, "NINE", [("dancer_small", 4)])
    monkeypatch.setattr(bench, "RACERS", ("2012", "ssdr fast"))
    monkeypatch.setattr(bench, "require", lambda jobs: None)  # no data, no Dem Bones

    def run(*more: str) -> Record:
        monkeypatch.setattr(sys, "argv", ["bench.py", "--out", str(tmp_path), *more])
        bench.main()
        return Record(tmp_path / "bench.json")

    before = run("--solver", own)
    assert [row.get("failed") for row in before.rows.values()] == [None] * 3
    row: dict[str, Any] = before.rows[f"dancer_small-4 K4 {own}"]
    assert row["defects"] == []
    assert row["gemm"] > 0
    assert own in capsys.readouterr().out
    assert (tmp_path / "race.png").stat().st_size > 10_000
    (tmp_path / "race.png").unlink()
    assert run("--solver", own).rows == before.rows  # nothing is measured again
    assert (tmp_path / "race.png").is_file()
