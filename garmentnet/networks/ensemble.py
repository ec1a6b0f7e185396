"""The kernel that mixes networks of several simulation parameters (Pan et al. 2022, 4.4)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

__all__ = ["Kernel"]

Array = NDArray[np.float64]
# Added to a squared distance whose root must have a gradient at 0.
_SQUARE = 1e-12


class Kernel(nn.Module):
    """The RBF Ψ(θ_i, θ) of equation 4, normalised over the pivots to Ψ̄.

    Ψ = exp(−d² / (2 σ²)) with d = ‖g(θ_i) − g(θ)‖, or exp(−d / σ) as the published code has it.
    The MLP g is the published one, with one slope of the PReLU for all channels and without the
    batch normalisation, which in prediction is an affine map that the last layer can express.

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
        hidden: int = 16,
        latent: int = 4,
        *,
        sigma: float = 0.5,
        shape: Literal["gaussian", "exponential"] = "gaussian",
    ) -> None:
        super().__init__()
        self.sigma, self.shape = float(sigma), shape
        self.sizes = (inputs, hidden, latent)
        self.g = nn.Sequential(
            nn.Linear(inputs, hidden), nn.PReLU(), nn.Linear(hidden, latent)
        ).double()

    def forward(self, pivots: Tensor, theta: Tensor) -> Tensor:
        """Weights ``(..., K)`` of pivots with parameters ``(..., K, P)`` at ``(..., P)``; sum 1."""
        gap = (self.g(pivots) - self.g(theta)[..., None, :]).square().sum(-1)
        # The normalised kernel is a softmax, which does not divide by 0 where every Ψ underflows.
        if self.shape == "exponential":
            return torch.softmax(-(gap + _SQUARE).sqrt() / self.sigma, dim=-1)
        return torch.softmax(-gap / (2 * self.sigma**2), dim=-1)

    def weights(self, pivots: Any, theta: Any) -> Array:
        """Result of :meth:`forward` as an array, for arrays."""
        with torch.no_grad():
            out = self(
                torch.as_tensor(np.asarray(pivots, float)),
                torch.as_tensor(np.asarray(theta, float)),
            )
        weights: Array = np.array(out.numpy(), np.float64)
        return weights
