"""CHOLMOD: missing, or of a newer interface."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from helpers.surfaces import sphere
from ssdr import MissingDependencyError
from ssdr.laplacian.smoothing import LaplacianSmoother


def test_missing_cholmod(monkeypatch):
    monkeypatch.setitem(sys.modules, "sksparse", None)
    vertices, faces = sphere(1)
    assert LaplacianSmoother(vertices, faces, 0.1).backend == "scipy"
    with pytest.raises(MissingDependencyError, match=r"pip install .scikit-sparse"):
        LaplacianSmoother(vertices, faces, 0.1, backend="cholmod")


def test_newer_cholmod_interface(monkeypatch):
    calls = []

    def cho_factor(matrix):
        calls.append(matrix.format)
        return SimpleNamespace(solve=splu(matrix).solve)

    module = SimpleNamespace(cho_factor=cho_factor, CholmodError=ArithmeticError)
    monkeypatch.setitem(sys.modules, "sksparse", SimpleNamespace(cholmod=module))
    vertices, faces = sphere(1)
    smoother = LaplacianSmoother(vertices, faces, 0.1, backend="cholmod")
    expected = LaplacianSmoother(vertices, faces, 0.1, backend="scipy").smooth(vertices)
    np.testing.assert_allclose(smoother.smooth(vertices), expected, atol=1e-13)
    assert calls == ["csc"]
