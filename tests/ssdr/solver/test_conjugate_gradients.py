"""Conjugate gradients, and directions handed from one solve to the next, against dense matrices."""

from __future__ import annotations

import numpy as np

from ssdr.solver import conjugate_gradients
from ssdr.solver.conjugate_gradients import Recycled


def _system(rng: np.random.Generator, n: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """A positive definite matrix and the inverse of its diagonal."""
    half = rng.standard_normal((n, n))
    a = half @ half.T + 0.1 * np.eye(n)
    return a, np.diag(1 / np.diag(a))


def _solve(a, p, b, steps: int, recycled: Recycled | None = None):
    return conjugate_gradients.conjugate_gradients(
        lambda x: a @ x, b, lambda r: p @ r, steps=steps, recycled=recycled
    )


def _recycled(a: np.ndarray, p: np.ndarray, rng: np.random.Generator, steps: int = 5) -> Recycled:
    found = _solve(a, p, rng.standard_normal(len(a)), steps)[2]
    assert found is not None
    return found


def _dense(recycled: Recycled, p: np.ndarray) -> np.ndarray:
    apply = recycled.update(lambda r: p @ r)
    return np.stack([apply(e) for e in np.eye(len(p))], axis=1)


def test_the_solution_and_its_residual(rng: np.random.Generator) -> None:
    a, p = _system(rng)
    b = rng.standard_normal(12)
    for recycled in (None, _recycled(a, p, rng)):
        x, residual, found = _solve(a, p, b, 100, recycled)
        np.testing.assert_allclose(x, np.linalg.solve(a, b), rtol=1e-3, atol=1e-4)
        x, residual, found = _solve(a, p, b, 4, recycled)
        np.testing.assert_allclose(residual, b - a @ x, atol=1e-10)
        assert found is not None
        # conjugate: of every pair of directions, one's image is normal to the other
        np.testing.assert_allclose(found.directions @ a @ found.directions.T, np.eye(4), atol=1e-6)
        np.testing.assert_allclose(found.images, found.directions @ a, atol=1e-10)


def test_the_update_is_the_formula_and_positive_definite(rng: np.random.Generator) -> None:
    a, p = _system(rng)
    recycled = _recycled(a, p, rng)
    s, y = recycled.directions.T, recycled.images.T
    v = np.eye(12) - y @ s.T
    got = _dense(recycled, p)
    assert np.allclose(got, v.T @ p @ v + s @ s.T, rtol=1e-10, atol=1e-12)
    assert np.linalg.eigvalsh(0.5 * (got + got.T)).min() > 0
    # On the span of the directions it is the inverse.
    assert np.allclose(got @ y, s, rtol=1e-8, atol=1e-10)


def test_a_long_vector_is_taken_in_pieces(monkeypatch, rng: np.random.Generator) -> None:
    a, p = _system(rng)
    recycled = _recycled(a, p, rng)
    whole = _dense(recycled, p)
    monkeypatch.setattr(conjugate_gradients, "_COLUMNS", 5)
    assert np.allclose(_dense(recycled, p), whole, rtol=1e-10, atol=1e-12)


def test_a_system_near_by_is_solved_in_fewer_steps(rng: np.random.Generator) -> None:
    # Ten stiff directions that plain steps find first, again in every solve.
    turn, _ = np.linalg.qr(rng.standard_normal((40, 40)))
    a = turn @ np.diag(np.append(np.geomspace(10, 1e4, 10), np.linspace(1, 2, 30))) @ turn.T
    p, b = np.eye(40), rng.standard_normal(40)
    recycled = _recycled(a, p, rng, 25)
    near = a + 1e-3 * np.diag(np.diag(a))
    plain, handed = (_solve(near, p, b, 8, r)[1] for r in (None, recycled))
    assert np.linalg.norm(handed) < 0.1 * np.linalg.norm(plain)


def test_memory_is_bounded(monkeypatch) -> None:
    pairs = [(np.eye(5)[k], np.eye(5)[k]) for k in range(4)]
    monkeypatch.setattr(conjugate_gradients, "_NUMBERS", 14)
    few = Recycled.of(pairs)
    assert few is not None
    assert few.directions.shape == (2, 5)
    assert Recycled.of([]) is None
    monkeypatch.setattr(conjugate_gradients, "_NUMBERS", 4)
    assert Recycled.of(pairs) is None
