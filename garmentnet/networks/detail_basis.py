"""The high-frequency module with few outputs: weights of a basis that turns with the cloth.

Detail is expressed in local frames of the skinned surface.  There, a pleat that swings round with
the hem stays the same detail; in the moving frame of the body it does not.  Principal components of
the detail are found once from the training frames, and a GRU that reads the motion of the bones
predicts their weights.  It has one output per component, instead of the 10 V global features of
the paper's published code.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..training.shapes import ShapeBasis
from .gru import GRULinear


class DetailBasis(GRULinear):
    """Mean detail and principal components in the surface's frame, weighted by a GRU.

    Parameters
    ----------
    inputs : int
        Numbers that the GRU reads in a frame: the motion of the bones.
    n_vertices : int
        Vertices whose detail is predicted.
    hidden : int
    rank : int
        Number of components.

    Examples
    --------
    >>> module = DetailBasis(6, 5, hidden=8, rank=2)
    >>> numbers, state = module(torch.zeros(1, 4, 6))
    >>> module.local(numbers[0]).shape
    torch.Size([4, 5, 3])
    """

    mean: Tensor
    basis: Tensor
    deviation: Tensor

    def __init__(self, inputs: int, n_vertices: int, *, hidden: int, rank: int) -> None:
        super().__init__(inputs, hidden, rank)
        self.register_buffer("mean", torch.zeros(n_vertices, 3))
        self.register_buffer("basis", torch.zeros(rank, 3 * n_vertices))
        self.register_buffer("deviation", torch.ones(rank))

    def forward(
        self, x: Tensor, state: Tensor | None = None, mask: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Weights of the components ``(N, T, rank)``, metres, and the state ``(1, N, H)``."""
        out, state = super().forward(x, state, mask)
        return out * self.deviation, state

    def local(self, numbers: Tensor) -> Tensor:
        """Detail ``(F, n, 3)`` in the surface's frame, metres, from weights ``(F, rank)``."""
        return (numbers @ self.basis).unflatten(-1, self.mean.shape) + self.mean

    def code(self, local: Tensor) -> tuple[Tensor, Tensor]:
        """Weights ``(F, rank)`` of detail ``(F, n, 3)``, and the squared residual ``(F,)``."""
        flat = (local - self.mean).flatten(1)
        numbers = flat @ self.basis.T
        return numbers, (flat - numbers @ self.basis).square().sum(1)

    @torch.no_grad()
    def fit(self, local: Tensor) -> None:
        """Set the mean, the components and their deviations from detail ``(F, n, 3)``.

        Components beyond the rank of the detail are 0.
        """
        found = ShapeBasis.fit(local.cpu().numpy(), len(self.basis))
        self.mean.copy_(torch.from_numpy(found.mean))
        self.basis.copy_(torch.from_numpy(found.components).flatten(1))
        self.deviation.copy_(torch.from_numpy(found.deviation).clamp(min=1e-7))
