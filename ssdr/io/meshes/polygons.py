"""Mesh read from one file, and the cutting of polygons into triangles."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import FormatError
from ...mesh.surface import Surface


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Mesh:
    """Vertices and triangles of one file, in the file's order.

    Attributes
    ----------
    vertices : (V, 3) float
    faces : (T, 3) int
    surface : Surface or None
    topology : bytes
        Text from which the faces were parsed, for comparison with other files; may be empty.
    """

    vertices: NDArray[Any]
    faces: NDArray[np.int64]
    surface: Surface | None = None
    topology: bytes = b""


def fan(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cut polygons into triangles that share the first corner of their polygon.

    Parameters
    ----------
    counts : (N,) int
        Number of corners of each polygon.

    Returns
    -------
    corners : (T, 3) int
        Corners of each triangle, as positions in the concatenated corners of all polygons.
    polygon : (T,) int
        Index of the polygon that each triangle comes from.

    Raises
    ------
    FormatError
        If a polygon has fewer than three corners.
    """
    if len(counts) and counts.min() < 3:
        k = int(counts.argmin())
        raise FormatError(f"face {k} has {counts[k]} corners")
    n = counts - 2
    polygon = np.repeat(np.arange(len(counts)), n)
    start = np.cumsum(counts) - counts
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(n) - n, n)
    base = start[polygon]
    return np.stack([base, base + step + 1, base + step + 2], axis=1), polygon


def value_index(
    interpolation: str,
    corners: NDArray[np.int64],
    faces: NDArray[np.int64],
    polygon: NDArray[np.int64],
) -> NDArray[np.int64] | None:
    """Index (T, 3) of the value that UVs or normals have at each triangle corner.

    Parameters
    ----------
    interpolation : str
        USD's word for how many values there are, such as "vertex" for one per vertex.
    corners, faces : (T, 3) int arrays
        Corners of each triangle, as indices into those of all polygons, and its vertices.
    polygon : (T,) int array

    Returns
    -------
    (T, 3) int array, or None if the word is unknown.
    """
    return {
        "faceVarying": corners,
        "vertex": faces,
        "varying": faces,
        "uniform": np.repeat(polygon[:, None], 3, axis=1),
        "constant": np.zeros_like(faces),
    }.get(interpolation)
