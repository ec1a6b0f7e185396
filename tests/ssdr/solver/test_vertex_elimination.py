"""What is left of the normal equations without the vertices, against dense Jacobians."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.tiny import CASES, Tiny


@pytest.mark.parametrize("more", ["", "surface", "normals", "surface and normals"])
@pytest.mark.parametrize("case", [c for c in CASES if c not in ("joints", "motion alone")])
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
