"""A GRU followed by a linear layer, the core of the low-frequency module and `DetailBasis`."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn


class GRULinear(nn.Module):
    """A GRU, dropout of its outputs in training, and a linear layer.

    Examples
    --------
    >>> out, state = GRULinear(4, 8, 3)(torch.zeros(2, 5, 4))
    >>> out.shape, state.shape
    (torch.Size([2, 5, 3]), torch.Size([1, 2, 8]))
    """

    def __init__(self, inputs: int, hidden: int, outputs: int) -> None:
        super().__init__()
        self.gru = nn.GRU(inputs, hidden, batch_first=True)
        self.out = nn.Linear(hidden, outputs)

    def forward(
        self, x: Tensor, state: Tensor | None = None, mask: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Outputs ``(N, T, outputs)`` and the GRU's last state ``(1, N, H)``.

        `mask` ``(N, T, H)`` multiplies the input of the linear layer; see :func:`dropout_mask`.
        """
        h, state = self.gru(x, state)
        return self.out(h if mask is None else h * mask), state


def dropout_mask(
    rng: np.random.Generator, shape: tuple[int, ...], share: float, device: torch.device
) -> Tensor | None:
    """Dropout factors, each 0 or 1 / (1 − share); None if `share` is 0.

    They are drawn from the generator of the training loop, whose state is saved, so that a resumed
    run draws the same factors.
    """
    if not share:
        return None
    return (torch.from_numpy(rng.random(shape, np.float32) >= share) / (1 - share)).to(device)
