"""Shapes for what bones leave: by a threshold, by components, and where bones do better."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.rig_model import tube


def exact(count=2, frames=20):
    """Model without shapes, and the vertices of the same with smooth shapes."""
    model, rng = tube(frames=frames), np.random.default_rng(1)
    y = model.rest[:, 1]
    moved = np.stack([np.sin((k + 1) * y)[:, None] * [0.1, 0.02 * k, 0.1] for k in range(count)])
    shapes = ssdr.Shapes(moved, rng.random((frames, count)))
    return model, dataclasses.replace(model, shapes=shapes).skin()


def test_expressions_by_a_threshold():
    """The expression's own amount is 1: a displacement takes a vertex to its place, or is 0."""
    rng = np.random.default_rng(0)
    model = tube(frames=8)
    off = rng.normal(0, 0.02, (8, model.n_vertices, 3))
    off[0] = 0
    vertices, amounts = model.skin() + off, np.eye(8)[:, 1:]
    fit = ssdr.fit_shapes(vertices, model, tolerance=0.03, amounts=amounts)
    far = np.linalg.norm(off[1:], axis=2) > 0.03
    np.testing.assert_array_equal(fit.skinning.shapes.moved, far)
    assert fit.displaced == far.sum()
    gap = np.linalg.norm(fit.skinning.skin() - vertices, axis=2)
    assert gap[1:][far].max() < 1e-8
    np.testing.assert_allclose(gap[1:][~far], np.linalg.norm(off[1:], axis=2)[~far], atol=1e-12)
    assert fit.max_error == pytest.approx(gap.max())
    assert fit.rmse == pytest.approx(np.sqrt((gap**2).mean()))
    np.testing.assert_array_equal(fit.skinning.rest, model.rest)


def test_amounts_of_several_shapes_in_a_frame():
    """The least squares of all frames, where each vertex has the shapes of frames it is far in."""
    model, vertices = exact()
    truth = dataclasses.replace(model, shapes=None)
    amounts = np.random.default_rng(1).random((20, 2))
    fit = ssdr.fit_shapes(vertices, truth, tolerance=1e-9, amounts=amounts, names=["a", "b"])
    assert fit.rmse < 1e-7
    assert fit.skinning.shapes.names == ("a", "b")


def test_components_are_found_again():
    model, vertices = exact()
    fit = ssdr.fit_shapes(vertices, model, shapes=2)
    assert fit.worth > 1
    assert fit.rmse < 1e-4 * np.sqrt(((model.skin() - vertices) ** 2).sum(axis=2).mean())
    amounts = fit.skinning.shapes.amounts
    assert amounts.min() >= 0
    assert amounts.max() <= 1
    few = ssdr.fit_shapes(vertices, model, tolerance=0.01)
    assert few.rmse <= 0.01
    assert few.skinning.n_shapes == 2
    held = ssdr.fit_shapes(vertices, model, tolerance="50%")
    assert held.skinning.shapes is None


def test_no_shapes_where_bones_do_better():
    """Rigid parts that too few bones move: a shape takes the bytes of many bones."""
    model = tube(frames=6, bones=5, rings=60, influences=1)
    vertices = model.skin()
    few = ssdr.decompose(vertices, model.faces, bones=3, effort="fast").skinning
    fit = ssdr.fit_shapes(vertices, few, shapes=1)
    assert fit.skinning.shapes is None
    assert fit.worth < 1
    assert fit.rmse == pytest.approx(np.sqrt(((few.skin() - vertices) ** 2).sum(axis=2).mean()))


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({}, "tolerance: expected either"),
        ({"tolerance": 1, "shapes": 1}, "tolerance: expected either"),
        ({"amounts": np.ones((20, 1))}, "tolerance: expected one"),
        ({"amounts": np.ones((19, 1)), "tolerance": 1}, r"amounts: expected shape \(20, S\)"),
        ({"amounts": np.full((20, 1), np.nan), "tolerance": 1}, "amounts: expected finite"),
        ({"amounts": np.ones((20, 2)), "tolerance": 1, "names": ["a"]}, "2 names"),
        ({"amounts": np.ones((20, 10_000)), "tolerance": 1}, "amounts: expected .*no more than"),
        ({"shapes": 10_000}, "shapes: expected .*20"),
        ({"tolerance": -1}, "tolerance: expected a length > 0"),
    ],
)
def test_refusals(options, match):
    model, vertices = exact()
    with pytest.raises(ssdr.InputError, match=match):
        ssdr.fit_shapes(vertices, model, **options)


def test_models_that_do_not_fit():
    model, vertices = exact()
    with pytest.raises(ssdr.InputError, match="253 vertices"):
        ssdr.fit_shapes(vertices[:, 1:], model, shapes=1)
    with pytest.raises(ssdr.InputError, match="transforms"):
        ssdr.fit_shapes(vertices[1:], model, shapes=1)
    with pytest.raises(ssdr.InputError, match="skinning: expected a Skinning"):
        ssdr.fit_shapes(vertices, model.rest, shapes=1)
