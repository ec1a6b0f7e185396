"""Fitted rest normals: exact where the skinning is, and least squares elsewhere."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers import naive
from helpers.rig_model import tube
from ssdr.model.drawn_normals import drawn_angles, holders_of, with_fitted_normals


def blended(model):
    """Matrices (F, V, 3, 3) that engines turn a vertex's normal with."""
    dense = model.dense_weights().astype(np.float64)
    return np.einsum("vb,fbij->fvij", dense, model.transforms[..., :3])


def sequence_of(model, rng, noise=0.02):
    frames = model.skin() + noise * rng.normal(size=(model.n_frames, model.n_vertices, 3))
    return ssdr.MeshSequence(frames, model.faces, surface=model.surface)


@pytest.mark.parametrize("scaled", [False, True])
def test_normal_equations_against_a_dense_solver(rng, scaled):
    model = tube(rings=7, sides=6, scaled=scaled)
    sequence = sequence_of(model, rng)
    found = with_fitted_normals([sequence], model).surface.normals
    turns, corners = blended(model), holders_of(sequence).corner
    targets = np.stack([naive.corner_normals(x, model.faces, corners) for x in sequence.vertices])
    own = naive.corner_normals(model.rest, model.faces, corners)
    for k, face in enumerate(model.faces):
        for c, i in enumerate(face):
            design, right = turns[:, i].reshape(-1, 3), targets[:, k, c].reshape(-1)
            pull = np.sqrt(0.06 * (design**2).sum())
            design = np.concatenate([design, pull * np.eye(3)])
            right = np.concatenate([right, pull * own[k, c]])
            n = np.linalg.lstsq(design, right, rcond=None)[0]
            np.testing.assert_allclose(found[k, c], n / np.linalg.norm(n), atol=1e-6)


def test_shots_and_spans_do_not_matter(rng):
    model = tube(frames=70, rings=7, sides=6)
    sequence = sequence_of(model, rng)
    shots = [
        dataclasses.replace(sequence, vertices=part)
        for part in (sequence.vertices[:33], sequence.vertices[33:])
    ]
    whole, parts = with_fitted_normals([sequence], model), with_fitted_normals(shots, model)
    np.testing.assert_allclose(whole.surface.normals, parts.surface.normals, atol=1e-7)
    one, two = drawn_angles([sequence], whole), drawn_angles(shots, whole)
    np.testing.assert_allclose(one[1].frame_sum, two[1].frame_sum, rtol=1e-9)
    assert one[1].frame_sum.shape == (70,)


def test_unknown_normals_are_left_out_of_the_fit(rng):
    model = tube(rings=7, sides=6)
    sequence = sequence_of(model, rng, noise=0)
    frames = sequence.vertices.copy()
    frames[5:] = frames[5:, :1]  # collapsed to a point
    some = dataclasses.replace(sequence, vertices=frames)
    few = dataclasses.replace(
        model, transforms=model.transforms[:5], clips=None, keyframes=None, fps=24.0
    )
    kept = dataclasses.replace(sequence, vertices=frames[:5])
    expected = with_fitted_normals([kept], few).surface.normals
    found = with_fitted_normals([some], model)
    np.testing.assert_allclose(found.surface.normals, expected, atol=1e-6)
    _, angles, _ = drawn_angles([some], found)
    assert (angles.frame_count[5:] == 0).all()
    assert (angles.frame_count[:5] == len(holders_of(some).vertex)).all()
    none = dataclasses.replace(sequence, vertices=np.zeros_like(frames))
    geometric = naive.corner_normals(model.rest, model.faces, holders_of(sequence).corner)
    unfitted = with_fitted_normals([none], model).surface.normals
    np.testing.assert_allclose(unfitted, geometric, atol=1e-6)


def test_a_model_of_other_triangles_keeps_them(rng):
    model = tube(rings=5, sides=5)
    sequence = sequence_of(model, rng)
    fewer = dataclasses.replace(model, faces=model.faces[::2], surface=None)
    plain = ssdr.MeshSequence(sequence.vertices, fewer.faces)
    found, expected = (with_fitted_normals([x], fewer).surface for x in (sequence, plain))
    np.testing.assert_array_equal(found.normals, expected.normals)


def test_long_sequences_are_measured_in_part(rng):
    model = tube(frames=60, rings=5, sides=5)
    sequence = sequence_of(model, rng)
    frames, drawn, _ = drawn_angles([sequence], model, most=24)
    np.testing.assert_array_equal(frames, [*range(8), *range(26, 34), *range(52, 60)])
    _, every, _ = drawn_angles([sequence], model)
    np.testing.assert_allclose(drawn.frame_sum, every.frame_sum[frames], rtol=1e-12)


def test_copies_at_a_smooth_seam_get_one_normal(seam):
    smooth = ssdr.Surface(normals=np.tile(np.float32([0, 0, 1]), (len(seam.faces), 3, 1)))
    sequence = dataclasses.replace(seam, surface=smooth)
    normals = ssdr.decompose(sequence, bones=2, effort="fast").skinning.surface.normals
    places = np.concatenate(list(seam.vertices), axis=1)
    vertex = np.unique(places, axis=0, return_inverse=True)[1].ravel()[seam.faces].ravel()
    for k in range(15):
        assert np.ptp(normals.reshape(-1, 3)[vertex == k], axis=0).max() < 1e-6
