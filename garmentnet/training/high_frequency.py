"""Losses of the high-frequency module (Pan et al. 2022, section 4.3).

    L_HF = ‖Ĝ_HF − G_HF‖ + λ_collision mean max(−n_B·(v − v_B), 0)

for the paper's module, and the first term alone for principal components of detail.  The module is
trained on the low-frequency mesh that the trained low-frequency module predicts.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..data.clip import spread
from ..networks.detail_basis import DetailBasis
from ..networks.gru import dropout_mask
from ..networks.high_frequency import HighFrequency
from ..networks.network import MotionNetwork
from ..networks.skinning import turn_back
from .batches import Batch, Track
from .coefficients import CoefficientObjective
from .loop import TrainingObjective, mixed_precision
from .losses import BodyShape, collision_depth, frame_norm

# Smallest deviation, metres, by which the output of a module is scaled.
LEAST_DEVIATION = 1e-4
# Number of frames from which mean and components are found: enough for a hundred components, and
# the Gram matrix stays small.
_FRAMES = 1500


@torch.no_grad()
def _bone_motion(network: MotionNetwork, track: Track) -> Tensor:
    """Normalised bone motion ``(F, B, C)`` that the low-frequency module predicts."""
    return network.low(track.inputs[None].to(network.device))[0][0]


@torch.no_grad()
def _target(network: MotionNetwork, track: Track, z: Tensor, frames: Any = slice(None)) -> Tensor:
    """Target detail Ĝ_HF ``(f, V, 3)`` of frames with predicted bone motion `z` ``(f, B, C)``.

    With ``high.target = "residual"``, the default, it is the difference of the clip from the
    predicted low-frequency mesh, with "detail" the high-frequency part of the clip.
    """
    if network.config.high.target == "detail":
        return track.detail(frames)
    return track.mesh(frames) - network.mesh(z, track.joints(frames).to(z.device)).cpu()


class HighFrequencyObjective(TrainingObjective):
    """Loss L_HF of the paper's module, over the vertices that it predicts.

    The GRU reads every frame of a window; the loss is computed on a few frames, because the layers
    after the GRU are the expensive ones.

    Parameters
    ----------
    network : MotionNetwork
    tracks, validation : list of Track
    start : bool
        Whether to keep the statistics that the module already has.
    """

    def __init__(
        self,
        network: MotionNetwork,
        tracks: list[Track],
        validation: list[Track],
        *,
        start: bool = False,
    ) -> None:
        assert isinstance(network.high, HighFrequency)
        self.network, self.module, self.free = network, network.high, network.free
        self.tracks = [self._with_motion(t) for t in tracks]
        self.validation = [self._with_motion(t) for t in validation]
        self._known: dict[str, tuple[Tensor, Tensor]] = {}
        self.body = BodyShape(network.subject.body).to(network.device)
        if not start:
            self._fit_statistics()

    def _with_motion(self, track: Track) -> Track:
        return dataclasses.replace(track, extra=_bone_motion(self.network, track).cpu())

    def _read(self, track: Track) -> tuple[Tensor, Tensor]:
        """Targets ``(F, V, 3)`` and joints ``(F, J, 3, 4)`` of a clip, read once."""
        if track.name not in self._known:
            parts = track.parts()
            found = [_target(self.network, track, track.extra[p], p).half() for p in parts]
            self._known[track.name] = torch.cat(found), track.joints()
        return self._known[track.name]

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        """Loss L_HF of a batch, averaged over the chosen frames, and the GRU's new state."""
        device, options = self.network.device, self.network.config.high
        lanes, frames, chosen = batch.some_frames(options.frames, rng)
        z = batch.stack([w.track.extra[w.frames] for w in batch.windows]).to(device)
        known = [(*self._read(t), torch.from_numpy(f)) for t, f in frames]
        own = torch.stack([joints[f] for _, joints, f in known])
        joints = torch.zeros(len(chosen), *own.shape[1:])
        joints[lanes] = own
        pick, joints = torch.from_numpy(chosen).to(device), joints.to(device)
        with torch.no_grad():
            low = self._low(z[torch.arange(len(z), device=device)[:, None], pick], joints)
        x = self.network.high_inputs(batch.inputs().to(device), z)
        mask = dropout_mask(rng, (*chosen.shape, options.hidden), options.dropout, device)
        dropped = self.module.draw_edges(rng, options.edge_dropout)
        with mixed_precision(self.network.config.train, device):
            high, state = self.module(x, low, state, pick, mask, dropped)
        high = high.float()
        truth = torch.stack([goal[f] for goal, _, f in known]).float().to(device)
        loss = frame_norm((high[lanes] - truth)[:, :, self.free])
        if options.collision:
            body, normals = self.body(joints[lanes].flatten(0, 1))
            mesh = (low + high)[lanes][:, :, self.free].flatten(0, 1)
            loss = loss + options.collision * collision_depth(mesh, body, normals).mean()
        return loss, state

    def _low(self, z: Tensor, joints: Tensor) -> Tensor:
        """Low-frequency mesh ``(N, S, V, 3)``, with bound vertices placed by the body."""
        return self.network.mesh(z, joints)

    def squared_error(self, track: Track) -> Tensor:
        """Mean squared distance ``(F,)`` of the detail, metres².

        The garment is not compared, since the error of the low frequencies is ten times as large
        and would hide that of the detail.
        """
        state, found, device = None, [], self.network.device
        for part in track.parts():
            goal, joints = (a[part] for a in self._read(track))
            z, joints = (a[None].to(device) for a in (track.extra[part], joints))
            x = self.network.high_inputs(track.inputs[None, part].to(device), z)
            high, state = self.module(x, self._low(z, joints), state)
            gap = (high[0].cpu() - goal)[:, self.free]
            found.append(gap.double().square().sum(-1).mean(-1))
        return torch.cat(found)

    def _fit_statistics(self) -> None:
        """Set each vertex's mean detail and one common deviation, from the training clips."""
        total, square, frames = torch.zeros(()), 0.0, 0
        for track in self.tracks:
            high = self._read(track)[0].double()
            total = total + high.sum(0)
            square += float(high[:, self.free].square().sum())
            frames += len(high)
        mean = total / frames
        variance = square / (3 * len(self.free) * frames) - float(mean[self.free].square().mean())
        first, device = self.tracks[0], self.network.device
        low = self.network.mesh(first.extra[:1].to(device), first.joints(slice(1)).to(device))
        self.module.mean.copy_(mean)
        self.module.deviation.fill_(max(math.sqrt(max(variance, 0.0)), LEAST_DEVIATION))
        self.module.centre.copy_(low[0].mean(0))


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
                self._local(t, _bone_motion(network, t)[frames], frames)
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
        detail = _target(self.network, track, z, frames)[:, self.network.free].to(z.device)
        joints = track.joints(frames).to(z.device)
        return turn_back(self.network.blend(z, joints)[..., self.network.free], detail)

    @torch.no_grad()
    def _coded(self, track: Track) -> Track:
        z, rows = _bone_motion(self.network, track), []
        assert isinstance(self.network.high, DetailBasis)
        for part in track.parts():
            numbers, rest = self.network.high.code(self._local(track, z[part], part))
            rows.append(torch.cat([numbers, rest[:, None]], dim=1).cpu())
        inputs = self.network.high_inputs(track.inputs.to(z.device), z).cpu()
        return dataclasses.replace(track, inputs=inputs, extra=torch.cat(rows))
