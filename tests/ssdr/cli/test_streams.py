"""Standard streams that are full, whose reader has gone, or that lack characters."""

from __future__ import annotations

import io
import os
import sys

import pytest

import ssdr
from helpers import command
from ssdr import cli

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="devices of a POSIX system")


@pytest.fixture
def printed(monkeypatch):
    """Run the command with its own stdout or stderr; the exit code."""

    def call(name, stream, *arguments):
        monkeypatch.setattr(sys, name, stream)
        return cli.main([str(a) for a in arguments])

    return call


@pytest.mark.parametrize(
    ("encoding", "name"), [("ascii", "\\udcff\\xe9.npz"), ("utf-8", "\\udcff\xe9.npz")]
)
def test_a_name_that_the_encoding_lacks_is_printed_with_escapes(
    printed, clip, tmp_path, encoding, name
):
    odd = os.fsencode(tmp_path) + b"/\xff\xc3\xa9.npz"
    os.link(clip, odd)
    text = io.BytesIO()
    stream = io.TextIOWrapper(text, encoding=encoding)
    assert printed("stdout", stream, "info", os.fsdecode(odd)) == 0
    assert f"{name}: a sequence" in text.getvalue().decode(encoding)


@pytest.mark.usefixtures("faked")
def test_messages_that_a_full_device_does_not_take_are_dropped(printed, clip, tmp_path):
    with open("/dev/full", "w", buffering=1) as full:
        words = ("-v", "decompose", clip, "-b", 2, "-o", tmp_path / "a.npz")
        assert printed("stderr", full, *words) == 0
    assert ssdr.load_skinning(tmp_path / "a.npz").n_bones == 2


@pytest.mark.slow
@pytest.mark.parametrize("more", [(), ("--json",)])
def test_a_result_that_a_full_device_does_not_take_is_an_error(more, clip, tmp_path):
    out = tmp_path / "a.npz"
    work = [*command.faked(), "decompose", clip, "-o", out, "--bones", 2, *more]
    process = command.through_shell(">/dev/full", work)
    _, err = process.communicate(timeout=600)
    assert process.returncode == 1
    assert err.splitlines()[-1] == "ssdr: error: standard output: No space left on device"
    assert "Traceback" not in err
    assert ssdr.load_skinning(out).n_bones == 2
    process = command.through_shell(
        ">/dev/full", ["-m", "ssdr.cli", "info", tmp_path / "none.npz", *more]
    )
    _, err = process.communicate(timeout=600)
    assert (process.returncode, len(err.splitlines())) == (2, 1)


@pytest.mark.slow
def test_a_reader_that_has_gone_loses_no_work(clip, tmp_path):
    work = [*command.faked(), "decompose", clip, "-o", tmp_path / "a.npz", "--bones", 2]
    for words, code in ((work, 0), (["-m", "ssdr.cli", "info", clip], 1)):
        read, write = os.pipe()
        os.close(read)
        process = command.start(words, stdout=write)
        os.close(write)
        _, err = process.communicate(timeout=600)
        assert (process.returncode, err.replace("solving\n", "")) == (code, "")
    assert (tmp_path / "a.npz").exists()


@pytest.mark.slow
def test_streams_that_are_closed_lose_no_work(clip, tmp_path):
    """As cron and pythonw start programs; a file must not get the number of a closed stream."""
    for k, closed in enumerate(("2>&-", ">&-", ">&- 2>&- <&-")):
        out = tmp_path / f"{k}.npz"
        work = [*command.faked(), "decompose", clip, "-o", out, "--bones", 2]
        process = command.through_shell(closed, work)
        process.communicate(timeout=600)
        assert process.returncode == 0, closed
        assert ssdr.load_skinning(out).n_bones == 2
