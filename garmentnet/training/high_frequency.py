"""Losses of the high-frequency module (Pan et al. 2022, section 4.3).

    L_HF = ‖Ĝ_HF − G_HF‖ + λ_collision mean max(−n_B·(v − v_B), 0)

for the paper's module, and the first term alone for principal components of detail.  The module
learns on the low-frequency mesh that the trained low-frequency module predicts.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import torch
from torch import Tensor

from ..networks.detail_basis import DetailBasis
from ..networks.gru import dropout_mask
from ..networks.high_frequency import HighFrequency
from ..networks.losses import EXACT, BodyShape, collision_depth, frame_norm
from ..networks.network import MotionNetwork
from .batches import Batch, Track, spread
from .loop import Objective
from .precision import mixed_precision

__all__ = ["LEAST_DEVIATION", "DetailObjective", "HighFrequencyObjective"]

# Metres; the smallest deviation by which the output of a module is scaled.
LEAST_DEVIATION = 1e-4
# Frames from which mean and components are found: enough for a hundred, and a small Gram matrix.
_FRAMES = 1500


@torch.no_grad()
def _bone_motion(network: MotionNetwork, track: Track) -> Tensor:
    """Normalised bone motion ``(F, B, C)`` that the low-frequency module predicts."""
    return network.low(track.inputs[None].to(network.device))[0][0]


class HighFrequencyObjective(Objective):
    """L_HF of the paper's module, over the vertices that it predicts.

    The GRU reads every frame of a window; the loss is computed on a few frames, because the layers
    after the GRU are the expensive ones.

    Parameters
    ----------
    network : MotionNetwork
    tracks, validation : list of Track
    """

    def __init__(
        self, network: MotionNetwork, tracks: list[Track], validation: list[Track]
    ) -> None:
        assert isinstance(network.high, HighFrequency)
        self.network, self.module, self.free = network, network.high, network.free
        self.tracks = [self._with_motion(t) for t in tracks]
        self.validation = [self._with_motion(t) for t in validation]
        self.body = BodyShape(network.subject.body).to(network.device)

    def _with_motion(self, track: Track) -> Track:
        return dataclasses.replace(track, extra=_bone_motion(self.network, track).cpu())

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        """L_HF of a batch, the mean over the chosen frames, and the GRU's new state."""
        device, options = self.network.device, self.network.config.high
        lanes, frames, chosen = batch.some_frames(options.frames, rng)
        z = batch.stack([w and w.track.extra[w.frames] for w in batch.windows]).to(device)
        own = torch.stack([t.joints(f) for t, f in frames])
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
        truth = torch.stack([t.target("high", f) for t, f in frames]).to(device)
        loss = frame_norm((high[lanes] - truth)[:, :, self.free])
        if options.collision:
            body, normals = self.body(joints[lanes].flatten(0, 1))
            mesh = (low + high)[lanes][:, :, self.free].flatten(0, 1)
            loss = loss + options.collision * collision_depth(mesh, body, normals).mean()
        return loss, state

    def _low(self, z: Tensor, joints: Tensor) -> Tensor:
        """Low-frequency mesh ``(N, S, V, 3)``, with what the body carries in its place."""
        mesh = self.network.carry(self.network.mesh(z).flatten(0, 1), joints.flatten(0, 1))
        return mesh.unflatten(0, z.shape[:2])

    def squared_error(self, track: Track) -> Tensor:
        """Mean squared distance ``(F,)`` of the detail, metres².

        Not of the garment: the low frequencies' error, ten times as large, would hide it.
        """
        state, found, device = None, [], self.network.device
        for part in track.parts():
            z, joints = (a[None].to(device) for a in (track.extra[part], track.joints(part)))
            x = self.network.high_inputs(track.inputs[None, part].to(device), z)
            high, state = self.module(x, self._low(z, joints), state)
            gap = (high[0].cpu() - track.target("high", part))[:, self.free]
            found.append(gap.double().square().sum(-1).mean(-1))
        return torch.cat(found)

    def fit_statistics(self) -> None:
        """Set the mean detail of every vertex and one deviation, over the training clips."""
        total, square, frames = torch.zeros(()), 0.0, 0
        for track in self.tracks:
            high = track.target("high").double()
            total = total + high.sum(0)
            square += float(high[:, self.free].square().sum())
            frames += len(high)
        mean = total / frames
        variance = square / (3 * len(self.free) * frames) - float(mean[self.free].square().mean())
        low = self.network.mesh(self.tracks[0].extra[:1].to(self.network.device))
        self.module.mean.copy_(mean)
        self.module.deviation.fill_(max(math.sqrt(max(variance, 0.0)), LEAST_DEVIATION))
        self.module.centre.copy_(low[0].mean(0))


class DetailObjective(Objective):
    """‖Ĝ_HF − G_HF‖ of principal components, without the mesh.

    The components are orthonormal and the surface's frames are rotations, so that the norm over
    the mesh is that of the components' weights, plus what no weights can reach.

    Parameters
    ----------
    network : MotionNetwork
        Its low-frequency module is trained.
    tracks, validation : list of Track
    start : bool
        Whether the module holds a basis already, which is kept.
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
        self.network, self.module = network, network.high
        if not start:
            chosen = zip(tracks, spread([t.n_frames for t in tracks], _FRAMES), strict=True)
            parts = [
                self._local(t, _bone_motion(network, t)[frames], frames)
                for t, frames in chosen
                if len(frames)
            ]
            self.module.fit(torch.cat(parts))
        self.tracks = [self._with_targets(t) for t in tracks]
        self.validation = [self._with_targets(t) for t in validation]

    @torch.no_grad()
    def _local(self, track: Track, z: Tensor, frames: object) -> Tensor:
        """True detail ``(f, n, 3)`` in the predicted surface's frame."""
        detail = track.target("high", frames)[:, self.network.free].to(z.device)
        turns = self.network.turns(self.network.low.code(z))
        return (turns.transpose(-1, -2) @ detail[..., None])[..., 0]

    @torch.no_grad()
    def _with_targets(self, track: Track) -> Track:
        z, rows = _bone_motion(self.network, track), []
        for part in track.parts():
            numbers, rest = self.module.code(self._local(track, z[part], part))
            rows.append(torch.cat([z[part].flatten(1), numbers, rest[:, None]], dim=1).cpu())
        return dataclasses.replace(track, extra=torch.cat(rows))

    def _motion(self, rows: Tensor) -> Tensor:
        """Bone motion ``(..., B, C)`` of rows of `extra`."""
        return rows[..., : -len(self.module.basis) - 1].unflatten(-1, self.network.low.code.shape)

    def _squares(self, got: Tensor, rows: Tensor) -> Tensor:
        """Mean squared distance of the vertices in each frame, from weights and rows of `extra`."""
        numbers, rest = rows[..., -len(self.module.basis) - 1 : -1], rows[..., -1]
        return ((got - numbers).square().sum(-1) + rest) / len(self.network.free)

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        """‖Ĝ_HF − G_HF‖ of a batch, the mean over its frames, and the GRU's new state."""
        device, options = self.network.device, self.network.config.high
        rows = batch.stack([w and w.track.extra[w.frames] for w in batch.windows]).to(device)
        mask = dropout_mask(rng, (*rows.shape[:2], options.hidden), options.dropout, device)
        x = self.network.high_inputs(batch.inputs().to(device), self._motion(rows))
        with mixed_precision(self.network.config.train, device):
            got, state = self.module(x, state, mask)
        squares = self._squares(got.float(), rows)[batch.mask.to(device)]
        return (squares + EXACT).sqrt().mean(), state

    def squared_error(self, track: Track) -> Tensor:
        """Mean squared distance ``(F,)`` of the detail, metres²."""
        rows = track.extra[None].to(self.network.device)
        x = self.network.high_inputs(track.inputs[None].to(rows), self._motion(rows))
        return self._squares(self.module(x)[0], rows)[0]
