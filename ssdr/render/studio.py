"""A posed subject under the lights, before its colours are known."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter

from .light import Illumination, Lights, around_both_sides, lamp, sky
from .palette import linear_from_srgb
from .raster import (
    Camera,
    Pixels,
    balls_seen,
    between,
    empty_depth,
    normals_of,
    triangles_seen,
    unit,
)

__all__ = ["Stage"]

Float = NDArray[np.float64]
_TOP, _BOTTOM = (0.957, 0.957, 0.965), (0.863, 0.871, 0.894)  # sRGB of the backdrop
_CREASE = 0.6  # cosine of the angle between the normals of a vertex and its triangle
_BIAS = 0.0035  # of the diagonal: nearer surfaces do not shade each other


@dataclasses.dataclass(frozen=True, eq=False)
class Stage:
    """A posed subject under the lights; pictures of it in several colours share this work.

    Attributes
    ----------
    picture : (H, W, 3) float64
        The backdrop with the shadows on the floor, linear RGB.
    nearness : (H, W) float64
        Depth buffer of the subject.
    pixels : (rows, columns)
        The N pixels that show it.
    corners : (N, k) int32
        Vertices of the triangle, or the point, that each of them shows.
    share : (N, k) float64
        Barycentric coordinates between them.
    lit : Illumination
    """

    picture: Float
    nearness: Float
    pixels: Pixels
    corners: NDArray[np.int32]
    share: Float
    lit: Illumination

    @classmethod
    def of_mesh(
        cls,
        camera: Camera,
        size: tuple[int, int],
        points: Float,
        faces: NDArray[np.int32],
        ground: float,
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
            Height of the floor, which gets shadows.
        """
        bias = _BIAS * float(np.linalg.norm(np.ptp(points, axis=0)))
        around, beams = sky(camera, points, faces), lamp(camera, points, faces)
        # Shadows on the floor are soft: a quarter of the resolution is enough.
        coarse = (max(1, size[0] // 4), max(1, size[1] // 4))
        shade = Image.fromarray(_floor(camera, coarse, ground, points, around, beams, bias))
        floor = np.asarray(shade.resize(size, Image.Resampling.BILINEAR))
        nearness = empty_depth(size)
        pixels, hit, share = triangles_seen(camera, points, faces, nearness)
        corners = faces[hit]
        flat, smooth = normals_of(points, faces)
        # Light from around changes slowly: at vertices, not at every pixel.
        seen = np.zeros(len(points), dtype=bool)
        seen[corners] = True
        light = np.zeros((len(points), 6))
        light[seen] = around_both_sides(around, points[seen], smooth[seen], bias)
        at, arrived = between(share, points[corners]), between(share, light[corners])
        toward = camera.eye - at if camera.perspective else camera.axes[2]
        side = (flat[hit] * toward).sum(axis=1, keepdims=True) > 0
        # Across a crease a corner keeps its triangle's own normal.
        own, normal = flat[hit][:, None], smooth[corners]
        normal = np.where((normal * own).sum(axis=2, keepdims=True) < _CREASE, own, normal)
        normal = unit(between(share, normal)) * np.where(side, 1.0, -1.0)
        reached = beams.shares(at, normal, bias).mean(axis=1)[:, None]
        lit = Illumination(camera, normal, np.where(side, *np.split(arrived, 2, axis=1)), reached)
        picture = _backdrop(size) * floor[..., None]
        return cls(picture, nearness, pixels, corners, share, lit)

    @classmethod
    def of_cloud(cls, camera: Camera, size: tuple[int, int], points: Float, radius: float) -> Stage:
        """Light a cloud of points, drawn as balls, without shadows."""
        nearness = empty_depth(size)
        pixels, index, normal = balls_seen(camera, points, np.full(len(points), radius), nearness)
        lit = Illumination(camera, normal)
        share = np.ones((len(index), 1))
        return cls(_backdrop(size), nearness, pixels, index[:, None], share, lit)

    def draw(self, colors: Float, even: float = 0.0, opacity: float = 1.0) -> Float:
        """Picture ``(H, W, 3)`` of a subject of colours ``(V, 3)``, all linear RGB."""
        picture = self.picture.copy()
        color = self.lit.shaded(between(self.share, colors[self.corners]), even)
        picture[self.pixels] += opacity * (color - picture[self.pixels])
        return picture


def _backdrop(size: tuple[int, int]) -> Float:
    """A quiet vertical gradient, linear RGB."""
    at = np.linspace(0, 1, size[1])[:, None]
    rows = linear_from_srgb(np.array(_TOP) * (1 - at) + np.array(_BOTTOM) * at)
    return np.repeat(rows[:, None], size[0], axis=1)


def _floor(
    camera: Camera,
    size: tuple[int, int],
    ground: float,
    points: Float,
    around: Lights,
    beams: Lights,
    bias: float,
) -> NDArray[np.float32]:
    """Share ``(H, W)`` of the light that reaches the floor; 1 in pixels that show no floor."""
    out = np.ones((size[1], size[0]), dtype=np.float32)
    # There is no floor in a view from below, where it would hide everything.
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
    # Light that grazes the floor is left out: it casts a streak for each direction.
    cosine = around.directions @ camera.vertical
    high = cosine > 0.3
    weight = cosine[high] * around.colors[high].mean(axis=1)
    arrived = around.only(high).shares(at, up, bias) @ (weight / weight.sum())
    beam = beams.shares(at, up, bias).mean(axis=1)
    soft = np.zeros_like(out)
    # The shadows are weak, since a white floor is lit by more than the lamp and the sky.
    soft[pixels] = 0.55 * (1 - arrived)
    out -= gaussian_filter(soft, size[1] / 22)
    out[pixels] *= 1 - 0.22 * (1 - beam)
    return out
