"""Standard streams that are full, whose reader has gone, or that lack characters."""

from __future__ import annotations

import os
import pty
import sys

import pytest

import ssdr
from helpers.command import faked, start, through_shell

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a POSIX shell is needed")


def _work(clip, out, *more):
    return [*faked(), "decompose", clip, "-o", out, "--bones", 2, *more]


def test_a_name_that_the_encoding_lacks_is_printed_with_escapes(clip, tmp_path):
    odd = os.fsencode(tmp_path) + b"/\xff\xc3\xa9.npz"
    os.link(clip, odd)
    for encoding, name in (("ascii", "\\udcff\\xe9.npz"), ("utf-8", "\\udcffé.npz")):
        environment = {"PYTHONIOENCODING": encoding}
        process = start(["-m", "ssdr", "info", os.fsdecode(odd)], environment=environment)
        text, err = process.communicate(timeout=60)
        assert (process.returncode, err) == (0, "")
        assert f"{name}: a sequence" in text


def test_messages_that_a_full_device_does_not_take_are_dropped(clip, tmp_path):
    out = tmp_path / "a.npz"
    process = through_shell("2>/dev/full", _work(clip, out))
    text, _ = process.communicate(timeout=60)
    assert (process.returncode, "2 bones" in text) == (0, True)
    assert ssdr.load_skinning(out).n_bones == 2


@pytest.mark.parametrize("more", [(), ("--json",)])
def test_a_result_that_a_full_device_does_not_take_is_an_error(more, clip, tmp_path):
    out = tmp_path / "a.npz"
    process = through_shell(">/dev/full", _work(clip, out, *more))
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert err.splitlines()[-1] == "ssdr: error: standard output: No space left on device"
    assert "Traceback" not in err
    assert ssdr.load_skinning(out).n_bones == 2
    process = through_shell(">/dev/full", ["-m", "ssdr", "info", tmp_path / "none.npz", *more])
    _, err = process.communicate(timeout=60)
    assert (process.returncode, len(err.splitlines())) == (2, 1)


def test_a_reader_that_has_gone_loses_no_work(clip, tmp_path):
    out = tmp_path / "a.npz"
    for words, code in ((_work(clip, out), 0), (["-m", "ssdr", "info", clip], 1)):
        read, write = os.pipe()
        os.close(read)
        process = start(words, stdout=write)
        os.close(write)
        _, err = process.communicate(timeout=60)
        assert (process.returncode, err.replace("solving\n", "")) == (code, "")
    assert out.exists()


def test_progress_on_a_terminal(clip, tmp_path):
    leader, follower = pty.openpty()
    variables = {"PYTHONIOENCODING": "latin-1", "TERM": "xterm"}
    process = start(
        [*faked(20, 0.05), "decompose", clip, "-o", tmp_path / "a.npz", "--bones", 2],
        stderr=follower,
        environment=variables,
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
    assert b"alternate" in seen
    assert b"RMSE" in seen
    assert b"Traceback" not in seen
    assert "2 bones" in text
