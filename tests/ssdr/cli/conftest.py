"""Fixtures of the command's tests."""

from __future__ import annotations

import dataclasses
import json

import pytest

import ssdr
from helpers.command import fake_decompose
from helpers.rig_model import tube
from ssdr import Clip, cli


@pytest.fixture
def faked(monkeypatch):
    # Into the dictionary: the name is lazy, and setattr would import the solver.
    monkeypatch.setitem(vars(ssdr), "decompose", fake_decompose)


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
def clip(wave, tmp_path):
    path = tmp_path / "clip.npz"
    ssdr.save(wave, path)
    return path


@pytest.fixture
def rigged(tmp_path):
    """A model with clips of two frame rates."""
    clips = (Clip("walk", 0, 9, 24.0), Clip("jump", 9, 19, 60.0))
    model = tube(bones=3, frames=19, rings=7, sides=6)
    model = dataclasses.replace(model, clips=clips, surface=None, name="horse")
    ssdr.save(model, tmp_path / "rigged.glb")
    return tmp_path / "rigged.glb"
