"""Coefficients of the low frequencies, kept on disk."""

import numpy as np
import pytest

from garmentnet.data.clip import MIRRORED
from garmentnet.paper.bones import remove_frame
from garmentnet.training.targets import LowTargets

NAME = "base-train-0"


@pytest.mark.parametrize("suffix", ["", MIRRORED])
def test_rows_against_the_mesh(toy_bones, toy_network, suffix):
    features = toy_network.networks[0].features
    targets = LowTargets(toy_bones, features, [NAME])
    rows = targets.rows(NAME + suffix).astype(np.float64)
    frame = features(toy_bones.store.clip(NAME + suffix).joints)[1]
    low = remove_frame(frame, toy_bones.split(NAME + suffix)[0])
    given = targets.basis.decode(rows[:, :-2])
    gap = np.linalg.norm((low - given)[:, targets.free], axis=(1, 2))
    size = np.linalg.norm(low - targets.basis.mean, axis=(1, 2))
    assert (np.abs(gap - rows[:, -2]) < 2e-3 * size).all()
    assert gap.max() < 0.05 * size.max()


def test_rows_are_read_again(toy_bones, toy_network):
    features = toy_network.networks[0].features
    before = LowTargets(toy_bones, features, [NAME])
    rows = before.rows(NAME)
    files = list(toy_bones.folder.glob(f"low-*/{NAME}-*.npz"))
    changed = [file.stat().st_mtime_ns for file in files]
    again = LowTargets(toy_bones, features, [NAME])
    np.testing.assert_array_equal(again.rows(NAME), rows)
    assert files
    assert [file.stat().st_mtime_ns for file in files] == changed
