"""Diffused weights against a dense solve of the same system."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions, naive
from helpers.surfaces import sphere
from ssdr.laplacian import smooth_weights


def ball(bones: int = 4) -> ssdr.Skinning:
    """A sphere whose vertices each follow one bone."""
    rest, faces = sphere(2)
    rest = rest * [1.0, 1.3, 0.8]
    label = (rest @ np.random.default_rng(0).standard_normal((3, bones))).argmax(axis=1)
    moves = motions.motions(np.random.default_rng(1), 5, bones)
    return ssdr.Skinning.from_dense(rest, np.eye(bones)[label], moves, faces=faces, fps=30)


def dense_solution(model: ssdr.Skinning, length: float, kind: str) -> np.ndarray:
    rest, faces = np.asarray(model.rest), model.faces
    mass = np.diag(naive.barycentric_mass(rest, faces))
    if kind == "cotangent":
        laplacian = naive.cotangent_laplacian(rest, faces)
    else:
        laplacian = naive.uniform_laplacian(faces, len(rest)) / np.sqrt(3)
    return np.linalg.solve(mass + length**2 * laplacian, mass @ model.dense_weights())


@pytest.mark.parametrize("kind", ["cotangent", "uniform"])
@pytest.mark.parametrize("length", [0.05, 0.4])
def test_against_a_dense_solve(kind: Any, length: float) -> None:
    model = ball()
    expected = dense_solution(model, length, kind)
    found = smooth_weights(model, length, influences=4, kind=kind)
    assert expected.min() > -1e-12
    np.testing.assert_allclose(found.dense_weights(), expected, atol=1e-9)
    assert np.abs(expected - model.dense_weights()).max() > 0.05
    assert np.array_equal(found.rest, model.rest)
    assert np.array_equal(found.transforms, model.transforms)
    assert found.fps == 30


def test_weights_below_0_become_0_and_the_others_are_normalised() -> None:
    """A flat strip whose diagonals are not Delaunay, so that the cotangent one undershoots."""
    rest = np.array([[0, 0, 0], [4, 0, 0], [8, 0, 0], [0, 1, 0], [4, 1, 0], [8, 1, 0]], float)
    rest[3:, 0] += 3.5
    faces = np.array([[0, 4, 3], [0, 1, 4], [1, 5, 4], [1, 2, 5]])
    dense = np.eye(3)[[0, 0, 1, 2, 1, 2]]
    model = ssdr.Skinning.from_dense(rest, dense, np.tile(np.eye(3, 4), (1, 3, 1, 1)), faces=faces)
    expected = dense_solution(model, 2.0, "cotangent")
    assert expected.min() < -1e-3
    expected = np.maximum(expected, 0)
    expected /= expected.sum(axis=1, keepdims=True)
    found = smooth_weights(model, 2.0, influences=3)
    np.testing.assert_allclose(found.dense_weights(), expected, atol=1e-9)


def test_the_largest_influences_are_kept_as_many_as_the_model_has() -> None:
    model = ball()
    assert smooth_weights(model, 0.4).n_influences == 1
    two = smooth_weights(SimpleNamespace(skinning=model), 0.4, influences=2)
    whole = smooth_weights(model, 0.4, influences=4)
    assert np.array_equal(two.dense_weights(), whole.prune(2).dense_weights())


def test_no_length_changes_nothing_and_a_large_one_gives_means() -> None:
    model = ball()
    same = smooth_weights(model, 0.0)
    np.testing.assert_allclose(same.dense_weights(), model.dense_weights(), atol=1e-12)
    mass = naive.barycentric_mass(np.asarray(model.rest), model.faces)
    mean = mass @ model.dense_weights() / mass.sum()
    found = smooth_weights(model, 1e3, influences=4).dense_weights()
    np.testing.assert_allclose(found, np.broadcast_to(mean, found.shape), atol=1e-4)
