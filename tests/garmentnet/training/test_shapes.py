"""Principal components of meshes, with and without a mirror."""

import numpy as np
import pytest

from garmentnet.training.shapes import ShapeBasis

MIRROR = np.array([1, 0, 2, 4, 3])


@pytest.fixture
def meshes():
    rng = np.random.default_rng(0)
    return rng.normal(size=(40, 5, 3)) * rng.uniform(0.1, 2, (5, 3)) + rng.normal(size=(5, 3))


def image(meshes):
    return meshes[:, MIRROR] * (-1, 1, 1)


def test_components_are_those_of_a_singular_value_decomposition(meshes):
    basis = ShapeBasis.fit(meshes, 4)
    flat = (meshes - meshes.mean(0)).reshape(40, -1)
    _, s, rows = np.linalg.svd(flat, full_matrices=False)
    np.testing.assert_allclose(basis.deviation, s[:4] / np.sqrt(40), rtol=1e-5)
    turned = np.abs(basis.components.reshape(4, -1) @ rows[:4].T)
    np.testing.assert_allclose(turned, np.eye(4), atol=1e-5)
    left = np.linalg.norm(basis.decode(basis.encode(meshes)) - meshes) ** 2
    assert left == pytest.approx((s[4:] ** 2).sum(), rel=1e-5)


def test_signs_give_the_mirror_image(meshes):
    basis = ShapeBasis.fit(meshes, 6, MIRROR)
    both = ShapeBasis.fit(np.concatenate([meshes, image(meshes)]), 6)
    np.testing.assert_allclose(basis.deviation, both.deviation, rtol=1e-5)
    np.testing.assert_allclose(basis.mean, both.mean, atol=1e-6)
    assert set(basis.sign) == {1, -1}
    expected = basis.encode(image(meshes))
    np.testing.assert_allclose(basis.encode(meshes) * basis.sign, expected, atol=1e-5)


def test_more_components_than_meshes_have(meshes):
    basis = ShapeBasis.fit(meshes[:3], 6)
    np.testing.assert_allclose(basis.decode(basis.encode(meshes[:3])), meshes[:3], atol=1e-5)
    assert not basis.components[2:].any()
    assert (basis.deviation[2:] == 1).all()
