"""A hierarchy is drawn as bones from joint to joint."""

from __future__ import annotations

import dataclasses

import numpy as np

from helpers.rig_tree import creature, flat
from ssdr import show as render
from ssdr.show.camera import Camera
from ssdr.show.skeleton import octahedra


def test_bones_are_drawn_from_joint_to_joint():
    model = creature(frames=3)
    model = dataclasses.replace(model, transforms=model.transforms[:1], clips=None)
    camera = Camera.fit(model.skin(0), azimuth=20, elevation=5)
    options = {"size": (400, 400), "azimuth": 20, "elevation": 5}
    bones, plain = (
        np.asarray(render.render_frame(model, style=style, **options), dtype=int)
        for style in ("bones", "plain")
    )
    frame = model.transforms[0]
    joints = np.einsum("bij,bj->bi", frame[..., :3], model.joint_positions) + frame[..., 3]
    ends = camera.project(joints, (400, 400))[:, :2]
    changed = np.abs(bones - plain).max(axis=2) > 25
    for child, parent in ((1, 0), (3, 0), (0, 2), (4, 2), (6, 4)):
        for u in np.linspace(0.15, 0.8, 5):
            x, y = (1 - u) * ends[parent] + u * ends[child]
            x, y = int(x), int(y)
            assert changed[y - 1 : y + 2, x - 1 : x + 2].any(), (child, parent, u)
    other = np.asarray(render.render_frame(flat(model), style="bones", **options), dtype=int)
    assert np.abs(bones - other).max() > 40


def test_octahedra_are_closed_and_face_outwards():
    heads = np.array([[0.0, 0, 0], [1, 1, 1], [2, 0, 0]])
    tails = np.array([[0.0, 2, 0], [0, 1, 3], [2, 0, 0]])  # the last has no length
    points, faces = octahedra(heads, tails, most=0.1)
    assert (points.shape, faces.shape) == ((18, 3), (24, 3))
    assert np.isfinite(points).all()
    a, b, c = (points[faces[:16, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    middle = ((heads + 0.2 * (tails - heads))[:2])[np.repeat([0, 1], 8)]
    assert (np.einsum("nc,nc->n", normal, (a + b + c) / 3 - middle) > 0).all()
    for k in range(2):
        side = points[6 * k : 6 * k + 6] - heads[k]
        along = (tails[k] - heads[k]) / np.linalg.norm(tails[k] - heads[k])
        off = np.linalg.norm(side - np.outer(side @ along, along), axis=1)
        assert off.max() < 0.1 + 1e-9
