"""Training by coefficients of principal components; of detail, in such as turn with the cloth.

For orthonormal components, ‖Ĝ − G‖² = ‖ĉ − c‖² plus the squared norm of what the components leave
of G.  The loss is ‖Ĝ − G‖ / √V, the RMSE of a frame.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from ..data.clip import spread
from ..networks.detail_basis import DetailBasis
from ..networks.gru import dropout_mask
from ..networks.network import MotionNetwork
from ..paper.bones import turn_back
from .batches import Batch, Track
from .loop import TrainingObjective
from .losses import EXACT
from .targets import bone_motion, detail_target

# Number of frames from which mean and components are found: enough for a hundred components, and
# the Gram matrix stays small.
_FRAMES = 1500


class CoefficientObjective(TrainingObjective):
    """Mean over frames of ‖Ĝ − G‖ / √V, computed from coefficients.

    Parameters
    ----------
    module : torch.nn.Module
        Called with inputs ``(N, T, D)``, a state and a dropout mask ``(N, T, H)`` or None; returns
        coefficients ``(N, T, r)`` and the state.
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
        n_vertices: int,
        *,
        hidden: int,
        dropout: float,
        tracks: list[Track],
        validation: list[Track],
    ) -> None:
        self.module, self.n_vertices = module, n_vertices
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
        got, state = self.module(x, state, mask)
        squares = self._squares(got[batch.mask.to(x.device)], batch.extra().to(x.device))
        return (squares + EXACT).sqrt().mean(), state

    def squared_error(self, track: Track) -> Tensor:
        """Mean squared distance ``(F,)`` of the meshes, metres²."""
        got = self.module(track.inputs[None].to(self.device), None, None)[0][0]
        return self._squares(got, track.extra.to(self.device))


class DetailObjective(CoefficientObjective):
    """Loss ‖Ĝ_HF − G_HF‖ for detail in principal components, computed without the mesh.

    The components are orthonormal and the surface's frames are rotations, so that the squared norm
    over the mesh is that of the components' weights, plus the squared residual of the components.

    Parameters
    ----------
    network : MotionNetwork
        A network whose low-frequency module is trained.
    tracks, validation : list of Track
    start : bool
        Whether to keep the basis that the module already has.
    """

    def __init__(
        self,
        network: MotionNetwork,
        tracks: list[Track],
        validation: list[Track],
        *,
        start: bool = False,
    ) -> None:
        assert isinstance(network.high, DetailBasis)
        self.network = network
        if not start:
            chosen = zip(tracks, spread([t.n_frames for t in tracks], _FRAMES), strict=True)
            parts = [
                self._local(t, bone_motion(network, t)[frames], frames)
                for t, frames in chosen
                if len(frames)
            ]
            network.high.fit(torch.cat(parts))
        super().__init__(
            network.high,
            len(network.free),
            hidden=network.config.high.hidden,
            dropout=network.config.high.dropout,
            tracks=[self._coded(t) for t in tracks],
            validation=[self._coded(t) for t in validation],
        )

    @torch.no_grad()
    def _local(self, track: Track, z: Tensor, frames: object) -> Tensor:
        """True detail ``(f, n, 3)`` in the local frames of the predicted surface."""
        detail = detail_target(self.network, track, z, frames)[:, self.network.free].to(z.device)
        joints = track.joints(frames).to(z.device)
        return turn_back(self.network.blend(z, joints)[..., self.network.free], detail)

    @torch.no_grad()
    def _coded(self, track: Track) -> Track:
        z, rows = bone_motion(self.network, track), []
        assert isinstance(self.network.high, DetailBasis)
        for part in track.parts():
            numbers, rest = self.network.high.code(self._local(track, z[part], part))
            rows.append(torch.cat([numbers, rest[:, None]], dim=1).cpu())
        inputs = self.network.high_inputs(track.inputs.to(z.device), z).cpu()
        return dataclasses.replace(track, inputs=inputs, extra=torch.cat(rows))
