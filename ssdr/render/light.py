"""Light that things are in the way of: depth seen from distant lights."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from ..kernels.raster import light_shares, raster_triangles
from ..parallel import chunk_bounds, run_chunks

__all__ = ["Lights", "on_both_sides", "sphere_directions"]

Float = NDArray[np.float64]
_CHUNK = 8192  # points in a piece of work


@dataclasses.dataclass(frozen=True, eq=False)
class Lights:
    """Distant lights and what each of them sees.

    Attributes
    ----------
    axes : (D, 3, 3) float64
        Rows: right and up in a light's picture, and towards the light.
    corners : (D, 2) float64
        Of the pictures, along their axes.
    scales : (D,) float64
        Pixels per unit of length.
    nearness : (D, n, n) float64
        Along the third axis, −inf where nothing is.
    """

    axes: Float
    corners: Float
    scales: Float
    nearness: Float

    @classmethod
    def around(
        cls, directions: Float, points: Float, faces: NDArray[np.int32], pixels: int
    ) -> Lights:
        """Lights in unit directions ``(D, 3)`` from triangles, with square pictures of them."""
        across = np.eye(3)[np.abs(directions).argmin(axis=1)]
        right = np.cross(across, directions)
        right /= np.linalg.norm(right, axis=1, keepdims=True)
        axes = np.stack([right, np.cross(directions, right), directions], axis=1)
        view = np.einsum("drc,vc->dvr", axes, points)
        low, high = view[:, :, :2].min(axis=1), view[:, :, :2].max(axis=1)
        # Two pixels are free on each side, so that interpolation meets an edge.
        scales = (pixels - 4) / np.maximum((high - low).max(axis=1), 1e-30)
        corners = low - 2 / scales[:, None]
        view[:, :, :2] = (view[:, :, :2] - corners[:, None]) * scales[:, None, None]
        nearness = np.full((len(axes), pixels, pixels), -np.inf)

        def look(_: int, first: int, last: int) -> None:
            index = np.empty((pixels, pixels), dtype=np.int32)
            for d in range(first, last):
                raster_triangles(view[d], faces, nearness[d], index, 0, pixels)

        run_chunks(look, chunk_bounds(len(axes), 4))
        return cls(axes, corners, scales, nearness)

    @property
    def directions(self) -> Float:
        """Unit vectors ``(D, 3)`` towards the lights."""
        return self.axes[:, 2]

    def only(self, chosen: NDArray[np.bool_]) -> Lights:
        """Some of the lights."""
        return Lights(
            self.axes[chosen], self.corners[chosen], self.scales[chosen], self.nearness[chosen]
        )

    def shares(self, points: Float, normals: Float, bias: float) -> Float:
        """Share ``(N, D)`` of each light that reaches points on a surface.

        What lies nearer to a light by less than `bias` casts no shadow, by twice as much a full
        one; points are lifted along their normals by as much, to the light's side.
        """
        out = np.empty((len(points), len(self.axes)))
        arrays = (self.axes, self.corners, self.scales, self.nearness)

        def read(_: int, first: int, last: int) -> None:
            light_shares(points, normals, *arrays, bias, out, first, last)

        run_chunks(read, chunk_bounds(len(points), _CHUNK))
        return out


def sphere_directions(count: int) -> Float:
    """Unit vectors ``(count, 3)``, evenly over the sphere (Fibonacci)."""
    k = np.arange(count) + 0.5
    height = 1 - 2 * k / count
    turn = k * math.pi * (3 - math.sqrt(5))
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(turn), height, ring * np.sin(turn)], axis=1)


def on_both_sides(
    lights: Lights, colors: Float, points: Float, normals: Float, bias: float
) -> Float:
    """Light ``(N, 6)`` from all around on a surface, as far as it arrives.

    Parameters
    ----------
    lights : Lights
        Evenly over the sphere.
    colors : (D, 3) float64
        Their radiance, linear RGB; 1 everywhere gives 1 where nothing is in the way.
    points, normals : (N, 3) float64
        The first three columns of the result are for the side of the normal.
    bias : float
        See :meth:`Lights.shares`.
    """
    arrived = lights.shares(points, normals, bias)
    cosine = normals @ lights.directions.T
    front = (np.maximum(cosine, 0.0) * arrived) @ colors
    back = (np.maximum(-cosine, 0.0) * arrived) @ colors
    return np.asarray(np.concatenate([front, back], axis=1) * (4.0 / len(colors)))
