"""What a tolerance may be, and what an error tells to do about quads."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import ssdr
from ssdr.common.checks import parse_normals, parse_tolerance


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


def test_quads_are_refused_with_the_way_out() -> None:
    q = np.array([[0, 1, 2, 3], [3, 2, 4, 5]])
    with pytest.raises(ssdr.InputError) as caught:
        ssdr.MeshSequence(np.zeros((2, 6, 3)), q)
    way = re.search(r"of quads q pass (.*)\), got", str(caught.value))
    assert way is not None
    triangles = eval(way[1], {"np": np, "q": q})  # what the error says, as a reader would type it
    corners = {frozenset(t) for t in triangles.tolist()}
    assert corners == {frozenset(t) for t in ([0, 1, 2], [0, 2, 3], [3, 2, 4], [3, 4, 5])}
