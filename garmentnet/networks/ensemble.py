"""Networks of several simulation parameters, mixed by a kernel (Pan et al. 2022, section 4.4).

All pivots have the same rest pose, skin weights and moving frame.  LBS is linear in the transforms,
so Σ Ψ̄ LBS(M_i) = LBS(Σ Ψ̄ M_i): the low-frequency mesh is skinned once.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ssdr.errors import InputError

from .features import transforms_in_frame
from .network import Motion, MotionNetwork, NetworkState, Predictor

__all__ = ["Ensemble", "Kernel"]

Array = NDArray[np.float64]
# Added to a squared distance whose root must have a gradient at 0.
_SQUARE = 1e-12


class Kernel(nn.Module):
    """The RBF Ψ(θ_i, θ) of equation 4, normalised over the pivots to Ψ̄.

    Ψ = exp(−d² / (2 σ²)) with d = ‖g(θ_i) − g(θ)‖, or exp(−d / σ) as the published code has it.

    Parameters
    ----------
    inputs : int
        Number of simulation parameters.
    hidden, latent : int
        Widths of the MLP g.
    sigma : float
        Bandwidth, in the units of g.
    shape : {"gaussian", "exponential"}

    Examples
    --------
    >>> kernel = Kernel()
    >>> float(kernel.weights([[0.0, 0, 0], [1, 1, 1]], [0.5, 0.5, 0.5]).sum().round(6))
    1.0
    """

    def __init__(
        self,
        inputs: int = 3,
        *,
        hidden: int = 16,
        latent: int = 4,
        sigma: float = 0.5,
        shape: str = "gaussian",
    ) -> None:
        super().__init__()
        self.sigma, self.shape = float(sigma), shape
        self.sizes = (inputs, hidden, latent)
        self.g = nn.Sequential(
            nn.Linear(inputs, hidden), nn.Tanh(), nn.Linear(hidden, latent)
        ).double()

    def forward(self, pivots: Tensor, theta: Tensor) -> Tensor:
        """Weights ``(..., K)``, summing to 1, of pivots ``(..., K, P)`` at ``(..., P)``."""
        gap = (self.g(pivots) - self.g(theta)[..., None, :]).square().sum(-1)
        # The normalised kernel is a softmax, which does not divide by 0 where every Ψ underflows.
        if self.shape == "exponential":
            return torch.softmax(-(gap + _SQUARE).sqrt() / self.sigma, dim=-1)
        return torch.softmax(-gap / (2 * self.sigma**2), dim=-1)

    def weights(self, pivots: Any, theta: Any) -> Array:
        """As :meth:`forward`, for arrays."""
        with torch.no_grad():
            out = self(
                torch.as_tensor(np.asarray(pivots, float)),
                torch.as_tensor(np.asarray(theta, float)),
            )
        weights: Array = np.array(out.numpy(), np.float64)
        return weights


@dataclasses.dataclass(frozen=True, eq=False)
class Ensemble(Predictor):
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
        If the networks differ in rest pose, skin weights or moving frame.
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
            same = all(
                np.array_equal(getattr(a, k), getattr(b, k)) for k in ("rest", "indices", "weights")
            )
            if not same or first.config.features.frame != other.config.features.frame:
                raise InputError("networks", "pivots of one rest pose, weights and frame", "others")

    def weights(self, theta: Any) -> Array:
        """Ψ̄ ``(K,)`` of the pivots at normalised parameters; sums to 1."""
        return self.kernel.weights(self.parameters, theta)

    @torch.no_grad()
    def run(
        self,
        joints: Any,
        state: tuple[NetworkState, ...] | None = None,
        *,
        parameters: Any = None,
        detail: bool = True,
        frames: Any = None,
    ) -> tuple[Motion, tuple[NetworkState, ...]]:
        """As :meth:`MotionNetwork.run`, at normalised parameters; equation 3 of the paper."""
        weights = self.weights(np.asarray(parameters, float))
        states = list(state or (NetworkState(),) * len(self.networks))
        transforms: Any = 0.0
        high: Any = 0.0
        frame: Any = None
        for k, network in enumerate(self.networks):
            if weights[k] == 0:  # not run; of the pivots at least one has some
                continue
            motion, states[k] = network.run(joints, states[k], detail=detail, frames=frames)
            w, frame = float(weights[k]), motion.frame
            transforms = transforms + w * motion.transforms
            high = None if high is None or motion.high is None else high + w * motion.high
        first = self.networks[0]
        chosen = np.asarray(joints) if frames is None else np.asarray(joints)[frames]
        body = torch.from_numpy(transforms_in_frame(chosen, frame)).float().to(first.device)
        low = first.carry(first.lbs(transforms), body)
        return Motion(transforms, low, high, frame), tuple(states)
