"""Compiled code on disk: a damaged file is compiled anew, and each signature has its own."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

SOURCE = """
from ssdr.kernels.policy import kernel

@kernel
def twice(x):
    return 2 * x[0]
"""


def twice(folder: Path) -> Any:
    """The kernel as a process that starts finds it."""
    spec: Any = importlib.util.spec_from_file_location("own_kernel", folder / "own_kernel.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.twice


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[: len(data) // 2],
        lambda data: data[:-40] + bytes([data[-40] ^ 1]) + data[-39:],
        lambda data: data[:40] + bytes([data[40] ^ 1]) + data[41:],
    ],
)
def test_damaged_code_is_compiled_anew(damage: Any, tmp_path: Path) -> None:
    (tmp_path / "own_kernel.py").write_text(SOURCE)
    kinds = (np.float64, np.float32)
    for kind in kinds:
        assert twice(tmp_path)(np.ones(1, kind)) == 2
    files = sorted(tmp_path.rglob("*.nbc"))
    assert len(files) == len(kinds)
    assert not list(tmp_path.rglob("*.nbi"))
    sound = {path: path.read_bytes() for path in files}
    for path, data in sound.items():
        path.write_bytes(damage(data))
    for kind in kinds:
        again = twice(tmp_path)
        assert again(np.full(1, 3, kind)) == 6
        assert sum(again.stats.cache_misses.values()) == 1
        loaded = twice(tmp_path)
        assert loaded(np.full(1, 3, kind)) == 6
        assert sum(loaded.stats.cache_hits.values()) == 1


def test_code_of_other_sources_is_not_used(tmp_path: Path) -> None:
    (tmp_path / "own_kernel.py").write_text(SOURCE)
    assert twice(tmp_path)(np.ones(1)) == 2
    (tmp_path / "own_kernel.py").write_text(SOURCE.replace("2 *", "5 * 1 *"))
    assert twice(tmp_path)(np.ones(1)) == 5
