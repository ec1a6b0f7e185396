"""Derivatives of bones and vertices."""

from __future__ import annotations

import numpy as np
import pytest

from helpers import motions
from ssdr.kernels.schur import move_bones, tangent_image, tangent_pullback


def test_tangent_image_and_pullback_are_transposes(rng: np.random.Generator) -> None:
    transforms, scale = motions.motions(rng, 5, 4), 0.5 + rng.random(5)
    x, g = rng.standard_normal((5, 4, 6)), rng.standard_normal((15, 4, 4))
    image, back = np.zeros((15, 4, 4)), np.zeros((5, 4, 6))
    tangent_image(transforms, x, scale, image)
    tangent_pullback(transforms, g, scale, back)
    assert np.vdot(image, g) == pytest.approx(np.vdot(x, back), rel=1e-12)


def test_tangent_image_is_the_derivative_of_moving(rng: np.random.Generator) -> None:
    transforms, scale = motions.motions(rng, 3, 2), 0.5 + rng.random(3)
    x, image = rng.standard_normal((3, 2, 6)), np.zeros((9, 4, 2))
    tangent_image(transforms, x, scale, image)
    ends = []
    for sign in (1, -1):
        moved = transforms.copy()
        move_bones(moved, sign * 1e-6 * x)
        ends.append(moved)
    slope = (ends[0] - ends[1]) / 2e-6 * scale[:, None, None, None]
    np.testing.assert_allclose(image.reshape(3, 3, 4, 2), slope.transpose(0, 2, 3, 1), atol=1e-8)


def test_moving_keeps_rotations(rng: np.random.Generator) -> None:
    transforms = motions.motions(rng, 50, 3)
    for _ in range(20):
        move_bones(transforms, 3 * rng.standard_normal((50, 3, 6)))
    r = transforms[..., :3]
    assert np.abs(np.einsum("tjca,tjcb->tjab", r, r) - np.eye(3)).max() < 1e-12
    assert np.abs(np.linalg.det(r) - 1).max() < 1e-12
