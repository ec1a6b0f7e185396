"""Mesh read from one file, and the cutting of polygons into triangles."""

from __future__ import annotations

import dataclasses
import logging
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import FormatError
from ...mesh.surface import Surface
from ..file_errors import check

_log = logging.getLogger(__name__)


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


_MOST_CORNERS = 500  # of a polygon that is cut by ears, which takes a time of their square


def cut(
    counts: NDArray[np.int64], indices: NDArray[np.int64], vertices: NDArray[Any]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cut polygons into triangles that face as their polygon does.

    A polygon is cut into a fan at its first corner if no triangle of it is turned over, else by
    ears (Meisters, Polygons have ears, 1975).

    Parameters
    ----------
    counts : (N,) int
        Number of corners of each polygon.
    indices : (C,) int
        Vertex of every corner of all polygons; one that does not exist counts as another.
    vertices : (V, 3) float
        Vertices in the first frame.

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
    start, first = np.cumsum(counts) - counts, np.cumsum(n) - n
    step = np.arange(len(polygon)) - first[polygon]
    base = start[polygon]
    corners = np.stack([base, base + step + 1, base + step + 2], axis=1)
    many = np.flatnonzero(counts[polygon] > 3)
    if not len(many) or not len(vertices):
        return corners, polygon
    points = vertices.take(indices, axis=0, mode="clip")
    a, b, c = np.asarray(points, dtype=np.float64)[corners[many]].transpose(1, 0, 2)
    area = np.cross(b - a, c - a)
    whole = np.stack([np.bincount(polygon[many], x, len(counts)) for x in area.T], axis=1)
    facing = (area * whole[polygon[many]]).sum(axis=1)
    over = facing < -1e-6 * (whole**2).sum(axis=1)[polygon[many]]
    for k in np.unique(polygon[many][over]):
        if counts[k] <= _MOST_CORNERS:
            own = points[start[k] : start[k] + counts[k]]
            corners[first[k] : first[k] + n[k]] = start[k] + _ears(own, whole[k])
    return corners, polygon


def _ears(points: NDArray[Any], area: NDArray[np.float64]) -> list[list[int]]:
    """Triangles (N - 2, 3) of one polygon with the vector area `area`, cut off as ears.

    What has no ear left, in a polygon that crosses itself, is cut into a fan.
    """
    axis = int(np.abs(area).argmax())
    flat = np.delete(np.asarray(points, dtype=np.float64), axis, axis=1)
    if (area[axis] < 0) != (axis == 1):  # seen from the other side
        flat = flat[:, ::-1]

    def turn(a: int, b: int, c: NDArray[np.float64]) -> Any:
        side, along = flat[b] - flat[a], c - flat[a]
        return side[0] * along[..., 1] - side[1] * along[..., 0]

    def is_ear(i: int) -> bool:
        a, b, c = corner = left[i - 1], left[i], left[(i + 1) % len(left)]
        others = flat[[k for k in left if k not in corner]]
        inside = (turn(a, b, others) >= 0) & (turn(b, c, others) >= 0) & (turn(c, a, others) >= 0)
        return bool(turn(a, b, flat[c]) > 0) and not inside.any()

    left, triangles = list(range(len(flat))), []
    while len(left) > 3 and (ear := next(filter(is_ear, range(len(left))), None)) is not None:
        triangles.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    return triangles + [[left[0], left[k], left[k + 1]] for k in range(1, len(left) - 1)]


def check_polygons(
    counts: NDArray[np.int64], indices: NDArray[np.int64], count: int, what: str
) -> None:
    """Raise a FormatError unless polygons of `what` have the corners `indices` of V vertices."""
    total, least, most = counts.sum(), indices.min(initial=0), indices.max(initial=-1)
    problem = f"{what}: its polygons have {total} corners, there are {len(indices)} indices"
    check((counts >= 0).all() and total == len(indices), problem)
    problem = f"{what}: indices from {least} to {most} for {count} vertices"
    check(least >= 0 and most < count, problem)


def at_corners(
    mesh: Any, rows: NDArray[Any], how: str, what: str, index: NDArray[np.int64] | None = None
) -> NDArray[np.float32] | None:
    """Values (T, 3, N) at the corners of triangles, of UVs, normals or colours `rows`.

    None, with a warning that begins with `what`, if they do not match the mesh.

    Parameters
    ----------
    mesh : object
        It has `corners`, `polygon` (as :func:`cut` returns them) and `faces`.
    rows : (M, N) float
    how : str
        USD's word for how many values there are, such as "vertex" for one per vertex.
    index : (M0,) int, optional
        Row of each value, if values are not rows in their order.
    """
    place = {
        "faceVarying": mesh.corners,
        "vertex": mesh.faces,
        "varying": mesh.faces,
        "uniform": np.repeat(mesh.polygon[:, None], 3, axis=1),
        "constant": np.zeros_like(mesh.faces),
    }.get(how)
    if place is not None and index is not None:
        inside = place.max(initial=-1) < len(index) and index.min(initial=0) >= 0
        place = index[place] if inside else None
    if place is None or place.max(initial=-1) >= len(rows) or not np.isfinite(rows).all():
        _log.warning("%s do not match the mesh and are left out", what)
        return None
    return np.asarray(rows[place], dtype=np.float32)


def opaque(colors: NDArray[Any]) -> NDArray[np.float32]:
    """Colours (..., 4) of which those without an alpha (..., 3) become opaque."""
    alpha = np.ones((*colors.shape[:-1], 4 - colors.shape[-1]))
    return np.concatenate([colors, alpha], axis=-1).astype(np.float32)
