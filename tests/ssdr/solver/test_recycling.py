"""Directions handed from one solve to the next, against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest

from ssdr.errors import InputError
from ssdr.solver import recycling
from ssdr.solver.recycling import Recycled


def _system(rng: np.random.Generator, n: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """A positive definite matrix and the inverse of its diagonal."""
    half = rng.standard_normal((n, n))
    a = half @ half.T + 0.1 * np.eye(n)
    return a, np.diag(1 / np.diag(a))


def _directions(a: np.ndarray, p: np.ndarray, b: np.ndarray, steps: int):
    """Plain conjugate gradients: the directions, their images, and the residuals' lengths."""
    r, pairs, lengths = b.copy(), [], [float(np.linalg.norm(b))]
    d = p @ r
    for _ in range(steps):
        z = p @ r
        rho = r @ z
        image = a @ d
        pairs.append((d, image))
        alpha = rho / (d @ image)
        r = r - alpha * image
        lengths.append(float(np.linalg.norm(r)))
        d = p @ r + (r @ (p @ r)) / rho * d
    return pairs, lengths


def _dense(recycled: Recycled, p: np.ndarray) -> np.ndarray:
    apply = recycled.around(lambda r: p @ r, len(p))
    return np.stack([apply(e) for e in np.eye(len(p))], axis=1)


def test_it_is_the_formula_and_positive_definite(rng: np.random.Generator) -> None:
    a, p = _system(rng)
    pairs, _ = _directions(a, p, rng.standard_normal(12), 5)
    recycled = Recycled.of(pairs)
    assert recycled is not None
    s, y = recycled.directions.T, recycled.images.T
    v = np.eye(12) - y @ s.T
    got = _dense(recycled, p)
    assert np.allclose(got, v.T @ p @ v + s @ s.T, rtol=1e-10, atol=1e-12)
    assert np.linalg.eigvalsh(0.5 * (got + got.T)).min() > 0
    # On the span of the directions it is the inverse.
    assert np.allclose(got @ y, s, rtol=1e-8, atol=1e-10)


def test_a_long_vector_is_taken_in_pieces(monkeypatch) -> None:
    rng = np.random.default_rng(3)
    a, p = _system(rng)
    recycled = Recycled.of(_directions(a, p, rng.standard_normal(12), 5)[0])
    assert recycled is not None
    whole = _dense(recycled, p)
    monkeypatch.setattr(recycling, "_COLUMNS", 5)
    assert np.allclose(_dense(recycled, p), whole, rtol=1e-10, atol=1e-12)


def test_a_system_near_by_is_solved_in_fewer_steps(rng: np.random.Generator) -> None:
    # Ten stiff directions that plain steps find first, again in every solve.
    turn, _ = np.linalg.qr(rng.standard_normal((40, 40)))
    a = turn @ np.diag(np.append(np.geomspace(10, 1e4, 10), np.linspace(1, 2, 30))) @ turn.T
    p, b = np.eye(40), rng.standard_normal(40)
    pairs, _ = _directions(a, p, rng.standard_normal(40), 25)
    recycled = Recycled.of(pairs)
    assert recycled is not None
    near = a + 1e-3 * np.diag(np.diag(a))
    _, plain = _directions(near, p, b, 8)
    _, handed = _directions(near, _dense(recycled, p), b, 8)
    assert handed[-1] < 0.1 * plain[-1]


def test_memory_is_bounded_and_another_size_is_refused(monkeypatch) -> None:
    pairs = [(np.eye(5)[k], np.eye(5)[k]) for k in range(4)]
    monkeypatch.setattr(recycling, "_NUMBERS", 14)
    few = Recycled.of(pairs)
    assert few is not None
    assert few.directions.shape == (2, 5)
    assert Recycled.of([]) is None
    monkeypatch.setattr(recycling, "_NUMBERS", 4)
    assert Recycled.of(pairs) is None
    with pytest.raises(InputError, match="recycled"):
        few.around(lambda r: r, 6)
