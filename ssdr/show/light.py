"""Light on the subject of every picture: a lamp from the side, light from behind, sky and floor."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

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
_TOP, _BOTTOM = (0.957, 0.957, 0.965), (0.863, 0.871, 0.894)  # sRGB of the backdrop
_CREASE = 0.6  # cosine of the angle between the normals of a vertex and its triangle
_EVENLY = 1.15  # light without direction

# Draws a subject in colours (V, 3), with a share of light without direction, and an opacity: the
# picture (H, W, 3), linear RGB, and its depth buffer (H, W).
Drawer = Callable[[Float, float, float], tuple[Float, Float]]


def reflected(camera: Camera, normal: Float, albedo: Float, even: float = 0.0) -> Float:
    """Light ``(N, 3)`` that a surface reflects, linear RGB; nothing casts a shadow.

    Parameters
    ----------
    camera : Camera
    normal : (N, 3) float64
        Unit vectors on the viewer's side.
    albedo : (N, 3) float64
        Linear RGB.
    even : float
        Share of the light that does not depend on direction, larger where colours must be
        compared.
    """
    axes = camera.axes
    part = np.clip(0.5 + 0.55 * (normal @ camera.vertical), 0.0, 1.0)[:, None]
    direct = np.clip(normal @ (axes.T @ _LAMP), 0.0, 1.0)[:, None]
    rim = np.clip(normal @ (axes.T @ _RIM), 0.0, 1.0)[:, None]
    light = _FLOOR + (_SKY - _FLOOR) * part + _LAMP_COLOR * direct + _RIM_COLOR * rim
    return np.asarray(albedo * (even * _EVENLY + (1 - even) * light))


def mesh_drawer(
    camera: Camera,
    size: Size,
    points: Float,
    faces: NDArray[np.int32],
    normals: Float,
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
    creases : bool
        Whether corners have the normal of their triangle where it is far from `normals`.
    """
    nearness = empty_depth(size)
    pixels, hit, share = triangles_seen(camera, points, faces, nearness)
    corners, flat = faces[hit], triangle_normals(points, faces)[hit]
    normal = unit(normals)[corners]
    if creases:
        own = flat[:, None]
        normal = np.where((normal * own).sum(axis=2, keepdims=True) < _CREASE, own, normal)
    way = camera.eye - between(share, points[corners])
    side = np.where((flat * way).sum(axis=1, keepdims=True) > 0, 1.0, -1.0)
    normal = unit(between(share, normal)) * side

    def draw(colors: Float, even: float, opacity: float) -> tuple[Float, Float]:
        color = reflected(camera, normal, between(share, colors[corners]), even)
        return _over(_backdrop(size), pixels, color, opacity), nearness

    return draw


def cloud_drawer(camera: Camera, size: Size, points: Float, radius: float) -> Drawer:
    """Function that draws points as balls in given colours."""
    nearness = empty_depth(size)
    pixels, index, normal = balls_seen(camera, points, radius, nearness)

    def draw(colors: Float, even: float, opacity: float) -> tuple[Float, Float]:
        color = reflected(camera, normal, colors[index], even)
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
