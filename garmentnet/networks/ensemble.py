"""Networks of several simulation parameters as one (Pan et al. 2022, section 4.4).

All pivots share rest pose, weights and moving frame, so that
Σ Ψ̄ LBS(M_i) = LBS(Σ Ψ̄ M_i): the low-frequency mesh costs one skinning.

Everything that is learned or chosen here needs of the predictions only their
Gram matrices: for a training set s with residuals r_i = G_i − Ĝ_s of every
network i, ‖Σ w_i G_i − Ĝ_s‖² = wᵀ Q_s w with Q_s = ⟨r_i, r_j⟩, because Σ w = 1.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import nnls
from torch import Tensor, nn

from ssdr.errors import InputError

from .network import Motion, MotionNetwork, NetworkState

__all__ = [
    "Ensemble",
    "Kernel",
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

Array = NDArray[np.float64]


class Kernel(nn.Module):
    """Ψ(θ_i, θ) = exp(−‖g(θ_i) − g(θ)‖² / (2 σ²)), normalised over the pivots.

    Parameters
    ----------
    inputs : int
        Number of simulation parameters.
    hidden, latent : int
        Widths of the MLP g.
    sigma : float
        Bandwidth.
    """

    def __init__(
        self, inputs: int = 3, *, hidden: int = 16, latent: int = 4, sigma: float = 0.5
    ) -> None:
        super().__init__()
        self.sigma = float(sigma)
        self.sizes = (inputs, hidden, latent)
        self.g = nn.Sequential(
            nn.Linear(inputs, hidden), nn.Tanh(), nn.Linear(hidden, latent)
        ).double()

    def forward(self, pivots: Tensor, theta: Tensor) -> Tensor:
        """Weights ``(..., K)``, summing to 1, of pivots ``(..., K, P)`` at ``(..., P)``."""
        gap = (self.g(pivots) - self.g(theta)[..., None, :]).square().sum(-1)
        # A softmax is the normalised kernel, and safe where every Ψ underflows.
        return torch.softmax(-gap / (2 * self.sigma**2), dim=-1)

    def weights(self, pivots: Any, theta: Any) -> Array:
        """As :meth:`forward`, of arrays."""
        with torch.no_grad():
            out = self(torch.as_tensor(np.asarray(pivots, float)), torch.as_tensor(
                np.asarray(theta, float)))  # fmt: skip
        weights: Array = np.array(out.numpy(), np.float64)
        return weights


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


@dataclasses.dataclass(frozen=True, eq=False)
class Ensemble:
    """Pivot networks and the kernel that mixes them.

    Attributes
    ----------
    networks : tuple of MotionNetwork
    parameters : (K, P) float64
        Normalised parameters of the pivots.
    kernel : Kernel

    Raises
    ------
    InputError
        If the networks do not share rest pose, weights and moving frame.
    """

    networks: tuple[MotionNetwork, ...]
    parameters: Array
    kernel: Kernel

    def __post_init__(self) -> None:
        if not self.networks or len(self.networks) != len(self.parameters):
            raise InputError("networks", "as many as parameters", len(self.networks))
        first = self.networks[0]
        for other in self.networks[1:]:
            a, b = first.subject.garment, other.subject.garment
            same = (
                a.rest.shape == b.rest.shape
                and a.joints.shape == b.joints.shape
                and np.array_equal(a.rest, b.rest)
                and np.array_equal(a.joints, b.joints)
                and np.array_equal(a.weights, b.weights)
                and first.config.features.frame == other.config.features.frame
            )
            if not same:
                raise InputError("networks", "pivots of one rest pose, weights and frame", "others")

    def weights(self, theta: Any) -> Array:
        """Ψ̄ ``(K,)`` at normalised parameters."""
        return self.kernel.weights(self.parameters, theta)

    @torch.no_grad()
    def run(
        self,
        joints: Any,
        state: tuple[NetworkState, ...] | None = None,
        *,
        weights: Any,
        detail: bool = True,
    ) -> tuple[Motion, tuple[NetworkState, ...]]:
        """As :meth:`MotionNetwork.run`, mixed with the given weights."""
        w = np.asarray(weights, float)
        before = state or (None,) * len(self.networks)
        runs = [n.run(joints, s, detail=detail) for n, s in zip(self.networks, before, strict=True)]
        motions = [m for m, _ in runs]
        transforms = sum(float(a) * m.transforms for a, m in zip(w, motions, strict=True))
        assert isinstance(transforms, Tensor)
        low = torch.as_tensor(self.networks[0].lbs(transforms))
        high: Tensor | None = None
        if all(m.high is not None for m in motions):
            parts = [
                float(a) * m.high for a, m in zip(w, motions, strict=True) if m.high is not None
            ]
            high = torch.stack(parts).sum(0)
        return Motion(transforms, low, high, motions[0].frame), tuple(s for _, s in runs)

    def motions(self, joints: Any, *, weights: Any, detail: bool = True) -> list[Motion]:
        """The motion in pieces of bounded length, in order."""
        joints, state, out = np.asarray(joints), None, []
        for start in range(0, max(1, len(joints)), 128):
            part = joints[start : start + 128]
            motion, state = self.run(part, state, weights=weights, detail=detail)
            out.append(motion)
        return out

    def predict(self, joints: Any, theta: Any, *, detail: bool = True) -> NDArray[np.float32]:
        """World positions ``(F, V, 3)`` at normalised parameters."""
        parts = self.motions(joints, weights=self.weights(theta), detail=detail)
        return np.concatenate([m.vertices() for m in parts])

    def step(
        self, state: tuple[NetworkState, ...] | None, pose: Any, theta: Any
    ) -> tuple[tuple[NetworkState, ...], NDArray[np.float32]]:
        """One frame: joints ``(J, 3, 4)`` to world positions ``(V, 3)``."""
        motion, state = self.run(np.asarray(pose)[None], state, weights=self.weights(theta))
        return state, motion.vertices()[0]
