"""One picture of one frame, without text."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from .palette import heat, linear_from_srgb, srgb_from_linear
from .raster import backdrop, block_mean, draw_balls, draw_mesh, over, shadow
from .scene import Scene, Style, View
from .skeleton import draw_skeleton
from .studio import Look, Stage

__all__ = ["draw_panel"]

Float = NDArray[np.float64]
# sRGB, chosen by eye: a light warm grey on which shading shows
_CLAY = linear_from_srgb([0.84, 0.82, 0.79])
_LARGE = 600  # height in pixels from which triangles are cut more finely


def draw_panel(
    scene: Scene,
    view: View,
    frame: int,
    style: Style,
    size: tuple[int, int],
    top: float,
    supersample: int,
) -> Image.Image:
    """One frame in one style; `top` is the error that gets the last colour."""
    large = (size[0] * supersample, size[1] * supersample)
    shift = view.shift[frame]
    points = scene.positions(frame) - shift
    if scene.parts:
        return _image(_draw_parts(scene, view, frame, points, style, size, top, supersample))
    colors = np.broadcast_to(_CLAY, points.shape)
    if style == "weights":
        colors = scene.weight_colors
    elif style == "error":
        colors = heat(scene.errors(frame) / top)
    camera, faces = view.camera, scene.faces
    picture = backdrop(large)
    if len(faces):
        layer = draw_mesh(camera, large, points, faces, colors)
        # From below the ground would hide the mesh, so it is not there.
        if camera.eye @ camera.vertical > view.ground and camera.axes[2] @ camera.vertical > 0.02:
            soft = shadow(camera, size, points, faces, view.ground)
            picture *= np.kron(soft, np.ones((supersample, supersample)))[..., None]
    else:
        radii = np.full(len(points), scene.disc_radius)
        layer = draw_balls(camera, large, points, radii, colors)
    if style == "bones":
        picture = over(picture, layer, 0.55)
        bones = draw_skeleton(scene, view, frame, large)
        # A bone behind the surface shines through it.
        behind = np.where(layer.nearness > bones.nearness, 0.82, 1.0)
        picture = over(picture, bones, behind)
    else:
        picture = over(picture, layer)
    if supersample > 1:
        picture = block_mean(picture, supersample)
    return _image(picture)


def _image(picture: Float) -> Image.Image:
    return Image.fromarray((255 * srgb_from_linear(picture)).round().astype(np.uint8))


def _draw_parts(
    scene: Scene,
    view: View,
    frame: int,
    points: Float,
    style: Style,
    size: tuple[int, int],
    top: float,
    supersample: int,
) -> Float:
    """Parts in their materials, or their errors; both are drawn from one lighting."""
    key = (id(view), frame, size, supersample)
    lit = scene.lit.get(key)
    if lit is None:
        level = 3 if size[1] >= _LARGE else 2
        scene.lit.clear()
        lit = scene.lit[key] = Stage.of(
            view.camera,
            size,
            points,
            scene.faces,
            ground=view.ground,
            level=level,
            supersample=supersample,
        )
    if style == "error":
        return lit.draw(Look.of_errors(scene.parts, scene.errors(frame) / top))
    return lit.draw(Look.of(scene.parts))
