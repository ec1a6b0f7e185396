"""Which networks become pivots, and the kernel that mixes them (Pan et al. 2022, section 4.4)."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import nnls
from torch import Tensor

from ssdr.errors import InputError

from ..networks.ensemble import Kernel

Array = NDArray[np.float64]

__all__ = [
    "convex_fit",
    "error_of",
    "extremes",
    "fit_kernel",
    "gram",
    "inverse_distance",
    "left_out_errors",
    "nearest",
    "select_pivots",
    "smallest_good",
]


def inverse_distance(pivots: Any, theta: Any) -> Array:
    """Weights ∝ 1 / ‖θ_i − θ‖, the paper's first alternative; all to an exact match."""
    gap = np.linalg.norm(np.asarray(pivots, float) - np.asarray(theta, float), axis=1)
    near = np.asarray(gap < 1e-12, np.float64) if gap.min() < 1e-12 else 1 / gap
    return np.asarray(near / near.sum())


def nearest(pivots: Any, theta: Any) -> Array:
    """All weight to the pivot whose normalised parameters are closest."""
    gap = np.linalg.norm(np.asarray(pivots, float) - np.asarray(theta, float), axis=1)
    return np.asarray(np.arange(len(gap)) == gap.argmin(), float)


def gram(predictions: Sequence[Any], truth: Any) -> Array:
    """Q ``(S, S)``: mean over frames and vertices of ⟨r_i, r_j⟩, metres².

    Parameters
    ----------
    predictions : S arrays (F, V, 3)
    truth : (F, V, 3)
    """
    truth = np.asarray(truth, np.float64)
    r = np.stack([(np.asarray(p, np.float64) - truth).ravel() for p in predictions])
    return np.asarray(r @ r.T / (truth.shape[0] * truth.shape[1]))


def error_of(q: Array, weights: Any) -> float:
    """RMSE of a mixture, metres: √(wᵀ Q w)."""
    w = np.asarray(weights, float)
    return float(np.sqrt(max(0.0, w @ q @ w)))


def convex_fit(q: Array) -> tuple[Array, float]:
    """Weights ≥ 0 of sum 1 that minimise wᵀ Q w, and the root of the minimum."""
    # Without the sum fixed but with (1 − Σ w)² added, the minimum along a ray grows
    # with the value at Σ w = 1: the same direction wins, and it is least squares.
    values, vectors = np.linalg.eigh(q)
    root = np.sqrt(np.maximum(values, 0))[:, None] * vectors.T
    unit = np.sqrt(max(float(np.trace(q)) / len(q), 1e-30))
    w, _ = nnls(np.vstack([root / unit, np.ones(len(q))]), np.append(np.zeros(len(q)), 1.0))
    w = w / w.sum()
    return w, error_of(q, w)


def extremes(parameters: Any) -> list[int]:
    """Sets with at least one highest or lowest parameter."""
    p = np.asarray(parameters, float)
    spread = p.max(axis=0) > p.min(axis=0)
    found = (np.isclose(p, p.max(axis=0)) | np.isclose(p, p.min(axis=0))) & spread
    return np.flatnonzero(found.any(axis=1)).tolist() or [0]


def select_pivots(grams: Sequence[Array], parameters: Any, count: int) -> list[int]:
    """K pivots as the paper chooses them: the extremes, then the worst fitted one by one.

    A network s is fitted by the convex mixture of the pivots that comes closest
    to its own predictions on its own set.  With fewer than the extremes, those
    of them that fit all other networks best.

    Parameters
    ----------
    grams : S arrays (S, S)
        Of all networks on the frames of each set; see :func:`gram`.
    parameters : (S, P) array
    count : int
        K, 1 to S.

    Returns
    -------
    list of int
        Indices of the sets, in the order in which they were chosen.
    """
    n = len(grams)
    if not 1 <= count <= n:
        raise InputError("count", f"an integer from 1 to {n}", count)

    def misfit(s: int, pivots: Sequence[int]) -> float:
        # r_i − r_s is G_i − G_s: the truth drops out.
        q, p = grams[s], list(pivots)
        between = q[np.ix_(p, p)] - q[p, s][:, None] - q[s, p][None] + q[s, s]
        return convex_fit(between)[1]

    start = extremes(parameters)
    if count < len(start):

        def total(pivots: Iterable[int]) -> float:
            pivots = tuple(pivots)
            return sum(misfit(s, pivots) ** 2 for s in range(n) if s not in pivots)

        return list(min(itertools.combinations(start, count), key=total))
    chosen = list(start)
    while len(chosen) < count:
        rest = [s for s in range(n) if s not in chosen]
        chosen.append(max(rest, key=lambda s: misfit(s, chosen)))
    return chosen


def fit_kernel(
    grams: Sequence[Array],
    parameters: Any,
    pivots: Sequence[int],
    *,
    validation: Sequence[tuple[Array, Any]] = (),
    sigma: float = 0.5,
    steps: int = 600,
    learning_rate: float = 1e-2,
    weight_decay: float = 1e-3,
    seed: int = 0,
) -> tuple[Kernel, float]:
    """Train g, leaving one training set out at a time.

    For each training set s the mixture of the pivots other than s is compared
    with the simulation of s; with s among them a kernel that only ever picks s
    would be perfect, and nothing would be learned.

    Parameters
    ----------
    grams : S arrays (S, S)
        Of all networks against the simulation of each training set.
    parameters : (S, P) array
        Normalised.
    pivots : sequence of int
    validation : pairs (Q, θ)
        Of sets that no network was trained on; they choose the step.  Without
        any the last step is taken.

    Returns
    -------
    Kernel
    float
        The validation error (else the training error) at the chosen step, metres.
    """
    torch_state = torch.random.get_rng_state()
    torch.manual_seed(seed)
    kernel = Kernel(np.shape(parameters)[1], sigma=sigma)
    torch.random.set_rng_state(torch_state)
    p = list(pivots)
    theta = torch.as_tensor(np.asarray(parameters, float))
    places = theta[p]
    tasks = []
    for s, q in enumerate(grams):
        others = [k for k, i in enumerate(p) if i != s]
        if others:
            keep = [p[k] for k in others]
            tasks.append((places[others], theta[s], torch.as_tensor(q[np.ix_(keep, keep)])))
    checks = [
        (places, torch.as_tensor(np.asarray(t, float)), torch.as_tensor(q[np.ix_(p, p)]))
        for q, t in validation
    ]

    def mean_error(sets: list[tuple[Tensor, Tensor, Tensor]]) -> Tensor:
        errors = []
        for where, at, q in sets:
            w = kernel(where, at)
            errors.append((w @ q @ w).clamp(min=1e-16).sqrt())
        return torch.stack(errors).mean()

    if not tasks:  # one pivot that is the only set: its weight is 1 whatever g is
        return kernel, float("nan")
    optimiser = torch.optim.Adam(kernel.parameters(), lr=learning_rate, weight_decay=weight_decay)
    best, kept = float("inf"), {k: v.clone() for k, v in kernel.state_dict().items()}
    for _ in range(steps + 1):
        loss = mean_error(tasks)
        with torch.no_grad():
            value = float(mean_error(checks)) if checks else float(loss)
        if value < best or not checks:
            best, kept = value, {k: v.clone() for k, v in kernel.state_dict().items()}
        optimiser.zero_grad()
        torch.autograd.backward(loss)
        optimiser.step()
    kernel.load_state_dict(kept)
    return kernel, best


def left_out_errors(
    kernel: Kernel, grams: Sequence[Array], parameters: Any, pivots: Sequence[int]
) -> list[float]:
    """RMSE, metres, of each training set mixed from the pivots other than itself.

    A set that is the only pivot is passed over.
    """
    theta, errors = np.asarray(parameters, float), []
    for s, q in enumerate(grams):
        others = [i for i in pivots if i != s]
        if others:
            weights = kernel.weights(theta[others], theta[s])
            errors.append(error_of(q[np.ix_(others, others)], weights))
    return errors


def smallest_good(errors: Sequence[float], within: float = 0.02) -> int:
    """Smallest K (1 for the first entry) whose error is within a share of the best."""
    e = np.asarray(errors, float)
    return int(np.flatnonzero(e <= (1 + within) * np.nanmin(e))[0]) + 1
