"""Fits of plain arrays: as of models; masks, priors and importances against dense problems."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

import ssdr
from helpers import motions, naive
from helpers.stretches import rig

CHAIN = motions.chain(bones=5)
FRAMES = ssdr.MeshSequence(motions.wobble(CHAIN), CHAIN.faces, fps=30, name="chain")
DENSE = CHAIN.skinning.dense_weights()


def same(found: ssdr.fit.fit.Fit, expected: ssdr.fit.fit.Fit, part: str) -> None:
    assert np.array_equal(getattr(found.skinning, part), getattr(expected.skinning, part))
    assert found.rmse == expected.rmse
    assert np.array_equal(found.squared_error, expected.squared_error)
    assert np.array_equal(found.skinning.faces, CHAIN.faces)
    assert (found.skinning.fps, found.skinning.name) == (30, "chain")


def test_arrays_are_fitted_as_a_model_is_to_the_bit() -> None:
    model = CHAIN.skinning
    rest, indices, weights, moves = model.rest, model.indices, model.weights, model.transforms
    same(ssdr.fit_weights(FRAMES, rest, moves), ssdr.fit_weights(FRAMES, model), "weights")
    expected = ssdr.fit_bones(FRAMES, model, max_sweeps=20)
    same(ssdr.fit_bones(FRAMES, rest, indices, weights, max_sweeps=20), expected, "transforms")
    expected = ssdr.fit_rest_pose(FRAMES, model)
    same(ssdr.fit_rest_pose(FRAMES, rest, indices, weights, moves), expected, "rest")


@pytest.mark.parametrize("weights", [DENSE, csr_array(DENSE)], ids=["dense", "sparse"])
def test_weights_of_all_bones_are_taken(weights: Any) -> None:
    model = ssdr.Skinning.from_dense(CHAIN.rest, DENSE, CHAIN.transforms, faces=CHAIN.faces)
    found = ssdr.fit_bones(FRAMES, CHAIN.rest, weights=weights, max_sweeps=20)
    same(found, ssdr.fit_bones(FRAMES, model, max_sweeps=20), "transforms")
    found = ssdr.fit_rest_pose(FRAMES, CHAIN.rest, None, weights, CHAIN.transforms)
    same(found, ssdr.fit_rest_pose(FRAMES, model), "rest")


def test_a_result_is_taken_for_its_model() -> None:
    one = ssdr.fit_bones(FRAMES, CHAIN.skinning, max_sweeps=5)
    assert ssdr.fit_weights(FRAMES, one).rmse == ssdr.fit_weights(FRAMES, one.skinning).rmse


@pytest.mark.parametrize("kind", ["similarity", "affine"])
def test_the_bone_model_of_arrays(kind: Any) -> None:
    truth = rig(kind)
    arrays = truth.rest, truth.transforms
    found = ssdr.fit_weights(truth.frames, *arrays, bone_model=kind)
    assert found.skinning.bone_model == kind
    assert found.rmse < 1e-5


def test_exact_data_have_the_error_of_rounding_alone() -> None:
    """A sum of expanded squares would end at 1e-8."""
    for scale in (1.0, 1024.0):
        frames, rest = scale * CHAIN.frames, scale * CHAIN.rest
        moves = CHAIN.transforms * [1, 1, 1, scale]
        fits = [
            ssdr.fit_weights(frames, rest, moves),
            ssdr.fit_rest_pose(frames, rest, CHAIN.indices, CHAIN.weights, moves),
        ]
        for fit in fits:
            true = ssdr.metrics.rmse(frames, fit.skinning)
            assert fit.rmse < 1e-13 * scale
            assert fit.rmse == pytest.approx(true, rel=0.2)  # of the last bits
            expected = np.sqrt(fit.squared_error.sum() / frames[..., 0].size)
            assert fit.rmse == pytest.approx(expected, rel=1e-12)


def problem(seed: int, n: int = 9, bones: int = 5, n_frames: int = 6) -> tuple[Any, ...]:
    """Noisy frames, the rest pose and the bones, with the dense problem of each vertex."""
    rng = np.random.default_rng(seed)
    rest = rng.standard_normal((n, 3))
    moves = motions.motions(rng, n_frames, bones)
    indices, weights = motions.weights_of(rng, n, bones, 3)
    frames = motions.blend(rest, indices, weights, moves)
    frames += 0.3 * rng.standard_normal(frames.shape)
    return rng, frames, rest, moves, naive.bone_images(rest, moves), per_vertex(frames)


def per_vertex(frames: np.ndarray) -> np.ndarray:
    return frames.transpose(1, 0, 2).reshape(frames.shape[1], -1)


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), influences=st.integers(1, 5), alike=st.booleans())
def test_a_mask_of_bones(seed: int, influences: int, alike: bool) -> None:
    rng, frames, rest, moves, images, targets = problem(seed)
    allowed = rng.random((9, 5)) < 0.5
    allowed[np.arange(9), rng.integers(0, 5, 9)] = True
    if alike:
        allowed[:] = allowed[0]
    given_mask = allowed[0] if alike else allowed
    fit = ssdr.fit_weights(frames, rest, moves, allowed=given_mask, influences=influences)
    dense = fit.skinning.dense_weights()
    assert (dense[~allowed] == 0).all()
    best = np.array(
        [naive.best_convex(images[i][:, allowed[i]], targets[i], influences)[0] for i in range(9)]
    )
    assert (fit.squared_error >= best * (1 - 1e-9)).all()
    if influences >= allowed.sum(axis=1).max():
        assert (fit.squared_error <= best * (1 + 1e-5)).all()
    else:  # which K bones are best is a hard choice
        assert fit.squared_error.sum() <= 1.25 * best.sum()


def test_bones_are_exchanged_within_the_mask() -> None:
    """As without one: the error ends within a hundredth of the best of all supports."""
    rng, frames, rest, moves, images, targets = problem(7, n=40, bones=6, n_frames=8)
    allowed = np.ones((40, 6), bool)
    allowed[np.arange(40), rng.integers(0, 6, 40)] = False
    fit = ssdr.fit_weights(frames, rest, moves, allowed=allowed, influences=2)
    best = sum(
        naive.best_convex(images[i][:, allowed[i]], targets[i], 2)[0] for i in range(len(rest))
    )
    assert best * (1 - 1e-9) <= fit.squared_error.sum() <= 1.01 * best


@settings(max_examples=20)
@given(
    seed=st.integers(0, 10**6),
    length=st.sampled_from([0.01, 0.3, 3.0]),
    masked=st.booleans(),
)
def test_prior_and_importances_against_stacked_problems(
    seed: int, length: float, masked: bool
) -> None:
    """Minimised is u_i Σ s_t |error|² + F l² |w − prior|², with means of u and s of 1."""
    rng, frames, rest, moves, images, targets = problem(seed)
    prior = rng.dirichlet(np.ones(5), 9)
    u, s = rng.uniform(0.2, 3, 9), rng.uniform(0.1, 2, 6)
    allowed = np.ones((9, 5), bool)
    if masked:
        allowed[:, 2] = False
    fit = ssdr.fit_weights(
        frames,
        rest,
        moves,
        influences=5,
        allowed=allowed if masked else None,
        prior=prior,
        prior_length=length,
        vertex_importance=u,
        frame_importance=s,
    )
    found = fit.skinning.dense_weights()
    u, s = u / u.mean(), np.repeat(np.sqrt(s / s.mean()), 3)
    for i in range(9):
        rows = np.concatenate(
            [np.sqrt(u[i]) * s[:, None] * images[i], np.sqrt(6) * length * np.eye(5)]
        )
        right = np.concatenate([np.sqrt(u[i]) * s * targets[i], np.sqrt(6) * length * prior[i]])
        best, _ = naive.best_convex(rows[:, allowed[i]], right, 5)
        value = ((rows @ found[i] - right) ** 2).sum()
        assert best * (1 - 1e-9) <= value <= best * (1 + 1e-4)
    error = naive.squared_error(frames, rest, fit.skinning.indices, fit.skinning.weights, moves)
    np.testing.assert_allclose(fit.squared_error, error, rtol=1e-9)


def test_a_strong_prior_is_the_result_and_none_of_its_forms_matters() -> None:
    _, frames, rest, moves, *_ = problem(1)
    prior = np.random.default_rng(2).dirichlet(np.ones(5), 9)
    model = ssdr.Skinning.from_dense(rest, prior, moves)
    for given_prior in (prior, csr_array(prior), model):
        fit = ssdr.fit_weights(
            frames, rest, moves, influences=5, prior=given_prior, prior_length=1e4
        )
        np.testing.assert_allclose(fit.skinning.dense_weights(), prior, atol=1e-5)


def test_smoothness_ends_at_the_solution_of_the_dense_system() -> None:
    """Where no weight is 0, the minimum of error + F l² Σ_edges |jump|² is a linear system's."""
    rng = np.random.default_rng(0)
    sheet = motions.grid(3, 4)
    n, bones, n_frames, length = 12, 3, 8, 0.5
    rest = rng.standard_normal((n, 3))
    moves = motions.motions(rng, n_frames, bones)
    weights = rng.dirichlet(np.full(bones, 20.0), n)
    frames = np.einsum("ij,tjab,ib->tia", weights, moves, np.c_[rest, np.ones(n)])
    laplacian = naive.uniform_laplacian(sheet, n)
    images, targets = naive.bone_images(rest, moves), per_vertex(frames)
    size = n * bones
    system = np.zeros((size + n, size + n))
    system[:size, :size] = n_frames * length**2 * np.kron(laplacian, np.eye(bones))
    right = np.zeros(size + n)
    for i in range(n):
        own = slice(bones * i, bones * (i + 1))
        system[own, own] += images[i].T @ images[i]
        system[size + i, own] = system[own, size + i] = 1
        right[own], right[size + i] = images[i].T @ targets[i], 1
    expected = np.linalg.solve(system, right)[:size].reshape(n, bones)
    assert expected.min() > 0.01
    assert np.abs(expected - weights).max() > 0.01
    fit = ssdr.fit_weights(
        ssdr.MeshSequence(frames, sheet), rest, moves, smoothness=length, iterations=400
    )
    np.testing.assert_allclose(fit.skinning.dense_weights(), expected, atol=1e-4)


class Tensor:
    """What torch hands over: an array once it has no gradient and lies in this memory."""

    dtype = "float64 of a framework"

    def __init__(self, values: np.ndarray, left: tuple[str, ...] = ("detach", "cpu")) -> None:
        self.values, self.shape, self.left = values, values.shape, left

    def __getitem__(self, key: Any) -> Tensor:
        return Tensor(self.values[key])

    def detach(self) -> Tensor:
        return Tensor(self.values, self.left[1:])

    cpu = detach

    def numpy(self) -> np.ndarray:
        assert not self.left, self.left
        return self.values


def test_a_length_of_half_precision_does_not_overflow() -> None:
    one, other = (
        ssdr.fit_weights(FRAMES, CHAIN.skinning, smoothness=kind(3), iterations=2)
        for kind in (np.float16, float)
    )
    assert np.array_equal(one.skinning.weights, other.skinning.weights)


FORMS = {"lists": np.ndarray.tolist, "single precision": np.float32, "tensors": Tensor}


@pytest.mark.parametrize("name", FORMS)
def test_arrays_of_other_forms_are_taken(name: str) -> None:
    arrays = FRAMES.vertices, CHAIN.rest, CHAIN.transforms
    found = ssdr.fit_weights(*map(FORMS[name], arrays)).skinning.dense_weights()
    expected = ssdr.fit_weights(*arrays).skinning.dense_weights()
    np.testing.assert_allclose(found, expected, atol=1e-4 if name == "single precision" else 0)
