"""Every public function and class has an example in its docstring that runs as it stands."""

from __future__ import annotations

import doctest
import importlib
import inspect
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr

_MODULES = (
    "common.errors",
    "io",
    "io.samples",
    "laplacian",
    "metrics",
    "parsimony",
    "model.rigid",
    "show",
)
# What functions hand back; docs/api/results.md names them.
_RESULTS = (
    ("ssdr.search.progress", "Progress"),
    ("ssdr.search.progress", "Record"),
    ("ssdr.fit.fit", "Fit"),
    ("ssdr.fit.fit_bones", "BoneFit"),
    ("ssdr.show.page.page", "Page"),
)


def _documented() -> dict[str, Any]:
    """Functions and classes by name, each once; type aliases, tables and modules need none."""
    names = [("ssdr", name) for name in ssdr.__all__]
    for module in _MODULES:
        home = f"ssdr.{module}"
        names += [(home, name) for name in importlib.import_module(home).__all__]
    things: dict[str, Any] = {}
    for home, name in (*names, *_RESULTS):
        thing = getattr(importlib.import_module(home), name)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            things.setdefault(f"{thing.__module__}.{thing.__qualname__}", thing)
    return things


_THINGS = _documented()


def _examples(name: str) -> list[doctest.DocTest]:
    finder = doctest.DocTestFinder(recurse=False)
    return finder.find(_THINGS[name], name, globs={"ssdr": ssdr, "np": np})


@pytest.mark.parametrize("name", sorted(_THINGS))
def test_has_an_example_that_runs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # where examples write
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    tests = _examples(name)
    assert any(test.examples for test in tests)
    for test in tests:
        runner.run(test)
    assert runner.summarize(verbose=False).failed == 0
