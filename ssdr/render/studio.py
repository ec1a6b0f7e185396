"""Parts with materials, lit as in a studio: a broad lamp from the side, light from all around.

Both cast shadows, so that folds, and what hangs over something, show.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import zoom

from .curved import Curved
from .light import Lights, on_both_sides, sphere_directions
from .materials import NEUTRAL, Part
from .palette import heat, linear_from_srgb
from .raster import Camera, backdrop, block_mean, blur, hits, unit

__all__ = ["Look", "Stage"]

Float = NDArray[np.float64]
# Unit directions in view axes (right, up, towards the viewer) and linear RGB times strength,
# chosen by eye.  The lamp grazes what faces the viewer, so that creases cast light and shade.
_LAMP = unit(np.array([-0.84, 0.52, 0.36]))
_LAMP_COLOR = np.array([1.00, 0.95, 0.88]) * 1.15
_RIM = unit(np.array([0.80, 0.35, -0.42]))
_RIM_COLOR = np.array([0.80, 0.90, 1.00]) * 0.30
_SKY = np.array([0.88, 0.94, 1.02]) * 0.52
_FLOOR = np.array([1.00, 0.94, 0.88]) * 0.28
_LAMP_SIZE = 0.10  # radius over distance: how soft its shadows are
_BOUNCE = 0.5  # share of the light from around that is kept out and comes back from the cloth
_PASSING = np.array([1.0, 0.45, 0.30])  # red light goes furthest in skin
_DOME, _LAMPS = 40, 10  # directions; fewer show as bands
_DOME_PIXELS, _LAMP_PIXELS = 144, 512  # side of a picture of depth
_BIAS = 0.0035  # of the diagonal: nearer surfaces do not shade each other


@dataclasses.dataclass(frozen=True, eq=False)
class Look:
    """What the material is at every vertex.

    Attributes
    ----------
    front, back : (V, 3) float64
        Linear RGB of the two sides.
    finish : (V, 3) float64
        Gloss, sheen and softness of :class:`~ssdr.render.materials.Material`.
    even : float
        Share of the light that does not depend on direction: colours that have to be read are
        shaded less.
    """

    front: Float
    back: Float
    finish: Float
    even: float = 0.0

    @classmethod
    def of(cls, parts: Sequence[Part]) -> Look:
        """Each part in its material."""
        shape = (len(parts[0].vertices), 3)
        front, back, finish = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        for part in parts:
            m = part.material
            front[part.vertices] = linear_from_srgb(m.color)
            back[part.vertices] = linear_from_srgb(m.back or m.color)
            finish[part.vertices] = m.gloss, m.sheen, m.soft
        return cls(front, back, finish)

    @classmethod
    def of_errors(cls, parts: Sequence[Part], errors: Float) -> Look:
        """Errors, as a share of the scale, on the parts that are measured; grey on the others."""
        colors = heat(errors)
        finish = np.zeros((len(errors), 3))
        for part in parts:
            if not part.measured:
                colors[part.vertices] = linear_from_srgb(NEUTRAL.color)
                finish[part.vertices] = NEUTRAL.gloss, NEUTRAL.sheen, NEUTRAL.soft
        return cls(colors, colors, finish, 0.45)


@dataclasses.dataclass(frozen=True, eq=False)
class Stage:
    """A posed mesh under the lights, before its materials: two pictures of it share the work.

    Made by :meth:`of`.
    """

    camera: Camera
    supersample: int
    curved: Curved
    picture: Float
    pixels: tuple[Any, Any]
    corners: NDArray[np.int32]
    share: Float
    normal: Float
    toward: Float
    is_front: NDArray[np.bool_]
    around: Float
    reached: Float

    @classmethod
    def of(
        cls,
        camera: Camera,
        size: tuple[int, int],
        points: Float,
        faces: NDArray[np.int32],
        *,
        ground: float | None,
        level: int = 3,
        supersample: int = 2,
    ) -> Stage:
        """Light a mesh.

        Parameters
        ----------
        camera : Camera
        size : (int, int)
            Width and height of the picture.
        points : (V, 3) float64
        faces : (T, 3) int32
        ground : float or None
            Height of the floor, which gets shadows; None: there is none.
        level : int
            Each triangle is curved and cut into `level`² pieces.
        supersample : int
            Samples per pixel along each axis.
        """
        large = (size[0] * supersample, size[1] * supersample)
        curved = Curved(faces, level)
        vertex_normals = curved.vertex_normals(points)
        places, normals = curved.surface(points, vertex_normals)
        fine = curved.triangles()
        bias = _BIAS * float(np.linalg.norm(np.ptp(points, axis=0)))
        around, colors = _surroundings(camera)
        sky = Lights.around(around, points, faces, _DOME_PIXELS)
        lamps = Lights.around(_lamp_directions(camera), places, fine, _LAMP_PIXELS)
        picture = backdrop(large, "#f4f4f6", "#dcdee4")
        if ground is not None:
            # Shadows on the floor are soft: half the resolution is enough.
            half = (max(1, size[0] // 2), max(1, size[1] // 2))
            shade = _floor(camera, half, ground, points, colors, sky, lamps, bias)
            factors = (large[1] / half[1], large[0] / half[0])
            picture *= zoom(shade, factors, order=1, mode="nearest", grid_mode=True)[..., None]
        # Light from around changes slowly: at vertices, not at every pixel.
        light = curved.spread(on_both_sides(sky, colors, points, vertex_normals, bias))
        _, pixels, hit, share = hits(camera, large, places, fine)
        corners = fine[hit]
        at = _between(share, places[corners])
        toward = unit(camera.eye - at) if camera.perspective else camera.axes[2] + 0 * at
        a, b, c = (places[corners[:, k]] for k in range(3))
        is_front = np.einsum("nc,nc->n", np.cross(b - a, c - a), toward) > 0
        side = np.where(is_front, 1.0, -1.0)[:, None]
        normal = unit(_between(share, normals[corners])) * side
        arrived = _between(share, light[corners])
        return cls(
            camera,
            supersample,
            curved,
            picture,
            pixels,
            corners,
            share,
            normal,
            toward,
            is_front,
            np.where(is_front[:, None], arrived[:, :3], arrived[:, 3:]),
            lamps.shares(at, normal, bias).mean(axis=1)[:, None],
        )

    def draw(self, look: Look) -> Float:
        """Picture ``(H, W, 3)`` in linear light."""
        picture = self.picture.copy()
        if len(self.corners):
            picture[self.pixels] = self._shaded(look)
        return block_mean(picture, self.supersample) if self.supersample > 1 else picture

    def _shaded(self, look: Look) -> Float:
        front, back, finish = (
            _between(self.share, self.curved.spread(v)[self.corners])
            for v in (look.front, look.back, look.finish)
        )
        albedo = np.where(self.is_front[:, None], front, back)
        gloss, sheen, soft = (finish[:, k, None] for k in range(3))
        camera, n = self.camera, self.normal
        open_sky = _open(camera, n)
        kept = np.clip(self.around.sum(axis=1) / open_sky.sum(axis=1), 0.0, 1.0)[:, None]
        ambient = self.around + _BOUNCE * albedo * (open_sky - self.around).clip(0.0)
        direction = camera.axes.T @ _LAMP
        cosine = (n @ direction)[:, None]
        lit = np.clip(cosine, 0.0, 1.0)
        wrap = 0.5 * soft * _PASSING
        through = (np.clip((cosine + wrap) / (1 + wrap), 0.0, 1.0) - lit) * kept
        rim = np.clip(n @ (camera.axes.T @ _RIM), 0.0, 1.0)[:, None]
        total = ambient + _LAMP_COLOR * (lit * self.reached + through) + _RIM_COLOR * rim * kept
        if look.even:
            total = look.even * (1.15 - 0.35 * (1 - kept)) + (1 - look.even) * total
        half = unit(direction + self.toward)
        shine = np.clip(np.einsum("nc,nc->n", n, half), 0.0, 1.0)[:, None] ** 24
        # An interpolated normal may point away at the silhouette.
        facing = np.clip(np.einsum("nc,nc->n", n, self.toward), 0.0, 1.0)[:, None]
        fibres = sheen * (1.0 - facing) ** 4 * (ambient + 0.5 * _LAMP_COLOR * self.reached)
        glossy = gloss * shine * self.reached
        return np.asarray(albedo * total + glossy + fibres * (0.25 + 0.75 * albedo))


def _between(share: Float, values: Float) -> Float:
    # Several times faster than one product over all three corners.
    out = share[:, :1] * values[:, 0]
    for k in (1, 2):
        out += share[:, k : k + 1] * values[:, k]
    return out


def _surroundings(camera: Camera) -> tuple[Float, Float]:
    """Directions of the light from around, and its colours: a sky and a floor."""
    directions = sphere_directions(_DOME)
    # The Fibonacci axis is y; any fixed turn does.
    up = directions @ camera.vertical
    part = np.clip(0.5 + 1.5 * up, 0.0, 1.0)[:, None]
    return directions, _FLOOR + (_SKY - _FLOOR) * part


def _open(camera: Camera, normals: Float) -> Float:
    """Light from around on a surface that nothing covers, nearly."""
    part = np.clip(0.5 + 0.55 * (normals @ camera.vertical), 0.0, 1.0)[:, None]
    return _FLOOR + (_SKY - _FLOOR) * part


def _lamp_directions(camera: Camera) -> Float:
    k = np.arange(_LAMPS)
    radius = _LAMP_SIZE * np.sqrt((k + 0.5) / _LAMPS)
    turn = k * np.pi * (3 - np.sqrt(5))
    right = unit(np.cross([0.0, 1.0, 0.0], _LAMP))
    up = np.cross(_LAMP, right)
    spread = np.outer(radius * np.cos(turn), right) + np.outer(radius * np.sin(turn), up)
    return np.asarray(unit(_LAMP + spread) @ camera.axes)


def _floor(
    camera: Camera,
    size: tuple[int, int],
    ground: float,
    points: Float,
    colors: Float,
    sky: Lights,
    lamps: Lights,
    bias: float,
) -> Float:
    """Share ``(H, W)`` of the light that reaches the floor in each pixel; 1 where there is none."""
    out = np.ones((size[1], size[0]))
    pixel = size[1] / 2 / camera.scale
    rows, columns = np.mgrid[0 : size[1], 0 : size[0]].reshape(2, -1)
    x, y = (columns + 0.5 - size[0] / 2) / pixel, (size[1] / 2 - rows - 0.5) / pixel
    offset = np.outer(x, camera.axes[0]) + np.outer(y, camera.axes[1])
    if camera.perspective:
        start, ray = camera.eye[None], offset - camera.axes[2]
    else:
        start, ray = camera.eye + offset, np.tile(-camera.axes[2], (len(x), 1))
    fall = ray @ camera.vertical
    height = ground - start @ camera.vertical
    # From below the floor would hide everything, so it is not there.
    if camera.axes[2] @ camera.vertical <= 0.02:
        return out
    far = np.divide(height, fall, out=np.full(len(fall), -1.0), where=fall < -1e-6)
    at = start + far[:, None] * ray
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    reach = float(np.linalg.norm(np.ptp(points, axis=0)))
    near = (far > 0) & (np.linalg.norm(at - centre, axis=1) < 1.5 * reach)
    if not near.any():
        return out
    at = at[near]
    up = np.tile(camera.vertical, (len(at), 1))
    # Light that grazes the floor casts streaks, one for each direction.
    high = sky.directions @ camera.vertical > 0.3
    cosine = (sky.directions[high] @ camera.vertical) * colors[high].mean(axis=1)
    arrived = sky.only(high).shares(at, up, bias) @ (cosine / cosine.sum())
    beam = lamps.shares(at, up, bias).mean(axis=1)
    # Gently: a white floor is lit by more than the lamp and the sky.
    soft = np.zeros_like(out)
    soft[rows[near], columns[near]] = 0.55 * (1 - arrived)
    out -= blur(soft, size[1] / 22)
    out[rows[near], columns[near]] -= 0.22 * (1 - beam) * out[rows[near], columns[near]]
    return out
