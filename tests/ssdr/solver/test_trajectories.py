"""The normalised, reduced frames against the frames themselves and the SVD."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ssdr
from helpers import motions, naive
from ssdr.solver import trajectories
from ssdr.solver.alternation import vertex_step
from ssdr.solver.model import Model
from ssdr.solver.trajectories import Trajectories, gather


def gathered(frames: np.ndarray, **options: object) -> Trajectories:
    return gather([ssdr.MeshSequence(frames)], **({"bones": 2} | options))


def full(data: Trajectories) -> np.ndarray:
    """Reduced trajectories spread over all frames again, (V, 3F)."""
    return data.z if data.q is None else data.z @ data.q.T


def test_world_and_back(rng: np.random.Generator) -> None:
    frames = 50 + rng.standard_normal((6, 9, 3))
    data = gathered(frames)
    rest, transforms = rng.standard_normal((9, 3)), motions.motions(rng, 6, 3)
    outer, moved = data.alignment.to_world(*motions.in_solver(data, rest, transforms))
    np.testing.assert_allclose(outer, rest, atol=1e-12)
    np.testing.assert_allclose(moved, transforms, atol=1e-12)


@pytest.mark.parametrize("importance", [False, True])
def test_normalising_changes_no_error(importance: bool, rng: np.random.Generator) -> None:
    """Skinning in the solver's space has the error of skinning in the input's, up to scale."""
    rig = motions.chain(bones=3, rows=6, frames=8)
    frames = 7 + motions.wobble(rig, 0.3)
    weight = 0.5 + rng.random(len(rig.rest)) if importance else None
    data = gathered(frames, bones=100, vertex_importance=weight)
    moved = rig.transforms.copy()
    moved[..., 3] += 7.1
    rest, transforms = motions.in_solver(data, rig.rest, moved)
    inner = np.stack([data.frame(t) for t in range(8)])
    got = naive.squared_error(inner, rest, rig.indices, rig.weights, transforms)
    want = naive.squared_error(frames, rig.rest, rig.indices, rig.weights, moved)
    np.testing.assert_allclose(got * data.alignment.scale**2, want, rtol=1e-9)


def test_common_motion_is_taken_out(rng: np.random.Generator) -> None:
    shape = rng.standard_normal((20, 3)) * [3, 2, 1]
    frames = np.stack([shape @ motions.rotation(0.5 * t, t, 0).T + [0, 9 * t, 0] for t in range(8)])
    data = gathered(frames)
    first = data.frame(0)
    for t in range(8):
        np.testing.assert_allclose(data.frame(t), first, atol=1e-12)
    assert np.sqrt((first**2).sum(axis=1).mean()) == pytest.approx(1.0)


@settings(max_examples=15)
@given(
    seed=st.integers(0, 10**6),
    size=st.sampled_from([(30, 40), (80, 12), (25, 25)]),
    decay=st.floats(0.3, 1.0),
)
def test_loss_is_bounded_by_what_no_model_holds(
    seed: int, size: tuple[int, int], decay: float
) -> None:
    rng = np.random.default_rng(seed)
    n, n_frames = size
    rank = min(n, 3 * n_frames)
    x = (
        rng.standard_normal((n, rank))
        * decay ** np.arange(rank)
        @ rng.standard_normal((rank, 3 * n_frames))
    )
    frames = x.reshape(n, n_frames, 3).transpose(1, 0, 2)
    data = gathered(frames, bones=2)
    exact = full(gathered(frames, bones=10**6))
    singular = np.linalg.svd(exact, compute_uv=False)
    tail = (singular[8:] ** 2).sum()
    gap = ((full(data) - exact) ** 2).sum()
    assert gap <= 1.01e-4 * tail + 1e-14 * (singular**2).sum()
    np.testing.assert_allclose(data.x2, (exact**2).sum(axis=1), rtol=1e-12)
    if data.q is not None:
        r = data.q.shape[1]
        np.testing.assert_allclose(data.q.T @ data.q, np.eye(r), atol=1e-10)


def test_exact_rank_is_kept_exactly() -> None:
    rig = motions.chain(bones=4, frames=60, rows=30)
    data = gathered(rig.frames, bones=4)
    assert data.q is not None
    assert data.z.shape[1] <= 2 * 16  # of 180; rounding makes a few columns more than the rank
    np.testing.assert_allclose(full(data), full(gathered(rig.frames, bones=10**6)), atol=1e-7)


def test_sketch_of_large_input(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    """What the range finder keeps obeys the bound of the exact decomposition."""
    x = rng.standard_normal((300, 130)) * 0.7 ** np.arange(130) @ rng.standard_normal((130, 390))
    frames = x.reshape(300, 130, 3).transpose(1, 0, 2)
    exact = full(gathered(frames, bones=10**6))
    monkeypatch.setattr(trajectories, "_GRAM_LIMIT", 50)
    data = gathered(frames, bones=2)
    assert data.q is not None
    assert data.z.shape[1] < 200
    tail = (np.linalg.svd(exact, compute_uv=False)[8:] ** 2).sum()
    assert ((full(data) - exact) ** 2).sum() <= 1.01e-4 * tail
    np.testing.assert_allclose(data.q.T @ data.q, np.eye(data.q.shape[1]), atol=1e-10)


def test_products_against_loops(rng: np.random.Generator) -> None:
    frames = rng.standard_normal((5, 7, 3))
    data = gathered(frames, bones=10, frame_importance=0.5 + rng.random(5))
    transforms = motions.motions(rng, 5, 3)
    stacked = data.stack(transforms).reshape(5, 3, 4, 3)
    for t in range(5):
        for j in range(3):
            want = data.frame_scale[t] * transforms[t, j]
            np.testing.assert_allclose(stacked[t, :, :, j], want, atol=1e-14)
    a = rng.standard_normal((4, 3, 7))
    sums = data.expand(np.ascontiguousarray(a @ data.z))
    for t in range(5):
        want = np.einsum("djn,nc->cdj", a, data.frame(t))
        np.testing.assert_allclose(sums[t], want, atol=1e-12)


@pytest.mark.parametrize("n_frames", [5, 120])
def test_vertex_error_is_that_of_skinning(n_frames: int, rng: np.random.Generator) -> None:
    """The kernel's error, from moments in the reduced basis, against forward skinning."""
    rig = motions.chain(bones=4, frames=n_frames)
    frames = motions.wobble(rig, 0.1)
    data = gathered(frames, bones=4)
    assert (data.q is not None) == (n_frames == 120)
    rest, transforms = motions.in_solver(data, rig.rest, rig.transforms)
    model = Model.start(transforms, rest, rig.indices[:, 0].astype(np.intp), 2)
    vertex_step(data, model)
    rest, transforms = data.alignment.to_world(model.rest, model.transforms)
    want = naive.squared_error(frames, rest, model.indices, model.weights, transforms)
    np.testing.assert_allclose(model.error * data.alignment.scale**2, want, rtol=0.02)
    assert model.weighted_error(data) * data.alignment.scale**2 == pytest.approx(
        want.sum(), rel=5e-3
    )


def test_unimportant_vertices_do_not_decide_the_basis(rng: np.random.Generator) -> None:
    rig = motions.chain(bones=4, frames=80, rows=20)
    frames = rig.frames
    junk = np.arange(frames.shape[1]) % 2 == 0
    frames[:, junk] += 100 * rng.standard_normal((80, 3))[:, None] * rng.random((junk.sum(), 1))
    frames[:, junk] += 30 * rng.standard_normal((80, junk.sum(), 3))
    data = gathered(frames, bones=4, vertex_importance=1.0 - junk)
    exact = gathered(frames, bones=10**6, vertex_importance=1.0 - junk)
    gap = full(data)[~junk] - full(exact)[~junk]
    assert np.sqrt((gap**2).sum() / exact.x2[~junk].sum()) < 1e-6
