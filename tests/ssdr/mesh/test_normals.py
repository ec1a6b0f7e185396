"""Normals of a surface: means by angle, hard edges, seams, and triangles without an area."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import ssdr
from helpers import naive, surfaces
from helpers.rig_model import largest_distance, tube
from ssdr.mesh.normals import corner_normals, normal_holders, surface_normals


def test_hard_edges_stay_hard_and_smooth_ones_are_those_of_a_peer():
    model = tube()
    normals = corner_normals(model.rest, model.faces, model.surface)
    assert largest_distance(normals, model.surface.normals) < 0.02
    smooth = corner_normals(model.rest, model.faces, None)
    mesh = trimesh.Trimesh(model.rest, model.faces, process=False)
    peer = trimesh.geometry.weighted_vertex_normals(
        len(model.rest), mesh.faces, mesh.face_normals, mesh.face_angles
    )
    np.testing.assert_allclose(smooth, peer[model.faces], atol=1e-5)


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_every_frame_against_loops(rng, scale):
    frames, faces = surfaces.animation(noise=0.2)
    surface = ssdr.Surface(normals=rng.integers(0, 2, (len(faces), 3, 3)).astype(np.float32))
    holders = normal_holders(faces, frames.shape[1], surface)
    found = surface_normals(scale * frames, holders)
    for t, points in enumerate(frames):
        expected = naive.corner_normals(points, faces, holders.corner)
        np.testing.assert_allclose(found[t][holders.corner], expected, atol=1e-12)
    # corners share a normal where vertex and normal of the surface are equal, and only there
    rows = np.concatenate([faces[..., None], surface.normals], axis=2).reshape(-1, 4)
    same = (rows[:, None] == rows[None]).all(axis=2)
    corner = holders.corner.ravel()
    np.testing.assert_array_equal(corner[:, None] == corner[None], same)
    np.testing.assert_array_equal(holders.vertex[holders.corner], faces)


def test_a_triangle_without_area_does_not_count():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [0, 0, 0], [5, 5, 5]], float)
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 4, 2]])
    holders = normal_holders(faces, 6, None)
    found = surface_normals(points[None], holders)[0]
    np.testing.assert_array_equal(found[[0, 1, 2]], [[0, 0, 1]] * 3)
    np.testing.assert_array_equal(found[[3, 4, 5]], np.zeros((3, 3)))  # unknown
    at_corners = corner_normals(points, faces, None)
    np.testing.assert_array_equal(at_corners[1], [[0, 0, 1], [0, 0, 1], [0, 1, 0]])


def test_both_sides_of_a_sheet_keep_their_own_normals():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    normals = corner_normals(points, np.array([[0, 1, 2], [2, 1, 0]]), None)
    np.testing.assert_array_equal(normals, [[[0, 0, 1]] * 3, [[0, 0, -1]] * 3])


def test_copies_at_a_seam_have_one_normal_unless_the_edge_is_hard(seam):
    whole, _ = seam.weld()
    smooth = ssdr.Surface(normals=np.tile(np.float32([0, 0, 1]), (len(seam.faces), 3, 1)))
    places = np.concatenate(seam.frames(slice(0, 2)), axis=1)
    found = corner_of(seam, normal_holders(seam.faces, seam.n_vertices, smooth, places))
    expected = corner_of(whole, normal_holders(whole.faces, whole.n_vertices, None))
    np.testing.assert_allclose(found, expected, atol=1e-12)
    apart = corner_of(seam, normal_holders(seam.faces, seam.n_vertices, None))
    assert naive.angles(apart, expected).max() > 1
    hard = normal_holders(seam.faces, seam.n_vertices, seam.surface, places)
    np.testing.assert_array_equal(corner_of(seam, hard), apart)


def corner_of(sequence, holders):
    return surface_normals(sequence.vertices, holders)[:, holders.corner]
