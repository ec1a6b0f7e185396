"""The shell completes commands and options."""

from __future__ import annotations

import pytest

from ssdr import cli

INSTRUCTIONS = {
    "bash": ("COMP_WORDS", {"COMP_CWORD": "-1"}),
    "zsh": ("_TYPER_COMPLETE_ARGS", {}),
    "fish": ("_TYPER_COMPLETE_ARGS", {"_TYPER_COMPLETE_FISH_ACTION": "get-args"}),
}


@pytest.mark.parametrize("shell", INSTRUCTIONS)
def test_the_shell_completes_commands_and_options(
    shell: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def complete(words: str) -> str:
        name, more = INSTRUCTIONS[shell]
        last = str(len(words.split()) - 1)
        more = {k: v.replace("-1", last) for k, v in more.items()}
        for key, value in ({"_SSDR_COMPLETE": f"complete_{shell}", name: words} | more).items():
            monkeypatch.setenv(key, value)
        with pytest.raises(SystemExit):
            cli.main([])
        return capsys.readouterr().out

    commands = complete("ssdr dec")
    assert "decompose" in commands
    assert "convert" not in commands
    assert "--tolerance" in complete("ssdr smallest --to")
