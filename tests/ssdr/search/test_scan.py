"""The scan: what is streamed, which frames are solved first."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import motions
from ssdr.search import scan


def test_only_large_sequences_are_streamed() -> None:
    small = ssdr.MeshSequence(np.zeros((300, 10, 3)))
    large = ssdr.MeshSequence(np.broadcast_to(np.float32(0), (10_000, 10_000, 3)), validate=False)
    assert not scan.needs_streaming([small])
    assert scan.needs_streaming([large])


@pytest.mark.usefixtures("tiny_memory")
def test_an_extent_below_squares_is_refused() -> None:
    for size in (1e-120, 1e-200):
        with pytest.raises(ssdr.InputError, match="extent"):
            ssdr.decompose(size * motions.rippled(), bones=2, effort="fast")


@pytest.mark.usefixtures("tiny_memory")
def test_evenly_spread_frames_are_added_to_telling_ones() -> None:
    sequences = [ssdr.MeshSequence(motions.rippled())]
    few, more = (scan.scan(sequences, None, 7, spread=spread) for spread in (False, True))
    assert 40 <= len(few.chosen) <= 41
    assert 60 <= len(more.chosen) <= 80
    assert set(few.chosen) < set(more.chosen)
    np.testing.assert_array_equal(more.chosen[more.nearest[more.chosen]], more.chosen)
    other = np.setdiff1d(np.arange(120), more.chosen)
    np.testing.assert_array_equal(more.chosen[more.nearest[other]], few.chosen[few.nearest[other]])


@pytest.mark.usefixtures("tiny_memory")
def test_the_scan_can_be_stopped() -> None:
    seen = []
    with pytest.raises(ssdr.Cancelled):
        ssdr.decompose(motions.rippled(), bones=4, callback=lambda p: seen.append(p.phase) or True)
    assert seen == ["scan"]
