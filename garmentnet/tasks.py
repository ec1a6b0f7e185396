"""What the training loop minimises: the losses of the two modules and their validation."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import torch
from torch import Tensor

from .losses import BodyShape, MeshLaplacian, collision_depth, frame_norm
from .network import MotionNetwork
from .streams import Batch, Track

__all__ = ["HighTask", "LowTask"]


class LowTask:
    """The low-frequency module: ‖Ĝ_LF − G_LF‖ + λ_Lap ‖Δ(Ĝ_LF) − Δ(G_LF)‖."""

    def __init__(
        self, network: MotionNetwork, tracks: list[Track], validation: list[Track]
    ) -> None:
        self.network, self.module = network, network.low
        self.tracks, self.validation = tracks, validation
        garment = network.subject.garment
        self.laplacian = MeshLaplacian(garment.faces, garment.n_vertices).to(network.device)
        self.weight = network.config.low.laplacian

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        device = self.network.device
        z, state = self.module(batch.inputs().to(device), state)
        mask = batch.mask.to(device)
        targets = [w[0].target("low", slice(w[1], w[2])) for w in batch.windows if w]
        difference = self.network.mesh(z[mask]) - torch.cat(targets).to(device)
        loss = frame_norm(difference)
        if self.weight:
            loss = loss + self.weight * frame_norm(self.laplacian(difference))
        return loss, state

    def validate(self) -> float:
        square, count = 0.0, 0
        for track in self.validation:
            z = self.module(track.inputs[None].to(self.network.device))[0][0]
            for i in range(0, track.n_frames, 128):
                part = slice(i, min(i + 128, track.n_frames))
                gap = self.network.mesh(z[part]).cpu() - track.target("low", part)
                square += float(gap.double().square().sum())
                count += gap.shape[0] * gap.shape[1]
        return math.sqrt(square / count)


class HighTask:
    """The high-frequency module on the output of the low one: position and collision.

    The GRU reads every frame of a window; the loss looks at a few, for the
    module's last layers are its cost.
    """

    def __init__(
        self, network: MotionNetwork, tracks: list[Track], validation: list[Track]
    ) -> None:
        assert network.high is not None
        self.network, self.module = network, network.high
        self.tracks = [self._with_motion(t) for t in tracks]
        self.validation = [self._with_motion(t) for t in validation]
        self.body = BodyShape(network.subject.body).to(network.device)

    @torch.no_grad()
    def _with_motion(self, track: Track) -> Track:
        z = self.network.low(track.inputs[None].to(self.network.device))[0][0]
        return dataclasses.replace(track, extra=z.cpu())

    def _inputs(self, x: Tensor, z: Tensor) -> Tensor:
        device = self.network.device
        return self.network.high_inputs(x.to(device), z.to(device))

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        device, options = self.network.device, self.network.config.high
        lanes = [k for k, w in enumerate(batch.windows) if w]
        windows = [w for w in batch.windows if w]
        # As many frames of every lane, with repeats where a window is shorter.
        chosen = np.zeros((len(batch.windows), options.frames), int)
        for k, w in zip(lanes, windows, strict=True):
            length = w[2] - w[1]
            short = length < options.frames
            chosen[k] = np.sort(rng.choice(length, options.frames, replace=short))
        z = batch.stack([w and _extra(w[0])[w[1] : w[2]] for w in batch.windows])
        pick = torch.from_numpy(chosen)
        with torch.no_grad():
            index = pick[:, :, None, None].expand(-1, -1, *z.shape[2:])
            low = self.network.mesh(z.gather(1, index).to(device))
        x = self._inputs(batch.inputs(), z)
        high, state = self.module(x, low, state, pick.to(device))
        frames = [w[1] + chosen[k] for k, w in zip(lanes, windows, strict=True)]
        wanted = [w[0].target("high", f) for w, f in zip(windows, frames, strict=True)]
        truth = torch.stack(wanted).to(device)
        loss = frame_norm(high[lanes] - truth)
        if options.collision:
            joints = torch.cat([w[0].joints(f) for w, f in zip(windows, frames, strict=True)])
            body, normals = self.body(joints.to(device))
            mesh = (low + high)[lanes].flatten(0, 1)
            loss = loss + options.collision * collision_depth(mesh, body, normals).mean()
        return loss, state

    def validate(self) -> float:
        """RMSE of all, low and high: what the high-frequency module is there to lower."""
        square, count = 0.0, 0
        for track in self.validation:
            state, z = None, _extra(track)
            for i in range(0, track.n_frames, 64):
                part = slice(i, min(i + 64, track.n_frames))
                low = self.network.mesh(z[part].to(self.network.device))[None]
                x = self._inputs(track.inputs[None, part], z[None, part])
                high, state = self.module(x, low, state)
                truth = track.target("low", part) + track.target("high", part)
                gap = (low + high)[0].cpu() - truth
                square += float(gap.double().square().sum())
                count += gap.shape[0] * gap.shape[1]
        return math.sqrt(square / count)

    def fit_statistics(self) -> None:
        """Mean of every vertex's detail and one deviation, over the training clips."""
        total, square, frames = torch.zeros(()), 0.0, 0
        for track in self.tracks:
            high = track.target("high").double()
            total = total + high.sum(0)
            square += float(high.square().sum())
            frames += len(high)
        mean = total / frames
        variance = square / (mean.numel() * frames) - float(mean.square().mean())
        low = self.network.mesh(_extra(self.tracks[0])[:1].to(self.network.device))
        self.module.mean.copy_(mean)
        self.module.deviation.fill_(max(math.sqrt(max(variance, 0.0)), 1e-4))
        self.module.centre.copy_(low[0].mean(0))


def _extra(track: Track) -> Tensor:
    assert track.extra is not None
    return track.extra
