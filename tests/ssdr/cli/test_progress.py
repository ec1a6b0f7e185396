"""Progress is shown on a terminal and nowhere else."""

from __future__ import annotations

import io
import sys

import pytest

from ssdr.cli.options import Options
from ssdr.cli.output import Output


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("stream", "options", "shown"),
    [
        (Terminal(), {}, True),
        (Terminal(), {"quiet": True}, False),
        (Terminal(), {"json": True}, False),
        (io.StringIO(), {}, False),
    ],
)
def test_a_wait_and_a_bar(stream, options, shown, monkeypatch):
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    output = Output(Options(**options))
    with output.waiting("loading a[1].abc"):
        pass
    with output.progress_bar() as show:
        show("alternate", 0.5, "RMSE 1")
    for text in ("loading a[1].abc", "alternate", "50%", "RMSE 1"):
        assert (text in stream.getvalue()) == shown
