"""Fewest bytes: affine bones, shapes or more bones in the place of the fewest rigid ones."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

import ssdr
from helpers import naive
from helpers.measures import wavy
from helpers.motions import rotation
from ssdr.parsimony import search
from ssdr.parsimony.report import Pruning
from ssdr.problem import scan
from ssdr.progress import Stop
from ssdr.quantisation import is_stored

SEED = np.random.default_rng(3)
POINTS = SEED.uniform(-1, 1, (40, 3))
TIMES = np.linspace(0, 2 * np.pi, 40)


def error(frames, model):
    rest, shapes = np.asarray(model.rest), model.shapes
    squares = 0.0
    for t in range(len(frames)):
        bent = rest + (
            0 if shapes is None else shapes.amounts[t] @ shapes.displacements.swapaxes(0, 1)
        )
        posed = naive.skin(bent, model.indices, model.weights, model.transforms[t : t + 1])[0]
        squares += ((posed - frames[t]) ** 2).sum()
    return np.sqrt(squares / frames[..., 0].size)


def stretched():
    """One affine motion of all points, which many rigid bones have to share."""
    shears = 0.25 * SEED.standard_normal((3, 3, 3))
    signals = np.stack([np.sin(TIMES), np.cos(2 * TIMES), np.sin(3 * TIMES)], axis=1)
    return POINTS @ (np.eye(3) + np.tensordot(signals, shears, 1)).swapaxes(1, 2)


def dented():
    """A body that jumps about, with two displacements that differ from vertex to vertex."""
    amounts, turns = SEED.standard_normal((2, 40, 2))
    bent = POINTS + np.tensordot(amounts, 0.3 * SEED.standard_normal((2, 40, 3)), 1)
    return np.stack([p @ rotation(*a, 0).T for p, a in zip(bent, turns, strict=True)])


@pytest.mark.parametrize(
    ("frames", "what", "kind", "storage"),
    [
        (stretched(), "affine bones", "affine", "float32"),
        (dented(), "shapes", "rigid", "uint8"),
    ],
)
def test_what_takes_fewer_bytes_is_taken_and_named(frames, what, kind, storage):
    fractions = []
    options = {"tolerance": "2%", "effort": "fast", "bones": 20, "influences": (4, storage)}
    usual = ssdr.smallest(frames, **options)
    found = ssdr.smallest(
        frames, **options, fewest="bytes", callback=lambda p: fractions.append(p.fraction)
    )
    report, change = found.parsimony, found.parsimony.prunings[1]
    assert report.held
    assert error(frames, found.skinning) <= report.tolerance
    assert report.error == pytest.approx(error(frames, found.skinning), rel=1e-4)
    assert report.size.total < 0.8 * usual.parsimony.size.total
    assert found.skinning.bone_model == kind
    assert (found.skinning.n_shapes > 0) == (what == "shapes")
    assert (change.what, change.before) == (what, usual.skinning.n_bones)
    assert change.after == found.skinning.n_bones < usual.skinning.n_bones
    assert is_stored(found.skinning.weights, storage)
    assert fractions == sorted(fractions)
    assert max(fractions) <= 1
    for one, following in itertools.pairwise(report.prunings[1:]):
        assert one.bytes_after == following.bytes_before
        assert one.error_after <= report.tolerance
    last = report.prunings[-1]
    assert (last.what, last.bytes_after) == ("keyframes", report.size.total)
    assert last.error_after == pytest.approx(report.error)
    assert len(report.attempts) > len(usual.parsimony.attempts)


def test_a_smaller_model_found_before_a_stop_is_the_result(monkeypatch):
    """And a bound that retries for a coarse file have raised is not taken for a proven one."""
    given = []

    def found(models, bounds, effort, tolerance, rigid, skinning_of_all):
        given.append((bounds, models.tolerance / tolerance))
        yield dataclasses.replace(rigid, name="smaller"), [Pruning("more bones", *[0] * 6)]
        raise Stop("time limit")

    monkeypatch.setattr(search, "fewer_bytes", found)
    monkeypatch.setattr(search, "_least_bones", lambda *_: (1, 0))
    file = {"compression": "quantized", "name": "wavy", "tolerance": "1.5%"}
    options = {"tolerance": "0.8%", "effort": "fast", "file": file, "fewest": "bytes"}
    result = ssdr.smallest(wavy(), **options)
    assert (result.skinning.name, result.stop_reason) == ("smaller", "time limit")
    assert [one.what for one in result.parsimony.prunings] == ["bones", "more bones"]
    ((bounds, stricter),) = given
    assert stricter < 1
    assert bounds.least == 1 < result.skinning.n_bones


def test_rigid_bones_stay_where_nothing_takes_fewer():
    turns = [rotation(0.3 * t, 0.2 * t, 0) for t in TIMES]
    frames = np.stack([np.concatenate([POINTS, POINTS @ r.T + 3]) for r in turns])
    options = {"tolerance": "1%", "effort": "fast"}
    usual = ssdr.smallest(frames, **options)
    found = ssdr.smallest(frames, **options, fewest="bytes")
    assert found.parsimony.size == usual.parsimony.size
    assert found.parsimony.prunings == usual.parsimony.prunings
    np.testing.assert_array_equal(found.skinning.transforms, usual.skinning.transforms)


def test_refusals(monkeypatch):
    frames = stretched()
    with pytest.raises(ssdr.InputError, match="fewest: expected one of"):
        ssdr.smallest(frames, tolerance="1%", fewest="keys")
    monkeypatch.setattr(scan, "_IN_MEMORY", 1000)
    monkeypatch.setattr(scan, "_FEWEST", 8)
    with pytest.raises(ssdr.InputError, match="fewest: expected 'bones' for frames that are str"):
        ssdr.smallest(frames, tolerance="1%", fewest="bytes")
