"""Tangents: image, pullback and move belong together; preconditioners and damping."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.stretches import check_kind
from helpers.tiny import KINDS, TREES, Tiny


@pytest.fixture(params=[*KINDS, *TREES])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def _cases(kind: str) -> list[str]:
    return ["free"] if kind in KINDS else ["free", "joints"]


def test_image_pullback_and_move_belong_together(kind: str, rng: np.random.Generator) -> None:
    for case in _cases(kind):
        tiny = Tiny(kind, case)
        tangent, model = tiny.newton.tangent, tiny.model
        x = tiny.shaped(rng.standard_normal(tiny.unknowns))
        g = rng.standard_normal((3 * tiny.frames, 4 * tiny.bones))
        back = tangent.pullback(g)
        assert back.shape == x.shape
        ends = []
        for sign in (1e-6, -1e-6):
            trial = model.copy()
            tangent.move(trial, sign * x)
            np.testing.assert_allclose(trial.transforms, tiny.moved(sign * x.ravel()), atol=1e-11)
            check_kind(trial.transforms, tiny.constraints.bone_model)
            ends.append(tiny.data.stack(trial.transforms))
        for precision, rounding in ((tangent.precision, 1e-6), (np.float64, 1e-12)):
            tangent.precision = precision
            image = tangent.image(x)
            assert np.vdot(image, g) == pytest.approx(np.vdot(x, back), rel=rounding)
        np.testing.assert_allclose(image, (ends[0] - ends[1]) / 2e-6, atol=1e-7)


def test_a_large_step_keeps_the_bone_model(kind: str, rng: np.random.Generator) -> None:
    tiny = Tiny(kind)
    trial = tiny.model.copy()
    tiny.newton.tangent.move(trial, tiny.shaped(rng.standard_normal(tiny.unknowns)))
    check_kind(trial.transforms, tiny.constraints.bone_model)


def test_the_preconditioner_is_symmetric_and_positive(kind: str) -> None:
    for case in _cases(kind):
        tiny = Tiny(kind, case)
        u = tiny.newton._reduced().u
        precondition, _ = tiny.newton.tangent.precondition(u, 1e-3)
        matrix = np.stack([precondition(tiny.shaped(e)).ravel() for e in np.eye(tiny.unknowns)])
        scale = np.sqrt(np.abs(np.diag(matrix)))
        matrix = matrix / scale[:, None] / scale
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-9)
        assert np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).min() > 0


@pytest.mark.parametrize("kind", ["rigid", *TREES])
def test_damping_is_the_diagonal_of_the_bones(kind: str) -> None:
    """Averaged over frames along a chain, whose diagonal differs from frame to frame."""
    for case in ("free", "joints") if kind in TREES else ("free",):
        tiny = Tiny(kind, case)
        _, j_m, _ = tiny.jacobians()
        diagonal = tiny.shaped((j_m**2).sum(axis=0))
        tangent = tiny.newton.tangent
        _, damp = tangent.precondition(tiny.newton._reduced().u, 1.0)
        got = damp(np.ones_like(diagonal))
        if kind in TREES:
            (frames, joints), (own, own_joints) = tangent.parts(diagonal), tangent.parts(got)
            frames[:] = frames.mean(axis=0)
            np.testing.assert_allclose(own_joints, joints, rtol=1e-5, atol=1e-8)
            diagonal, got = frames, own
        np.testing.assert_allclose(got, diagonal, rtol=1e-5)
