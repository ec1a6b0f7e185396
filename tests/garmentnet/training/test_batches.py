"""Windows of clips side by side."""

import dataclasses

import numpy as np
import pytest
import torch

from garmentnet.training.batches import batches


@dataclasses.dataclass
class Piece:
    """All that batches() looks at."""

    name: str
    n_frames: int
    inputs: object = None


@pytest.mark.parametrize("seed", [None, 0, 1])
def test_an_epoch_shows_every_frame_once_in_order(seed):
    tracks = [Piece(f"t{k}", n) for k, n in enumerate([50, 7, 31, 90, 1, 64])]
    seen = {t.name: [] for t in tracks}
    lanes = [None] * 3
    rng = None if seed is None else np.random.default_rng(seed)
    for batch in batches(tracks, 3, 20, rng):
        for lane, w in enumerate(batch.windows):
            assert int(batch.mask[lane].sum()) == (0 if w is None else w[2] - w[1])
            if w is None:
                assert batch.fresh[lane]
                continue
            track, start, stop = w
            assert stop - start <= 20
            assert bool(batch.fresh[lane]) == (start == 0)
            if start:  # memory is only ever carried on within a track
                assert lanes[lane] == (track.name, start)
            lanes[lane] = (track.name, stop)
            seen[track.name] += range(start, stop)
    assert all(seen[t.name] == list(range(t.n_frames)) for t in tracks)


def test_forgetting():
    batch = next(batches([Piece("a", 5), Piece("b", 5)], 2, 5, None))
    batch = dataclasses.replace(batch, fresh=torch.tensor([True, False]))
    state = batch.forget(torch.ones(1, 2, 4))
    assert state[0, 0].abs().sum() == 0
    assert bool((state[0, 1] == 1).all())
