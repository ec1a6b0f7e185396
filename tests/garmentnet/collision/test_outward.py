"""Limbs that come through cloth: they are counted, and the cloth goes back to its side."""

import numpy as np
import pytest
import trimesh

import ssdr
from garmentnet.collision import outward
from garmentnet.collision.body_tree import BodyTree
from garmentnet.collision.crossings import find_crossings
from garmentnet.collision.outward import OutwardPush
from helpers.cloth_scenes import rigid, square

STILL = np.eye(3, 4)[None, None]


def leg(radius=0.07, length=1.0):
    """A thigh along x, its skin as coarse as that of the body that ships."""
    mesh = trimesh.creation.cylinder(radius, length, sections=14)
    mesh = mesh.subdivide_to_size(0.05)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    return rigid(mesh.vertices, mesh.faces)


def naive_pairs(cloth, faces, body, triangles):
    """Pairs of triangles, an edge of one of which meets the other, by linear systems."""

    def meets(p, q, a, b, c):
        m = np.stack([b - a, c - a, p - q], axis=1)
        if abs(np.linalg.det(m)) < 1e-15:
            return False
        s, t, u = np.linalg.solve(m, p - a)
        return s >= 0 and t >= 0 and s + t <= 1 and 0 <= u <= 1

    count, skin = 0, body[triangles]
    low, high = skin.min(axis=1), skin.max(axis=1)
    for f in cloth[faces]:
        for g in skin[((low <= f.max(0)) & (high >= f.min(0))).all(axis=1)]:
            edges = [(f[k], f[k - 1], *g) for k in range(3)] + [
                (g[k], g[k - 1], *f) for k in range(3)
            ]
            count += any(meets(*e) for e in edges)
    return count


def test_crossings_are_those_of_all_pairs(rng):
    body = leg()
    cloth, faces = square(9, 0.3, 0.03)
    cloth = cloth + rng.normal(0, 0.02, (3, *cloth.shape))
    found = find_crossings(body, faces, cloth, STILL.repeat(3, 0))
    expected = [naive_pairs(v, faces, np.asarray(body.rest, float), body.faces) for v in cloth]
    assert found.pairs.tolist() == expected
    assert min(expected) > 20


def test_a_limb_through_the_cloth_is_seen_where_no_vertex_is_inside():
    cone = trimesh.creation.cone(0.01, 0.4)
    spike = rigid(cone.vertices, cone.faces)
    cloth, faces = square(6, 0.3, 0.2)  # its vertices are 12 cm apart, none at the spike
    inside = BodyTree(spike).signed_distance(cloth[None], STILL) < 0
    found = find_crossings(spike, faces, cloth[None], STILL)
    assert not inside.any()
    assert found.any == found.deep == 1
    pinned = np.ones(len(cloth), bool)
    assert find_crossings(spike, faces, cloth[None], STILL, pinned=pinned).any == 0


@pytest.mark.parametrize("depth", [0.02, 0.06, 0.09])
def test_the_leg_stays_under_the_cloth(depth):
    """The shortest way out of the lower half of the leg leads under it."""
    body = leg()
    cloth, faces = square(25, 0.3, 0.07 - depth)
    frame = cloth[None]
    assert find_crossings(body, faces, frame, STILL).any == 1
    push = OutwardPush(body, faces, len(cloth))
    out = push(frame, STILL).vertices
    assert find_crossings(body, faces, out, STILL).any == 0
    over = np.abs(cloth[:, 1]) < 0.03
    over &= np.abs(cloth[:, 0]) < 0.25
    assert out[0, over, 2].min() > 0.03
    # Far away, and what does not cross, stays.
    assert np.array_equal(out[0, 0], cloth[0])
    clear = cloth[None] + [0, 0, depth + 0.01]
    assert np.array_equal(push(clear, STILL).vertices, clear)


def test_what_cannot_be_freed_is_not_dragged_about(rng, monkeypatch):
    """Vertices that are held inside the leg cross it whatever the others do."""
    body = leg()
    cloth, faces = square(25, 0.3, 0.0)
    held = (np.abs(cloth[:, 1]) < 0.05) & (rng.random(len(cloth)) < 0.3)
    push, results = OutwardPush(body, faces, len(cloth), pinned=held), []
    for rounds in (1, 40):
        monkeypatch.setattr(outward, "_ROUNDS", rounds)
        results.append(push(cloth[None], STILL))
    one, many = results
    left = [find_crossings(body, faces, out.vertices, STILL).pairs for out in (one, many)]
    assert 0 < left[1] <= left[0]
    assert one.farthest <= many.farthest < 0.2
    over = ~held & (np.abs(cloth[:, 1]) < 0.03) & (np.abs(cloth[:, 0]) < 0.25)
    assert (many.vertices[0, over, 2] > 0).mean() > 0.9


def test_pinned_vertices_stay(rng):
    body = leg()
    cloth, faces = square(25, 0.3, 0.04)
    pinned = rng.random(len(cloth)) < 0.2
    push = OutwardPush(body, faces, len(cloth), pinned=pinned)
    out = push(cloth[None].repeat(2, 0), STILL.repeat(2, 0)).vertices
    assert np.array_equal(out[0, pinned], cloth[pinned])
    assert np.array_equal(out[0], out[1])
    before = ssdr.get_threads()
    try:
        ssdr.set_threads(3)
        many = push(cloth[None].repeat(20, 0), STILL.repeat(20, 0)).vertices
    finally:
        ssdr.set_threads(before)
    assert (many == out[0]).all()
