"""Derivatives of linear blend skinning against an einsum twin and differences of skinning."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ssdr
from docs import snippets


def parts(
    seed: int, n: int = 9, bones: int = 4, k: int = 3, n_frames: int = 5
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Any affine bones and weights; a vertex may name a bone twice, and some weights are 0."""
    rng = np.random.default_rng(seed)
    weights = rng.standard_normal((n, k))
    weights[rng.random((n, k)) < 0.2] = 0
    moves = rng.standard_normal((n_frames, bones, 3, 4))
    return rng.standard_normal((n, 3)), rng.integers(0, bones, (n, k)), weights, moves


def twin(rest: Any, indices: Any, weights: Any, moves: Any, g: Any) -> dict[str, np.ndarray]:
    """The three gradients by einsum over all bones."""
    one_hot = np.eye(moves.shape[1])[indices]
    points = np.c_[rest, np.ones(len(rest))]
    dense = np.einsum("ik,ikj->ij", weights, one_hot)
    return {
        "rest": np.einsum("ij,tjab,tia->ib", dense, moves[..., :3], g),
        "weights": np.einsum("tia,ikj,tjab,ib->ik", g, one_hot, moves, points),
        "transforms": np.einsum("ij,tia,ib->tjab", dense, g, points),
    }


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10**6),
    n=st.integers(1, 12),
    bones=st.integers(1, 6),
    k=st.integers(1, 5),
    n_frames=st.integers(1, 4),
)
def test_against_einsum(seed: int, n: int, bones: int, k: int, n_frames: int) -> None:
    arrays = parts(seed, n, bones, k, n_frames)
    g = np.random.default_rng(seed).standard_normal((n_frames, n, 3))
    found = ssdr.skin_gradients(*arrays, g)
    for name, expected in twin(*arrays, g).items():
        np.testing.assert_allclose(getattr(found, name), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("part", ["rest", "weights", "transforms"])
def test_against_differences_of_skinning(part: str) -> None:
    """Skinning is linear in each argument, so that no step is too large."""
    names = ("rest", "indices", "weights", "transforms")
    arrays = dict(zip(names, parts(7), strict=True))
    g = np.random.default_rng(8).standard_normal((5, 9, 3))
    found = getattr(ssdr.skin_gradients(*arrays.values(), g), part)
    assert found.shape == arrays[part].shape
    for place in np.ndindex(found.shape):
        step = np.zeros(found.shape)
        step[place] = 0.5
        up, down = (
            np.vdot(g, ssdr.skin(**{**arrays, part: arrays[part] + sign * step}))
            for sign in (1, -1)
        )
        assert found[place] == pytest.approx(up - down, abs=1e-11)


def test_a_single_frame() -> None:
    rest, indices, weights, moves = parts(3)
    g = np.random.default_rng(1).standard_normal((9, 3))
    one = ssdr.skin_gradients(rest, indices, weights, moves[0], g)
    many = ssdr.skin_gradients(rest, indices, weights, moves[:1], g[None])
    assert one.transforms.shape == (4, 3, 4)
    assert np.array_equal(one.transforms, many.transforms[0])
    assert np.array_equal(one.rest, many.rest)


def test_precision_is_that_of_the_arrays() -> None:
    arrays = parts(4)
    g = np.random.default_rng(1).standard_normal((5, 9, 3))
    single = [a.astype(np.float32) if a.dtype.kind == "f" else a for a in (*arrays, g)]
    found, expected = ssdr.skin_gradients(*single), ssdr.skin_gradients(*arrays, g)
    wide = ssdr.skin_gradients(*single, dtype=np.float64)
    assert ssdr.skin_gradients(*single[:4], g).rest.dtype == np.float64
    for name in ("rest", "weights", "transforms"):
        assert getattr(found, name).dtype == np.float32
        assert getattr(wide, name).dtype == np.float64
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-4)


def test_a_bone_that_moves_nothing_may_be_no_number() -> None:
    rest, indices, weights, moves = parts(5)
    weights[indices == 2] = 0
    moves[:, 2] = np.nan
    found = ssdr.skin_gradients(rest, indices, weights, moves, np.ones((5, 9, 3)))
    assert np.isfinite(found.rest).all()
    assert (found.transforms[:, 2] == 0).all()
    assert np.isnan(found.weights[indices == 2]).all()


def test_the_function_of_the_page_in_pytorch() -> None:
    torch = pytest.importorskip("torch")
    page = Path(__file__).resolve().parents[3] / "docs" / "data.md"
    names: dict[str, Any] = {"ssdr": ssdr}
    code = [t for _, t in snippets.FENCE.findall(page.read_text("utf-8")) if "# needs: torch" in t]
    assert len(code) == 1
    exec(code[0], names)
    rest, indices, weights, moves = (torch.from_numpy(a) for a in parts(9, n=4, n_frames=2))
    real = [x.requires_grad_() for x in (rest, weights, moves)]
    assert torch.autograd.gradcheck(
        lambda p, w, m: names["Skin"].apply(p, indices, w, m), real, eps=1e-3, atol=1e-8
    )
