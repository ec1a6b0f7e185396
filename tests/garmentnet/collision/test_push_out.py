import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import ssdr
from garmentnet.collision.outward import OutwardPush
from garmentnet.collision.push_out import INSIDE, PushOut
from helpers.cloth_scenes import rigid, square
from ssdr.common.errors import InputError

STILL = np.eye(3, 4)[None, None]
FLAT = np.array([[[0, 1, 2]]])


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
    found = PushOut(body, FLAT[0]).signed_distance(points[None], joints)[0]
    assert np.abs(found - expected).max() < 1e-9
    assert (expected < 0).sum() > 50


def test_rays_through_vertices_and_edges_count_once():
    v, f = sphere()
    lattice = np.concatenate([v * 0.5, v * 1.5, v * [1, 1, 0.3]])
    found = PushOut(rigid(v, f), FLAT[0]).signed_distance(lattice[None], STILL)
    expected = naive_signed_distance(lattice, v, f)
    clear = np.abs(expected) > 1e-9
    assert np.array_equal(found[0, clear] < 0, expected[clear] < 0)


def inside(push, vertices, joints):
    return push.signed_distance(vertices, joints) < -INSIDE


def test_a_point_inside_goes_the_shortest_way():
    v, f = sphere(24, 32)
    cloth = np.array([[[0, 0, 0.9], [0, 0.7, 0], [0, 0, 3.0]]])
    push = PushOut(rigid(v, f), FLAT[0], margin=0.02, sweeps=0)
    out = push(cloth, STILL)
    radius = np.linalg.norm(out.vertices[0], axis=1)
    assert np.abs(radius[:2] - 1.02).max() < 0.01
    assert np.array_equal(out.vertices[0, 2], cloth[0, 2])
    assert inside(push, cloth, STILL)[0].tolist() == [True, True, False]
    assert not inside(push, out.vertices, STILL).any()
    assert 0.3 < out.farthest < 0.33
    assert out.moved == pytest.approx(2 / 3)


def test_a_sheet_on_a_box_is_lifted_without_a_spike():
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 0)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    box = rigid(corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))
    sheet, faces = square(21, 0.5, 0.02)
    dent = sheet.copy()
    dent[220, 2] = -0.03
    hard = PushOut(box, faces, margin=0.01, sweeps=0)(dent[None], STILL)
    assert hard.vertices[0, 220, 2] == pytest.approx(0.01)
    assert (hard.distance > 0).sum() == 1
    soft = PushOut(box, faces, margin=0.01, sweeps=4)(dent[None], STILL)
    lift = (soft.vertices[0] - dent)[:, 2]
    assert soft.vertices[0, 220, 2] == pytest.approx(0.01, abs=1e-4)
    ring = lift[[219, 221, 199, 241]]
    assert (0.1 * lift[220] < ring).all()
    assert (ring < lift[220]).all()
    # Four edges away is as far as four sweeps reach.
    assert np.array_equal(soft.vertices[0, 225], dent[225])
    assert (soft.distance > 0).sum() > 20


def test_pinned_vertices_stay():
    v, f = sphere()
    cloth, faces = square(5, 0.4)
    pinned = np.zeros(25, bool)
    pinned[[0, 12]] = True
    out = PushOut(rigid(v, f), faces, margin=0.01, pinned=pinned)(cloth[None], STILL)
    assert np.array_equal(out.vertices[0, pinned], cloth[pinned])
    assert (out.distance[0, ~pinned] > 0).all()


@settings(max_examples=60)
@given(
    points=arrays(np.float64, (25, 3), elements=st.floats(-1.6, 2.6)),
    distance=st.floats(0.3, 2.3),
    sweeps=st.integers(0, 5),
)
def test_nothing_ends_deeper_and_a_second_time_moves_nothing(points, distance, sweeps):
    body, joints = two_spheres(distance)
    _, faces = square(5, 1.0)
    push = PushOut(body, faces, margin=0.01, sweeps=sweeps)
    before = push.signed_distance(points[None], joints)
    out = push(points[None], joints)
    after = push.signed_distance(out.vertices, joints)
    assert (after >= np.minimum(before, 0.01) - 2e-6).all()
    assert not ((after < -INSIDE) & (before >= -INSIDE)).any()
    if distance > 2.1:
        assert not (after < -INSIDE).any()
    if sweeps == 0:
        assert (out.distance[before > 0.01 + 1e-6] == 0).all()
    again = push(out.vertices, joints)
    assert again.farthest < 1e-6


def test_overlapping_parts_of_the_body_do_not_throw_a_vertex_away():
    body, joints = two_spheres(1.2)
    # Between the skins of both spheres, in the middle of the overlap: no way out nearby.
    middle = np.array([[[0.6, 0, 0], [0.6, 0.05, 0], [0.65, 0, 0.05]]])
    out = PushOut(body, FLAT[0])(middle, joints)
    assert out.farthest < 0.021


def test_near_the_seam_of_two_parts_the_free_skin_is_taken():
    v, f = sphere(60, 80, 0.1)
    both = rigid(np.concatenate([v, v + np.array([0.12, 0, 0])]), np.concatenate([f, f + len(v)]))
    seam = np.array([[[0.058, 0.076, 0], [0.06, 0, 0.077], [0.062, 0, -0.076]]])
    push = PushOut(both, FLAT[0])
    out = push(seam, STILL)
    assert inside(push, seam, STILL).all()
    assert not inside(push, out.vertices, STILL).any()
    assert out.farthest < 0.03


def test_threads_and_frames_do_not_matter(rng):
    body, _ = two_spheres(2.5)
    cloth, faces = square(9, 0.9)
    v = cloth + rng.normal(0, 0.05, (20, *cloth.shape))
    joints = np.tile(np.eye(3, 4), (20, 2, 1, 1))
    joints[:, 0, 2, 3] = np.linspace(-0.9, 0.9, 20)
    push = PushOut(body, faces)
    before = ssdr.get_threads()
    try:
        ssdr.set_threads(1)
        one = push(v, joints)
        ssdr.set_threads(3)
        assert np.array_equal(one.vertices, push(v, joints).vertices)
    finally:
        ssdr.set_threads(before)
    assert push(v.astype(np.float32), joints).vertices.dtype == np.float32
    assert one.moved > 0.05


V, F = sphere()
BODY = rigid(V, F)
CLOTH = np.ones((1, 3, 3))
NAN = np.where(np.arange(3)[:, None] == 1, np.nan, CLOTH)
LEVEL, FACES = square(3, 0.3)
REFUSED = [
    (lambda: PushOut(BODY, FLAT[0])(NAN, STILL), r"vertices: .*frame 0"),
    (lambda: PushOut(BODY, FLAT[0])(CLOTH, STILL * np.nan), r"joints: .*frame 0"),
    (lambda: PushOut(BODY, FLAT[0])(CLOTH[0], STILL), r"vertices: .*shape"),
    (lambda: PushOut(BODY, FLAT[0])(CLOTH, STILL[0]), r"joints: .*shape"),
    (lambda: PushOut(rigid(V, F[1:]), FLAT[0]), r"body: .*closed"),
    (lambda: PushOut(BODY, FLAT[0], margin=float("nan")), "margin"),
    (lambda: PushOut(BODY, FLAT[0], sweeps=-1), "sweeps"),
    (lambda: PushOut(BODY, FLAT[0], pinned=np.zeros(4, bool)), "pinned"),
    (lambda: PushOut(BODY, [[0, 1, -1]]), "faces"),
    (lambda: OutwardPush(BODY, FACES, LEVEL, rounds=0), "rounds"),
    (lambda: OutwardPush(BODY, FACES, LEVEL, pinned=np.ones(9, bool)), "pinned"),
]


@pytest.mark.parametrize(("call", "text"), REFUSED)
def test_refusals(call, text):
    with pytest.raises(InputError, match=text):
        call()
