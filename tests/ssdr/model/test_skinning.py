"""Forward skinning against plain loops, and what the model accepts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from helpers import naive
from ssdr import Skinning, skin


def make(seed=0, *, V=30, B=5, K=3, F=4, dtype=np.float64):
    rng = np.random.default_rng(seed)
    indices = np.stack([rng.permutation(B)[:K] for _ in range(V)])
    weights = -np.sort(-rng.dirichlet(np.ones(K), V), axis=1)
    rotation = Rotation.random(F * B, rng=rng).as_matrix().reshape(F, B, 3, 3)
    transforms = np.concatenate([rotation, rng.normal(size=(F, B, 3, 1))], axis=-1)
    return {
        "rest": rng.normal(size=(V, 3)).astype(dtype),
        "indices": indices,
        "weights": weights.astype(dtype),
        "transforms": transforms.astype(dtype),
    }


@given(
    seed=st.integers(0, 10**6),
    V=st.integers(1, 40),
    K=st.integers(1, 5),
    F=st.integers(1, 4),
    dtype=st.sampled_from([np.float32, np.float64]),
)
def test_equals_naive_loops(seed, V, K, F, dtype):
    arrays = make(seed, V=V, K=K, F=F, dtype=dtype)
    expected = naive.skin(**arrays)
    got = skin(**arrays)
    assert got.dtype == dtype
    np.testing.assert_allclose(got, expected, atol=1e-5 if dtype == np.float32 else 1e-13)


def test_chunk_borders_and_one_frame():
    arrays = make(V=2500)
    frames = skin(**arrays)
    np.testing.assert_allclose(frames, naive.skin(**arrays), atol=1e-13)
    alone = skin(**(arrays | {"transforms": arrays["transforms"][2]}))
    assert alone.shape == (2500, 3)
    np.testing.assert_array_equal(alone, frames[2])


def test_the_dtype_is_that_of_the_arrays_or_the_one_asked_for():
    arrays = make(dtype=np.float32)
    assert skin(**arrays, dtype=np.float64).dtype == np.float64
    mixed = arrays | {"transforms": arrays["transforms"].astype(np.float64)}
    assert skin(**mixed).dtype == np.float64
    assert skin(**mixed, dtype=np.float32).dtype == np.float32


def test_padding_never_touches_its_bone():
    arrays = make(K=2)
    arrays["indices"][:] = [1, 0]
    arrays["weights"][:] = [1.0, 0.0]
    arrays["transforms"][:, 0] = np.nan
    assert np.isfinite(skin(**arrays)).all()


def test_inputs_of_any_layout():
    arrays = make(V=40)
    expected = skin(**arrays)
    odd = {name: np.asfortranarray(array) for name, array in arrays.items()}
    np.testing.assert_array_equal(skin(**odd), expected)
    wide = np.repeat(arrays["rest"], 2, axis=0)[::2]
    np.testing.assert_array_equal(skin(**(arrays | {"rest": wide})), expected)
    lists = {name: array.tolist() for name, array in arrays.items()}
    np.testing.assert_array_equal(skin(**lists), expected)


def test_model_skins_the_named_frames():
    model = Skinning(**make())
    frames = model.skin()
    for index in ([2, 0], slice(1, 3), np.array([True, False, True, False]), [-1], [], 1, -1):
        np.testing.assert_array_equal(model.skin(index), frames[index])
    assert model.skin(dtype=np.float32).dtype == np.float32


def test_centroids_are_weighted_means():
    arrays = make(K=2)
    arrays["indices"][arrays["indices"] == 4] = 3  # bone 4 moves nothing
    model = Skinning(**arrays)
    dense = model.dense_weights()
    for j in range(4):
        expected = (dense[:, j, None] * model.rest).sum(axis=0) / dense[:, j].sum()
        np.testing.assert_allclose(model.centroids()[j], expected, atol=1e-13)
    np.testing.assert_allclose(model.centroids()[4], model.rest.mean(axis=0), atol=1e-13)


@given(seed=st.integers(0, 10**6), keep=st.integers(1, 6))
def test_prune_keeps_the_largest(seed, keep):
    arrays = make(seed, K=4)
    rng = np.random.default_rng(seed)
    order = rng.permuted(np.tile(np.arange(4), (30, 1)), axis=1)  # unsorted on purpose
    arrays["weights"] = np.take_along_axis(arrays["weights"], order, axis=1)
    model = Skinning(**arrays)
    pruned = model.prune(keep)
    assert pruned.n_influences == min(keep, 4)
    for i in range(30):
        rank = sorted(zip(-model.weights[i], model.indices[i], strict=True))[:keep]
        kept = {j: -w for w, j in rank}
        total = sum(kept.values())
        got = {j: w for j, w in zip(pruned.indices[i], pruned.weights[i], strict=True) if w > 0}
        assert got == pytest.approx({j: w / total for j, w in kept.items()})
        assert (pruned.indices[i][pruned.weights[i] == 0] == 0).all()
    np.testing.assert_allclose(pruned.weights.sum(axis=1), 1, atol=1e-12)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_prune_of_nothing_changes_no_bit(dtype):
    model = Skinning(**make(dtype=dtype))
    assert np.array_equal(model.prune(8).dense_weights(), model.dense_weights())
    np.testing.assert_allclose(model.prune(8).skin(), model.skin(), atol=1e-14)


@given(seed=st.integers(0, 10**6), bones=st.integers(1, 7), used=st.integers(1, 7))
def test_dense_weights_come_back_to_the_bit(seed, bones, used):
    rng = np.random.default_rng(seed)
    dense = rng.random((11, bones))
    dense[rng.permuted(np.tile(np.arange(bones), (11, 1)), axis=1) >= used] = 0
    dense /= dense.sum(axis=1, keepdims=True)
    rest, moves = rng.standard_normal((11, 3)), rng.standard_normal((4, bones, 3, 4))
    for given_weights in (dense, csr_array(dense), dense.tolist()):
        model = Skinning.from_dense(rest, given_weights, moves, fps=30)
        assert np.array_equal(model.dense_weights(), dense)
        assert model.n_influences == min(used, bones)
        assert (np.diff(model.weights, axis=1) <= 0).all()
        assert model.fps == 30
    frames = np.einsum("ij,tjab,ib->tia", dense, moves, np.c_[rest, np.ones(11)])
    np.testing.assert_allclose(model.skin(), frames, atol=1e-13)
    cut = Skinning.from_dense(rest, dense, moves, influences=2)
    assert cut.n_influences == min(2, bones)
    least = np.sort(dense, axis=1)[:, -2:][:, :1]
    expected = np.where(dense >= least, dense, 0)
    expected /= expected.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(cut.dense_weights(), expected, atol=1e-15)


def test_dense_weights_of_integers_and_single_precision():
    rest, moves = np.eye(3), np.tile(np.eye(3, 4), (2, 4, 1, 1))
    each = Skinning.from_dense(rest, np.eye(3, 4, dtype=int), moves)
    assert each.indices.tolist() == [[0], [1], [2]]
    single = Skinning.from_dense(rest, np.full((3, 4), 0.25, np.float32), moves)
    assert single.weights.dtype == np.float32
