"""The scan: what is streamed, which frames are solved first."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import motions
from ssdr.problem import scan


def test_only_large_sequences_are_streamed() -> None:
    small = ssdr.MeshSequence(np.zeros((300, 10, 3)))
    large = ssdr.MeshSequence(np.broadcast_to(np.float32(0), (10_000, 10_000, 3)), validate=False)
    assert not scan.needs_streaming([small])
    assert scan.needs_streaming([large])


def test_an_extent_below_squares_is_refused() -> None:
    for size in (1e-120, 1e-200):
        with pytest.raises(ssdr.InputError, match="extent"):
            scan.scan([ssdr.MeshSequence(size * motions.rippled(9))], None)
    assert scan.scan([ssdr.MeshSequence(1e-90 * motions.rippled(9))], None).alignment.scale < 1e-89
    assert scan.scan([ssdr.MeshSequence(np.ones((9, 5, 3)))], None).alignment.scale == 1


@pytest.mark.usefixtures("tiny_memory")
def test_telling_frames_are_among_the_many_on_which_the_model_settles() -> None:
    found = scan.scan([ssdr.MeshSequence(motions.rippled())], None, keep=[7])
    more = found.extended(200)
    assert more is not None
    assert 80 <= len(more.chosen) < 120
    assert set(found.chosen) < set(more.chosen)
    np.testing.assert_array_equal(more.chosen[more.nearest[more.chosen]], more.chosen)
    other = np.setdiff1d(np.arange(120), more.chosen)
    np.testing.assert_array_equal(
        more.chosen[more.nearest[other]], found.chosen[found.nearest[other]]
    )
    assert found.extended(200_000_000) is None  # not even one could be held


@pytest.mark.usefixtures("tiny_memory")
def test_the_scan_can_be_stopped() -> None:
    seen = []
    with pytest.raises(ssdr.Cancelled):
        ssdr.decompose(motions.rippled(), bones=4, callback=lambda p: seen.append(p.phase) or True)
    assert seen == ["scan"]
