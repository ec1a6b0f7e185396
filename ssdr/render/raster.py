"""From geometry to shaded pixels: camera, depth buffer, light.  Needs no display.

The picture is computed in linear light at `supersample` times the resolution and averaged
down; :mod:`ssdr.render` arranges it into figures.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ..errors import InputError
from ..kernels.raster import raster_balls, raster_triangles
from ..parallel import chunk_bounds, run_chunks
from .palette import linear_from_srgb

__all__ = [
    "Camera",
    "Layer",
    "backdrop",
    "block_mean",
    "blur",
    "draw_balls",
    "draw_mesh",
    "hits",
    "over",
    "shadow",
    "unit",
    "up_axes",
]

Float = NDArray[np.float64]
_BAND = 48  # rows of pixels in a task: fewer balance threads better, each visits all triangles
# Unit directions of lights in view axes: right, up, towards the viewer.
_KEY = np.array([-0.50, 0.72, 0.62]) / np.linalg.norm([-0.50, 0.72, 0.62])
# from the other side, so that no part stays black
_FILL = np.array([0.85, 0.05, 0.45]) / np.linalg.norm([0.85, 0.05, 0.45])
# halfway between the key light and the viewer: the highlight lies there (Blinn 1977)
_HALF = (_KEY + np.array([0.0, 0.0, 1.0])) / np.linalg.norm(_KEY + np.array([0.0, 0.0, 1.0]))
# Linear RGB times strength, chosen by eye: a warm key light, a cool fill, a sky above and a
# warmer floor below; larger factors brighten, and nearer ones flatten, the shape.
_KEY_COLOR = np.array([1.00, 0.96, 0.90]) * 0.74
_FILL_COLOR = np.array([0.80, 0.90, 1.00]) * 0.22  # weak beside the key light
_SKY = np.array([0.94, 0.98, 1.06]) * 0.44  # light from above, from everywhere
_GROUND = np.array([1.00, 0.94, 0.88]) * 0.21  # light back from the floor


@dataclasses.dataclass(frozen=True, eq=False)
class Camera:
    """Where the viewer is.

    Attributes
    ----------
    axes : (3, 3) float64
        Rows: right, up and towards the viewer, in world coordinates.
    eye : (3,) float64
        Centre of projection; for a parallel projection any point of its axis.
    scale : float
        Half the height that is seen: at distance 1 (perspective), or anywhere
        (parallel), in the mesh's units.
    perspective : bool
    vertical : (3,) float64
        The world's up axis, where the sky is.

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
        field_of_view: float = 24.0,
        margin: float = 0.08,
    ) -> Camera:
        """Camera that just sees all the points.

        Parameters
        ----------
        points : (N, 3) float64
        azimuth, elevation : float
            Degrees; azimuth 0 looks at the front (the side of +z where y is up,
            of −y where z is up), positive walks to the viewer's right.
        up : {"x", "y", "z", "-x", "-y", "-z"}
        aspect : float
            Width over height of the picture.
        perspective : bool
            False: parallel projection.
        field_of_view : float
            Degrees, vertical.
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
        tall = math.tan(math.radians(field_of_view) / 2)
        free = 1 - 2 * margin
        if not perspective:
            half = max((high[1] - low[1]) / 2, (high[0] - low[0]) / 2 / aspect, size * 1e-3) / free
            eye = (low + high) / 2 + [0, 0, 2 * size]
            return cls(axes, eye @ axes, float(half), False, vertical)
        # Each side plane bounds eye and distance linearly; opposite ones meet in the middle.
        distance, centre = 0.0, np.zeros(3)
        for c, reach in ((0, tall * aspect * free), (1, tall * free)):
            above = float((view[:, c] / reach + view[:, 2]).max())
            below = float((-view[:, c] / reach + view[:, 2]).max())
            distance = max(distance, (above + below) / 2) if c else (above + below) / 2
            centre[c] = reach * (above - below) / 2
        centre[2] = max(distance, high[2] + 0.05 * size)
        return cls(axes, centre @ axes, tall, True, vertical)

    def project(self, points: Float, size: tuple[int, int]) -> Float:
        """Pixel coordinates x, y and nearness, ``(N, 3)``; NaN behind the camera."""
        width, height = size
        view = (np.asarray(points, dtype=np.float64) - self.eye) @ self.axes.T
        z = -view[:, 2]
        pixel = height / 2 / self.scale
        if self.perspective:
            near = np.divide(1.0, z, out=np.full(len(z), np.nan), where=z > 0)
            with np.errstate(invalid="ignore"):
                x, y = view[:, 0] * near * pixel, view[:, 1] * near * pixel
        else:
            x, y, near = view[:, 0] * pixel, view[:, 1] * pixel, -z
        return np.stack([width / 2 + x, height / 2 - y, near], axis=1)

    def distance(self, nearness: Float) -> Float:
        """Distance along the view axis, in the mesh's units."""
        return 1.0 / nearness if self.perspective else -nearness

    def pixels(self, distance: Float, size: tuple[int, int]) -> Float:
        """Pixels that one unit of length covers at a distance."""
        pixel = size[1] / 2 / self.scale
        return pixel / distance if self.perspective else np.full_like(distance, pixel)


@dataclasses.dataclass(eq=False)
class Layer:
    """Shaded pixels: linear RGB ``(H, W, 3)``, nearness ``(H, W)``, −inf where empty."""

    color: Float
    nearness: Float

    @property
    def mask(self) -> NDArray[np.bool_]:
        return np.isfinite(self.nearness)


def draw_mesh(
    camera: Camera, size: tuple[int, int], points: Float, faces: NDArray[np.int32], colors: Float
) -> Layer:
    """Triangles with smooth normals, lit, colours (linear RGB per vertex) interpolated."""
    nearness, (rows, columns), hit, share = hits(camera, size, points, faces)
    out = np.zeros((size[1], size[0], 3))
    if len(rows):
        corners = faces[hit]
        flat, smooth = _normals(points, faces)
        flat = flat[hit]
        normal = smooth[corners]
        # Across a crease a corner keeps its triangle's own normal.
        crease = (normal * flat[:, None]).sum(axis=2) < 0.5
        normal = np.where(crease[:, :, None], flat[:, None], normal)
        normal = np.einsum("nk,nkc->nc", share, normal) @ camera.axes.T
        albedo = np.einsum("nk,nkc->nc", share, colors[corners])
        occlusion = _occlusion(camera, nearness, size)[rows, columns]
        out[rows, columns] = _shade(camera, albedo, normal, occlusion)
    return Layer(out, nearness)


def hits(
    camera: Camera, size: tuple[int, int], points: Float, faces: NDArray[np.int32]
) -> tuple[Float, tuple[Any, Any], NDArray[np.int32], Float]:
    """What the camera sees of triangles.

    Returns
    -------
    nearness : (H, W) float64
        −inf where nothing is.
    (rows, columns)
        Pixels that a triangle covers, N of them.
    index : (N,) int32
        The nearest triangle.
    share : (N, 3) float64
        Barycentric coordinates in it.
    """
    screen = camera.project(points, size)
    nearness, index = _buffers(size)
    tasks = chunk_bounds(size[1], _BAND)
    run_chunks(lambda _, a, b: raster_triangles(screen, faces, nearness, index, a, b), tasks)
    rows, columns = np.nonzero(index >= 0)
    hit = index[rows, columns]
    corners = faces[hit]
    share = _barycentric(screen, corners, np.stack([columns, rows], axis=1) + 0.5)
    if camera.perspective:
        share *= screen[corners, 2]
        share /= share.sum(axis=1, keepdims=True)
    return nearness, (rows, columns), hit, share


def draw_balls(
    camera: Camera, size: tuple[int, int], centers: Float, radii: Float, colors: Float
) -> Layer:
    """Lit balls: bones, or the points of a cloud."""
    screen = camera.project(centers, size)
    distance = np.where(np.isfinite(screen[:, 2]), camera.distance(screen[:, 2]), np.nan)
    radius = radii * camera.pixels(distance, size)
    front = np.maximum(distance - radii, 1e-3 * distance)
    rise = (1.0 / front if camera.perspective else -front) - screen[:, 2]
    balls = np.column_stack([screen[:, :2], np.maximum(radius, 0.5), screen[:, 2], rise])
    nearness, index = _buffers(size)
    tasks = chunk_bounds(size[1], _BAND)
    run_chunks(lambda _, a, b: raster_balls(balls, nearness, index, a, b), tasks)
    out = np.zeros((size[1], size[0], 3))
    rows, columns = np.nonzero(index >= 0)
    if len(rows):
        hit = index[rows, columns]
        x = (columns + 0.5 - balls[hit, 0]) / balls[hit, 2]
        y = (balls[hit, 1] - rows - 0.5) / balls[hit, 2]
        normal = np.stack([x, y, np.sqrt(np.maximum(0.0, 1 - x * x - y * y))], axis=1)
        occlusion = _occlusion(camera, nearness, size)[rows, columns]
        out[rows, columns] = _shade(camera, colors[hit], normal, occlusion)
    return Layer(out, nearness)


def shadow(
    camera: Camera, size: tuple[int, int], points: Float, faces: NDArray[np.int32], ground: float
) -> Float:
    """Soft shadow on the ground, straight below: a factor ``(H, W)`` in [0, 1]."""
    drop = np.outer(points @ camera.vertical - ground, camera.vertical)
    screen = camera.project(points - drop, size)
    nearness, index = _buffers(size)
    tasks = chunk_bounds(size[1], _BAND)
    run_chunks(lambda _, a, b: raster_triangles(screen, faces, nearness, index, a, b), tasks)
    cover = (index >= 0).astype(np.float64)
    soft = 0.6 * blur(cover, size[1] / 50) + 0.4 * blur(cover, size[1] / 16)
    return np.asarray(1.0 - 0.34 * np.clip(soft, 0.0, 1.0))


def backdrop(size: tuple[int, int], top: str = "#fbfbfd", bottom: str = "#e8ebf1") -> Float:
    """A quiet vertical gradient in linear RGB."""
    ends = [[int(h[i : i + 2], 16) / 255 for i in (1, 3, 5)] for h in (top, bottom)]
    at = np.linspace(0, 1, size[1])[:, None]
    rows = linear_from_srgb(ends[0] * (1 - at) + ends[1] * at)
    return np.repeat(rows[:, None], size[0], axis=1)


def over(picture: Float, layer: Layer, opacity: float | Float = 1.0) -> Float:
    """Lay a layer on a picture, both in linear light."""
    alpha = np.where(layer.mask, opacity, 0.0)[..., None]
    return np.asarray(picture * (1 - alpha) + layer.color * alpha)


def block_mean(values: Float, step: int) -> Float:
    """Mean of squares of `step` by `step` pixels; both sides are multiples of it."""
    rows = values[0::step].copy()
    for k in range(1, step):  # slices are several times faster than a mean over two axes
        rows += values[k::step]
    out = rows[:, 0::step].copy()
    for k in range(1, step):
        out += rows[:, k::step]
    return np.asarray(out / step**2)


def up_axes(up: str) -> tuple[Float, Float, Float]:
    """Unit vectors up, to the front and to its right, from the name of the up axis."""
    name = up.lstrip("-") if isinstance(up, str) else ""
    if name not in ("x", "y", "z") or up not in (name, f"-{name}"):
        raise InputError("up", "x, y or z, with or without a minus", repr(up))
    vertical = np.zeros(3)
    vertical["xyz".index(name)] = -1.0 if up.startswith("-") else 1.0
    front = {"x": [0.0, 0, 1], "y": [0.0, 0, 1], "z": [0.0, -1, 0]}[name]
    return vertical, np.array(front), np.cross(vertical, front)


def _buffers(size: tuple[int, int]) -> tuple[Float, NDArray[np.int32]]:
    shape = (size[1], size[0])
    return np.full(shape, -np.inf), np.full(shape, -1, dtype=np.int32)


def _barycentric(screen: Float, corners: NDArray[np.int32], pixels: Any) -> Float:
    p = screen[corners, :2] - pixels[:, None]
    q, r = np.roll(p, -1, axis=1), np.roll(p, -2, axis=1)
    share = q[..., 0] * r[..., 1] - r[..., 0] * q[..., 1]
    return np.asarray(share / share.sum(axis=1, keepdims=True))


def _normals(points: Float, faces: NDArray[np.int32]) -> tuple[Float, Float]:
    """Unit normals of the triangles, and of the vertices weighted by area."""
    p = np.asarray(points, dtype=np.float64)
    a, b, c = (p[faces[:, k]] for k in range(3))
    flat: Float = np.cross(b - a, c - a).astype(np.float64)
    smooth = np.stack(
        [np.bincount(faces.ravel(), np.repeat(flat[:, k], 3), len(p)) for k in range(3)], axis=1
    )
    return unit(flat), unit(smooth)


def unit(vectors: Any) -> Float:
    """Vectors of length 1; a zero stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1.0))


def _occlusion(camera: Camera, nearness: Float, size: tuple[int, int]) -> Float:
    """Ambient light that reaches a pixel: less where it lies behind its neighbourhood.

    Luft et al., "Image enhancement by unsharp masking the depth buffer", 2006.
    """
    mask = np.isfinite(nearness)
    depth = np.zeros_like(nearness)
    depth[mask] = camera.distance(nearness[mask])
    mean = float(depth[mask].mean()) if mask.any() else 1.0
    light = np.ones_like(nearness)
    for share, strength in ((1 / 90, 0.45), (1 / 28, 0.40)):
        sigma = size[1] * share
        cover = blur(mask.astype(np.float64), sigma)
        around = blur(depth, sigma) / np.maximum(cover, 1e-6)
        length = 2.5 * sigma / float(camera.pixels(np.array([mean]), size)[0])
        behind = np.clip((depth - around) / length, 0.0, 1.0)
        light *= 1.0 - strength * behind
    return light


def blur(values: Float, sigma: float) -> Float:
    """Gaussian blur; a wide one is done on a coarser grid, where it costs less."""
    step = max(1, int(sigma / 4))
    if step == 1:
        return np.asarray(gaussian_filter(values, sigma, truncate=3.0))
    rows, columns = values.shape
    coarse = np.pad(values, ((0, -rows % step), (0, -columns % step)), mode="edge")
    coarse = gaussian_filter(block_mean(coarse, step), sigma / step, truncate=3.0)
    for axis, count in ((0, rows), (1, columns)):
        at = np.clip((np.arange(count) + 0.5) / step - 0.5, 0, coarse.shape[axis] - 1)
        low = np.minimum(at.astype(np.intp), max(coarse.shape[axis] - 2, 0))
        high = np.minimum(low + 1, coarse.shape[axis] - 1)
        share = np.expand_dims(at - low, 1 - axis)
        below, above = np.take(coarse, low, axis=axis), np.take(coarse, high, axis=axis)
        coarse = below * (1 - share) + above * share
    return np.asarray(coarse)


def _shade(camera: Camera, albedo: Float, normal: Float, occlusion: Float) -> Float:
    n = unit(normal)
    n = np.where(n[:, 2:] < 0, -n, n)  # both sides of a triangle are lit alike
    sky = n @ (camera.axes @ camera.vertical) * 0.5 + 0.5
    key = np.clip((n @ _KEY + 0.12) / 1.12, 0.0, 1.0)
    fill = np.clip(n @ _FILL, 0.0, 1.0)
    shine = 0.10 * np.clip(n @ _HALF, 0.0, 1.0) ** 40
    ambient = _GROUND + (_SKY - _GROUND) * sky[:, None]
    dim = occlusion[:, None]
    light = ambient * dim**1.6 + _KEY_COLOR * key[:, None] * dim + _FILL_COLOR * fill[:, None]
    edge = 0.10 * (1.0 - n[:, 2:]) ** 3
    return np.asarray(albedo * light * (1 - edge) + shine[:, None] * dim)
