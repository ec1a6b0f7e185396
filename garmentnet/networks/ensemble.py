"""The kernel that mixes networks of several simulation parameters (Pan et al. 2022, 4.4)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from .document import HIDDEN, LATENT

Array = NDArray[np.float64]
# Added to a squared distance whose root must have a gradient at 0.
_SQUARE = 1e-12


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
    power : {2, 1}
        Exponent of the distance: 2, or 1 as in the published code.

    Examples
    --------
    >>> kernel = Kernel()
    >>> float(kernel.weights([[0.0, 0, 0], [1, 1, 1]], [0.5, 0.5, 0.5]).sum().round(6))
    1.0
    """

    def __init__(self, inputs: int = 3, *, power: int = 2) -> None:
        super().__init__()
        self.power = power
        self.g = nn.Sequential(
            nn.Linear(inputs, HIDDEN), nn.PReLU(), nn.Linear(HIDDEN, LATENT)
        ).double()

    def forward(self, pivots: Tensor, theta: Tensor) -> Tensor:
        """Weights ``(..., K)`` of pivots with parameters ``(..., K, P)`` at ``(..., P)``; sum 1."""
        gap = (self.g(pivots) - self.g(theta)[..., None, :]).square().sum(-1)
        # The normalised kernel is a softmax, which does not divide by 0 where every Ψ underflows.
        return torch.softmax(-((gap + _SQUARE) ** (self.power / 2)), dim=-1)

    def weights(self, pivots: Any, theta: Any) -> Array:
        """Result of :meth:`forward` as an array, for arrays."""
        rows = (torch.as_tensor(np.asarray(x, float)) for x in (pivots, theta))
        with torch.no_grad():
            return np.asarray(self(*rows).numpy())
