"""A run with effort `best`: no worse than `balanced`, whatever bones it starts from."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr


def beam(frames: int, rings: int) -> tuple[np.ndarray, np.ndarray]:
    """A smooth motion of few vertices: a bar that bends while waves run along it."""
    rest = np.array([[x, y, z] for x in np.linspace(0, 4, rings) for y in (0, 1) for z in (0, 1)])
    out = []
    for t in range(frames):
        angle = 0.1 * np.sin(0.7 * t) * rest[:, 0] + 0.1 * np.cos(0.3 * t)
        c, s = np.cos(angle), np.sin(angle)
        wave = rest[:, 2] + 0.2 * np.sin(t + rest[:, 0])
        out.append(
            np.stack([c * rest[:, 0] - s * rest[:, 1], s * rest[:, 0] + c * rest[:, 1], wave], 1)
        )
    return np.array(out), rest


@pytest.mark.parametrize(
    ("frames", "rings", "options"),
    [
        (8, 14, {"bones": 6}),
        (20, 8, {"bones": 4, "influences": 2}),
        (15, 10, {"bones": 4, "influences": 1}),
        (10, 12, {"bones": 5, "rest": True}),
        (6, 7, {"bones": 25, "influences": 1}),
    ],
)
def test_best_is_no_worse_than_balanced(
    frames: int, rings: int, options: dict[str, object]
) -> None:
    """The quick start alone ended at two to eight times its error here."""
    moving, rest = beam(frames, rings)
    options = options | ({"rest": rest} if "rest" in options else {})
    balanced, best = (
        ssdr.decompose(moving, effort=effort, **options).rmse for effort in ("balanced", "best")
    )
    assert best < 1.05 * balanced + 1e-11  # of a beam of length four: rounding


def test_bones_that_are_given_and_not_locked_are_no_more_than_a_start() -> None:
    moving, rest = beam(10, 12)
    poor = np.repeat(ssdr.kabsch(rest, moving)[:, None], 5, axis=1)
    free = ssdr.decompose(moving, bones=5).rmse
    given = ssdr.decompose(moving, bones=5, transforms=poor, locked_bones=[]).rmse
    assert given < 4 * free  # both end anywhere between 2e-4 and 7e-4 of a length of 4
    kept = ssdr.decompose(moving, bones=5, transforms=poor[:, :2], locked_bones=[1])
    assert np.allclose(kept.skinning.transforms[:, 1], poor[:, 1], atol=1e-9)
