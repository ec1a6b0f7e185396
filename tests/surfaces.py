"""When two sequences are the same."""

from __future__ import annotations

import dataclasses

import numpy as np


def same_sequence(a, b, *, strict=True):
    np.testing.assert_array_equal(a.vertices[:], b.vertices[:], strict=strict)
    np.testing.assert_array_equal(a.faces, b.faces, strict=True)
    assert a.fps == b.fps


def same_surface(a, b):
    for field in ("uv", "normals", "material_index"):
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field), strict=True)
    assert [dataclasses.asdict(m) for m in a.materials] == [
        dataclasses.asdict(m) for m in b.materials
    ]
