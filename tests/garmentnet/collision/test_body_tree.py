import numpy as np
import pytest
import trimesh

import ssdr
from garmentnet.collision.body_tree import BodyTree
from garmentnet.collision.outward import OutwardPush
from helpers.cloth_scenes import rigid, square
from ssdr.common.errors import InputError

STILL = np.eye(3, 4)[None, None]


def sphere(rings=12, columns=16, radius=1.0):
    mesh = trimesh.creation.uv_sphere(radius, (rings, columns))
    return mesh.vertices, mesh.faces


def two_spheres(distance):
    """Two unit spheres as one body, each with a joint; apart in the rest pose."""
    v, f = sphere()
    both = np.concatenate([v, v + np.array([3.0, 0, 0])])
    body = rigid(both, np.concatenate([f, f + len(v)]), np.repeat([0, 1], len(v)), 2)
    joints = np.tile(np.eye(3, 4), (1, 2, 1, 1))
    joints[0, 1, 0, 3] = distance - 3.0
    return body, joints


def naive_signed_distance(points, vertices, faces):
    """All pairs: trimesh's closest points, sign by the sum of solid angles."""
    out = np.empty(len(points))
    tri = vertices[faces]
    for i, p in enumerate(points):
        closest = trimesh.triangles.closest_point(tri, np.tile(p, (len(tri), 1)))
        best = np.linalg.norm(closest - p, axis=1).min()
        a, b, c = (tri[:, k] - p for k in range(3))
        la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
        det = (a * np.cross(b, c)).sum(1)
        div = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        winding = (2 * np.arctan2(det, div)).sum() / (4 * np.pi)
        out[i] = -best if winding > 0.5 else best
    return out


@pytest.mark.parametrize("distance", [1.2, 1.9, 2.5])
def test_distances_are_those_of_all_pairs(rng, distance):
    body, joints = two_spheres(distance)
    points = rng.uniform([-1.3, -1.3, -1.3], [distance + 1.3, 1.3, 1.3], (300, 3))
    posed = ssdr.skin(body.rest, body.indices, body.weights, joints)[0]
    expected = naive_signed_distance(points, np.asarray(posed, float), body.faces)
    found = BodyTree(body).signed_distance(points[None], joints)[0]
    assert np.abs(found - expected).max() < 1e-9
    assert (expected < 0).sum() > 50


def test_rays_through_vertices_and_edges_count_once():
    v, f = sphere()
    lattice = np.concatenate([v * 0.5, v * 1.5, v * [1, 1, 0.3]])
    found = BodyTree(rigid(v, f)).signed_distance(lattice[None], STILL)
    expected = naive_signed_distance(lattice, v, f)
    clear = np.abs(expected) > 1e-9
    assert np.array_equal(found[0, clear] < 0, expected[clear] < 0)


def test_threads_and_frames_do_not_matter(rng):
    body, _ = two_spheres(2.5)
    cloth, faces = square(9, 0.9)
    v = cloth + rng.normal(0, 0.05, (20, *cloth.shape))
    joints = np.tile(np.eye(3, 4), (20, 2, 1, 1))
    joints[:, 0, 2, 3] = np.linspace(-0.9, 0.9, 20)
    push = OutwardPush(body, faces, len(cloth))
    before = ssdr.get_threads()
    try:
        ssdr.set_threads(1)
        one = push(v, joints)
        ssdr.set_threads(3)
        assert np.array_equal(one.vertices, push(v, joints).vertices)
    finally:
        ssdr.set_threads(before)
    assert push(v.astype(np.float32), joints).vertices.dtype == np.float32
    assert one.moved > 0.02


V, F = sphere()
BODY = rigid(V, F)
LEVEL, FACES = square(3, 0.3)
CLOTH = LEVEL[None]
NAN = np.where(np.arange(9)[:, None] == 1, np.nan, CLOTH)
PUSH = OutwardPush(BODY, FACES, len(LEVEL))
REFUSED = [
    (lambda: PUSH(NAN, STILL), r"vertices: expected finite numbers, got NaN or Inf at \(0, 1, 0\)"),
    (
        lambda: PUSH(CLOTH, STILL * np.nan),
        r"joints: expected finite numbers, got NaN or Inf at \(0, 0, 0, 0\)",
    ),
    (lambda: PUSH(CLOTH[0], STILL), r"vertices: .*shape"),
    (lambda: PUSH(CLOTH, STILL[0]), r"joints: .*shape"),
    (lambda: OutwardPush(rigid(V, F[1:]), FACES, len(LEVEL)), r"body: .*closed"),
    (lambda: OutwardPush(BODY, FACES, len(LEVEL), pinned=np.zeros(4, bool)), "pinned"),
    (lambda: OutwardPush(BODY, [[0, 1, -1]], len(LEVEL)), "faces"),
]


@pytest.mark.parametrize(("call", "text"), REFUSED)
def test_refusals(call, text):
    with pytest.raises(InputError, match=text):
        call()
