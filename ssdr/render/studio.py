"""Visible points of a posed subject and the light on them, shared by pictures in all colours."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter

from .light import Lights, around_both_sides, lamp, reflected, sky
from .palette import linear_from_srgb
from .raster import (
    Camera,
    Float,
    Pixels,
    balls_seen,
    between,
    empty_depth,
    normals_of,
    triangles_seen,
    unit,
)

_TOP, _BOTTOM = (0.957, 0.957, 0.965), (0.863, 0.871, 0.894)  # sRGB of the backdrop
_CREASE = 0.6  # cosine of the angle between the normals of a vertex and its triangle
_BIAS = 0.0035  # distance, relative to the diagonal, below which surfaces cast no shadow


@dataclasses.dataclass(frozen=True, eq=False)
class Stage:
    """Visible points of a posed subject and the light on them; pictures in all colours share it.

    Attributes
    ----------
    camera : Camera
    picture : (H, W, 3) float64
        The background with shadows on the floor, linear RGB.
    nearness : (H, W) float64
        Depth buffer of the subject.
    pixels : (rows, columns)
        The N pixels that show the subject.
    corners : (N, k) int32
        Vertices of the triangle in each of these pixels, or the vertex of a cloud.
    share : (N, k) float64
        Barycentric coordinates of the pixel among these vertices.
    normal, around, reached
        As in :func:`reflected`.
    """

    camera: Camera
    picture: Float
    nearness: Float
    pixels: Pixels
    corners: NDArray[np.int32]
    share: Float
    normal: Float
    around: Float | None = None
    reached: Float | float = 1.0

    @classmethod
    def of_mesh(
        cls,
        camera: Camera,
        size: tuple[int, int],
        points: Float,
        faces: NDArray[np.int32],
        ground: float,
        normals: Float | None = None,
    ) -> Stage:
        """Light a mesh.

        Parameters
        ----------
        camera : Camera
        size : (int, int)
            Width and height in pixels.
        points : (V, 3) float64
        faces : (T, 3) int32
        ground : float
            Height of the floor, on which shadows fall.
        normals : (V, 3) float64, optional
            By default those of the surface, with creases.
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
        flat, smooth = normals_of(points, faces)
        smooth = smooth if normals is None else normals
        # Light of sky and floor varies slowly, so that it is computed at vertices, not pixels.
        seen = np.zeros(len(points), dtype=bool)
        seen[corners] = True
        light = np.zeros((len(points), 6))
        light[seen] = around_both_sides(dome, points[seen], smooth[seen], bias)
        at, arrived = between(share, points[corners]), between(share, light[corners])
        toward = camera.eye - at if camera.perspective else camera.axes[2]
        side = (flat[hit] * toward).sum(axis=1, keepdims=True) > 0
        normal = smooth[corners]
        if normals is None:  # at a crease a corner has the normal of its triangle
            own = flat[hit][:, None]
            normal = np.where((normal * own).sum(axis=2, keepdims=True) < _CREASE, own, normal)
        normal = unit(between(share, normal)) * np.where(side, 1.0, -1.0)
        reached = beams.shares(at, normal, bias).mean(axis=1)[:, None]
        around = np.where(side, *np.split(arrived, 2, axis=1))
        picture = _backdrop(size) * floor[..., None]
        return cls(camera, picture, nearness, pixels, corners, share, normal, around, reached)

    @classmethod
    def of_cloud(cls, camera: Camera, size: tuple[int, int], points: Float, radius: float) -> Stage:
        """Light a cloud of points, drawn as balls without shadows."""
        nearness = empty_depth(size)
        pixels, index, normal = balls_seen(camera, points, np.full(len(points), radius), nearness)
        share = np.ones((len(index), 1))
        return cls(camera, _backdrop(size), nearness, pixels, index[:, None], share, normal)

    def draw(self, colors: Float, even: float = 0.0, opacity: float = 1.0) -> Float:
        """Picture ``(H, W, 3)`` of the subject with vertex colours ``(V, 3)``, linear RGB."""
        picture, albedo = self.picture.copy(), between(self.share, colors[self.corners])
        color = reflected(self.camera, self.normal, albedo, self.around, self.reached, even)
        picture[self.pixels] += opacity * (color - picture[self.pixels])
        return picture


def _backdrop(size: tuple[int, int]) -> Float:
    """Background ``(H, W, 3)``: a vertical gradient, linear RGB."""
    at = np.linspace(0, 1, size[1])[:, None]
    rows = linear_from_srgb(np.array(_TOP) * (1 - at) + np.array(_BOTTOM) * at)
    return np.repeat(rows[:, None], size[0], axis=1)


def _floor(
    camera: Camera,
    size: tuple[int, int],
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
    start, ray = camera.rays(rows, columns, size)
    fall, height = ray @ camera.vertical, ground - start @ camera.vertical
    far = np.divide(height, fall, out=np.full(len(fall), -1.0), where=fall < -1e-6)
    at = start + far[:, None] * ray
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    reach = float(np.linalg.norm(np.ptp(points, axis=0)))
    near = (far > 0) & (np.linalg.norm(at - centre, axis=1) < 1.5 * reach)
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
