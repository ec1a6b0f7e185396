"""Memory so small that test data count as larger than it."""

from __future__ import annotations

import pytest

from ssdr.mesh import executor
from ssdr.search import scan


@pytest.fixture
def tiny_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything counts as too large; some eighty frames are chosen, forty by what they tell."""
    monkeypatch.setattr(scan, "_IN_MEMORY", 1)
    monkeypatch.setattr(scan, "_MOST_SPREAD", 80)
    monkeypatch.setattr(scan, "_FEWEST", 40)
    monkeypatch.setattr(scan, "_MOST", 40)
    monkeypatch.setattr(executor, "_BLOCK", 24 * 200 * 7)
    monkeypatch.setattr(executor, "_SPANS", 4)
