"""Camera and rasteriser: the nearest triangle or ball in each pixel."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..kernels.raster import raster_balls, raster_triangles
from ..parallel import chunk_bounds, run_chunks

Float = NDArray[np.float64]
Pixels = tuple[NDArray[np.intp], NDArray[np.intp]]
_BAND = 48  # rows of pixels in a task; each task visits all triangles
_FIELD_OF_VIEW = 24.0  # degrees, vertical


@dataclasses.dataclass(frozen=True, eq=False)
class Camera:
    """Position, orientation and projection of the viewer.

    Attributes
    ----------
    axes : (3, 3) float64
        Rows: right, up and towards the viewer, in world coordinates.
    eye : (3,) float64
        Centre of projection; for a parallel projection any point on its axis.
    scale : float
        Half the height of what the picture shows, in the mesh's units; for a perspective
        projection at distance 1 from the eye.
    perspective : bool
    vertical : (3,) float64
        Up axis of the world.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> from ssdr.render import Camera
    >>> camera = Camera.fit(dancer.vertices.reshape(-1, 3), azimuth=45)
    >>> pixels = camera.project(dancer.frames(0), (640, 640))
    >>> pixels.shape, bool((pixels[:, :2] >= 0).all() and (pixels[:, :2] <= 640).all())
    ((799, 3), True)
    """

    axes: Float
    eye: Float
    scale: float
    perspective: bool
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
        perspective: bool = True,
        margin: float = 0.08,
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
        perspective : bool
            False: parallel projection.
        margin : float
            Share of the picture left free on each side.

        Raises
        ------
        InputError
            If `up` names no axis.
        """
        vertical, front, side = up_axes(up)
        a, e = math.radians(azimuth), math.radians(elevation)
        back = math.cos(e) * (math.cos(a) * front + math.sin(a) * side) + math.sin(e) * vertical
        right = math.cos(a) * side - math.sin(a) * front
        axes = np.stack([right, np.cross(back, right), back])
        view = np.asarray(points, dtype=np.float64) @ axes.T
        low, high = view.min(axis=0), view.max(axis=0)
        size = max(float(np.linalg.norm(high - low)), 1e-12 * float(np.abs(view).max()), 1e-30)
        tall = math.tan(math.radians(_FIELD_OF_VIEW) / 2)
        free = 1 - 2 * margin
        if not perspective:
            half = max((high[1] - low[1]) / 2, (high[0] - low[0]) / 2 / aspect, size * 1e-3) / free
            eye = (low + high) / 2 + [0, 0, 2 * size]
            return cls(axes, eye @ axes, float(half), False, vertical)
        # Each side plane of the view bounds the position of the eye linearly.
        distance, centre = 0.0, np.zeros(3)
        for c, reach in ((0, tall * aspect * free), (1, tall * free)):
            above = float((view[:, c] / reach + view[:, 2]).max())
            below = float((-view[:, c] / reach + view[:, 2]).max())
            distance = max(distance, (above + below) / 2) if c else (above + below) / 2
            centre[c] = reach * (above - below) / 2
        centre[2] = max(distance, high[2] + 0.05 * size)
        return cls(axes, centre @ axes, tall, True, vertical)

    def project(self, points: Float, size: tuple[int, int]) -> Float:
        """Pixel coordinates x, y and nearness ``(N, 3)``; NaN for points behind the eye."""
        width, height = size
        view = (np.asarray(points, dtype=np.float64) - self.eye) @ self.axes.T
        z = -view[:, 2]
        pixel = self.pixels_per_unit(size)
        if self.perspective:
            near = np.divide(1.0, z, out=np.full(len(z), np.nan), where=z > 0)
            with np.errstate(invalid="ignore"):
                x, y = view[:, 0] * near * pixel, view[:, 1] * near * pixel
        else:
            x, y, near = view[:, 0] * pixel, view[:, 1] * pixel, -z
        return np.stack([width / 2 + x, height / 2 - y, near], axis=1)

    def pixels_per_unit(self, size: tuple[int, int]) -> float:
        """Pixels per unit of length; for a perspective projection, at distance 1 from the eye."""
        return size[1] / 2 / self.scale

    def rays(
        self, rows: NDArray[np.intp], columns: NDArray[np.intp], size: tuple[int, int]
    ) -> tuple[Float, Float]:
        """Origins and directions, ``(N, 3)`` each, of the lines of sight through pixels."""
        pixel = self.pixels_per_unit(size)
        right, up = (columns + 0.5 - size[0] / 2) / pixel, (size[1] / 2 - rows - 0.5) / pixel
        offset = np.outer(right, self.axes[0]) + np.outer(up, self.axes[1])
        if self.perspective:
            return np.broadcast_to(self.eye, offset.shape), offset - self.axes[2]
        return self.eye + offset, np.broadcast_to(-self.axes[2], offset.shape)


def empty_depth(size: tuple[int, int]) -> Float:
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
    size = (nearness.shape[1], nearness.shape[0])
    screen = camera.project(points, size)
    pixels, index = _nearest(raster_triangles, screen, faces, nearness)
    corners = faces[index]
    p = screen[corners, :2] - np.stack(pixels[::-1], axis=1)[:, None] - 0.5
    q, r = np.roll(p, -1, axis=1), np.roll(p, -2, axis=1)
    share = q[..., 0] * r[..., 1] - r[..., 0] * q[..., 1]
    if camera.perspective:
        share = share * screen[corners, 2]
    return pixels, index, share / share.sum(axis=1, keepdims=True)


def balls_seen(
    camera: Camera, centers: Float, radii: Float, nearness: Float
) -> tuple[Pixels, NDArray[np.int32], Float]:
    """Rasterise balls of centres ``(M, 3)`` and radii ``(M,)``.

    The other parameters and the results are those of :func:`triangles_seen`, with unit normals
    ``(N, 3)`` in world axes instead of barycentric coordinates.
    """
    size = (nearness.shape[1], nearness.shape[0])
    screen, pixel = camera.project(centers, size), camera.pixels_per_unit(size)
    near = screen[:, 2]
    radius, rise = radii * pixel, radii
    if camera.perspective:
        radius = radius * near
        rise = 1.0 / np.maximum(1.0 / near - radii, 1e-3 / near) - near
    balls = np.column_stack([screen[:, :2], np.maximum(radius, 0.5), near, rise])
    pixels, index = _nearest(raster_balls, balls, None, nearness)
    x = (pixels[1] + 0.5 - balls[index, 0]) / balls[index, 2]
    y = (balls[index, 1] - pixels[0] - 0.5) / balls[index, 2]
    normal = np.stack([x, y, np.sqrt(np.maximum(0.0, 1 - x * x - y * y))], axis=1)
    return pixels, index, normal @ camera.axes


def _nearest(kernel: Any, shapes: Float, faces: Any, nearness: Float) -> tuple[Pixels, Any]:
    index = np.full(nearness.shape, -1, dtype=np.int32)
    arrays = (shapes,) if faces is None else (shapes, faces)

    def draw(_: int, first: int, last: int) -> None:
        kernel(*arrays, nearness, index, first, last)

    run_chunks(draw, chunk_bounds(len(index), _BAND))
    rows, columns = np.nonzero(index >= 0)
    return (rows, columns), index[rows, columns]


def block_mean(values: Float, step: int) -> Float:
    """Mean of each block of `step` × `step` pixels; `step` must divide height and width."""
    rows = values[0::step].copy()
    for k in range(1, step):  # several times faster than a mean over two axes
        rows += values[k::step]
    out = rows[:, 0::step].copy()
    for k in range(1, step):
        out += rows[:, k::step]
    return np.asarray(out / step**2)


def up_axes(up: str) -> tuple[Float, Float, Float]:
    """Unit vectors towards the up axis, the front, and the right seen from the front."""
    name = up.lstrip("-") if isinstance(up, str) else ""
    if name not in ("x", "y", "z") or up not in (name, f"-{name}"):
        raise InputError("up", "x, y or z, with or without a minus", repr(up))
    vertical = np.zeros(3)
    vertical["xyz".index(name)] = -1.0 if up.startswith("-") else 1.0
    front = {"x": [0.0, 0, 1], "y": [0.0, 0, 1], "z": [0.0, -1, 0]}[name]
    return vertical, np.array(front), np.cross(vertical, front)


def between(share: Float, values: Float) -> Float:
    """Values ``(N, k, C)`` interpolated to ``(N, C)`` with weights ``(N, k)``."""
    # several times faster than one product over all corners
    out = share[:, :1] * values[:, 0]
    for k in range(1, share.shape[1]):
        out += share[:, k : k + 1] * values[:, k]
    return out


def normals_of(points: Float, faces: NDArray[np.int32]) -> tuple[Float, Float]:
    """Unit normals of the triangles ``(T, 3)`` and of the vertices ``(V, 3)``.

    Vertex normals are exact on a sphere (Max, "Weights for computing vertex normals from facet
    normals", 1999), and 0 at vertices without triangles.
    """
    p = points[faces]
    flat = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    after, before = np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p
    lengths = (after**2).sum(-1) * (before**2).sum(-1)
    part = flat[:, None] / np.maximum(lengths, 1e-300)[..., None]
    sums = [np.bincount(faces.ravel(), part[..., c].ravel(), len(points)) for c in range(3)]
    return unit(flat), unit(np.stack(sums, axis=1))


def unit(vectors: Any) -> Float:
    """Vectors scaled to norm 1; zero vectors stay zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1.0))
