"""Loss of the detail basis: all in its components, without the mesh."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import torch
from torch import Tensor

from ..networks.detail_basis import DetailBasis
from ..networks.losses import EXACT
from ..networks.network import MotionNetwork
from .batches import Batch, Track
from .objectives import dropout_mask, extra_of
from .precision import mixed_precision

__all__ = ["DetailObjective"]

# Frames of vertices in memory at once.
_FRAMES_AT_ONCE = 64
# Frames from which mean and components are found: enough for a hundred, and a small Gram matrix.
_FRAMES = 1500


class DetailObjective:
    """‖Ĝ_HF − G_HF‖ of the vertices that the module predicts.

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
            self._fit(tracks)
        self.tracks = [self._with_targets(t) for t in tracks]
        self.validation = [self._with_targets(t) for t in validation]

    @torch.no_grad()
    def _fit(self, tracks: list[Track]) -> None:
        total = sum(t.n_frames for t in tracks)
        chosen = np.unique(np.linspace(0, total - 1, min(total, _FRAMES)).astype(int))
        parts, first = [], 0
        for track in tracks:
            here = chosen[(chosen >= first) & (chosen < first + track.n_frames)] - first
            first += track.n_frames
            if len(here):
                parts.append(self._local(track, self._motion(track)[here], here))
        self.module.fit(torch.cat(parts))

    def _motion(self, track: Track) -> Tensor:
        """Normalised bone motion ``(F, B, C)`` that the low-frequency module predicts."""
        return self.network.low(track.inputs[None].to(self.network.device))[0][0]

    def _local(self, track: Track, z: Tensor, frames: object) -> Tensor:
        """True detail ``(f, n, 3)`` in the predicted surface's frame."""
        detail = track.target("high", frames)[:, self.network.free].to(z.device)
        turns = self.network.turns(self.network.low.code(z))
        return (turns.transpose(-1, -2) @ detail[..., None])[..., 0]

    @torch.no_grad()
    def _with_targets(self, track: Track) -> Track:
        z, rows = self._motion(track), []
        for i in range(0, track.n_frames, _FRAMES_AT_ONCE):
            part = slice(i, min(i + _FRAMES_AT_ONCE, track.n_frames))
            numbers, rest = self.module.code(self._local(track, z[part], part))
            rows.append(torch.cat([z[part].flatten(1), numbers, rest[:, None]], dim=1).cpu())
        return dataclasses.replace(track, extra=torch.cat(rows))

    def _parts(self, rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Bone motion ``(..., B, C)``, true weights ``(..., rank)`` and the squared rest."""
        rank = len(self.module.basis)
        z = rows[..., : -rank - 1].unflatten(-1, self.network.low.code.shape)
        return z, rows[..., -rank - 1 : -1], rows[..., -1]

    def _squares(self, got: Tensor, numbers: Tensor, rest: Tensor) -> Tensor:
        """Mean squared distance of the vertices in each frame."""
        return ((got - numbers).square().sum(-1) + rest) / len(self.network.free)

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        device, options = self.network.device, self.network.config.high
        rows = batch.stack([w and extra_of(w.track)[w.frames] for w in batch.windows]).to(device)
        z, numbers, rest = self._parts(rows)
        mask = dropout_mask(rng, (*z.shape[:2], options.hidden), options.dropout, device)
        x = self.network.high_inputs(batch.inputs().to(device), z)
        with mixed_precision(self.network.config.train, device):
            got, state = self.module(x, state, mask)
        squares = self._squares(got.float(), numbers, rest)[batch.mask.to(device)]
        return (squares + EXACT).sqrt().mean(), state

    def validate(self) -> float:
        """RMSE of the detail, of the vertices that the module predicts, metres."""
        square, count = 0.0, 0
        for track in self.validation:
            z, numbers, rest = self._parts(extra_of(track)[None].to(self.network.device))
            x = self.network.high_inputs(track.inputs[None].to(z.device), z)
            square += float(self._squares(self.module(x)[0], numbers, rest).double().sum())
            count += track.n_frames
        return math.sqrt(square / count) if count else math.nan
