"""Fixtures of the command's tests."""

from __future__ import annotations

import pytest

import ssdr
from helpers.command import FakeState, fake_decompose
from ssdr import cli


@pytest.fixture
def faked(monkeypatch):
    # Into the dictionary: the names are lazy, and setattr would import the solver.
    monkeypatch.setitem(vars(ssdr), "decompose", fake_decompose)
    monkeypatch.setitem(vars(ssdr), "SolverState", FakeState)


@pytest.fixture
def run(capsys):
    """Run the command in this process; exit code, stdout and stderr."""

    def call(*arguments):
        code = cli.main([str(a) for a in arguments])
        out, err = capsys.readouterr()
        return code, out, err

    return call


@pytest.fixture
def clip(wave, tmp_path):
    path = tmp_path / "clip.npz"
    ssdr.save(wave, path)
    return path
