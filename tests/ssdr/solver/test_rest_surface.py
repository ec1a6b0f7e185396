"""What a rest pose is to resemble: its strain, the pulls that majorise it, the frame it is near."""

from __future__ import annotations

import math

import numpy as np
import pytest
import threadpoolctl

import ssdr
from helpers import motions, surfaces, terms
from ssdr.mesh.edges import distinct_pairs
from ssdr.solver.initialization import central_frame
from ssdr.solver.rest_surface import RestSurface
from ssdr.solver.trajectories import Trajectories, gather


def _data(frames: np.ndarray, faces: np.ndarray) -> Trajectories:
    return gather([ssdr.MeshSequence(frames, faces)], bones=1, compress=False)


def _sheet(rng: np.random.Generator, size: int = 4) -> tuple[RestSurface, np.ndarray]:
    points, faces = surfaces.grid(size, size, jitter=0.1, rng=rng)
    data = _data(points[None], faces)
    surface = RestSurface.build(data.faces, data.frame(0))
    assert surface is not None
    return surface, faces


def test_the_strain_is_that_of_the_edges(rng: np.random.Generator) -> None:
    surface, faces = _sheet(rng)
    pose = surface.pose
    rest = pose + 0.1 * rng.standard_normal(pose.shape)
    want = 1 + terms.STRENGTH * terms.strain(rest, pose, faces)
    assert surface.factor(rest) == pytest.approx(want, rel=1e-12)
    assert surface.factor(pose + np.array([1, -2, 3])) == pytest.approx(1, abs=1e-12)
    for degrees in (20, 180):
        turn = motions.rotation(0, 0, math.radians(degrees))  # the sheet is flat: in its plane
        want = 1 + terms.STRENGTH * 4 * math.sin(math.radians(degrees / 2)) ** 2
        assert surface.factor(pose @ turn.T) == pytest.approx(want, rel=1e-9)


def test_pulls_majorise_the_logarithm_of_the_factor(rng: np.random.Generator) -> None:
    """E log F rises by at most what the pulls rise, and by as much to first order."""
    surface, _ = _sheet(rng)
    n, error = len(surface.pose), 3.7
    importance = 0.2 + rng.random(n)
    rest = surface.pose + 0.2 * rng.standard_normal((n, 3))
    pulls = surface.pulls(rest, error, importance)

    def pulled(p: np.ndarray) -> float:
        return float(importance @ (pulls[:, 0] * ((p - pulls[:, 1:]) ** 2).sum(axis=1)))

    def rise(p: np.ndarray) -> float:
        return error * math.log(surface.factor(p) / surface.factor(rest))

    for size in (1e-3, 0.1, 1.0, 10.0):
        for p in rest + size * rng.standard_normal((20, n, 3)):
            assert rise(p) <= (pulled(p) - pulled(rest)) * (1 + 1e-9)
    for i, c in ((0, 0), (7, 1), (12, 2)):
        step = np.zeros((n, 3))
        step[i, c] = 1e-5
        slopes = [f(rest + step) - f(rest - step) for f in (rise, pulled)]
        assert slopes[0] == pytest.approx(slopes[1], rel=1e-6)
    assert np.isfinite(surface.pulls(rest, error, np.zeros(n))).all()


def test_without_edges_there_is_no_surface(rng: np.random.Generator) -> None:
    points = rng.standard_normal((1, 5, 3))
    for frames, faces in (
        (points, np.zeros((0, 3))),
        (points, [[1, 1, 1]]),
        (0 * points, [[0, 1, 2]]),
    ):
        data = _data(frames, np.array(faces, dtype=np.int32))
        assert RestSurface.build(data.faces, data.frame(0)) is None
    assert central_frame(_data(points, np.zeros((0, 3), np.int32)), first=True) == 0


def test_edges_are_distinct_pairs_in_order(rng: np.random.Generator) -> None:
    ends = rng.integers(0, 9, (60, 2)).astype(np.int32)
    want = sorted({(min(a, b), max(a, b)) for a, b in ends.tolist() if a != b})
    np.testing.assert_array_equal(distinct_pairs(ends, 9), want)
    assert distinct_pairs(ends[:0], 9).shape == (0, 2)


def test_stiffer_edges_count_so_many_times_as_much(rng: np.random.Generator) -> None:
    surface, faces = _sheet(rng)
    some = faces[[4, 5]]
    stiff = surface.stiffened(some, 7.0)
    rest = surface.pose.copy()
    i, j = some[0, 0], next(int(k) for k in range(len(rest)) if k not in faces[:6])
    for k, times in ((i, None), (j, 1.0)):
        moved = rest.copy()
        moved[k] += 0.1
        ends = [pair for pair in terms.edges_of(faces) if k in pair]
        weight = {pair: surface.edges[pair[0], pair[1]] for pair in ends}
        sevenfold = [7 * w if pair in terms.edges_of(some) else w for pair, w in weight.items()]
        ratio = sum(sevenfold) / sum(weight.values())
        found = (stiff.factor(moved) - 1) / (surface.factor(moved) - 1)
        assert found == pytest.approx(ratio if times is None else times, rel=1e-9)
    assert stiff.factor(rest) == 1


def test_tilted_triangles_are_found(rng: np.random.Generator) -> None:
    surface, faces = _sheet(rng)
    leaning = surface.pose.copy()
    leaning[:, 2] += np.where(leaning[:, 0] > leaning[:, 0].mean(), 0.8, 0.1) * leaning[:, 0]
    for cosine in (-1.0, 0.7, 0.95, 1.1):
        want = []
        for i, j, k in faces:
            ends = [(p[j] - p[i], p[k] - p[i]) for p in (leaning, surface.pose)]
            a, b = (np.cross(*pair) / np.linalg.norm(np.cross(*pair)) for pair in ends)
            want.append(a @ b < cosine)
        np.testing.assert_array_equal(surface.tilted(leaning, faces, cosine), want)
    assert 0 < surface.tilted(leaning, faces, 0.95).sum() < len(faces)


def test_triangles_turned_over_are_found(rng: np.random.Generator) -> None:
    points, faces = surfaces.grid(4, 4)
    data = _data(points[None], faces)
    surface = RestSurface.build(data.faces, data.frame(0))
    assert surface is not None
    assert not surface.turned(surface.pose, faces).any()
    folded = surface.pose.copy()
    folded[12] += 1.3 * (folded[13] - folded[12])  # across the edges of triangles on that side
    turned = surface.turned(folded, faces)
    a, b, c = folded[faces].transpose(1, 0, 2)
    up = np.cross(b - a, c - a)[:, 2]
    flat = np.cross(*np.diff(surface.pose[faces], axis=1).transpose(1, 0, 2))[:, 2]
    np.testing.assert_array_equal(turned, up * flat < 0)
    assert 0 < turned.sum() < 6
    bent = RestSurface.build(data.faces, folded)
    assert bent is not None
    assert not bent.turned(folded, faces).any()
    assert not bent.turned(surface.pose, faces).any()


def test_the_central_frame_is_nearest_to_the_mean_of_the_edges(rng: np.random.Generator) -> None:
    points, faces = surfaces.grid(4, 5)
    amount = np.array([0.3, -0.25, 0.12, 0.01, -0.2, 0.22, -0.19])
    frames = points + amount[:, None, None] * (points**2)[:, [2, 2, 0]]
    turns = np.stack([motions.rotation(*v) for v in rng.standard_normal((len(frames), 3))])
    frames = np.einsum("tab,tib->tia", turns, frames) + 10 * rng.standard_normal(
        (len(frames), 1, 3)
    )
    assert central_frame(_data(frames, faces)) == 3
    many = np.repeat(frames, 40, axis=0)
    found = central_frame(_data(many, faces))
    assert found // 40 == 3
    assert found in np.linspace(0, len(many) - 1, 64).round()


def test_the_same_bits_whatever_threads_blas_may_use() -> None:
    frames, faces = motions.cloth(frames=12, side=130)
    data = _data(frames, faces)
    found = set()
    for limit in (1, 2):
        with threadpoolctl.threadpool_limits(limit, user_api="blas"):
            surface = RestSurface.build(data.faces, data.frame(0))
            assert surface is not None
            found.add((surface.edges.data.tobytes(), central_frame(data)))
    assert len(found) == 1
