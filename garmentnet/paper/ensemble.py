"""The ensemble over simulation parameters (Pan et al. 2022, section 4.4).

Pivots are networks of single parameter sets.  :class:`Kernel` is the RBF of equation 4, by which
equation 3 mixes them (`networks.checkpoint`); :func:`select_pivots` chooses them, and
:func:`fit_kernel` trains the kernel.  Both need only Gram matrices of the residuals: for a training
set s with residuals r_i = G_i − Ĝ_s of every network i, ‖Σ w_i G_i − Ĝ_s‖² = wᵀ Q_s w with
Q_s = ⟨r_i, r_j⟩, because Σ w = 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import nnls
from torch import Tensor, nn

from ssdr.common.errors import InputError

Array = NDArray[np.float64]
# Widths of the MLP g, as published.
_HIDDEN, _LATENT = 16, 4


class Kernel(nn.Module):
    """The RBF Ψ(θ_i, θ) of equation 4, normalised over the pivots to Ψ̄.

    Ψ = exp(−‖g(θ_i) − g(θ)‖²); its width σ is a part of g.  The published code has the distance
    itself in the place of its square.  The MLP g is the published one, with one slope of the PReLU
    for all channels and without the batch normalisation, which in prediction is an affine map that
    the last layer can express.

    Parameters
    ----------
    inputs : int
        Number of simulation parameters.

    Examples
    --------
    >>> kernel = Kernel()
    >>> float(kernel.weights([[0.0, 0, 0], [1, 1, 1]], [0.5, 0.5, 0.5]).sum().round(6))
    1.0
    """

    def __init__(self, inputs: int = 3) -> None:
        super().__init__()
        self.g = nn.Sequential(
            nn.Linear(inputs, _HIDDEN), nn.PReLU(), nn.Linear(_HIDDEN, _LATENT)
        ).double()

    def forward(self, pivots: Tensor, theta: Tensor) -> Tensor:
        """Weights ``(..., K)`` of pivots with parameters ``(..., K, P)`` at ``(..., P)``; sum 1."""
        gap = (self.g(pivots) - self.g(theta)[..., None, :]).square().sum(-1)
        # The normalised kernel is a softmax, which does not divide by 0 where every Ψ underflows.
        return torch.softmax(-gap, dim=-1)

    def weights(self, pivots: Any, theta: Any) -> Array:
        """Result of :meth:`forward` as an array, for arrays."""
        rows = (torch.as_tensor(np.asarray(x, float)) for x in (pivots, theta))
        with torch.no_grad():
            return np.asarray(self(*rows).numpy())


# Square of 10 nm: an exact mixture has no gradient.
_EXACT = 1e-16
# Metres²; only against a division by 0 where all residuals vanish.
_TINY = 1e-30


def gram(predictions: Sequence[Any], truth: Any) -> Array:
    """Gram matrix Q ``(S, S)`` of residuals: means of ⟨r_i, r_j⟩ over frames and vertices, metres².

    Parameters
    ----------
    predictions : S arrays (F, V, 3)
    truth : (F, V, 3)

    Examples
    --------
    >>> truth = np.zeros((1, 2, 3))
    >>> gram([truth + 1, truth - 1], truth).tolist()
    [[3.0, -3.0], [-3.0, 3.0]]
    """
    truth = np.asarray(truth, np.float64)
    r = np.stack([(np.asarray(p, np.float64) - truth).ravel() for p in predictions])
    return np.asarray(r @ r.T / (truth.shape[0] * truth.shape[1]))


# Normalised parameters (K, P) of pivots and (P,) of a set, and the Gram matrix (K, K) of the
# pivots' residuals on its frames.
Mixture = tuple[Array, Array, Array]


def convex_fit(q: Array) -> tuple[Array, float]:
    """Weights w ≥ 0 with sum 1 that minimise wᵀ Q w, and the square root of the minimum.

    Examples
    --------
    >>> weights, error = convex_fit(np.diag([1.0, 3.0]))
    >>> weights.round(3).tolist(), round(error**2, 3)
    ([0.75, 0.25], 0.75)
    """
    # The penalty (1 − Σ w)² in place of the constraint gives non-negative least squares.  Its
    # minimum along a ray rises with wᵀ Q w at Σ w = 1, so the best ray is the same.
    values, vectors = np.linalg.eigh(q)
    root = np.sqrt(np.maximum(values, 0))[:, None] * vectors.T
    unit = np.sqrt(max(float(np.trace(q)) / len(q), _TINY))
    w, _ = nnls(np.vstack([root / unit, np.ones(len(q))]), np.append(np.zeros(len(q)), 1.0))
    w = w / w.sum()
    return w, math.sqrt(max(0.0, float(w @ q @ w)))


def extremes(parameters: Any, count: int) -> list[int]:
    """Indices of the parameter sets in which a parameter is highest or lowest: the first pivots.

    Parameters
    ----------
    parameters : (S, P) array
    count : int
        Number of pivots that are wanted in all.

    Raises
    ------
    InputError
        If `count` is less than their number, or more than that of the sets.

    Examples
    --------
    >>> extremes([[0.0, 1.0], [0.5, 1.0], [1.0, 1.0]], 2)
    [0, 2]
    """
    p = np.asarray(parameters, float)
    spread = p.max(axis=0) > p.min(axis=0)
    at_end = (np.isclose(p, p.max(axis=0)) | np.isclose(p, p.min(axis=0))) & spread
    found: list[int] = np.flatnonzero(at_end.any(axis=1)).tolist() or [0]
    if not len(found) <= count <= len(p):
        expected = f"{len(found)} or more, the sets with an extreme, and at most {len(p)}"
        raise InputError("ensemble.pivots", expected, count)
    return found


def select_pivots(grams: Sequence[Array], parameters: Any, count: int) -> list[int]:
    """Choose K pivots as the paper does: the extremes, then the worst fitted, one at a time.

    The network of a set that is no pivot is compared, on that set, with the best convex mixture of
    the pivots' predictions.

    Parameters
    ----------
    grams : S arrays (S, S)
        Gram matrix of all networks on the frames of each set; see :func:`gram`.
    parameters : (S, P) array
    count : int
        Number K of pivots.

    Returns
    -------
    list of int
        Indices of the sets, in the order in which they were chosen.

    Raises
    ------
    InputError
        As :func:`extremes`.

    Examples
    --------
    >>> grams = [np.eye(3)] * 3
    >>> select_pivots(grams, [[0.0], [0.4], [1.0]], 2)
    [0, 2]
    """
    chosen = extremes(parameters, count)

    def misfit(s: int) -> float:
        # r_i − r_s = G_i − G_s: the simulation cancels.
        q, p = grams[s], chosen
        between = q[np.ix_(p, p)] - q[p, s][:, None] - q[s, p][None] + q[s, s]
        return convex_fit(between)[1]

    while len(chosen) < count:
        rest = [s for s in range(len(grams)) if s not in chosen]
        chosen.append(max(rest, key=misfit))
    return chosen


def fit_kernel(learned: Sequence[Mixture], *, steps: int = 600, seed: int = 0) -> Kernel:
    """Train the kernel, leaving the pivot of one training parameter set out at a time.

    Parameters
    ----------
    learned : sequence of tuple
        One or more; see :func:`left_out`.
    steps : int
        Number of steps of Adam.
    seed : int
        Seed of the initial weights.

    Examples
    --------
    >>> sets = left_out([np.eye(2)] * 2, [[0.0], [1.0]], [0, 1])
    >>> fit_kernel(sets, steps=2).weights([[0.0], [1.0]], [0.0]).argmax()
    np.int64(0)
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        made = Kernel(len(learned[0][1]))
    optimiser = torch.optim.Adam(made.parameters(), lr=1e-2, weight_decay=1e-3)
    sets = [[torch.from_numpy(x) for x in mixed] for mixed in learned]
    for _ in range(steps):
        errors = []
        for pivots, theta, q in sets:
            w = made(pivots, theta)
            errors.append((w @ q @ w).clamp(min=_EXACT).sqrt())
        optimiser.zero_grad()
        torch.autograd.backward(torch.stack(errors).mean())
        optimiser.step()
    return made


def left_out(grams: Sequence[Array], parameters: Any, pivots: Sequence[int]) -> list[Mixture]:
    """For each training set the mixture of the pivots other than itself, if there are any."""
    theta = np.asarray(parameters, float)
    others = [[i for i in pivots if i != s] for s in range(len(grams))]
    return [(theta[p], theta[s], grams[s][np.ix_(p, p)]) for s, p in enumerate(others) if p]
