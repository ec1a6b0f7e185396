"""The curve of error over bytes, and its knee."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.measures import diagonal, wavy
from ssdr import parsimony, sequence
from ssdr.parsimony.rate_distortion import knee
from ssdr.problem import check, scan


def test_curve_of_exact_skinning_has_its_knee_there() -> None:
    rig = motions.chain(bones=5, rows=14, frames=15)
    curve = parsimony.curve(rig.frames, bones=10)
    assert curve.bones.tolist() == [1, 2, 3, 4, 5, 6, 7, 8, 10]
    assert (np.diff(curve.rmse) <= 0).all()
    assert curve.bones[curve.knee] == 5
    assert curve.diagonal == pytest.approx(diagonal(rig.frames))
    assert (curve.bytes >= curve.bones * (12 + 15 * 28) + 84 * (12 + 1 + 3)).all()
    assert (curve.bytes <= curve.bones * (12 + 15 * 28) + 84 * (12 + 1 + 4 * 3)).all()


def test_curve_of_streamed_frames_has_the_bytes_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = wavy().copy()
    frames[8, 40:42] += [[0, 0, -4], [0, 0, 4]]  # vertices by which frames are not compared
    monkeypatch.setattr(scan, "_IN_MEMORY", 1 << 10)
    monkeypatch.setattr(scan, "_FEWEST", 6)
    monkeypatch.setattr(scan, "_MOST", 6)
    monkeypatch.setattr(scan, "_PROBES", 8)
    sequence = ssdr.MeshSequence(frames)
    assert 8 not in scan.scan([sequence], None).chosen
    curve = parsimony.curve(frames, bones=2)
    weights = 84 * np.array([[1 + 3, 1 + 3], [1 + 3, 1 + 2 * 3]])
    for bones, stored, least, most in zip(curve.bones, curve.bytes, *weights, strict=True):
        known = 84 * 12 + bones * (12 + 15 * 28)
        assert known + least <= stored <= known + most
    assert curve.diagonal == pytest.approx(diagonal(frames))


def test_copies_are_looked_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Looking for them is a pass over all frames, which may have to be read from a disk."""
    looked: list[int] = []

    def labels_of(sequences: list[ssdr.MeshSequence]) -> np.ndarray:
        looked.append(len(sequences))
        return sequence.labels_of(sequences)

    monkeypatch.setattr(check, "labels_of", labels_of)
    twice = np.repeat(wavy()[:, :3], 2, axis=1)
    assert parsimony.curve(twice).bones.tolist() == [1, 2, 3]
    assert ssdr.smallest(twice, tolerance="1%", effort="fast").copies == 3
    assert parsimony.curve(twice, bones=4).bones.tolist() == [1, 2, 3, 4]
    assert len(looked) == 3


def test_knee() -> None:
    sizes = np.array([10, 20, 40, 80, 160])
    assert knee(sizes, np.array([1.0, 0.5, 0.01, 0.008, 0.007]), 0.0) == 2
    assert knee(sizes, np.array([1.0, 0.5, 0.0, 0.0, 0.0]), 1e-5) == 2
    assert knee(sizes, np.zeros(5), 1e-5) == 0
    assert knee(sizes[:1], np.ones(1), 0.0) == 0


def test_curve_refuses_and_cancels() -> None:
    for change in ({"effort": "heroic"}, {"bones": 0}):
        with pytest.raises(ssdr.InputError):
            parsimony.curve(wavy(), **change)  # type: ignore[arg-type]
    with pytest.raises(ssdr.Cancelled):
        parsimony.curve(wavy(), bones=4, callback=lambda p: True)
