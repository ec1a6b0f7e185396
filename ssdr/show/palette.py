"""Colours of bones, skin weights and errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Color = tuple[float, float, float]
CLAY: Color = (0.84, 0.82, 0.79)
"""Light warm grey."""
SKIN: Color = (0.87, 0.68, 0.58)
"""Pale skin."""
FABRIC: Color = (0.27, 0.50, 0.66)
"""Blue cloth."""
NEUTRAL: Color = (0.62, 0.62, 0.63)
"""Grey of vertices that are not measured."""

# Ottosson, "A perceptual color space for image processing" (OKLab), 2020: both matrices.
_LMS_FROM_RGB = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
# from the cube roots of LMS
_LAB_FROM_LMS = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)
_HEAT = (
    "#fbf7e9 #fdeec0 #fedc91 #fdc069 #fb9d52 #f4764c #e4524f #c93559 "
    "#a52365 #7e1a6b #571766 #341351 #1a0d33"
)


def linear_from_srgb(color: ArrayLike) -> NDArray[np.float64]:
    """Linear RGB from sRGB, in [0, 1] (IEC 61966-2-1)."""
    c = np.asarray(color, dtype=np.float64)
    return np.asarray(np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4))


def srgb_from_linear(color: ArrayLike) -> NDArray[np.float64]:
    """Display values (sRGB) from linear RGB, clipped to [0, 1]."""
    c = np.clip(np.asarray(color, dtype=np.float64), 0.0, 1.0)
    return np.asarray(np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055))


def bone_colors(positions: ArrayLike) -> NDArray[np.float64]:
    """Colours of bones: the closer two bones are, the more their colours differ.

    Parameters
    ----------
    positions : (B, 3) array
        Positions of the bones in the rest pose.

    Returns
    -------
    (B, 3) float64
        Linear RGB.  The same positions always give the same colours.

    Notes
    -----
    Greedy: each bone in turn takes the candidate colour with the least Σ closeness / (colour
    distance)² over the bones that have a colour, with distances in OKLab.  The cost is O(B²).
    """
    x = np.asarray(positions, dtype=np.float64)
    lab = _candidates()
    apart = ((lab[:, None] - lab[None]) ** 2).sum(axis=2)
    gap = ((x[:, None] - x[None]) ** 2).sum(axis=2)
    # The distance at which bones count as close is that of about five neighbours.
    reach = np.sort(gap, axis=1)[:, min(5, len(x) - 1)]
    near = np.exp(-gap / np.maximum(np.median(reach), 1e-300)) + 0.02
    repulsion = 1.0 / (apart + 1e-4)
    cost = np.zeros((len(x), len(lab)))
    chosen = np.full(len(x), -1)
    used = np.zeros(len(lab))
    for _ in range(len(x)):
        # The bone whose best colour costs most is next, since its choice only becomes worse.
        open_bones = np.flatnonzero(chosen < 0)
        b = int(open_bones[np.argmax(cost[open_bones].min(axis=1))])
        c = int(np.argmin(cost[b] + 0.5 * used))
        chosen[b] = c
        cost += near[:, b][:, None] * repulsion[c]
        used += repulsion[c] * 0.02
    return _linear_from_oklab(lab[chosen]).clip(0.0, 1.0)


def mix(colors: NDArray[np.float64], weights: ArrayLike, indices: ArrayLike) -> NDArray[np.float64]:
    """Colours ``(V, 3)`` of vertices: bone colours ``(B, 3)`` blended by skin weights ``(V, K)``.

    All colours are linear RGB; they are blended in OKLab.
    """
    lab = np.cbrt(colors @ _LMS_FROM_RGB.T) @ _LAB_FROM_LMS.T
    w, j = np.asarray(weights, dtype=np.float64), np.asarray(indices)
    return _linear_from_oklab(np.einsum("vk,vkc->vc", w, lab[j])).clip(0.0, 1.0)


def heat(values: ArrayLike) -> NDArray[np.float64]:
    """Colours of values in [0, 1], linear RGB, from pale to dark with decreasing lightness."""
    table = np.array([[int(h[i : i + 2], 16) for i in (1, 3, 5)] for h in _HEAT.split()]) / 255
    at = np.clip(np.asarray(values, dtype=np.float64), 0.0, 1.0) * (len(table) - 1)
    grid = np.arange(len(table))
    return linear_from_srgb(np.stack([np.interp(at, grid, table[:, c]) for c in range(3)], axis=-1))


def _linear_from_oklab(lab: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear RGB of OKLab colours; it may lie outside the gamut of the display."""
    return np.asarray((lab @ np.linalg.inv(_LAB_FROM_LMS).T) ** 3 @ np.linalg.inv(_LMS_FROM_RGB).T)


def _candidates() -> NDArray[np.float64]:
    """Saturated colours of medium lightness in OKLab, inside the gamut of the display."""
    light, turn = np.meshgrid([0.55, 0.66, 0.77, 0.86], np.radians(np.arange(0, 360, 15)))
    lab = np.stack([light, 0.19 * np.cos(turn), 0.19 * np.sin(turn)], axis=-1).reshape(-1, 3)
    for _ in range(30):
        rgb = _linear_from_oklab(lab)
        outside = (rgb < 0).any(axis=1) | (rgb > 1).any(axis=1)
        lab[outside, 1:] *= 0.96
    return lab
