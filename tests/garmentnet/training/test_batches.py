"""Windows of clips side by side."""

import dataclasses

import numpy as np
import pytest
import torch

from garmentnet.networks.gru import GRULinear
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
        for lane, (track, start, stop) in enumerate(batch.windows):
            assert int(batch.mask[lane].sum()) == stop - start
            if start == stop:  # the lane is finished
                continue
            assert stop - start == min(batch.mask.shape[1], track.n_frames - start)
            assert batch.mask.shape[1] in range(15, 21)
            assert bool(batch.fresh[lane]) == (start == 0)
            if start:  # memory is only ever carried on within a track
                assert lanes[lane] == (track.name, start)
            lanes[lane] = (track.name, stop)
            seen[track.name] += range(start, stop)
    assert all(seen[t.name] == list(range(t.n_frames)) for t in tracks)


def test_memory_at_the_end_of_a_window_is_that_of_the_whole_clip():
    """However clips are cut, outputs are those of every clip in one piece."""
    torch.manual_seed(0)
    net = GRULinear(3, 8, 2)
    tracks = [Piece(str(n), n, torch.randn(n, 3)) for n in (50, 7, 31, 1, 64)]
    found, state = {t.name: [] for t in tracks}, None
    for batch in batches(tracks, 2, 20, np.random.default_rng(3)):
        out, state = net(batch.inputs(), batch.forget(state))
        for lane, (track, start, stop) in enumerate(batch.windows):
            found[track.name].append(out[lane, : stop - start])
    for track in tracks:
        whole = net(track.inputs[None])[0][0]
        torch.testing.assert_close(torch.cat(found[track.name]), whole)


def test_forgetting():
    batch = next(batches([Piece("a", 5), Piece("b", 5)], 2, 5, None))
    batch = dataclasses.replace(batch, fresh=torch.tensor([True, False]))
    state = batch.forget(torch.ones(1, 2, 4))
    assert state[0, 0].abs().sum() == 0
    assert bool((state[0, 1] == 1).all())
