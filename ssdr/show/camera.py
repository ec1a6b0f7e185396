"""The viewer of a picture, and the triangles and balls that it sees, by a depth buffer."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError
from ..common.parallel import chunk_bounds, run_chunks
from ..kernels.raster import raster_balls, raster_triangles

Float = NDArray[np.float64]
Size = tuple[int, int]
Pixels = tuple[NDArray[np.intp], NDArray[np.intp]]
_TALL = math.tan(math.radians(24.0) / 2)  # half the height of the view at distance 1
_FREE = 0.84  # share of the picture that the subject fills at most
_BAND = 48  # rows of pixels in a task; each task visits all triangles


@dataclasses.dataclass(frozen=True, eq=False)
class Camera:
    """Position and orientation of the viewer, in perspective.

    Attributes
    ----------
    axes : (3, 3) float64
        Rows: right, up and towards the viewer, in world coordinates.
    eye : (3,) float64
        Centre of projection.
    vertical : (3,) float64
        Up axis of the world.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> from ssdr.show import Camera
    >>> camera = Camera.fit(dancer.vertices.reshape(-1, 3), azimuth=45)
    >>> pixels = camera.project(dancer.frames(0), (640, 640))
    >>> pixels.shape, bool((pixels[:, :2] >= 0).all() and (pixels[:, :2] <= 640).all())
    ((799, 3), True)
    """

    axes: Float
    eye: Float
    vertical: Float

    @classmethod
    def fit(
        cls,
        points: Float,
        *,
        azimuth: float = 30.0,
        elevation: float = 12.0,
        up: str = "y",
        aspect: float = 1.0,
    ) -> Camera:
        """Closest camera that sees all the points.

        Parameters
        ----------
        points : (N, 3) float64
        azimuth, elevation : float
            Degrees.  At azimuth 0 the camera faces the front of the subject (the side of +z if y
            is up, of −y if z is up); a positive azimuth moves the camera to the viewer's right.
        up : {"x", "y", "z", "-x", "-y", "-z"}
        aspect : float
            Width over height of the picture.

        Raises
        ------
        InputError
            If `up` names no axis, or an angle is not valid.
        """
        vertical, front, side = up_axes(up)
        if not -90 <= elevation <= 90:
            raise InputError("elevation", "-90 to 90 degrees", elevation)
        if not math.isfinite(azimuth):
            raise InputError("azimuth", "degrees", azimuth)
        a, e = math.radians(azimuth), math.radians(elevation)
        back = math.cos(e) * (math.cos(a) * front + math.sin(a) * side) + math.sin(e) * vertical
        right = math.cos(a) * side - math.sin(a) * front
        axes = np.stack([right, np.cross(back, right), back])
        view = np.asarray(points, dtype=np.float64) @ axes.T
        low, high = view.min(axis=0), view.max(axis=0)
        size = max(float(np.linalg.norm(high - low)), 1e-12 * float(np.abs(view).max()), 1e-30)
        # Each side plane of the view bounds the position of the eye linearly.
        eye, distance = np.zeros(3), -np.inf
        for c, reach in ((0, _TALL * aspect * _FREE), (1, _TALL * _FREE)):
            above = float((view[:, c] / reach + view[:, 2]).max())
            below = float((-view[:, c] / reach + view[:, 2]).max())
            distance = max(distance, (above + below) / 2)
            eye[c] = reach * (above - below) / 2
        eye[2] = max(distance, high[2] + 0.05 * size)
        return cls(axes, eye @ axes, vertical)

    def project(self, points: Float, size: Size) -> Float:
        """Pixel coordinates x, y and nearness ``(N, 3)``; NaN for points behind the eye."""
        view = (np.asarray(points, dtype=np.float64) - self.eye) @ self.axes.T
        z = -view[:, 2]
        near = np.divide(1.0, z, out=np.full(len(z), np.nan), where=z > 0)
        right, up = (view[:, :2] * (near * pixels_per_unit(size))[:, None]).T
        return np.stack([size[0] / 2 + right, size[1] / 2 - up, near], axis=1)


def pixels_per_unit(size: Size) -> float:
    """Pixels per unit of length at distance 1 from the eye."""
    return size[1] / 2 / _TALL


def up_axes(up: str) -> tuple[Float, Float, Float]:
    """Unit vectors towards the up axis, the front, and the right seen from the front."""
    name = up.lstrip("-") if isinstance(up, str) else ""
    if name not in ("x", "y", "z") or up not in (name, f"-{name}"):
        raise InputError("up", "x, y or z, with or without a minus", repr(up))
    vertical = np.zeros(3)
    vertical["xyz".index(name)] = -1.0 if up.startswith("-") else 1.0
    front = {"x": [0.0, 0, 1], "y": [0.0, 0, 1], "z": [0.0, -1, 0]}[name]
    return vertical, np.array(front), np.cross(vertical, front)


def empty_depth(size: Size) -> Float:
    """Empty depth buffer ``(H, W)``: nearness −inf everywhere."""
    return np.full((size[1], size[0]), -np.inf)


def triangles_seen(
    camera: Camera, points: Float, faces: NDArray[np.int32], nearness: Float
) -> tuple[Pixels, NDArray[np.int32], Float]:
    """Rasterise triangles.

    Parameters
    ----------
    camera : Camera
    points : (V, 3) float64
    faces : (T, 3) int32
    nearness : (H, W) float64
        Depth buffer, updated in place: larger is nearer, −inf is empty.

    Returns
    -------
    pixels : (rows, columns)
        The N pixels in which a triangle is nearest.
    index : (N,) int32
        Index of the triangle.
    share : (N, 3) float64
        Barycentric coordinates in the triangle.
    """
    screen = camera.project(points, nearness.shape[::-1])
    pixels, index = _nearest(raster_triangles, (screen, faces), nearness)
    corners = faces[index]
    p = screen[corners, :2] - np.stack(pixels[::-1], axis=1)[:, None] - 0.5
    q, r = np.roll(p, -1, axis=1), np.roll(p, -2, axis=1)
    share = (q[..., 0] * r[..., 1] - r[..., 0] * q[..., 1]) * screen[corners, 2]
    return pixels, index, share / share.sum(axis=1, keepdims=True)


def balls_seen(
    camera: Camera, centers: Float, radius: float, nearness: Float
) -> tuple[Pixels, NDArray[np.int32], Float]:
    """Rasterise balls of centres ``(M, 3)``.

    The other parameters and the results are those of :func:`triangles_seen`, with unit normals
    ``(N, 3)`` in world axes instead of barycentric coordinates.
    """
    size = nearness.shape[::-1]
    screen = camera.project(centers, size)
    near = screen[:, 2]
    rise = 1.0 / np.maximum(1.0 / near - radius, 1e-3 / near) - near
    radii = np.maximum(radius * pixels_per_unit(size) * near, 0.5)
    balls = np.column_stack([screen[:, :2], radii, near, rise])
    pixels, index = _nearest(raster_balls, (balls,), nearness)
    x = (pixels[1] + 0.5 - balls[index, 0]) / balls[index, 2]
    y = (balls[index, 1] - pixels[0] - 0.5) / balls[index, 2]
    normal = np.stack([x, y, np.sqrt(np.maximum(0.0, 1 - x * x - y * y))], axis=1)
    return pixels, index, normal @ camera.axes


def _nearest(kernel: Any, shapes: tuple[Any, ...], nearness: Float) -> tuple[Pixels, Any]:
    index = np.full(nearness.shape, -1, dtype=np.int32)

    def draw(_: int, first: int, last: int) -> None:
        kernel(*shapes, nearness, index, first, last)

    run_chunks(draw, chunk_bounds(len(index), _BAND))
    rows, columns = np.nonzero(index >= 0)
    return (rows, columns), index[rows, columns]


def between(share: Float, values: Float) -> Float:
    """Values ``(N, k, C)`` interpolated to ``(N, C)`` with weights ``(N, k)``."""
    # several times faster than one product over all corners
    out = share[:, :1] * values[:, 0]
    for k in range(1, share.shape[1]):
        out += share[:, k : k + 1] * values[:, k]
    return out
