"""The bound on the number of bones, and the frames that it is computed from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ssdr
from helpers import motions
from helpers.measures import solved
from ssdr.parsimony.rank import rank_bound, reduced
from ssdr.solver.trajectories import gather


@settings(max_examples=15)
@given(seed=st.integers(0, 1000), bones=st.integers(1, 4))
def test_no_model_is_below_the_rank_bound(seed: int, bones: int) -> None:
    rng = np.random.default_rng(seed)
    rest = rng.uniform(-1, 1, (40, 3))
    frames = motions.random_skinning(rng, rest, 9, bones, 3)
    frames += 1e-3 * rng.standard_normal(frames.shape)
    data = gather([ssdr.MeshSequence(frames)], bones=40)
    model = solved(data, bones)
    error = model.weighted_error(data)
    assert rank_bound(data, error) <= bones
    # the bound itself, from the frames by a plain SVD of what is left without the centroids
    centred = (frames - frames.mean(axis=1, keepdims=True)).transpose(1, 0, 2).reshape(40, -1)
    values = np.linalg.svd(centred / data.alignment.scale, compute_uv=False) ** 2
    left = values.sum() - np.concatenate([[0], np.cumsum(values)])
    rank = int(np.argmax(left <= error))
    assert rank_bound(data, error) == max(1, -(-(rank + 1) // 4))


@pytest.mark.parametrize("shape", [(30, 40), (6, 90)])
def test_reduction_keeps_what_the_tolerance_sees(shape: tuple[int, int]) -> None:
    n_frames, n = shape
    rng = np.random.default_rng(0)
    low = rng.standard_normal((n, 4)) @ rng.standard_normal((4, 3 * n_frames))
    frames = low.reshape(n, n_frames, 3).transpose(1, 0, 2)
    frames = frames + 1e-4 * rng.standard_normal(frames.shape)
    data = gather([ssdr.MeshSequence(frames)], bones=n)
    less = reduced(data, 1e-2 * float(data.x2.sum()))
    assert less.z.shape[1] < data.z.shape[1]
    assert less.q is not None
    assert np.abs(less.q.T @ less.q - np.eye(less.q.shape[1])).max() < 1e-10
    whole = data.z if data.q is None else data.z @ data.q.T
    lost = float(((whole - less.z @ less.q.T) ** 2).sum())
    assert lost <= 1e-6 * float(data.x2.sum())
