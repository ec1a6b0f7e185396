"""The shell completes commands and options."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
INSTRUCTIONS = {
    "bash": ("COMP_WORDS", {"COMP_CWORD": "-1"}),
    "zsh": ("_TYPER_COMPLETE_ARGS", {}),
    "fish": ("_TYPER_COMPLETE_ARGS", {"_TYPER_COMPLETE_FISH_ACTION": "get-args"}),
}


def complete(shell: str, words: str) -> str:
    name, more = INSTRUCTIONS[shell]
    more = {k: str(len(words.split()) - 1) if v == "-1" else v for k, v in more.items()}
    done = subprocess.run(
        [sys.executable, "-m", "ssdr"],
        env={**os.environ, "_SSDR_COMPLETE": f"complete_{shell}", name: words, **more},
        cwd=ROOT, capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    return done.stdout


@pytest.mark.parametrize("shell", sorted(INSTRUCTIONS))
def test_the_shell_completes_commands_and_options(shell: str) -> None:
    commands = complete(shell, "ssdr dec")
    assert "decompose" in commands
    assert "convert" not in commands
    assert "--tolerance" in complete(shell, "ssdr smallest --to")
