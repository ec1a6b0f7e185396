"""Sheets of cloth and bodies of one joint, with no clothes and no skeleton, for the simulator."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.garment.scenes.body import Body
from benchmarks.garment.scenes.garments import Garment
from benchmarks.garment.scenes.motion import Motion
from garmentnet.data.skeleton import Skeleton
from ssdr.model.skinning import Skinning


def sheet(columns, rows, edge):
    """Rest (V, 3) and triangles of a strip of equilateral triangles in the plane z = 0.

    Rows are parallel to x; the first is at y = 0, the others below it.
    """
    r, c = np.indices((rows, columns))
    x = edge * (c + 0.5 * (r % 2)) - edge * (columns - 0.5) / 2
    rest = np.stack([x, -edge * math.sqrt(0.75) * r, np.zeros_like(x)], axis=-1)
    faces = []
    for i in range(rows - 1):
        for j in range(columns - 1):
            a, b = i * columns + j, i * columns + j + 1
            d, e = a + columns, b + columns
            faces += [[a, d, b], [b, d, e]] if i % 2 == 0 else [[a, d, e], [a, e, b]]
    return rest.reshape(-1, 3), np.array(faces, np.int32)


def garment(rest, faces, pinned=()):
    mask = np.zeros(len(rest), bool)
    mask[list(pinned)] = True
    return Garment(
        rest=rest.astype(np.float32),
        faces=faces,
        pinned=mask,
        indices=np.zeros((len(rest), 1), np.int32),
        weights=np.ones((len(rest), 1), np.float32),
        mirror=None,
    )


def rigid(vertices, faces, joints=None, count=1):
    """A skinning at rest whose vertices follow one joint each; the first by default."""
    j = np.zeros(len(vertices), int) if joints is None else np.asarray(joints)
    still = np.tile(np.eye(3, 4), (1, count, 1, 1))
    names = tuple(f"joint {k}" for k in range(count))
    return Skinning(
        vertices, j[:, None], np.ones((len(j), 1)), still, faces=faces, bone_names=names
    )


def rigid_body(vertices, faces):
    """A body of one joint at the origin."""
    rig = rigid(np.asarray(vertices, np.float32), np.asarray(faces))
    return Body(rig, Skeleton(rig.bone_names, [-1], [[0, 0, 0]]))


def square(n, size, height=0.0):
    """Rest (V, 3) and triangles of a level sheet of n × n vertices that faces z."""
    x = np.linspace(-size, size, n)
    v = np.stack([*np.meshgrid(x, x), np.full((n, n), height)], -1).reshape(-1, 3)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = [np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)]
    return v, np.concatenate(faces)


def ball(radius, centre):
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return rigid_body(mesh.vertices + np.asarray(centre), mesh.faces)


def slope(degrees):
    """A slab whose upper side passes through the origin and falls towards +x; its rotation."""
    import trimesh

    mesh = trimesh.creation.box(extents=(8, 1, 8))
    turn = Rotation.from_euler("z", -degrees, degrees=True).as_matrix()
    return rigid_body((mesh.vertices - [0, 0.5, 0]) @ turn.T, mesh.faces), turn


def still(frames, joints=1):
    return Motion(np.tile(np.eye(3, 4), (frames, joints, 1, 1)), np.zeros(frames, np.int8))


def tube(heights, radii, columns=10):
    """Rest (V, 3) and triangles that face out of rings around the y axis, from the top down."""
    heights, radii = np.broadcast_arrays(heights, radii)
    turn = np.arange(columns) * 2 * np.pi / columns
    around = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=-1)
    rest = radii[:, None, None] * around + heights[:, None, None] * np.array([0.0, 1.0, 0.0])
    k = np.arange(columns * (len(heights) - 1))
    n = k - k % columns + (k + 1) % columns
    lower, upper = [k, k + columns, n + columns], [k, n + columns, n]
    return rest.reshape(-1, 3), np.concatenate([np.stack(lower, 1), np.stack(upper, 1)])
