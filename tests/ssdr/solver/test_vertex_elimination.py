"""What is left of the normal equations without the vertices, against dense Jacobians."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.tiny import CASES, Tiny
from ssdr.solver import vertex_elimination

MORE = ["", "surface", "normals", "surface and normals"]
OF_BONES = [c for c in CASES if c not in ("joints", "motion alone")]


@pytest.fixture(autouse=True)
def exact_rest_positions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Solve rest positions together to the end."""
    for name in ("_ROUGH", "_ACCURATE"):
        monkeypatch.setattr(vertex_elimination, name, (300, 1e-9))


@pytest.mark.parametrize("more", MORE)
@pytest.mark.parametrize("case", OF_BONES)
def test_products_are_those_of_the_dense_schur_complement(case: str, more: str) -> None:
    tiny = Tiny(case=case, more=more)
    _, j_m, j_v = tiny.jacobians()
    x = np.random.default_rng(1).standard_normal(tiny.unknowns)
    tangent = tiny.newton.tangent
    got = tangent.pullback(tiny.newton._reduced().times(tangent.image(tiny.shaped(x)))).ravel()
    want = j_m.T @ (j_m @ x)
    if j_v.shape[1]:
        want -= j_m.T @ j_v @ np.linalg.solve(j_v.T @ j_v, j_v.T @ (j_m @ x))
    np.testing.assert_allclose(got, want, atol=1e-4 * np.abs(want).max())


@pytest.mark.parametrize("more", MORE)
@pytest.mark.parametrize("case", OF_BONES)
def test_vertices_answer_best(case: str, more: str) -> None:
    """Given the bones' step, v = -(JvᵀJv)⁻¹ Jvᵀ (r + Jm x)."""
    tiny = Tiny(case=case, more=more)
    r, j_m, j_v = tiny.jacobians()
    x = 0.01 * np.random.default_rng(1).standard_normal(tiny.unknowns)
    step = tiny.newton._reduced().best_step(tiny.newton.tangent.image(tiny.shaped(x)))
    got = np.zeros(j_v.shape[1])
    slot: dict[int, int] = {}
    for k, (i, _) in enumerate(tiny.freedoms()):
        got[k] = -step[i, slot.get(i, 0)]
        slot[i] = slot.get(i, 0) + 1
    want = np.zeros(0)
    if j_v.shape[1]:
        want = -np.linalg.solve(j_v.T @ j_v, j_v.T @ (r + j_m @ x))
    np.testing.assert_allclose(got, want, atol=1e-5 * max(np.abs(want).max(initial=0), 1e-3))
    for i in range(tiny.n):
        assert (step[i, slot.get(i, 0) :] == 0).all()
