"""The command as a whole: help, exit codes, errors as JSON, samples."""

from __future__ import annotations

import json
import re

import pytest

import ssdr
from helpers.command import start

COMMANDS = ("decompose", "smallest", "info", "compare", "convert", "render")


def test_help_version_and_usage(run, refused):
    assert run("--version")[:2] == (0, f"ssdr {ssdr.__version__}\n")
    for arguments in ((), ("--help",)):
        code, out, _ = run(*arguments)
        assert code == 0
        assert all(name in out for name in (*COMMANDS, "Exit codes"))
    assert "--bones" in refused("decompose", "a.npz", "--bones", "0", "-o", "b.npz")
    err = refused("decompose", "a.npz", "-b", "1", "-o", "b.npz", "--bone-model", "rubber")
    assert "'rigid'" in err
    assert "'affine'" in err


@pytest.mark.parametrize("command", COMMANDS[:2])
def test_options_stand_in_panels(run, command):
    code, out, _ = run(command, "--help")
    assert code == 0
    titles = re.findall(r"[-─] (\w+) [-─]", out)
    assert titles == ["Arguments", "Options", "Model", "Rig", "Run", "Files"]
    assert len(set(re.findall(r"^\W+(--[\w-]+)", out, re.MULTILINE)) - {"--help"}) <= 26


def test_exit_codes_and_json_of_errors(run, refused, tmp_path, monkeypatch):
    bad = tmp_path / "bad.npz"
    bad.write_bytes(b"not a zip archive")
    code, out, err = run("info", bad, "--json")
    assert (code, err) == (3, "")
    document = json.loads(out)
    assert (document["kind"], document["exit_code"]) == ("FormatError", 3)
    assert "bad.npz" in document["error"]
    missing = tmp_path / "none.npz"
    assert refused("info", missing) == f"ssdr: error: {missing}: no such file\n"
    for command in (["info"], ["compare", ssdr.samples.path("dancer_small")]):
        assert "File name too long" in refused(*command, "9" * 300 + ".npz")

    def fall(error):
        def read_any(*_, **__):
            raise error

        monkeypatch.setattr("ssdr.cli.info.read_any", read_any)

    fall(ZeroDivisionError("oh"))
    assert "unexpected ZeroDivisionError: oh" in refused("info", bad, code=1)
    fall(KeyboardInterrupt())
    assert refused("info", bad, code=130) == "ssdr: interrupted\n"


def test_log_and_threads_are_options_of_the_program(run, refused, clip, monkeypatch):
    counts = []
    monkeypatch.setattr("ssdr.cli.app.set_threads", counts.append)
    assert run("info", clip)[2] == ""
    weld = ("info", clip, "--read", "weld=true")
    assert "INFO ssdr.io.load_save: " in run("-v", "--threads", 3, *weld)[2]
    assert counts == [3]
    assert run(*weld)[2] == ""
    assert "-v" in refused("info", clip, "-v")
    assert "weld: expected" in refused("info", clip, "--read", "weld=yes")


def test_a_sample_is_given_by_name(done, refused):
    found = done("info", "sample:dancer_small")
    assert (found["input"], found["frames"]) == (str(ssdr.samples.path("dancer_small")), 24)
    assert "one of dancer, dancer_small" in refused("info", "sample:nobody")


def test_a_process_of_its_own_without_a_display(clip, tmp_path):
    process = start(["-m", "ssdr", "render", clip, "-o", tmp_path / "a.png", "--width", 300])
    out, err = process.communicate(timeout=600)
    assert (process.returncode, err) == (0, "")
    assert "a.png" in out
