"""What the leaderboard's tests share: its scripts as commands, data that may not be here."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import common

BOARD = common.ROOT / "benchmarks" / "leaderboard"
EXAMPLE = BOARD / "example_solver.py"


def run(script: Path, *words: str, data: Path | None = None) -> subprocess.CompletedProcess[str]:
    settings = {"PYTHONPATH": str(common.ROOT)} | ({"SSDR_TEST_DATA": str(data)} if data else {})
    return subprocess.run(
        [sys.executable, str(script), *words],
        capture_output=True,
        text=True,
        timeout=600,
        env=os.environ | settings,
    )


def needs(name: str) -> np.ndarray:
    if not common.sequence_file(name).is_file():
        pytest.skip(f"no data for {name}")
    return common.load(name)[0]
