"""Drawn normals and folds of the smallest model, at hardly more bytes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import ssdr
from helpers.drawn import surface_normals
from ssdr.parsimony import pruning

DANCER = ssdr.samples.load("dancer_small")


def against(points: Any, faces: Any) -> Any:
    """Mask of triangles that point against the normals at their corners."""
    a, b, c = points[faces].astype(float).transpose(1, 0, 2)
    around = surface_normals(points, faces).sum(axis=1)
    return (np.cross(b - a, c - a) * around).sum(axis=1) < 0


@pytest.mark.slow
def test_normals_are_better_at_hardly_more_bytes() -> None:
    """At a tolerance that leaves room: the next number of bones is not a little below it."""
    plain = ssdr.smallest(DANCER, tolerance="2%", effort="fast", normals=False)
    found = ssdr.smallest(DANCER, tolerance="2%", effort="fast")
    assert found.parsimony.held
    assert found.parsimony.bones == plain.parsimony.bones
    assert found.parsimony.size.total <= 1.03 * plain.parsimony.size.total
    means = [ssdr.metrics.normals(DANCER, r.skinning).mean for r in (found, plain)]
    assert means[0] < 0.93 * means[1]


@pytest.mark.slow
def test_the_rest_pose_is_unfolded(monkeypatch: pytest.MonkeyPatch) -> None:
    faces = DANCER.faces
    own = np.any([against(points, faces) for points in DANCER.vertices], axis=0)

    def turned_over() -> int:
        found = ssdr.smallest(DANCER, tolerance="0.5%", effort="fast", rng=1)
        return int((against(found.skinning.rest, faces) & ~own).sum())

    assert turned_over() == 0
    monkeypatch.setattr(pruning, "unfold", lambda d, entering: None)
    assert turned_over() > 0
