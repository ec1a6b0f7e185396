"""The kernels against formulas evaluated one constraint at a time, in float64."""

from __future__ import annotations

import numpy as np

from benchmarks.garment.scenes.xpbd.chunks import colour, pack
from benchmarks.garment.scenes.xpbd.constraints import BUFFER_ROWS, bend, stretch
from benchmarks.garment.scenes.xpbd.contact import CLUSTER, find_contacts, skin_points
from benchmarks.garment.scenes.xpbd.policy import INDEX, LANES, REAL

BUFFER = np.zeros(BUFFER_ROWS * LANES, REAL)


def angle(p):
    """Dihedral angle between the triangles (1, 2, 3) and (2, 1, 4)."""
    e = p[1] - p[0]
    a, b = np.cross(e, p[2] - p[0]), np.cross(p[3] - p[0], e)
    return np.arctan2(np.cross(a, b) @ e / np.linalg.norm(e), a @ b)


def gradient(function, p, step=1e-6):
    out = np.zeros_like(p)
    for place in np.ndindex(p.shape):
        shift = np.zeros_like(p)
        shift[place] = step
        out[place] = (function(p + shift) - function(p - shift)) / (2 * step)
    return out


def projected(function, p, before, rest, w, compliance, damping):
    """Equation 26 of XPBD, λ from 0."""
    g = gradient(function, p)
    rate = (g * (p - before)).sum()
    weighted = (w * (g**2).sum(axis=1)).sum()
    change = -(function(p) - rest + damping * rate) / ((1 + damping) * weighted + compliance)
    return p + w[:, None] * g * change


def test_bending_is_the_formula(rng):
    for _ in range(20):
        p = np.array([[0, 0, 0], [1, 0, 0], [0.4, 0.9, 0], [0.6, -0.8, 0]]) * 0.03
        p = p + rng.normal(0, 0.004, p.shape)
        before = p + rng.normal(0, 1e-4, p.shape)
        w, compliance, damping = rng.uniform(5e3, 1e4, 4), 1e9, 3.0
        rest = angle(p) + rng.uniform(-0.3, 0.3)
        numbers = np.array([[np.cos(rest), np.sin(rest), compliance]])
        hinge = pack(np.arange(4)[None], w[None], numbers, [np.array([0])])
        x, previous = p.ravel().astype(REAL), before.ravel().astype(REAL)
        bend(x, previous, hinge, REAL(damping), BUFFER)
        want = projected(angle, p, before, rest, w, compliance, damping) - p
        # The arc tangent is approximated within 0.005 rad.
        np.testing.assert_allclose(x.reshape(4, 3) - p, want, atol=0.03 * np.abs(want).max() + 1e-8)


def test_stretching_is_the_formula(rng):
    p = rng.normal(0, 0.03, (2, 3))
    w, compliance = np.array([3e3, 8e3]), 5e3
    edge = pack(np.array([[0, 1]]), w[None], np.array([[0.02, compliance]]), [np.array([0])])
    x = p.ravel().astype(REAL)
    stretch(x, edge, BUFFER)
    want = projected(lambda q: np.linalg.norm(q[1] - q[0]), p, p, 0.02, w, compliance, 0.0)
    np.testing.assert_allclose(x.reshape(2, 3), want, atol=1e-7)


def test_constraints_of_a_colour_share_no_free_vertex(rng):
    pinned = rng.random(60) < 0.2
    constraints = np.array([rng.choice(60, 4, replace=False) for _ in range(300)])
    colours = colour(constraints, pinned)
    assert sorted(np.concatenate(colours)) == list(range(300))
    for members in colours:
        free = constraints[members].ravel()
        free = free[~pinned[free]]
        assert len(set(free)) == len(free)


def test_contacts_are_the_nearest_triangles(rng):
    import trimesh

    from ssdr.kernels.closest import fit_boxes, tree_order

    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    triangles = mesh.faces[tree_order(mesh.vertices, mesh.faces, 5)].astype(np.int32)
    points, at = mesh.vertices.ravel().astype(REAL), rng.normal(0, 0.3, (80, 3)).astype(REAL)
    # Triangles of a search before: right, wrong and none.
    boxes, nearest = np.empty((63, 6), REAL), rng.integers(-1, 320, 80).astype(np.int32)
    close = np.empty(80, INDEX)
    fit_boxes(points.reshape(-1, 3), triangles, 5, boxes)
    # Points and triangles of a side do not meet those of the other one.
    own, sides = (rng.integers(-1, 2, n).astype(np.int8) for n in (80, len(triangles)))
    tree = (points, triangles, sides, 5, boxes)
    # The last cluster has two vertices fewer and is filled up with its first one.
    clusters = np.append(np.arange(78), [64, 64]).reshape(-1, CLUSTER)
    nearest[78:] = -1
    count = find_contacts(at.ravel(), clusters, own, REAL(0.1), tree, nearest, close)
    corners = mesh.vertices[triangles]
    gap = np.stack(
        [
            np.linalg.norm(
                trimesh.triangles.closest_point(corners, np.tile(p, (len(corners), 1))) - p, axis=1
            )
            for p in at
        ]
    )
    gap[own[:, None] * sides < 0] = np.inf
    inside = gap.min(axis=1) < 0.1
    inside[78:] = False
    assert set(close[:count]) == set(np.flatnonzero(inside))
    assert set(np.flatnonzero(nearest < 0)) == set(np.flatnonzero(~inside))
    found = gap[close[:count], nearest[close[:count]]]
    np.testing.assert_allclose(found, gap.min(axis=1)[close[:count]], atol=1e-6)


def test_skinning_is_that_of_ssdr(rng):
    from scipy.spatial.transform import Rotation

    from ssdr.model.skinning import skin

    rest, indices = rng.normal(size=(50, 3)), rng.integers(0, 4, (50, 3))
    weights = rng.dirichlet(np.ones(3), 50)
    turns = Rotation.random(4, random_state=1).as_matrix()
    joints = np.concatenate([turns, rng.normal(size=(4, 3, 1))], axis=2)
    arrays = (rest.astype(REAL), indices.astype(np.int32), weights.astype(REAL))
    points = np.empty(150, REAL)
    skin_points(arrays, joints.reshape(4, 12).astype(REAL), points)
    want = skin(rest, indices, weights, joints[None])[0]
    np.testing.assert_allclose(points.reshape(-1, 3), want, atol=2e-6)
