"""Training of detail in principal components that turn with the cloth."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from ..data.clip import spread
from ..networks.detail_basis import DetailBasis
from ..networks.network import MotionNetwork
from ..paper.bones import turn_back
from .batches import Track
from .coefficients import CoefficientObjective
from .targets import bone_motion, detail_target

# Number of frames from which mean and components are found: enough for a hundred components, and
# the Gram matrix stays small.
_FRAMES = 1500


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
            network.config.train,
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
