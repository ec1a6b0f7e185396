"""Convex outlines of a part of the body along an axis, which a garment follows at a distance."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import ConvexHull

Floats = NDArray[np.float64]

# Distance between the sections of an outline, metres.
LEVEL = 0.01
# Angles of a section; 0 is the front and a quarter the left side.
_TURN = np.linspace(0, 2 * np.pi, 129)
_BACK = 64


@dataclasses.dataclass(frozen=True, eq=False)
class Outline:
    """Outlines of a part of the body, at several positions along its axis.

    Attributes
    ----------
    levels : (n,) float64
        Positions along the axis, metres.
    centre : (n, 2) float64
        Centre of each outline in x and z.
    radius : (n, 129) float64
        Radius of each outline at the angles of a full turn.
    frame : (3, 3) float64
        Axes as rows; y is along the part of the body.
    """

    levels: Floats
    centre: Floats
    radius: Floats
    frame: Floats

    def at(self, y: float, angles: Floats, wider: float = 0.0) -> Floats:
        """Points ``(n, 3)`` at the position `y` of the axis, `wider` metres outside the outline."""
        k = int(np.clip(np.searchsorted(self.levels, y, "right") - 1, 0, len(self.levels) - 2))
        table = np.concatenate([self.centre, self.radius], axis=1)[k : k + 2]
        slope = (table[1] - table[0]) / (self.levels[k + 1] - self.levels[k])
        row = slope * (y - self.levels[k]) + table[0]
        r = np.interp(angles, _TURN, row[2:], period=2 * np.pi) + wider
        x, z = row[0] + r * np.sin(angles), row[1] + r * np.cos(angles)
        return np.stack([x, np.full(len(x), y), z], axis=1) @ self.frame


def find_outline(
    rest: Floats,
    faces: NDArray[np.int32],
    low: float,
    high: float,
    clearance: float,
    frame: Floats | None = None,
) -> Outline:
    """Outlines of some triangles of the body over a part of the y axis.

    Parameters
    ----------
    rest : (V, 3) float64
    faces : (T, 3) int32
    low, high : float
        Ends of that part; the outlines reach 20 mm beyond both.
    clearance : float
        Distance from the skin, perpendicular to the axis, metres.
    frame : (3, 3) float64, optional
        Axes as rows; by default those of the body, with outlines symmetric in x.
    """
    axes = np.eye(3) if frame is None else frame
    points = rest @ axes.T
    levels = np.arange(low - 2 * LEVEL, high + 2.1 * LEVEL, LEVEL)
    direction = np.stack([np.sin(_TURN), np.cos(_TURN)], axis=1)
    centre, radius = np.zeros((len(levels), 2)), np.empty((len(levels), len(_TURN)))
    for k, y in enumerate(levels):
        cut = section(points, faces, float(y))
        if frame is None:
            cut = np.concatenate([cut, cut * [-1, 1]])
        centre[k] = (cut.min(axis=0) + cut.max(axis=0)) / 2
        hull = ConvexHull(cut - centre[k]).equations
        toward = direction @ hull[:, :2].T
        with np.errstate(divide="ignore"):
            hit = np.where(toward > 1e-9, -hull[:, 2] / toward, np.inf)
        radius[k] = hit.min(axis=1)
    if frame is None:
        radius[:, _BACK + 1 :] = radius[:, _BACK - 1 :: -1]
    # Smoothed over about 30 mm of height and 2.5 sections, and over 2 of the 128 angles.
    centre = gaussian_filter1d(centre, 3, axis=0, mode="nearest")
    even = gaussian_filter1d(radius[:, :-1], 2.5, axis=0, mode="nearest")
    even = gaussian_filter1d(even, 2, mode="wrap")
    outer = np.maximum(even, radius[:, :-1])
    if frame is None:
        # At the spine the smoothed radius is used even if it is smaller than the body's: the stored
        # clips of the dress depend on that.
        outer[:, _BACK] = even[:, _BACK]
    outer = np.concatenate([outer, outer[:, :1]], axis=1) + clearance
    return Outline(levels, centre, outer, axes)


def section(rest: Floats, faces: NDArray[np.int32], y: float) -> Floats:
    """Points ``(n, 2)``, as x and z, at which edges of the mesh cross the height `y`."""
    pairs = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    a, b = rest[pairs[:, 0]], rest[pairs[:, 1]]
    cut = (a[:, 1] < y) != (b[:, 1] < y)
    a, b = a[cut], b[cut]
    t = ((y - a[:, 1]) / (b[:, 1] - a[:, 1]))[:, None]
    return np.asarray((a + t * (b - a))[:, [0, 2]])
