"""Drawing of bones: octahedra from joint to joint, or balls with axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..mesh.normals import triangle_normals, unit
from ..model.bone_ends import limb_ends
from .camera import Camera, Float, balls_seen, triangles_seen
from .light import reflected
from .palette import linear_from_srgb
from .subject import Scene

# red, green and blue for a bone's x, y and z axes, as in modelling programs
_AXES = linear_from_srgb([[0.86, 0.27, 0.25], [0.30, 0.66, 0.31], [0.22, 0.45, 0.85]])
_JOINT = linear_from_srgb([0.24, 0.25, 0.28])
_COVERED = 0.82  # opacity of a bone behind the surface
_WAIST, _WIDTH = 0.16, 0.085  # position and half width of the widest section, per bone length
_THICKEST = 0.016  # largest half width, relative to the diagonal
_CORNERS = np.array(
    [[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 1, 4], [5, 1, 2], [5, 2, 3], [5, 3, 4], [5, 4, 1]]
)


def draw_bones(
    picture: Float, surface: Float, camera: Camera, scene: Scene, frame: int, shift: Float
) -> None:
    """Draw the bones of a frame over a picture.

    With a hierarchy a bone is drawn as octahedra from its joint to the joints of its children, or
    to its end.  Without a hierarchy it is a ball with axes at the posed centroid of the vertices
    that it moves.

    Parameters
    ----------
    picture : (H, W, 3) float64
        Linear RGB, updated in place.
    surface : (H, W) float64
        Depth buffer of the mesh.
    camera : Camera
    scene : Scene
        The subject is a skinning.
    frame : int
    shift : (3,) float64
        Subtracted from all points.
    """
    model = scene.model
    m = model.transforms[frame].astype(np.float64)
    if model.parents is None:
        centers, ball_colors = _moved(m, model.centroids()), scene.palette
        radius = scene.diagonal * 0.022 * min(1.0, (20 / len(m)) ** 0.33)
        axes = 2.3 * radius * unit(np.swapaxes(m[:, :, :3], 1, 2))
        # the wide end of an axis lies outside the ball
        heads, tails = (centers[:, None] + axes).reshape(-1, 3), np.repeat(centers, 3, axis=0)
        colors, most = np.tile(_AXES, (len(m), 1)), 0.18 * radius
    else:
        parents, centers = np.asarray(model.parents), _moved(m, model.joint_positions)
        hung = np.flatnonzero(parents >= 0)
        leaves = np.setdiff1d(np.arange(len(parents)), parents)
        bone = np.concatenate([parents[hung], leaves])
        heads = centers[bone]
        skin = model.rest, model.indices, model.weights
        ends = _moved(m, limb_ends(model.joint_positions, parents, *skin))
        tails = np.concatenate([centers[hung], ends[leaves]])
        colors, most = scene.palette[bone], _THICKEST * scene.diagonal
        ball_colors, radius = np.tile(_JOINT, (len(m), 1)), 0.45 * most
    nearness = np.full_like(surface, -np.inf)
    points, faces = octahedra(heads - shift, tails - shift, most=most)
    pixels, hit, _ = triangles_seen(camera, points, faces, nearness)
    drawn = [(pixels, triangle_normals(points, faces)[hit], colors[hit // len(_CORNERS)])]
    pixels, index, normal = balls_seen(camera, centers - shift, radius, nearness)
    drawn.append((pixels, normal, ball_colors[index]))
    for pixels, normal, albedo in drawn:
        opacity = np.where(surface[pixels] > nearness[pixels], _COVERED, 1.0)[:, None]
        color = reflected(camera, normal, albedo)
        picture[pixels] += opacity * (color - picture[pixels])


def octahedra(heads: Float, tails: Float, *, most: float) -> tuple[Float, NDArray[np.int32]]:
    """Octahedra stretched between pairs of points.

    Parameters
    ----------
    heads, tails : (N, 3) arrays
    most : float
        Largest distance of a side from the axis.

    Returns
    -------
    points : (6 N, 3) float64
    faces : (8 N, 3) int32
    """
    way = tails - heads
    length = np.linalg.norm(way, axis=1, keepdims=True)
    along = np.where(length > 0, unit(way), [0.0, 1.0, 0.0])
    one = unit(np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)]))
    two = np.cross(along, one)
    width = np.minimum(_WIDTH * length, most)
    waist = heads + np.minimum(_WAIST * length, 2 * most) * along
    ring = [waist + width * side for side in (one, two, -one, -two)]
    points = np.stack([heads, *ring, tails], axis=1).reshape(-1, 3)
    faces = 6 * np.arange(len(heads))[:, None, None] + _CORNERS
    return points, faces.reshape(-1, 3).astype(np.int32)


def _moved(transforms: Float, points: NDArray[np.floating]) -> Float:
    p = np.asarray(points, dtype=np.float64)
    return np.asarray(np.einsum("bij,bj->bi", transforms[..., :3], p) + transforms[..., 3])
