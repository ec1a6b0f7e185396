"""Errors of normals, as engines draw them, against loops and by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers import naive, surfaces
from helpers.rig_model import tube
from ssdr.model.drawn_normals import holders_of


def test_every_field_against_loops(rng):
    model = tube(rings=9, sides=8)
    frames = model.skin() + 0.03 * rng.normal(size=(20, model.n_vertices, 3))
    reference = ssdr.MeshSequence(frames, model.faces, surface=model.surface)
    holders, dense = holders_of(reference), model.dense_weights()
    rest = {}
    for face, normals in zip(holders.corner, model.surface.normals, strict=True):
        rest |= dict(zip(face.tolist(), normals, strict=True))
    angles, own = np.zeros((2, 20, len(holders.vertex)))
    for t in range(20):
        there = naive.corner_normals(frames[t], model.faces, holders.corner)
        posed = naive.corner_normals(model.skin()[t], model.faces, holders.corner)
        for k, c in np.ndindex(holders.corner.shape):
            h, i = holders.corner[k, c], model.faces[k, c]
            turn = np.einsum("b,bij->ij", dense[i], model.transforms[t, :, :, :3])
            angles[t, h] = naive.angles(turn @ rest[h], there[k, c])
            own[t, h] = naive.angles(posed[k, c], there[k, c])
    found = ssdr.metrics.normals(reference, model)
    assert found.mean == pytest.approx(angles.mean(), rel=1e-6)
    assert found.surface == pytest.approx(own.mean(), rel=1e-6)
    assert found.max == pytest.approx(angles.max(), rel=1e-6)
    assert found.p95 == pytest.approx(np.percentile(angles, 95), abs=0.03)
    assert found.beyond_20 == pytest.approx((angles > 20).mean(), abs=1e-3)
    assert found.inwards == pytest.approx((angles > 90).mean(), abs=1e-3)
    np.testing.assert_allclose(found.per_frame, angles.mean(axis=1), rtol=1e-6)
    for i in range(model.n_vertices):
        here = angles[:, holders.vertex == i]
        assert found.per_vertex[i] == pytest.approx(here.mean(), rel=1e-6)
    np.testing.assert_array_equal(found.frames, np.arange(20))


def test_a_turned_copy_has_one_angle():
    frames, faces = surfaces.animation()
    c, s = np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    flat = np.array([[[0, 0, 0], [1, 0, 0], [1, 0, 1]]], float)
    one = ssdr.metrics.normals(flat, flat @ turn, [[0, 1, 2]])
    assert one.mean == one.max == pytest.approx(np.degrees(0.5))
    assert one.p95 == pytest.approx(np.degrees(0.5), abs=0.01)
    assert (one.beyond_20, one.inwards, one.surface) == (1, 0, None)
    over = ssdr.metrics.normals(flat, flat, [[0, 1, 2]])
    assert (over.mean, over.max, over.p95) == (0, 0, 0)
    back = ssdr.metrics.normals(flat, flat * [1, 1, -1], [[0, 1, 2]])
    assert (back.inwards, back.max) == (1, 180)
    assert 0 < ssdr.metrics.normals(frames, frames @ turn, faces).mean <= np.degrees(0.5)


def test_a_skinning_without_normals_is_drawn_by_those_of_its_rest_pose(rng):
    model = tube()
    plain = dataclasses.replace(model, surface=None)
    reference = ssdr.MeshSequence(model.skin(), model.faces)
    geometric = naive.corner_normals(model.rest, model.faces).astype(np.float32)
    given = dataclasses.replace(model, surface=ssdr.Surface(normals=geometric))
    one, two = (ssdr.metrics.normals(reference, m) for m in (plain, given))
    assert one.mean == pytest.approx(two.mean, rel=1e-5)
    assert one.surface < 1e-4 < one.mean
