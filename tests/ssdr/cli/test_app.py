"""The command as a whole: help, exit codes, errors as JSON."""

from __future__ import annotations

import json

import ssdr
from helpers.command import start


def test_help_version_and_usage(run):
    code, out, _ = run("--help")
    assert code == 0
    for name in ("decompose", "info", "compare", "convert", "render", "Exit codes"):
        assert name in out
    assert run("--version")[:2] == (0, f"ssdr {ssdr.__version__}\n")
    code, out, err = run()
    assert (code, out) == (2, "")
    assert err.startswith("Usage: ssdr")
    code, out, err = run("decompose", "a.npz", "--bones", "0", "-o", "b.npz")
    assert (code, out) == (2, "")
    assert "--bones" in err
    code, _, err = run("decompose", "a.npz", "-b", "1", "-o", "b.npz", "--bone-model", "rubber")
    assert code == 2
    assert "'rigid'" in err
    assert "'affine'" in err
    assert "Traceback" not in err


def test_exit_codes_and_json_of_errors(run, tmp_path, monkeypatch):
    bad = tmp_path / "bad.npz"
    bad.write_bytes(b"not a zip archive")
    code, out, err = run("info", bad, "--json")
    assert (code, err) == (3, "")
    document = json.loads(out)
    assert document["kind"] == "FormatError"
    assert document["exit_code"] == 3
    assert "bad.npz" in document["error"]
    code, out, err = run("info", tmp_path / "none.npz")
    assert (code, out) == (2, "")
    assert err == f"ssdr: error: {tmp_path / 'none.npz'}: no such file\n"

    def fall(*_, **__):
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("ssdr.cli.inspecting.read_any", fall)
    code, out, err = run("info", bad)
    assert (code, out) == (1, "")
    assert "unexpected ZeroDivisionError: oh" in err
    assert "Traceback" not in err

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("ssdr.cli.inspecting.read_any", interrupt)
    assert run("info", bad)[0] == 130


def test_a_process_of_its_own_without_a_display(clip, tmp_path):
    process = start(["-m", "ssdr", "render", clip, "-o", tmp_path / "a.png", "--width", 300])
    out, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, "")
    assert "a.png" in out
    process = start(["-m", "ssdr", "info", tmp_path / "none.npz"])
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, "")
    assert "Traceback" not in err


def test_a_name_that_no_file_can_have_is_wrong_input(run):
    for command in (["info"], ["compare", ssdr.samples.path("dancer_small")]):
        code, out, err = run(*command, "9" * 300 + ".npz")
        assert (code, out) == (2, "")
        assert "File name too long" in err
