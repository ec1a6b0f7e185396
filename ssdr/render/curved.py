"""Curved triangles: a coarse mesh drawn without its corners."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from .raster import unit

__all__ = ["Curved"]

Float = NDArray[np.float64]
# Cosine between a vertex's normal and its triangle's, below which the corner stays sharp.
_SHARP = 0.3


@dataclasses.dataclass(frozen=True, eq=False)
class Curved:
    """Cubic triangles through the vertices of a mesh, each cut into `level`² flat ones.

    Vlachos et al., "Curved PN triangles", 2001.  Every vertex stays where it is; between them
    the surface follows the vertices' normals.

    Attributes
    ----------
    faces : (T, 3) int32
        Of the coarse mesh.
    level : int
    """

    faces: NDArray[np.int32]
    level: int

    @property
    def lattice(self) -> Float:
        """Barycentric coordinates ``(L, 3)`` of the points in a triangle."""
        n = self.level
        rows = [(n - j - k, j, k) for k in range(n + 1) for j in range(n + 1 - k)]
        return np.array(rows, dtype=np.float64) / n

    def triangles(self) -> NDArray[np.int32]:
        """Fine triangles ``(T level², 3)``, in the order of the coarse ones."""
        n = self.level
        start = np.cumsum([0, *range(n + 1, 0, -1)])
        cell: list[tuple[int, int, int]] = []
        for k in range(n):
            for j in range(n - k):
                a, b = int(start[k]) + j, int(start[k + 1]) + j
                cell.append((a, a + 1, b))
                if j + k < n - 1:
                    cell.append((a + 1, b + 1, b))
        points = (n + 1) * (n + 2) // 2
        first = np.arange(len(self.faces), dtype=np.int32) * points
        fine = first[:, None, None] + np.array(cell, dtype=np.int32)
        return np.ascontiguousarray(fine.reshape(-1, 3))

    def spread(self, values: Float) -> Float:
        """Values of vertices ``(V, c)``, interpolated to the fine points ``(T L, c)``."""
        fine = np.einsum("lk,tkc->tlc", self.lattice, values[self.faces])
        return np.asarray(fine.reshape(-1, values.shape[1]))

    def vertex_normals(self, points: Float) -> Float:
        """Unit normals ``(V, 3)``, weighted so that a sphere gets its own (Max 1999)."""
        p = points[self.faces]
        flat = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        after, before = np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p
        lengths = (after**2).sum(-1) * (before**2).sum(-1)
        part = flat[:, None] / np.maximum(lengths, 1e-300)[..., None]
        corners = self.faces.ravel()
        sums = [np.bincount(corners, part[..., c].ravel(), len(points)) for c in range(3)]
        return unit(np.stack(sums, axis=1))

    def surface(self, points: Float, smooth: Float) -> tuple[Float, Float]:
        """Places and unit normals of the fine points, each ``(T L, 3)``, from vertex normals."""
        p = points[self.faces]
        flat = unit(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))
        normals = smooth[self.faces]
        sharp = np.einsum("tkc,tc->tk", normals, flat) < _SHARP
        normals = np.where(sharp[..., None], flat[:, None], normals)
        if self.level == 1:
            return p.reshape(-1, 3), normals.reshape(-1, 3)
        lattice = self.lattice
        u, v, w = lattice.T
        place = np.einsum("lk,tkc->tlc", np.stack([u**3, v**3, w**3], axis=1), p)
        middle = np.zeros_like(p[:, 0])
        corners = lattice.T
        for i in range(3):
            for j in range(3):
                if i != j:
                    # Control point near corner i on its edge to corner j.
                    rise = np.einsum("tc,tc->t", p[:, j] - p[:, i], normals[:, i])
                    control = (2 * p[:, i] + p[:, j] - rise[:, None] * normals[:, i]) / 3
                    place += (3 * corners[i] ** 2 * corners[j])[None, :, None] * control[:, None]
                    middle += control / 4
        middle -= p.sum(axis=1) / 6
        place += (6 * u * v * w)[None, :, None] * middle[:, None]
        normal = unit(np.einsum("lk,tkc->tlc", lattice, normals))
        return place.reshape(-1, 3), normal.reshape(-1, 3)
