"""The reference names what there is, no more and no less; the solver's pages run as they stand."""

from __future__ import annotations

import inspect
import re
import warnings
from pathlib import Path

import pytest

import ssdr

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = ["decompose.md", "parsimony.md", "sequence.md", "skinning.md", "rigid.md", "parallel.md"]
_ROW = re.compile(r"^\| `([^`]+)` \| (.*) \|$", re.MULTILINE)


def _rows(section: str) -> dict[str, str]:
    text = (DOCS / "api.md").read_text(encoding="utf-8")
    return dict(_ROW.findall(text.partition(f"## {section}\n")[2].partition("\n## ")[0]))


def _signature(function: object) -> str:
    parts, star = [], False
    for p in inspect.signature(function).parameters.values():  # type: ignore[arg-type]
        if p.kind is p.VAR_KEYWORD:
            continue
        if p.kind is p.KEYWORD_ONLY and not star:
            parts.append("*")
            star = True
        parts.append(p.name)
    return f"({', '.join(parts)})"


def test_every_public_name_has_its_entry() -> None:
    named = {entry.partition("(")[0] for entry in [*_rows("`ssdr`"), *_rows("Modules")]}
    assert named == set(ssdr.__all__)
    assert all(text.strip() for text in [*_rows("`ssdr`").values(), *_rows("Modules").values()])


def test_entries_have_the_parameters_that_functions_take() -> None:
    checked = 0
    for entry in _rows("`ssdr`"):
        thing = getattr(ssdr, entry.partition("(")[0])
        if inspect.isfunction(thing):
            assert entry == thing.__name__ + _signature(thing)
            checked += 1
        else:
            assert "(" not in entry
    assert checked >= 12


@pytest.mark.parametrize("name", [n for n in ssdr.__all__ if inspect.ismodule(getattr(ssdr, n))])
def test_entries_of_modules_name_what_they_export(name: str) -> None:
    said = set(re.findall(r"`(\w+)`", _rows("Modules")[name]))
    exported = set(getattr(ssdr, name).__all__)
    if name == "errors":  # the table above has them
        assert exported <= {entry.partition("(")[0] for entry in _rows("`ssdr`")}
    else:
        assert said == exported


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_snippets_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = (DOCS / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert blocks
    names: dict[str, object] = {"__name__": "__main__"}
    try:
        for block in blocks:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                exec(compile(block, page, "exec"), names)
    finally:
        ssdr.set_threads(None)
