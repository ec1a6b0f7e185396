"""Motion matching, against a search by hand and on the motions that it knows."""

# ruff: noqa: E402
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from benchmarks.garment.matching import MotionMatching, Windows
from helpers.measures import pooled

TRAIN = ["base-train-0"]


def test_the_nearest_windows_are_those_of_a_search_by_hand():
    rng = np.random.default_rng(0)
    motions = [rng.normal(size=(n, 3)) for n in (12, 7)]
    chosen = [np.array([0, 5, 11]), np.array([2, 6])]
    query = rng.normal(size=(6, 3))
    index, weight = Windows(motions, (0, 2), chosen).nearest(query, 2)

    def window(motion, frame):
        return np.concatenate([motion[frame], motion[max(0, frame - 2)]])

    known = [window(m, f) for m, some in zip(motions, chosen, strict=True) for f in some]
    for f in range(6):
        gap = [np.linalg.norm(window(query, f) - k) for k in known]
        first, second = np.argsort(gap)[:2]
        assert index[f].tolist() == [first, second]
        ratio = (gap[second] / gap[first]) ** 2
        assert weight[f] == pytest.approx([ratio / (1 + ratio), 1 / (1 + ratio)])


def test_a_known_motion_finds_its_own_cloth(toy_bones, toy_store, toy_config):
    features = toy_config().features
    method = MotionMatching(toy_bones, TRAIN, features, frames=90, count=1)
    low, high = method.split(toy_store.clip(TRAIN[0]), toy_bones)
    true_low, true_high = toy_bones.split(TRAIN[0])
    # What the bones leave, and nothing of the detail but its turn by other bones.
    still = pooled(0 * true_low + true_low.mean(axis=0), true_low)
    assert pooled(low, true_low) < 0.1 * still
    assert pooled(low + high, true_low + true_high) < 0.1 * still
    assert pooled(high[10:], true_high[10:]) < 0.5 * pooled(0 * high, true_high)
