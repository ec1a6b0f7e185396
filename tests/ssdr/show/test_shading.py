"""Pictures of models are lit as engines light them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.drawn import model_normals
from ssdr import show as render
from ssdr.mesh.normals import unit
from ssdr.show.subject import Scene

LOOK = {"size": (80, 80), "azimuth": 0.0, "elevation": 60.0}


def tilted(n_frames=2, degrees=30.0, flip=1.0):
    """A flat square that stands still, and a model of it whose rest normals are tilted."""
    square = np.array([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    truth = ssdr.MeshSequence(np.tile(square, (n_frames, 1, 1)), faces)
    angle = np.radians(degrees)
    normals = np.tile(np.float32([0, flip * np.cos(angle), np.sin(angle)]), (2, 3, 1))
    still = np.tile(np.eye(3, 4), (n_frames, 1, 1, 1))
    bones = np.zeros((4, 1), int), np.ones((4, 1)), still
    return truth, ssdr.Skinning(square, *bones, faces=faces, surface=ssdr.Surface(normals=normals))


@pytest.mark.parametrize("own", ["smooth", "hard", "none"])
def test_normals_are_those_of_the_rest_pose_turned_by_the_blended_matrices(model, own):
    if own == "hard":
        normals = model.surface.normals.copy()
        normals[::2] = np.float32([0, 0, 1])
        model = dataclasses.replace(model, surface=ssdr.Surface(normals=normals))
    model = dataclasses.replace(model, surface=None if own == "none" else model.surface)
    scene = Scene.of(model)
    assert (len(scene.vertex) > model.n_vertices) == (own == "hard")
    for frame in range(model.n_frames):
        drawn = unit(scene.normals(frame))[scene.faces]
        np.testing.assert_allclose(drawn, model_normals(model, frame), atol=2e-6)


def test_a_model_is_lit_by_its_rest_normals_and_a_sequence_by_its_surface():
    truth, answer = tilted(degrees=0)
    wrong = tilted(degrees=75)[1]
    inwards = tilted(degrees=0, flip=-1.0)[1]
    shown = [
        np.asarray(render.render_frame(subject, style="plain", **LOOK), dtype=int)[30:50, 30:50]
        for subject in (truth, answer, wrong, inwards)
    ]
    np.testing.assert_allclose(shown[1], shown[0], atol=1)
    for other in shown[2:]:
        assert np.abs(other - shown[0]).mean() > 15
    assert shown[3].mean() < shown[0].mean() - 15  # not turned to the viewer
