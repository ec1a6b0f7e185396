"""Solves of vertices with a normal and a pull against dense least squares."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize

import ssdr
from helpers import motions, naive, terms
from ssdr.kernels.influence_choice import choose_influences
from ssdr.kernels.lanes import LANES
from ssdr.kernels.vertex_polish import polish_vertices
from ssdr.kernels.vertices import solve_vertices
from ssdr.solver.model import Model
from ssdr.solver.moments import transform_sums
from ssdr.solver.trajectories import Trajectories, gather

N, FRAMES, BONES = 12, 5, 3
LENGTH = 0.7
LOCKED = np.arange(N) % 4 == 0


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """Vertices under given bones, whose error is |x − ΣwMp̃|² + |l (n − ΣwRn)|² + μ|p − m|²."""

    data: Trajectories
    model: Model
    hold: np.ndarray
    frames: np.ndarray  # (F, V, 3), each multiplied by the root of its importance
    normals: np.ndarray
    moves: np.ndarray

    @property
    def turns(self) -> np.ndarray:
        still = self.moves.copy()
        still[..., 3] = 0
        return still

    def residual(self, i: int, w: np.ndarray, p: np.ndarray, n: np.ndarray) -> np.ndarray:
        """All that is squared in the error of vertex i; `w` are the weights (B,) of all bones."""
        blended = np.einsum("j,tjab->tab", w, self.moves)
        place = blended[..., :3] @ p + blended[..., 3] - self.frames[:, i]
        turned = LENGTH * (blended[..., :3] @ n - self.normals[:, i])
        held = np.sqrt(self.hold[i, 0]) * (p - self.hold[i, 1:])
        return np.concatenate([place.ravel(), turned.ravel(), held])

    def error(self, i: int, w: np.ndarray, p: np.ndarray, n: np.ndarray) -> float:
        return float((self.residual(i, w, p, n) ** 2).sum())

    def best_weights(self, i: int) -> tuple[float, np.ndarray]:
        p, n = self.model.rest[i : i + 1], self.model.normals[i, :1]
        images = [naive.bone_images(p, self.moves), LENGTH * naive.bone_images(n, self.turns)]
        target = [self.frames[:, i].ravel(), LENGTH * self.normals[:, i].ravel()]
        matrix = np.concatenate([one[0] for one in images])
        return naive.best_convex(matrix, np.concatenate(target), BONES)

    def best_places(self, i: int, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rest position and normal under the weights."""
        zero = np.zeros(3)
        base = self.residual(i, w, zero, zero)
        design = np.stack([self.residual(i, w, e[:3], e[3:]) - base for e in np.eye(6)], axis=1)
        out = np.linalg.lstsq(design, -base, rcond=None)[0]
        return out[:3], out[3:]

    def sums(self) -> tuple[np.ndarray, ...]:
        _, gram, gram4, reduced = transform_sums(self.data, self.model.transforms)
        some = slice(None)
        return (
            self.data.products(some, reduced, LENGTH),
            self.data.squares(some, LENGTH),
            gram,
            gram4,
        )


@pytest.fixture
def problem(rng: np.random.Generator) -> Problem:
    rest, ring = rng.standard_normal((N, 3)), np.arange(N)
    faces = np.stack([ring, (ring + 1) % N, (ring + 2) % N], axis=1)
    indices, weights = motions.weights_of(rng, N, BONES, BONES)
    truth = motions.motions(rng, FRAMES, BONES)
    frames = motions.blend(rest, indices, weights, truth)
    frames += 0.3 * rng.standard_normal(frames.shape)
    counts = 0.4 + rng.random(FRAMES)
    data = gather([ssdr.MeshSequence(frames, faces)], bones=99, frame_importance=counts)
    data = data.with_normals()
    inner, moves = motions.in_solver(data, rest, truth)
    model = Model.with_weights(moves, inner, indices, weights, BONES)
    model.normals = rng.standard_normal((N, 1, 3))
    hold = rng.standard_normal((N, 4))
    hold[:, 0] = 3 * rng.random(N) * (rng.random(N) < 0.7)
    solved = np.stack([data.frame(t) for t in range(FRAMES)])
    scale = data.frame_scale[:, None, None]
    normals = scale * terms.frame_normals(solved, faces)
    return Problem(data, model, hold, scale * solved, normals, moves * scale[..., None])


def _errors_are_those_of_loops(problem: Problem) -> None:
    model = problem.model
    for i, w in enumerate(model.dense_weights()):
        r = problem.residual(i, w, model.rest[i], model.normals[i, 0]) ** 2
        place, turned = r[: 3 * FRAMES].sum(), r[3 * FRAMES : -3].sum()
        assert model.error[i] == pytest.approx(place, rel=1e-9)
        assert model.normal_error[i] == pytest.approx(turned / LENGTH**2, rel=1e-9)


@pytest.mark.parametrize("move_rest", [True, False])
def test_the_alternation_solves_weights_then_places(problem: Problem, move_rest: bool) -> None:
    model, before = problem.model, problem.model.copy()
    best = [problem.best_weights(i) for i in range(N)]
    y, x2, gram, _ = problem.sums()
    pairs = np.ascontiguousarray(gram.transpose(0, 2, 1))
    rows = model.vertex_rows(0, N)
    none = np.zeros((0, 0)), np.zeros(0)
    solve_vertices(y, x2, gram, pairs, *none, *rows, problem.hold, LENGTH, LOCKED, move_rest)
    old, found = before.dense_weights(), model.dense_weights()
    np.testing.assert_array_equal(found[LOCKED], old[LOCKED])
    for i, w in enumerate(found):
        if not LOCKED[i]:
            # a bone stays out if it would gain less than a millionth of the error
            pulled = problem.hold[i, 0] * ((before.rest[i] - problem.hold[i, 1:]) ** 2).sum()
            here = problem.error(i, w, before.rest[i], before.normals[i, 0]) - pulled
            assert here == pytest.approx(best[i][0], rel=1e-5)
        p, n = problem.best_places(i, w)
        np.testing.assert_allclose(model.rest[i], p if move_rest else before.rest[i], atol=1e-9)
        np.testing.assert_allclose(model.normals[i, 0], n, atol=1e-9)
    _errors_are_those_of_loops(problem)


@pytest.mark.parametrize("move_rest", [True, False])
def test_gradient_and_inverse_of_a_vertex(problem: Problem, move_rest: bool) -> None:
    model = problem.model
    y, x2, _, gram4 = problem.sums()
    size = BONES - 1 + 6
    inverse, gradient = np.empty((N, size, size)), np.empty((N, size))
    rows = model.rest, model.indices, model.weights, model.error, model.normals, model.normal_error
    flags = problem.hold, LENGTH, LOCKED, move_rest, 0
    polish_vertices(y, x2, gram4, *rows, *flags, inverse, gradient)
    _errors_are_those_of_loops(problem)
    for i in range(N):
        used = np.count_nonzero(model.weights[i])
        count = 0 if LOCKED[i] else used - 1

        def residual(v: np.ndarray, i: int = i, count: int = count) -> np.ndarray:
            w = np.zeros(BONES)
            np.add.at(w, model.indices[i], model.weights[i])
            w[model.indices[i, 1 : count + 1]] += v[:count]
            w[model.indices[i, 0]] -= v[:count].sum()
            places = v[count:] if move_rest else np.concatenate([np.zeros(3), v[count:]])
            n = model.normals[i, 0] + places[3:] / LENGTH
            return problem.residual(i, w, model.rest[i] + places[:3], n)

        n = count + (6 if move_rest else 3)
        ends = [[residual(s * e) for e in 1e-6 * np.eye(n)] for s in (1, -1)]
        jacobian = (np.array(ends[0]) - np.array(ends[1])).T / 2e-6
        want = jacobian.T @ residual(np.zeros(n))
        np.testing.assert_allclose(gradient[i, :n], want, atol=1e-6 * np.abs(want).max())
        want = np.linalg.inv(jacobian.T @ jacobian)
        np.testing.assert_allclose(inverse[i, :n, :n], want, atol=1e-5 * np.abs(want).max())
        assert (gradient[i, n:] == 0).all()
        assert (inverse[i, n:] == 0).all()
        assert (inverse[i, :, n:] == 0).all()


def test_a_vertex_is_polished_alike_beside_any_others(problem: Problem) -> None:
    """More vertices than work together have the bits of those that are polished one by one."""
    model, (y, x2, _, gram4) = problem.model, problem.sums()
    names = ("rest", "indices", "weights", "error", "normals", "normal_error")
    size, found = BONES - 1 + 6, []
    assert 5 * N < LANES < 6 * N
    for rows in ([np.arange(6 * N) % N], np.arange(N)[:, None]):
        parts: list[list[np.ndarray]] = []
        for some in rows:
            own = [getattr(model, name)[some] for name in names]
            held = problem.hold[some], LENGTH, LOCKED[some], True, 3
            left = np.empty((len(some), size, size)), np.empty((len(some), size))
            polish_vertices(y[some], x2[some], gram4, *own, *held, *left)
            parts.append([*own, *left])
        found.append([np.concatenate(each)[:N] for each in zip(*parts, strict=True)])
        found.append([np.concatenate(each)[-N:] for each in zip(*parts, strict=True)])
    for arrays in zip(*found, strict=True):
        for other in arrays[1:]:
            np.testing.assert_array_equal(other, arrays[0])


def test_the_polish_ends_at_a_minimum(problem: Problem) -> None:
    """No step of a general solver from there lowers the error of a vertex."""
    model = problem.model
    y, x2, gram, gram4 = problem.sums()
    size = BONES - 1 + 6
    unread = np.empty((N, size, size)), np.empty((N, size))
    rows = model.rest, model.indices, model.weights, model.error, model.normals, model.normal_error
    before = [
        problem.error(i, w, model.rest[i], model.normals[i, 0])
        for i, w in enumerate(model.dense_weights())
    ]
    for _ in range(60):
        choose_influences(y, x2, gram, *rows[:3], model.normals, LENGTH, LOCKED, 0)
        flags = problem.hold, LENGTH, LOCKED, True, 3
        polish_vertices(y, x2, gram4, *rows, *flags, *unread)
    _errors_are_those_of_loops(problem)
    for i, w in enumerate(model.dense_weights()):
        x = np.concatenate([w, model.rest[i], model.normals[i, 0]])
        least = problem.error(i, x[:3], x[3:6], x[6:])
        assert least < before[i]
        used = (w > 0) & ~LOCKED[i]
        bounds = [(0, 1) if one else (v, v) for one, v in zip(used, w, strict=True)]
        found = minimize(
            lambda x, i=i: problem.error(i, x[:3], x[3:6], x[6:]),
            x,
            method="SLSQP",
            bounds=[*bounds, *6 * [(None, None)]],
            constraints={"type": "eq", "fun": lambda x: x[:3].sum() - 1},
            options={"ftol": 1e-14, "maxiter": 200},
        )
        assert found.fun > least * (1 - 1e-4)
