"""Loss of a network whose output is coefficients of principal components.

For orthonormal components, ‖Ĝ − G‖² = ‖ĉ − c‖² plus the squared norm of what the components leave
of G.  The loss is ‖Ĝ − G‖ / √V, the RMSE of a frame.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ..configs.config import TrainOptions
from ..networks.gru import dropout_mask
from .batches import Batch, Track
from .loop import TrainingObjective, mixed_precision
from .losses import EXACT


class CoefficientObjective(TrainingObjective):
    """Mean over frames of ‖Ĝ − G‖ / √V, computed from coefficients.

    Parameters
    ----------
    module : torch.nn.Module
        Called with inputs ``(N, T, D)``, a state and a dropout mask ``(N, T, H)`` or None; returns
        coefficients ``(N, T, r)`` and the state.
    options : TrainOptions
    n_vertices : int
        Number of vertices V.
    hidden : int
        Width H of the dropout mask.
    dropout : float
    tracks, validation : list of Track
        Their `extra` ``(F, r + 1)`` holds the coefficients and the squared norm of what the
        components leave.
    """

    def __init__(
        self,
        module: torch.nn.Module,
        options: TrainOptions,
        n_vertices: int,
        *,
        hidden: int,
        dropout: float,
        tracks: list[Track],
        validation: list[Track],
    ) -> None:
        self.module, self.options, self.n_vertices = module, options, n_vertices
        self.hidden, self.dropout = hidden, dropout
        self.tracks, self.validation = tracks, validation

    @property
    def device(self) -> torch.device:
        return next(self.module.parameters()).device

    def _squares(self, got: Tensor, rows: Tensor) -> Tensor:
        return ((got - rows[..., :-1]).square().sum(-1) + rows[..., -1]) / self.n_vertices

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        """Loss of a batch and the GRU's new state."""
        x = batch.inputs().to(self.device)
        mask = dropout_mask(rng, (*x.shape[:2], self.hidden), self.dropout, self.device)
        with mixed_precision(self.options, self.device):
            got, state = self.module(x, state, mask)
        squares = self._squares(got.float()[batch.mask.to(x.device)], batch.extra().to(x.device))
        return (squares + EXACT).sqrt().mean(), state

    def squared_error(self, track: Track) -> Tensor:
        """Mean squared distance ``(F,)`` of the meshes, metres²."""
        got = self.module(track.inputs[None].to(self.device), None, None)[0][0]
        return self._squares(got, track.extra.to(self.device))
