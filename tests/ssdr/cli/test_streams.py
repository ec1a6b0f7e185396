"""Standard streams that are closed, full or of few characters: the work is done all the same."""

from __future__ import annotations

import json
import os
import pty
import sys

import pytest

import ssdr
from helpers.command import FAKED, start, through_shell

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a POSIX shell is needed")


def _work(clip, out, *more):
    return ["-c", FAKED.format(steps=3), "decompose", clip, "-o", out, "--bones", 2, *more]


@pytest.mark.parametrize("encoding", ["cp1252", "ascii", "cp437"])
def test_a_stream_of_few_characters_gets_others(encoding, clip, tmp_path):
    """`√` and `×` ended the command with exit code 1, after the work."""
    out = tmp_path / "a.npz"
    process = start(_work(clip, out), environment={"PYTHONIOENCODING": encoding}, encoding="cp437")
    text, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    root = "√" if encoding == "cp437" else "sqrt"
    assert f"RMSE / {root}3" in text
    assert ssdr.load_skinning(out).n_bones == 2


def test_a_name_that_is_no_text_is_printed_with_its_bytes(clip, tmp_path):
    odd = os.fsencode(tmp_path) + b"/\xff\xfe.npz"
    os.link(clip, odd)
    process = start(["-m", "ssdr", "info", os.fsdecode(odd)])
    text, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")
    assert "\\udcff\\udcfe.npz: a sequence" in text


@pytest.mark.parametrize(
    ("closed", "more"),
    [
        (">&-", ()),
        ("2>&-", ("--json",)),
        ("2>&-", ()),
        ("<&- >&- 2>&-", ("--json",)),
        ("2>/dev/full", ()),
    ],
)
def test_a_closed_stream_does_not_end_the_work(closed, more, clip, tmp_path):
    out = tmp_path / "a.npz"
    process = through_shell(closed, _work(clip, out, *more))
    text, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert ssdr.load_skinning(out).n_bones == 2
    if ">&-" not in closed.split():
        assert json.loads(text)["bones"] == 2 if more else "2 bones" in text
    if closed == ">&-":
        assert "Exception" not in err


@pytest.mark.parametrize("more", [(), ("--json",)])
def test_a_full_device_is_named_and_files_stay(more, clip, tmp_path):
    out = tmp_path / "a.npz"
    process = through_shell(
        ">/dev/full", _work(clip, out, "--checkpoint", tmp_path / "s.npz", *more)
    )
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert err.splitlines()[-1] == "ssdr: error: standard output: No space left on device"
    assert "Traceback" not in err
    assert ssdr.load_skinning(out).n_bones == 2
    for command in (["info", clip], ["info", tmp_path / "none.npz"], ["--help"]):
        process = through_shell(">/dev/full", ["-m", "ssdr", *command, *more])
        _, err = process.communicate(timeout=60)
        assert process.returncode in (1, 2)
        assert len(err.splitlines()) == 1, err
        assert err.startswith("ssdr: error: ")


def test_a_reader_that_has_gone_loses_no_work(clip, tmp_path):
    read, write = os.pipe()
    os.close(read)
    out = tmp_path / "a.npz"
    process = start(_work(clip, out), stdout=write)
    os.close(write)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert "Exception" not in err
    assert out.exists()


def test_a_terminal_of_latin_letters_shows_progress(clip, tmp_path):
    leader, follower = pty.openpty()
    process = start(
        _work(clip, tmp_path / "a.npz"),
        stderr=follower,
        environment={"PYTHONIOENCODING": "latin-1", "TERM": "xterm"},
        encoding="latin-1",
    )
    os.close(follower)
    text, _ = process.communicate(timeout=60)
    seen = b""
    with open(leader, "rb", buffering=0) as terminal:
        try:
            while block := terminal.read(4096):
                seen += block
        except OSError:  # how a terminal ends
            pass
    assert process.returncode == 0, seen
    assert b"Traceback" not in seen
    assert "sqrt3" in text
