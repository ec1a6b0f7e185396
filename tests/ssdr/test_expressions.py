"""Expressions of a face as clips whose bones are linear in their weights."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.glb import opened
from helpers.rig_model import largest_distance, tube
from helpers.surfaces import sphere
from ssdr.expressions import displaced

BALL = sphere(3)


def ball():
    """A ball, what three expressions add to it, and its triangles."""
    rest, faces = BALL

    def spot(x, y):
        far = np.linalg.norm(rest - np.array([x, y, 0.8]), axis=1)
        return np.exp(-((far / 0.4) ** 2))[:, None]

    moved = {
        "jaw": 0.3 * spot(0, -0.6) * [0, -1, 0.2],
        "smile": 0.2 * (spot(0.5, 0) + spot(-0.5, 0)) * [0, 1, 0],
        "blink": 0.1 * spot(0.3, 0.5) * [0, -1, 0],
    }
    return rest, moved, faces


@pytest.fixture(scope="module")
def made():
    rest, moved, faces = ball()
    shapes = {name: rest + d for name, d in moved.items()}
    return ssdr.decompose_expressions(
        rest, shapes, faces=faces, bones=4, influences=2, tolerance=0.01
    )


def test_names_clips_and_error(made):
    rest, moved, _ = ball()
    model = made.skinning
    assert made.names == ("jaw", "smile", "blink")
    assert [c.name for c in model.clips] == ["jaw", "smile", "blink"]
    truth = np.stack([rest + d for d in moved.values()])
    np.testing.assert_array_equal(model.skinning.rest, rest)
    np.testing.assert_allclose(model.skin()[::2], np.stack([rest] * 3), atol=1e-12)
    gap = np.linalg.norm(model.skin()[1::2] - truth, axis=2)
    assert gap.max() == pytest.approx(made.max_error, rel=1e-6)
    assert gap.max() <= 0.01 * (1 + 1e-9)
    assert made.rmse == pytest.approx(np.sqrt((gap**2).mean()), rel=1e-6)
    assert made.displaced == model.shapes.moved.sum() > 0
    # displaced is what bones alone leave beyond the tolerance
    alone = model.skinning.skin()[1::2]
    assert made.displaced == (np.linalg.norm(alone - truth, axis=2) > 0.01).sum()
    # a part that an expression does not need stands still, exactly
    still = (model.skinning.transforms[1::2] == np.eye(3, 4)).all(axis=(2, 3))
    assert still.any()


def test_expressions_add(made):
    """Bones add exactly; displacements also turn with the bones of other expressions."""
    rest, moved, _ = ball()
    weights = np.array([[1, 0, 0], [1, 1, 0], [0.5, 0.2, 1], [0, 0, 0]])
    driven = ssdr.drive(made, weights)
    exact = rest + np.tensordot(weights, np.stack(list(moved.values())), 1)
    none = ssdr.Shapes(np.zeros((0, len(rest), 3)), np.zeros((6, 0)))
    bones = dataclasses.replace(made.skinning, shapes=none)
    each = bones.skin()[1::2] - rest
    added = rest + np.tensordot(weights, each, 1)
    np.testing.assert_allclose(ssdr.drive(bones, weights).skin(), added, atol=1e-12)
    assert largest_distance(driven.skin(), exact) < 2 * made.max_error
    np.testing.assert_allclose(driven.skin()[3], rest, atol=1e-12)
    assert driven.n_frames == 4


def test_files_play_the_expressions(made, tmp_path):
    for name in ("a.npz", "a.glb"):
        ssdr.save(made.skinning, tmp_path / name)
        back = ssdr.load_skinning(tmp_path / name)
        assert [c.name for c in back.clips] == list(made.names)
        assert largest_distance(back.skin(), made.skinning.skin()) < 1e-5
        assert back.driven
        weights = np.full((1, 3), 0.5)
        both = (ssdr.drive(x, weights).skin() for x in (back, made))
        assert largest_distance(*both) < 1e-5
    resampled = ssdr.load_skinning(tmp_path / "a.glb", fps=3 * back.fps)
    assert not resampled.driven  # more than two frames a clip
    document, _ = opened(tmp_path / "a.glb")
    moved = [len(one["channels"]) for one in document["animations"]]
    still = (made.skinning.skinning.transforms[1::2] == np.eye(3, 4)).all(axis=(2, 3)).sum(axis=1)
    assert moved == [2 * (4 - n) + 1 for n in still]  # bones at rest have no keys


def test_a_face_of_bones_alone_is_read_as_one(made, tmp_path):
    none = ssdr.Shapes(np.zeros((0, made.skinning.n_vertices, 3)), np.zeros((6, 0)))
    bones = dataclasses.replace(made.skinning, shapes=none)
    back = ssdr.load_skinning(ssdr.save(bones, tmp_path / "a.glb").path)
    weights = np.full((1, 3), 0.5)
    moved = (ssdr.drive(x, weights).skin() for x in (back, bones))
    assert largest_distance(*moved) < 1e-5


def test_from_the_shapes_of_a_file(made, tmp_path):
    rest, moved, faces = ball()
    amounts = np.zeros((1, 3))
    shapes = ssdr.Shapes(np.stack(list(moved.values())), amounts, names=list(moved))
    one = np.ones((len(rest), 1)), np.eye(3, 4)[None, None]
    rig = ssdr.ShapedSkinning(ssdr.Skinning.from_dense(rest, *one, faces=faces), shapes)
    ssdr.save(rig, tmp_path / "rig.glb")
    read = ssdr.load_skinning(tmp_path / "rig.glb")
    again = ssdr.decompose_expressions(read, bones=4, influences=2, tolerance=0.01)
    assert again.names == made.names
    assert again.max_error <= 0.01 * (1 + 1e-6)


def test_without_a_tolerance():
    rest, moved, faces = ball()
    face = ssdr.MeshSequence(rest[None], faces)
    found = ssdr.decompose_expressions(face, rest + np.stack(list(moved.values())), bones=3)
    assert len(found.skinning.shapes) == 0
    assert found.skinning.driven
    assert found.names == ("expression_0", "expression_1", "expression_2")


def test_displacements_by_a_threshold():
    """The expression's own amount is 1: a displacement takes a vertex to its place, or is 0."""
    rng = np.random.default_rng(0)
    model = tube(frames=8)
    off = rng.normal(0, 0.02, (8, model.n_vertices, 3))
    off[0] = 0
    vertices, amounts = model.skin() + off, np.eye(8)[:, 1:]
    found = displaced(model, vertices, amounts, 0.03)
    far = np.linalg.norm(off[1:], axis=2) > 0.03
    np.testing.assert_array_equal(found.shapes.moved, far)
    gap = np.linalg.norm(found.skin() - vertices, axis=2)
    assert gap[1:][far].max() < 1e-8
    np.testing.assert_allclose(gap[1:][~far], np.linalg.norm(off[1:], axis=2)[~far], atol=1e-12)
    np.testing.assert_array_equal(found.skinning.rest, model.rest)


def test_amounts_of_several_shapes_in_a_frame():
    """The least squares of all frames, where each vertex has the shapes of frames it is far in."""
    model, rng = tube(frames=20), np.random.default_rng(1)
    y = model.rest[:, 1]
    moved = np.stack([np.sin((k + 1) * y)[:, None] * [0.1, 0.02 * k, 0.1] for k in range(2)])
    amounts = rng.random((20, 2))
    vertices = ssdr.ShapedSkinning(model, ssdr.Shapes(moved, amounts)).skin()
    found = displaced(model, vertices, amounts, 1e-9, ["a", "b"])
    assert np.sqrt(((found.skin() - vertices) ** 2).sum(axis=2).mean()) < 1e-7
    assert found.shapes.names == ("a", "b")
