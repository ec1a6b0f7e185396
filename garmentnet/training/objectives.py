"""Losses of the two modules, and their validation errors."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..networks.high_frequency import HighFrequency
from ..networks.losses import EXACT, BodyShape, collision_depth, frame_norm, mesh_laplacian
from ..networks.network import MotionNetwork
from .batches import Batch, Track
from .precision import mixed_precision

__all__ = [
    "LEAST_DEVIATION",
    "HighFrequencyObjective",
    "LowFrequencyObjective",
    "dropout_mask",
    "extra_of",
]

# Metres; the smallest deviation by which the output of a module is scaled.
LEAST_DEVIATION = 1e-4
# Frames of vertices in memory at once.
_FRAMES_AT_ONCE = 64


class _SkinnedNorm:
    """‖A M − G‖² of many frames, exact and without the vertices.

    With the thin QR factorisation A = Q R it is ‖R M − Qᵀ G‖² + ‖G − Q Qᵀ G‖².  R has 4B rows, A
    has V.  Qᵀ G and the last term do not depend on M and are computed once for every frame.

    Parameters
    ----------
    matrix : (V, 4B) array
        Rest pose and weights as one matrix, or an operator on vertices times that.
    """

    def __init__(self, matrix: NDArray[np.float64], device: torch.device) -> None:
        self._q, r = np.linalg.qr(matrix)
        self._r = torch.from_numpy(r).float().to(device)
        self.size = 3 * len(r) + 1

    def code(self, targets: NDArray[np.float64]) -> NDArray[np.float64]:
        """Qᵀ G and ‖G − Q Qᵀ G‖² of frames ``(F, V, 3)``, as rows ``(F, size)``."""
        flat = targets.transpose(1, 0, 2).reshape(targets.shape[1], -1)
        inner = self._q.T @ flat
        # Pythagoras; in double precision what the difference of squares loses is far below 1 µm.
        rest = (flat**2).sum(axis=0) - (inner**2).sum(axis=0)
        rest = np.maximum(rest, 0.0).reshape(-1, 3).sum(axis=1)
        inner = inner.reshape(len(inner), -1, 3).transpose(1, 0, 2)
        return np.concatenate([inner.reshape(len(targets), -1), rest[:, None]], axis=1)

    def __call__(self, transforms: Tensor, code: Tensor) -> Tensor:
        """Squared norms ``(N,)`` for transforms ``(N, B, 3, 4)``."""
        n = len(transforms)
        m = transforms.permute(1, 3, 0, 2).reshape(self._r.shape[1], 3 * n)
        gap = (self._r @ m).view(-1, n, 3) - code[:, :-1].view(n, -1, 3).transpose(0, 1)
        return gap.square().sum((0, 2)) + code[:, -1]


class LowFrequencyObjective:
    """Loss of the low-frequency module: ‖Ĝ_LF − G_LF‖ + λ_Lap ‖Δ(Ĝ_LF) − Δ(G_LF)‖.

    Over the vertices that the module predicts; those that the body carries are exact, and so is
    their part of Δ.

    Parameters
    ----------
    network : MotionNetwork
    tracks, validation : list of Track
    """

    def __init__(
        self, network: MotionNetwork, tracks: list[Track], validation: list[Track]
    ) -> None:
        self.network, self.module = network, network.low
        garment = network.subject.garment
        self.weight = network.config.low.laplacian
        self._free = network.free
        self._count = len(self._free)
        skinned = network.lbs.matrix.double().cpu().numpy()[self._free]
        laplacian = mesh_laplacian(garment.faces, garment.n_vertices)
        self._laplacian = laplacian[self._free][:, self._free]
        self.body = BodyShape(network.subject.body).to(network.device)
        self._position = _SkinnedNorm(skinned, network.device)
        self._detail = _SkinnedNorm(self._laplacian @ skinned, network.device)
        self.tracks = [self._with_targets(t) for t in tracks]
        self.validation = [self._with_targets(t) for t in validation]

    def _with_targets(self, track: Track) -> Track:
        codes = []
        for i in range(0, track.n_frames, _FRAMES_AT_ONCE):
            part = slice(i, min(i + _FRAMES_AT_ONCE, track.n_frames))
            g = track.target("low", part).double().numpy()[:, self._free]
            flat = g.transpose(1, 0, 2).reshape(self._count, -1)
            bent = (self._laplacian @ flat).reshape(self._count, -1, 3).transpose(1, 0, 2)
            codes.append(np.hstack([self._position.code(g), self._detail.code(bent)]))
        return dataclasses.replace(track, extra=torch.from_numpy(np.concatenate(codes)).float())

    def _norms(self, z: Tensor, code: Tensor) -> tuple[Tensor, Tensor]:
        """Mean squared distance of vertices, and of their Laplacians, for each frame."""
        transforms, code = self.network.low.code(z), code.to(self.network.device)
        first, second = code.split([self._position.size, self._detail.size], dim=1)
        return (
            self._position(transforms, first) / self._count,
            self._detail(transforms, second) / self._count,
        )

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        device, hidden = self.network.device, self.module.gru.hidden_size
        x = batch.inputs().to(device)
        share = self.network.config.low.dropout
        mask = dropout_mask(rng, (*x.shape[:2], hidden), share, device)
        with mixed_precision(self.network.config.train, device):
            z, state = self.module(x, state, mask)
        z = z.float()
        code = torch.cat([extra_of(w.track)[w.frames] for w in batch.windows if w])
        position, detail = self._norms(z[batch.mask.to(z.device)], code)
        loss = (position + EXACT).sqrt().mean()
        if self.weight:
            loss = loss + self.weight * (detail + EXACT).sqrt().mean()
        options = self.network.config.low
        if options.collision:
            lanes, frames, chosen = _some_frames(batch, options.frames, rng)
            some = z[lanes, torch.from_numpy(chosen)[lanes].T].transpose(0, 1)
            vertices = self.network.mesh(some)[:, :, self._free].flatten(0, 1)
            windows = [w for w in batch.windows if w]
            joints = [w.track.joints(f) for w, f in zip(windows, frames, strict=True)]
            body, normals = self.body(torch.cat(joints).to(z.device))
            loss = loss + options.collision * collision_depth(vertices, body, normals).mean()
        return loss, state

    def validate(self) -> float:
        """RMSE of the low-frequency mesh, metres; NaN without validation clips."""
        square, count = 0.0, 0
        for track in self.validation:
            z = self.module(track.inputs[None].to(self.network.device))[0][0]
            position, _ = self._norms(z, extra_of(track))
            square += float(position.double().sum())
            count += track.n_frames
        return math.sqrt(square / count) if count else math.nan


class HighFrequencyObjective:
    """Loss of the high-frequency module on the low-frequency mesh: position and collision.

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
        lanes, frames, chosen = _some_frames(batch, options.frames, rng)
        windows = [w for w in batch.windows if w]
        z = batch.stack([w and extra_of(w.track)[w.frames] for w in batch.windows])
        joints = torch.zeros(*chosen.shape, *windows[0].track.joints([0]).shape[1:])
        for k, w, f in zip(lanes, windows, frames, strict=True):
            joints[k] = w.track.joints(f)
        pick, joints = torch.from_numpy(chosen), joints.to(device)
        with torch.no_grad():
            index = pick[:, :, None, None].expand(-1, -1, *z.shape[2:])
            low = self._low(z.gather(1, index).to(device), joints)
        x = self._inputs(batch.inputs(), z)
        dropped = self.module.draw(
            rng, (len(chosen), options.frames), hidden=options.dropout, edges=options.edge_dropout
        )
        with mixed_precision(self.network.config.train, device):
            high, state = self.module(x, low, state, pick.to(device), dropped)
        high = high.float()
        targets = [w.track.target("high", f) for w, f in zip(windows, frames, strict=True)]
        truth = torch.stack(targets).to(device)
        gap = high[lanes] - truth
        loss = frame_norm(gap[:, :, self.network.free])
        if options.collision:
            body, normals = self.body(joints[lanes].flatten(0, 1))
            mesh = (low + high)[lanes][:, :, self.network.free].flatten(0, 1)
            loss = loss + options.collision * collision_depth(mesh, body, normals).mean()
        return loss, state

    def _low(self, z: Tensor, joints: Tensor) -> Tensor:
        """Low-frequency mesh ``(N, S, V, 3)``, with what the body carries in its place."""
        mesh, _ = self.network.carry(self.network.mesh(z).flatten(0, 1), None, joints.flatten(0, 1))
        return mesh.unflatten(0, z.shape[:2])

    def validate(self) -> float:
        """RMSE of the detail, of the vertices that the module predicts, metres.

        Not of the garment: the low frequencies' error, ten times as large, would hide it.
        """
        square, count, free = 0.0, 0, self.network.free
        for track in self.validation:
            state, z = None, extra_of(track)
            for i in range(0, track.n_frames, _FRAMES_AT_ONCE):
                part = slice(i, min(i + _FRAMES_AT_ONCE, track.n_frames))
                joints = track.joints(part)[None].to(self.network.device)
                low = self._low(z[None, part].to(self.network.device), joints)
                x = self._inputs(track.inputs[None, part], z[None, part])
                high, state = self.module(x, low, state)
                gap = (high[0].cpu() - track.target("high", part))[:, free]
                square += float(gap.double().square().sum())
                count += gap.shape[0] * gap.shape[1]
        return math.sqrt(square / count) if count else math.nan

    def fit_statistics(self) -> None:
        """Set the mean detail of every vertex and one deviation, over the training clips."""
        total, square, frames = torch.zeros(()), 0.0, 0
        free = self.network.free
        for track in self.tracks:
            high = track.target("high").double()
            total = total + high.sum(0)
            square += float(high[:, free].square().sum())
            frames += len(high)
        mean = total / frames
        variance = square / (3 * len(free) * frames) - float(mean[free].square().mean())
        low = self.network.mesh(extra_of(self.tracks[0])[:1].to(self.network.device))
        self.module.mean.copy_(mean)
        self.module.deviation.fill_(max(math.sqrt(max(variance, 0.0)), LEAST_DEVIATION))
        self.module.centre.copy_(low[0].mean(0))


def dropout_mask(
    rng: np.random.Generator, shape: tuple[int, ...], share: float, device: torch.device
) -> Tensor | None:
    """Factors 0 and 1 / (1 − share); None where nothing is left out.

    Drawn from the loop's generator, whose state is saved: a resumed run draws the same.
    """
    if not share:
        return None
    return (torch.from_numpy(rng.random(shape, np.float32) >= share) / (1 - share)).to(device)


def _some_frames(
    batch: Batch, count: int, rng: np.random.Generator
) -> tuple[list[int], list[NDArray[np.int64]], NDArray[np.int64]]:
    """Frames for the terms that are too expensive for all.

    Returns
    -------
    lanes : list of int
        Those that hold a window.
    frames : list of (S,) int arrays
        For each of them, the chosen frames of its track.
    chosen : (N, S) int array
        Likewise for every lane, counted from the window's start.
    """
    lanes = [k for k, w in enumerate(batch.windows) if w]
    chosen, frames = np.zeros((len(batch.windows), count), np.int64), []
    for k in lanes:
        w = batch.windows[k]
        assert w is not None
        length = w.stop - w.start
        # Some twice where a window is shorter.
        chosen[k] = np.sort(rng.choice(length, count, replace=length < count))
        frames.append(w.start + chosen[k])
    return lanes, frames, chosen


def extra_of(track: Track) -> Tensor:
    """What the objective computed beforehand for every frame of a track."""
    assert track.extra is not None
    return track.extra
