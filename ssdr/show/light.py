"""Light on the subject of every picture: a broad lamp from the side, a sky, a floor, their shadows.

Shadows are read from depth maps, one for the direction of each light.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter

from ..common.parallel import chunk_bounds, run_chunks
from ..kernels.raster import light_shares, raster_triangles
from ..mesh.normals import triangle_normals, unit
from .camera import Camera, Float, Pixels, Size, balls_seen, between, empty_depth, triangles_seen
from .palette import linear_from_srgb

# Unit directions in view axes (right, up, towards the viewer) and linear RGB times strength, chosen
# by eye.  The lamp grazes surfaces that face the viewer, so that folds are shaded.
_LAMP = unit(np.array([-0.84, 0.52, 0.36]))
_LAMP_COLOR = np.array([1.00, 0.95, 0.88]) * 1.15
_RIM = unit(np.array([0.80, 0.35, -0.42]))
_RIM_COLOR = np.array([0.80, 0.90, 1.00]) * 0.30
_SKY = np.array([0.88, 0.94, 1.02]) * 0.52
_FLOOR = np.array([1.00, 0.94, 0.88]) * 0.28
_LAMP_SIZE = 0.10  # radius over distance, on which the softness of its shadows depends
_BOUNCE = 0.5  # part of the light blocked by the surface itself that it reflects
_SKY_LIGHTS, _LAMP_LIGHTS = 40, 10  # number of directions; fewer show as bands
_SKY_PIXELS, _LAMP_PIXELS = 144, 384  # side of a depth map
_CHUNK = 8192  # points in a task
_TOP, _BOTTOM = (0.957, 0.957, 0.965), (0.863, 0.871, 0.894)  # sRGB of the backdrop
_CREASE = 0.6  # cosine of the angle between the normals of a vertex and its triangle
_BIAS = 0.0035  # distance, relative to the diagonal, below which surfaces cast no shadow

# Draws a subject in colours (V, 3), with a share of light without direction, and an opacity: the
# picture (H, W, 3), linear RGB, and its depth buffer (H, W).
Drawer = Callable[[Float, float, float], tuple[Float, Float]]


@dataclasses.dataclass(frozen=True, eq=False)
class Lights:
    """Distant lights, each with a square depth map.

    Attributes
    ----------
    axes : (D, 3, 3) float64
        Rows: right and up in a light's depth map, and towards the light.
    corners : (D, 2) float64
        Lower left corner of each map in its axes.
    scales : (D,) float64
        Pixels per unit of length.
    nearness : (D, n, n) float64
        Largest coordinate along the third axis, −inf in empty pixels.
    colors : (D, 3) float64
        Linear RGB.
    """

    axes: Float
    corners: Float
    scales: Float
    nearness: Float
    colors: Float

    @classmethod
    def around(
        cls,
        directions: Float,
        colors: Float,
        points: Float,
        faces: NDArray[np.int32],
        pixels: int,
    ) -> Lights:
        """Lights in unit directions ``(D, 3)`` with depth maps of a mesh."""
        across = np.eye(3)[np.abs(directions).argmin(axis=1)]
        right = unit(np.cross(across, directions))
        axes = np.stack([right, np.cross(directions, right), directions], axis=1)
        corners, scales = np.empty((len(axes), 2)), np.empty(len(axes))
        nearness = np.full((len(axes), pixels, pixels), -np.inf)

        def draw(_: int, first: int, last: int) -> None:
            index = np.empty((pixels, pixels), dtype=np.int32)
            for d in range(first, last):
                view = axes[d] @ points.T
                low, high = view[:2].min(axis=1), view[:2].max(axis=1)
                # A border of two empty pixels for the interpolation.
                scales[d] = (pixels - 4) / max(float((high - low).max()), 1e-30)
                corners[d] = low - 2 / scales[d]
                view[:2] = (view[:2] - corners[d][:, None]) * scales[d]
                view = np.ascontiguousarray(view.T)
                raster_triangles(view, faces, nearness[d], index, 0, pixels)

        run_chunks(draw, chunk_bounds(len(axes), 4))
        return cls(axes, corners, scales, nearness, colors)

    @property
    def directions(self) -> Float:
        """Unit vectors ``(D, 3)`` towards the lights."""
        return self.axes[:, 2]

    def only(self, chosen: NDArray[np.bool_]) -> Lights:
        """Copy with the lights that a mask ``(D,)`` chooses."""
        return Lights(*(getattr(self, f.name)[chosen] for f in dataclasses.fields(self)))

    def shares(self, points: Float, normals: Float, bias: float) -> Float:
        """Share ``(N, D)`` of each light that reaches points on a surface.

        A surface nearer to the light than a point casts no shadow on it if the difference is less
        than `bias`, and a full shadow if the difference is at least twice `bias`.  Points are
        lifted by `bias` along their normals, to the side of the light.
        """
        out = np.empty((len(points), len(self.axes)))
        arrays = (self.axes, self.corners, self.scales, self.nearness)

        def read(_: int, first: int, last: int) -> None:
            light_shares(points, normals, *arrays, bias, out, first, last)

        run_chunks(read, chunk_bounds(len(points), _CHUNK))
        return out


def sphere_directions(count: int) -> Float:
    """Unit vectors ``(count, 3)``, evenly over the sphere (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    height = 1 - 2 * k / count
    turn = k * math.pi * (3 - math.sqrt(5))
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(turn), height, ring * np.sin(turn)], axis=1)


def sky(camera: Camera, points: Float, faces: NDArray[np.int32]) -> Lights:
    """Lights from all directions: the sky above and the floor below."""
    directions = sphere_directions(_SKY_LIGHTS)
    part = np.clip(0.5 + 1.5 * directions @ camera.vertical, 0.0, 1.0)[:, None]
    return Lights.around(directions, _FLOOR + (_SKY - _FLOOR) * part, points, faces, _SKY_PIXELS)


def lamp(camera: Camera, points: Float, faces: NDArray[np.int32]) -> Lights:
    """Lights of the lamp, spread evenly over its disc."""
    k = np.arange(_LAMP_LIGHTS)
    radius = _LAMP_SIZE * np.sqrt((k + 0.5) / _LAMP_LIGHTS)
    turn = k * np.pi * (3 - np.sqrt(5))
    right = unit(np.cross([0.0, 1.0, 0.0], _LAMP))
    up = np.cross(_LAMP, right)
    spread = np.outer(radius * np.cos(turn), right) + np.outer(radius * np.sin(turn), up)
    colors = np.tile(_LAMP_COLOR / _LAMP_LIGHTS, (_LAMP_LIGHTS, 1))
    return Lights.around(unit(_LAMP + spread) @ camera.axes, colors, points, faces, _LAMP_PIXELS)


def around_both_sides(lights: Lights, points: Float, normals: Float, bias: float) -> Float:
    """Light ``(N, 6)`` from all directions that arrives on both sides of a surface.

    The first three columns are RGB on the side of the normal, the others on its back.

    Parameters
    ----------
    lights : Lights
        Evenly over the sphere; with colours of 1 the result is 1 where nothing blocks the light.
    points, normals : (N, 3) float64
    bias : float
        See :meth:`Lights.shares`.
    """
    arrived = lights.shares(points, normals, bias)
    cosine = normals @ lights.directions.T
    front = (np.maximum(cosine, 0.0) * arrived) @ lights.colors
    back = (np.maximum(-cosine, 0.0) * arrived) @ lights.colors
    return np.asarray(np.concatenate([front, back], axis=1) * (4.0 / len(lights.colors)))


def reflected(
    camera: Camera,
    normal: Float,
    albedo: Float,
    around: Float | None = None,
    reached: Float | float = 1.0,
    even: float = 0.0,
) -> Float:
    """Light ``(N, 3)`` that a surface reflects, linear RGB.

    Parameters
    ----------
    camera : Camera
    normal : (N, 3) float64
        Unit vectors on the viewer's side.
    albedo : (N, 3) float64
        Linear RGB.
    around : (N, 3) float64, optional
        Light that arrives from sky and floor, linear RGB; by default nothing blocks it.
    reached : (N, 1) float64 or float
        Share of the lamp's light that arrives.
    even : float
        Share of the light that does not depend on direction, larger where colours must be
        compared.
    """
    axes = camera.axes
    part = np.clip(0.5 + 0.55 * (normal @ camera.vertical), 0.0, 1.0)[:, None]
    uncovered = _FLOOR + (_SKY - _FLOOR) * part  # close to exact on a convex surface
    around = uncovered if around is None else around
    kept = np.clip(around.sum(axis=1) / uncovered.sum(axis=1), 0.0, 1.0)[:, None]
    ambient = around + _BOUNCE * albedo * (uncovered - around).clip(0.0)
    direct = np.clip(normal @ (axes.T @ _LAMP), 0.0, 1.0)[:, None] * reached
    rim = np.clip(normal @ (axes.T @ _RIM), 0.0, 1.0)[:, None] * kept
    light = ambient + _LAMP_COLOR * direct + _RIM_COLOR * rim
    return np.asarray(albedo * (even * (0.8 + 0.35 * kept) + (1 - even) * light))


def mesh_drawer(
    camera: Camera,
    size: Size,
    points: Float,
    faces: NDArray[np.int32],
    normals: Float,
    ground: float,
    *,
    creases: bool,
) -> Drawer:
    """Light a mesh, and return a function that draws it in given colours.

    Parameters
    ----------
    camera : Camera
    size : (int, int)
        Width and height in pixels.
    points : (V, 3) float64
    faces : (T, 3) int32
    normals : (V, 3) float64
        Of any norm.
    ground : float
        Height of the floor, on which shadows fall.
    creases : bool
        Whether corners have the normal of their triangle where it is far from `normals`.
    """
    bias = _BIAS * float(np.linalg.norm(np.ptp(points, axis=0)))
    dome, beams = sky(camera, points, faces), lamp(camera, points, faces)
    # A quarter of the resolution is enough for soft shadows on the floor.
    coarse = (max(1, size[0] // 4), max(1, size[1] // 4))
    shade = Image.fromarray(_floor(camera, coarse, ground, points, dome, beams, bias))
    floor = np.asarray(shade.resize(size, Image.Resampling.BILINEAR))
    nearness = empty_depth(size)
    pixels, hit, share = triangles_seen(camera, points, faces, nearness)
    corners = faces[hit]
    flat, smooth = triangle_normals(points, faces), unit(normals)
    # Light of sky and floor varies slowly, so that it is computed at vertices, not pixels.
    seen = np.unique(corners)
    light = np.zeros((len(points), 6))
    light[seen] = around_both_sides(dome, points[seen], smooth[seen], bias)
    at, arrived = between(share, points[corners]), between(share, light[corners])
    side = (flat[hit] * (camera.eye - at)).sum(axis=1, keepdims=True) > 0
    normal = smooth[corners]
    if creases:
        own = flat[hit][:, None]
        normal = np.where((normal * own).sum(axis=2, keepdims=True) < _CREASE, own, normal)
    normal = unit(between(share, normal)) * np.where(side, 1.0, -1.0)
    reached = beams.shares(at, normal, bias).mean(axis=1)[:, None]
    around = np.where(side, *np.split(arrived, 2, axis=1))
    backdrop = _backdrop(size) * floor[..., None]

    def draw(colors: Float, even: float, opacity: float) -> tuple[Float, Float]:
        albedo = between(share, colors[corners])
        color = reflected(camera, normal, albedo, around, reached, even)
        return _over(backdrop, pixels, color, opacity), nearness

    return draw


def cloud_drawer(camera: Camera, size: Size, points: Float, radius: float) -> Drawer:
    """Function that draws points as balls without shadows, in given colours."""
    nearness = empty_depth(size)
    pixels, index, normal = balls_seen(camera, points, radius, nearness)

    def draw(colors: Float, even: float, opacity: float) -> tuple[Float, Float]:
        color = reflected(camera, normal, colors[index], even=even)
        return _over(_backdrop(size), pixels, color, opacity), nearness

    return draw


def _over(backdrop: Float, pixels: Pixels, color: Float, opacity: float) -> Float:
    picture = backdrop.copy()
    picture[pixels] += opacity * (color - picture[pixels])
    return picture


def _backdrop(size: Size) -> Float:
    """Background ``(H, W, 3)``: a vertical gradient, linear RGB."""
    at = np.linspace(0, 1, size[1])[:, None]
    rows = linear_from_srgb(np.array(_TOP) * (1 - at) + np.array(_BOTTOM) * at)
    return np.repeat(rows[:, None], size[0], axis=1)


def _floor(
    camera: Camera,
    size: Size,
    ground: float,
    points: Float,
    dome: Lights,
    beams: Lights,
    bias: float,
) -> NDArray[np.float32]:
    """Share ``(H, W)`` of the light that reaches the floor; 1 in pixels without floor."""
    out = np.ones((size[1], size[0]), dtype=np.float32)
    # No floor in a view from below, where it would hide the subject.
    if camera.axes[2] @ camera.vertical <= 0.02:
        return out
    rows, columns = np.indices(out.shape).reshape(2, -1)
    ray = camera.rays(rows, columns, size)
    fall, height = ray @ camera.vertical, ground - camera.eye @ camera.vertical
    far = np.divide(height, fall, out=np.full(len(fall), -1.0), where=fall < -1e-6)
    at = camera.eye + far[:, None] * ray
    reach = float(np.linalg.norm(np.ptp(points, axis=0)))
    near = (far > 0) & (np.linalg.norm(at - points.mean(axis=0), axis=1) < 1.5 * reach)
    at, pixels = at[near], (rows[near], columns[near])
    up = np.tile(camera.vertical, (len(at), 1))
    # Light that grazes the floor is left out, since each direction would cast a streak.
    cosine = dome.directions @ camera.vertical
    high = cosine > 0.3
    weight = cosine[high] * dome.colors[high].mean(axis=1)
    arrived = dome.only(high).shares(at, up, bias) @ (weight / weight.sum())
    beam = beams.shares(at, up, bias).mean(axis=1)
    soft = np.zeros_like(out)
    # Shadows are weakened, since a white floor in a room gets light from everywhere.
    soft[pixels] = 0.55 * (1 - arrived)
    out -= gaussian_filter(soft, size[1] / 22)
    out[pixels] *= 1 - 0.22 * (1 - beam)
    return out
