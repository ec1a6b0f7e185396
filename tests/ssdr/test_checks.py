"""Arguments: what a tolerance may be, and what errors tell to do about arrays."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions
from ssdr.common.checks import check_transforms, parse_normals, parse_tolerance


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.5%", 0.02),
        (" 1 % ", 0.04),
        ("2e-1%", 0.008),
        (0.3, 0.3),
        (np.float32(0.25), 0.25),
        (2, 2),
    ],
)
def test_tolerances(text: Any, expected: float) -> None:
    assert parse_tolerance(text, 4.0) == pytest.approx(expected)
    assert parse_normals(text, lambda: 4.0) == pytest.approx(expected)


def test_normals_are_solved_or_not_or_beside_a_length() -> None:
    assert [parse_normals(x) for x in (True, np.True_, False)] == [0.0, 0.0, None]
    with pytest.raises(ssdr.InputError, match="normals: expected True, False, a length"):
        parse_normals("no")


CHAIN = motions.chain(bones=3)
SIZED = CHAIN.transforms * np.array([1.25, 1.25, 1.25, 1.0])
STRETCHED = CHAIN.transforms @ np.diag([1.25, 1.0, 1.0, 1.0])


def square(transforms: np.ndarray) -> np.ndarray:
    """Transforms as 4×4 matrices."""
    last = np.broadcast_to([0, 0, 0, 1.0], (*transforms.shape[:2], 1, 4))
    return np.concatenate([transforms, last], axis=2)


def refusal(call: Callable[[], Any]) -> str:
    with pytest.raises(ssdr.InputError) as caught:
        call()
    return str(caught.value)


def test_matrices_of_another_shape_are_refused_with_the_way_out() -> None:
    parts = CHAIN.rest, CHAIN.indices, CHAIN.weights
    m, rows = square(CHAIN.transforms), np.swapaxes(CHAIN.transforms, -1, -2)

    for call in (functools.partial(ssdr.skin, *parts), functools.partial(ssdr.Skinning, *parts)):
        said = [refusal(functools.partial(call, given)) for given in (m, rows)]
        assert "(of 4×4 matrices for column vectors pass m[..., :3, :])" in said[0]
        assert "(of matrices for row vectors pass np.swapaxes(m, -1, -2))" in said[1]
    assert np.array_equal(ssdr.skin(*parts, m[..., :3, :]), ssdr.skin(*parts, CHAIN.transforms))
    assert "(of" not in refusal(lambda: ssdr.skin(*parts, m[0, 0]))


def test_quads_are_refused_with_the_way_out() -> None:
    q = np.array([[0, 1, 2, 3], [3, 2, 4, 5]])
    said = refusal(lambda: ssdr.MeshSequence(np.zeros((2, 6, 3)), q))
    way = re.search(r"of quads q pass (.*)\), got", said)
    assert way is not None
    triangles = eval(way[1], {"np": np, "q": q})  # what the error says, as a reader would type it
    assert len(ssdr.MeshSequence(np.zeros((2, 6, 3)), triangles).faces) == 4
    corners = {frozenset(t) for t in triangles.tolist()}
    assert corners == {frozenset(t) for t in ([0, 1, 2], [0, 2, 3], [3, 2, 4], [3, 4, 5])}
    assert "(of" not in refusal(lambda: ssdr.MeshSequence(np.zeros((2, 6, 3)), np.zeros((2, 5))))


def test_a_frame_alone_and_weights_of_all_bones_are_refused_with_the_way_out() -> None:
    assert "(of a single frame pass frame[None])" in refusal(lambda: ssdr.MeshSequence(CHAIN.rest))
    dense = CHAIN.skinning.dense_weights()
    said = refusal(lambda: ssdr.Skinning(CHAIN.rest, None, dense, CHAIN.transforms))
    assert "(of weights (V, B) of all bones: Skinning.from_dense)" in said


@pytest.mark.parametrize(
    ("transforms", "given", "named"),
    [
        (SIZED, "rigid", "similarity"),
        (STRETCHED, "rigid", "affine"),
        (STRETCHED, "similarity", "affine"),
    ],
)
def test_scaled_bones_are_refused_with_the_bone_model_that_takes_them(
    transforms: np.ndarray, given: Any, named: Any
) -> None:
    with pytest.raises(ssdr.InputError, match=f'\\(bone_model="{named}" allows them\\)') as caught:
        check_transforms(transforms, len(transforms), given)
    assert caught.value.argument == "transforms"
    if named == "similarity":
        assert "scales from 1.25 to 1.25" in str(caught.value)
    np.testing.assert_allclose(check_transforms(transforms, len(transforms), named), transforms)
