"""Rings of vertices around a body, and the triangles between them.

One half of a garment is built of rings and reflected, so that the permutation that swaps left and
right is exact.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

# Height of an equilateral triangle of side 1, the distance between rings of vertices.
ROW = np.sqrt(3) / 2
# Number of rings that describe the surface of a yoke, a sleeve or a leg before it is meshed.
_RINGS = 200


class Half:
    """The half of a garment at x >= 0: rows of points, to be joined by strips of triangles.

    Points at x = 0 belong to both halves.
    """

    def __init__(self) -> None:
        self._rows: list[Floats] = []
        self._limbs: list[bool] = []
        self._strips: list[list[Indices]] = []

    def add(self, points: Floats, *, limb: bool = False) -> Indices:
        """Add points ``(n, 3)`` and return their indices; `limb` marks those of a sleeve or leg."""
        first = sum(len(row) for row in self._rows)
        self._rows.append(points)
        self._limbs.append(limb)
        return first + np.arange(len(points))

    def join(self, rows: list[Indices]) -> None:
        """Add the triangles between consecutive rows, each of which lies below the one before."""
        self._strips.append(rows)

    def hang(self, ring: Indices, tube: Floats, spacing: float) -> None:
        """Add the rings ``(n, m, 3)`` of a sleeve or a leg below the existing ring `ring`.

        The first of the new rings coincides with it.
        """
        rows = [np.append(ring, ring[0])]
        for row in some_of(tube, spacing)[1:]:
            new = self.add(divide(row, spacing)[:-1], limb=True)
            rows.append(np.append(new, new[0]))
        self.join(rows)

    def n_vertices(self) -> int:
        """Number of vertices of both halves."""
        return sum(2 * len(row) - int((row[:, 0] == 0).sum()) for row in self._rows)

    def reflect(self) -> tuple[Floats, NDArray[np.int32], NDArray[np.int32], NDArray[np.int8]]:
        """Vertices, triangles, mirror permutation and sides of both halves, as in a garment."""
        rest, mirror, index, sides, start = [], [], [], [], 0
        for row, limb in zip(self._rows, self._limbs, strict=True):
            # From the front around the left side to the back, then the right side from there.
            other = np.flatnonzero(row[:, 0])[::-1]
            image = np.arange(len(row))
            image[other] = len(row) + np.arange(len(other))
            rest += [row, row[other] * [-1, 1, 1]]
            mirror += [start + image, start + other]
            sides += [np.full(len(row), limb, np.int8), -np.full(len(other), limb, np.int8)]
            index.append(start + np.arange(len(row)))
            start += len(row) + len(other)
        points, swap, place = (np.concatenate(a) for a in (rest, mirror, index))
        strips = [
            _zip(points, place[a], place[b], k)
            for strip in self._strips
            for k, (a, b) in enumerate(itertools.pairwise(strip))
        ]
        half = np.concatenate(strips)
        faces = np.concatenate([half, swap[half][:, ::-1]]).astype(np.int32)
        return points, faces, swap.astype(np.int32), np.concatenate(sides)


def evenly(rings: Floats) -> Floats:
    """Rings resampled at equal distances along the surface."""
    way = np.linalg.norm(np.diff(rings, axis=0), axis=2)
    length = np.concatenate([np.zeros((1, way.shape[1])), np.cumsum(way, axis=0)])
    at = np.linspace(0, 1, _RINGS)[:, None] * length[-1]
    columns = zip(at.T, length.T, rings.swapaxes(0, 1), strict=True)
    return np.stack([points_at(*column) for column in columns], axis=1)


def points_at(at: Floats, along: NDArray[Any], curve: Floats) -> Floats:
    """Points ``(m, 3)`` of a curve ``(n, 3)`` at some of the numbers ``(n,)`` along it."""
    return np.stack([np.interp(at, along, c) for c in curve.T], axis=1)


def some_of(rings: Floats, spacing: float) -> Floats:
    """Evenly chosen `rings`, so many that edges between them are about `spacing` long."""
    length = np.linalg.norm(np.diff(rings, axis=0), axis=2).sum(axis=0).mean()
    count = max(1, round(float(length) / (spacing * ROW)))
    at = np.linspace(0, len(rings) - 1, count + 1)
    first = np.minimum(at.astype(int), len(rings) - 2)
    share = (at - first)[:, None, None]
    return np.asarray((1 - share) * rings[first] + share * rings[first + 1])


def divide(curve: Floats, spacing: float) -> Floats:
    """Points ``(n, 3)`` along a curve, its ends among them, about `spacing` apart."""
    way = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    length = np.concatenate([[0], np.cumsum(way)])
    count = max(4, round(length[-1] / spacing))
    at = np.linspace(0, length[-1], count + 1)
    points = points_at(at, length, curve)
    points[np.abs(points[:, 0]) < 1e-9, 0] = 0.0
    return points


def _zip(
    points: NDArray[np.float64], above: NDArray[np.int64], below: NDArray[np.int64], row: int
) -> NDArray[np.int64]:
    """Triangles between two half rings, each chosen for the shorter of two diagonals."""
    i, j, faces = 0, 0, []
    while i < len(above) - 1 or j < len(below) - 1:
        if j == len(below) - 1:
            down = False
        elif i == len(above) - 1:
            down = True
        else:
            longer = np.linalg.norm(points[above[i]] - points[below[j + 1]]) - np.linalg.norm(
                points[above[i + 1]] - points[below[j]]
            )
            # Between rings of equal size both diagonals are equal (to 1e-3 of an edge): they
            # alternate, so that the cloth has no preferred direction.
            even = abs(longer) < 1e-3 * np.linalg.norm(points[below[j + 1]] - points[below[j]])
            down = (i + row) % 2 == 0 if even else bool(longer < 0)
        if down:
            faces.append((above[i], below[j], below[j + 1]))
            j += 1
        else:
            faces.append((above[i], below[j], above[i + 1]))
            i += 1
    return np.array(faces)
