"""Colours of bones and of errors."""

from __future__ import annotations

import numpy as np

from ssdr.show import palette


def test_srgb_round_trip_and_heat_darkens_steadily():
    x = np.linspace(0, 1, 257)
    np.testing.assert_allclose(palette.linear_from_srgb(palette.srgb_from_linear(x)), x, atol=1e-12)
    light = palette.heat(x) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(light) < 0).all()
    np.testing.assert_array_equal(palette.heat([-1.0, 7.0]), palette.heat([0.0, 1.0]))


def test_neighbouring_bones_get_colors_far_apart(rng):
    x = rng.uniform(size=(60, 3))
    colors = palette.bone_colors(x)
    np.testing.assert_array_equal(colors, palette.bone_colors(x))
    assert colors.min() >= 0
    assert colors.max() <= 1
    srgb = palette.srgb_from_linear(colors)
    gap = np.linalg.norm(x[:, None] - x[None], axis=2) + 9 * np.eye(60)
    nearest = np.linalg.norm(srgb - srgb[gap.argmin(axis=1)], axis=1)
    assert nearest.min() > 0.25
    for n in (1, 2, 300):
        assert palette.bone_colors(np.zeros((n, 3))).shape == (n, 3)


def test_a_vertex_of_one_bone_has_the_color_of_the_bone(rng):
    colors = palette.bone_colors(rng.normal(size=(7, 3)))
    indices = np.stack([np.arange(7), np.zeros(7, dtype=int)], axis=1)
    mixed = palette.mix(colors, np.tile([1.0, 0.0], (7, 1)), indices)
    np.testing.assert_allclose(mixed, colors, atol=1e-6)
