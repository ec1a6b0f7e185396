"""Fixtures of the command's tests."""

from __future__ import annotations

import json

import pytest

import ssdr
from helpers.command import fake_decompose
from ssdr import cli


@pytest.fixture
def faked(monkeypatch):
    # Into the dictionary: the name is lazy, and setattr would import the solver.
    monkeypatch.setitem(vars(ssdr), "decompose", fake_decompose)


@pytest.fixture
def never(monkeypatch):
    """Neither a file is read nor the solver called."""

    def fail(*_, **__):
        raise AssertionError("the work has started")

    monkeypatch.setitem(vars(ssdr), "decompose", fail)
    return fail


@pytest.fixture
def run(capsys):
    """Run the command in this process; exit code, stdout and stderr."""

    def call(*arguments):
        code = cli.main([str(a) for a in arguments])
        out, err = capsys.readouterr()
        return code, out, err

    return call


@pytest.fixture
def done(run):
    """Run the command, which must not fail; its JSON object."""

    def call(*arguments):
        code, out, err = run(*arguments, "--json")
        assert code == 0, out + err
        return json.loads(out)

    return call


@pytest.fixture
def refused(run):
    """Run the command, which must refuse its arguments; the line on stderr."""

    def call(*arguments, code=2):
        found, out, err = run(*arguments)
        assert (found, out) == (code, ""), (arguments, err)
        assert "Traceback" not in err
        return err

    return call


@pytest.fixture
def clip(wave, tmp_path):
    path = tmp_path / "clip.npz"
    ssdr.save(wave, path)
    return path
