"""Corners: seams are split."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ssdr.io.corners import split_corners


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_split_corners_is_the_inverse_of_its_map(seed):
    rng = np.random.default_rng(seed)
    faces = rng.integers(0, 9, size=(14, 3)).astype(np.int32)
    uv = rng.integers(0, 2, size=(14, 3, 2)).astype(np.float32)
    normals = rng.integers(0, 2, size=(14, 3, 3)).astype(np.float32)
    split = split_corners(faces, 9, uv, normals)
    np.testing.assert_array_equal(split.vertex[:9], np.arange(9))
    np.testing.assert_array_equal(split.vertex[split.faces], faces)
    np.testing.assert_array_equal(split.uv[split.faces], uv)
    np.testing.assert_array_equal(split.normals[split.faces], normals)
    rows = {
        (v, *u, *n)
        for v, u, n in zip(faces.ravel(), uv.reshape(-1, 2), normals.reshape(-1, 3), strict=True)
    }
    unused = 9 - len(set(faces.ravel()))
    assert len(split.vertex) == len(rows) + unused
