"""Bones as a picture shows them: balls with axes, or the octahedra of a hierarchy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .palette import linear_from_srgb
from .raster import Layer, draw_balls, draw_mesh
from .scene import Scene, View

__all__ = ["draw_skeleton", "octahedra"]

Float = NDArray[np.float64]
# sRGB of a bone's x, y and z axes: red, green, blue, as modelling programs draw them
_AXES = linear_from_srgb([[0.86, 0.27, 0.25], [0.30, 0.66, 0.31], [0.22, 0.45, 0.85]])
_JOINT = linear_from_srgb([0.24, 0.25, 0.28])
_WAIST, _WIDTH = 0.16, 0.085  # of a bone's length: where it is widest, and how wide to each side
_THICKEST = 0.016  # of the diagonal
_CORNERS = np.array(
    [[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 1, 4], [5, 1, 2], [5, 2, 3], [5, 3, 4], [5, 4, 1]]
)


def draw_skeleton(scene: Scene, view: View, frame: int, size: tuple[int, int]) -> Layer:
    """The bones of a frame; those of a hierarchy run from joint to joint."""
    assert scene.skinning is not None
    if scene.skinning.parents is None:
        return _draw_balls(scene, view, frame, size)
    heads, tails, bone = _limbs(scene, frame)
    heads, tails = heads - view.shift[frame], tails - view.shift[frame]
    points, faces = octahedra(heads, tails, most=_THICKEST * scene.diagonal)
    layer = draw_mesh(view.camera, size, points, faces, np.repeat(scene.palette[bone], 24, axis=0))
    joints = _joints(scene, frame) - view.shift[frame]
    radii = np.full(len(joints), 0.45 * _THICKEST * scene.diagonal)
    balls = draw_balls(view.camera, size, joints, radii, np.tile(_JOINT, (len(joints), 1)))
    nearer = balls.nearness > layer.nearness
    return Layer(
        np.where(nearer[..., None], balls.color, layer.color),
        np.where(nearer, balls.nearness, layer.nearness),
    )


def _joints(scene: Scene, frame: int) -> Float:
    skinning = scene.skinning
    assert skinning is not None
    return _moved(skinning.transforms[frame], skinning.joint_positions)


def _limbs(scene: Scene, frame: int) -> tuple[Float, Float, NDArray[np.int64]]:
    """Both ends and the bone of every limb: to each joint that hangs on it, else to its end."""
    skinning = scene.skinning
    assert skinning is not None
    parents = np.asarray(skinning.parents)
    joints = _joints(scene, frame)
    hung = np.flatnonzero(parents >= 0)
    leaves = np.setdiff1d(np.arange(len(parents)), parents)
    tips = _moved(skinning.transforms[frame], scene.limb_ends)[leaves]
    return (
        np.concatenate([joints[parents[hung]], joints[leaves]]),
        np.concatenate([joints[hung], tips]),
        np.concatenate([parents[hung], leaves]),
    )


def _moved(transforms: NDArray[np.floating], points: NDArray[np.floating]) -> Float:
    m = np.asarray(transforms, dtype=np.float64)
    p = np.asarray(points, dtype=np.float64)
    return np.asarray(np.einsum("bij,bj->bi", m[..., :3], p) + m[..., 3])


def octahedra(heads: Float, tails: Float, *, most: float) -> tuple[Float, NDArray[np.int32]]:
    """Long octahedra between pairs of points.

    Parameters
    ----------
    heads, tails : (N, 3) arrays
    most : float
        Largest distance of a side from the axis.

    Returns
    -------
    points : (24 N, 3) float64
        Three of its own for each triangle, so that edges stay sharp.
    faces : (8 N, 3) int32
    """
    way = tails - heads
    length = np.linalg.norm(way, axis=1, keepdims=True)
    along = np.divide(way, length, out=np.tile([0.0, 1.0, 0.0], (len(way), 1)), where=length > 0)
    least = np.eye(3)[np.argmin(np.abs(along), axis=1)]
    one = np.cross(along, least)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    two = np.cross(along, one)
    width = np.minimum(_WIDTH * length, most)
    waist = heads + np.minimum(_WAIST * length, 2 * most) * along
    ring = [waist + width * side for side in (one, two, -one, -two)]
    six = np.stack([heads, *ring, tails], axis=1)
    points = six[:, _CORNERS].reshape(-1, 3)
    return points, np.arange(len(points), dtype=np.int32).reshape(-1, 3)


def _draw_balls(scene: Scene, view: View, frame: int, size: tuple[int, int]) -> Layer:
    """Balls at the posed centroids; each axis of a bone is a row of small balls."""
    assert scene.skinning is not None
    transforms = scene.skinning.transforms[frame].astype(np.float64)
    turn = transforms[:, :, :3]
    at = np.einsum("brc,bc->br", turn, scene.centroids) + transforms[:, :, 3] - view.shift[frame]
    n_bones = len(at)
    radius = scene.diagonal * 0.022 * min(1.0, (20 / n_bones) ** 0.33)
    steps = np.linspace(1.0, 2.3, 14) * radius
    length = np.linalg.norm(turn, axis=1, keepdims=True)
    axes = np.swapaxes(turn / np.where(length > 0, length, 1.0), 1, 2)
    ticks = at[:, None, None] + steps[:, None] * axes[:, :, None]
    shape = (n_bones, 3, len(steps), 3)
    centers = np.concatenate([at, ticks.reshape(-1, 3)])
    radii = np.concatenate([np.full(n_bones, radius), np.full(ticks.size // 3, radius * 0.17)])
    tints = np.broadcast_to(_AXES[None, :, None], shape).reshape(-1, 3)
    return draw_balls(view.camera, size, centers, radii, np.concatenate([scene.palette, tints]))
