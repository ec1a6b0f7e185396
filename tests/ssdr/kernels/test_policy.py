"""Machine code that ships is used for what it was compiled for, and for nothing else."""

from __future__ import annotations

import importlib.machinery
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from ssdr.kernels import policy


def add(x: Any, by: float) -> None:
    """A kernel, as Python runs it."""
    for i in range(x.shape[0]):
        x[i] += by


@pytest.fixture
def ready(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The kernel, with something else as its machine code for arrays of float64."""
    codes = {f"{__name__}.add d1 -": lambda x, by: "shipped", f"{__name__}.add2 d1 -": None}
    monkeypatch.setattr(policy, "SHIPPED", codes)
    return policy.Ready(add, numba.njit)


def test_code_that_ships_serves_the_types_that_it_was_compiled_for(ready: Any) -> None:
    for by in (1.0, 1, np.float64(1.0)):
        assert ready(np.zeros(3), by) == "shipped"
    assert ready(np.zeros(3).view(np.memmap), 1.0) == "shipped"


@pytest.mark.parametrize(
    "x",
    [
        np.zeros(3, dtype=np.float32),
        np.zeros(3, dtype=np.int64),
        np.zeros(6)[::2],
        np.zeros((3, 2)),
        np.zeros(25, dtype=np.uint8)[1:].view(np.float64),
    ],
    ids=["float32", "int64", "stride", "2-D", "unaligned"],
)
def test_numba_compiles_for_all_other_types(ready: Any, x: Any) -> None:
    assert ready(x, 1.0) is None
    assert (x == 1).all()
    assert len(ready.dispatcher.signatures) == 1


def test_big_endian_numbers_are_refused_as_by_numba(ready: Any) -> None:
    with pytest.raises(numba.core.errors.NumbaError):
        ready(np.zeros(3, dtype=">f8"), 1.0)


def test_other_kernels_call_it_as_what_numba_compiles(ready: Any) -> None:
    @numba.njit
    def twice(x: Any) -> None:
        ready(x, 1.0)
        ready(x, 2.0)

    x = np.zeros(3)
    twice(x)
    assert (x == 3).all()


def test_code_of_other_sources_or_that_does_not_load_is_left_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    source = tmp_path / "one.py"
    source.write_text("a = 1")
    monkeypatch.setattr(policy, "__file__", str(tmp_path / "policy.py"))
    file = policy.code_file("baseline")
    assert file.parent == tmp_path
    assert file.name.startswith("baseline_")
    assert file.name.endswith(importlib.machinery.EXTENSION_SUFFIXES[0])
    file.write_bytes(b"no machine code")
    assert policy._load() == {}
    source.write_text("a = 2")
    assert policy.code_file("baseline") != file
