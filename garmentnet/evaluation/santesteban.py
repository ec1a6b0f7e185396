"""A recurrent baseline: offsets of the rest pose, moved by the body's joints."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ssdr.io.atomic import write_bytes

from ..configs.config import Config
from ..data.clip import Clip
from ..data.store import ClipStore
from ..data.virtual_bones import VirtualBones
from ..networks.features import transforms_in_frame
from ..networks.gru import GRU, dropout_mask
from ..networks.losses import frame_norm
from ..networks.network import FRAMES_AT_ONCE, MotionNetwork
from ..networks.skinning import apply_frame
from ..training.batches import Batch, Track, load_tracks
from ..training.high_frequency import LEAST_DEVIATION
from ..training.loop import Objective, fit
from ..training.precision import mixed_precision
from ..training.run import build_network
from .baselines import body_skinning
from .methods import Method

__all__ = ["Santesteban", "train_santesteban"]

# Against blends that are close to singular; the rotations' own AᵀA is the identity.
_RIDGE = 1e-3


class Santesteban(nn.Module, Method):
    """A GRU that predicts offsets of the rest pose, which the body's joints then skin.

    v = Σ_j w_ij M_j (p_i + o_i(t)), after Santesteban et al. 2019, "Learning-based
    animation of clothing for virtual try-on", on one body shape.

    Parameters
    ----------
    reader : MotionNetwork
        Its pose features are the input.
    store : ClipStore
    hidden : int
    """

    name = "Santesteban 2019"

    rest: Tensor
    weights: Tensor
    mean: Tensor
    deviation: Tensor

    def __init__(self, reader: MotionNetwork, store: ClipStore, hidden: int) -> None:
        super().__init__()
        skinning = body_skinning(store)
        self.reader = (reader,)  # a tuple hides its weights from this module
        self.n_vertices = skinning.n_vertices
        inputs = reader.features.size + reader.condition
        self.gru = GRU(inputs, hidden)
        self.out = nn.Linear(hidden, 3 * self.n_vertices)
        dense = np.asarray(skinning.dense_weights(), np.float32)
        self.register_buffer("weights", torch.from_numpy(dense), persistent=False)
        self.register_buffer(
            "rest", torch.from_numpy(np.array(skinning.rest, np.float32)), persistent=False
        )
        self.register_buffer("mean", torch.zeros(self.n_vertices, 3))
        self.register_buffer("deviation", torch.ones(()))

    def blended(self, joints: Tensor) -> Tensor:
        """Blended transforms ``(N, V, 3, 4)`` of joints ``(N, J, 3, 4)``."""
        flat = joints.flatten(-2).transpose(0, 1).reshape(joints.shape[1], -1)
        mixed = self.weights @ flat
        return mixed.view(self.n_vertices, -1, 3, 4).transpose(0, 1)

    def forward(
        self, x: Tensor, state: Tensor | None = None, mask: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Offsets ``(N, T, V, 3)`` in the rest pose, and the state.

        `mask` ``(N, T, H)`` multiplies what the linear layer reads, for dropout.
        """
        h, state = self.gru(x, state)
        if mask is not None:
            h = h * mask
        return self.out(h).unflatten(-1, (self.n_vertices, 3)) * self.deviation + self.mean, state

    def pose(self, offsets: Tensor, joints: Tensor) -> Tensor:
        """Positions ``(N, V, 3)`` from offsets ``(N, V, 3)`` and joints ``(N, J, 3, 4)``."""
        m, place = self.blended(joints), self.rest + offsets
        # Millions of 3×3 products are far faster written out than as a batch of matrices.
        turned = (m[..., k] * place[..., k : k + 1] for k in range(3))
        return sum(turned, m[..., 3])

    @torch.no_grad()
    def predict(self, clip: Clip) -> NDArray[np.float32]:
        (reader,) = self.reader
        features, frame, _ = reader.features(clip.joints)
        x = reader.inputs(features, None)[None].to(self.mean.device)
        offsets = self(x)[0][0].cpu()
        local = transforms_in_frame(clip.joints, frame)
        out = []
        for i in range(0, len(local), FRAMES_AT_ONCE):
            part = slice(i, i + FRAMES_AT_ONCE)
            m = torch.from_numpy(local[part]).float().to(self.mean.device)
            posed = self.pose(offsets[part].to(m), m).cpu().double()
            out.append(apply_frame(torch.from_numpy(frame[part]), posed).numpy())
        return np.concatenate(out).astype(np.float32)


class SantestebanObjective(Objective):
    """Loss and validation of the baseline, for the training loop."""

    def __init__(self, module: Santesteban, tracks: list[Track], validation: list[Track]) -> None:
        self.module: Santesteban = module
        self.tracks, self.validation = tracks, validation

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        device = self.module.mean.device
        (reader,) = self.module.reader
        x = batch.inputs().to(device)
        hidden = self.module.gru.hidden_size
        mask = dropout_mask(rng, (*x.shape[:2], hidden), reader.config.low.dropout, device)
        with mixed_precision(reader.config.train, device):
            offsets, state = self.module(x, state, mask)
        windows = [(w.track, w.frames) for w in batch.windows if w]
        truth = torch.cat([t.target("low", s) + t.target("high", s) for t, s in windows])
        joints = torch.cat([t.joints(s) for t, s in windows])
        posed = self.module.pose(offsets.float()[batch.mask.to(device)], joints.to(device))
        # What the body carries is placed by it, as in every method.
        return frame_norm((posed - truth.to(device))[:, reader.free]), state

    def squared_error(self, track: Track) -> Tensor:
        world = self.module.predict(track.clip)
        truth = track.bones.read("low") + track.bones.read("high")
        gap = (world - truth)[:, self.module.reader[0].free].astype(np.float64)
        return torch.from_numpy((gap**2).sum(axis=-1).mean(axis=-1))

    def fit_statistics(self) -> None:
        """Set mean and deviation from the offsets that reproduce the training frames."""
        total, square, frames = torch.zeros(()), 0.0, 0
        for track in self.tracks:
            truth = track.target("low") + track.target("high")
            m = self.module.blended(track.joints().to(self.module.mean.device)).cpu()
            # A blend of rotations may be close to singular: least squares with a small ridge.
            a = m[..., :3].double()
            gram = a.transpose(-1, -2) @ a + _RIDGE * torch.eye(3, dtype=torch.float64)
            right = a.transpose(-1, -2) @ (truth - m[..., 3]).double()[..., None]
            offset = torch.linalg.solve(gram, right)[..., 0] - self.module.rest.cpu()
            total = total + offset.sum(0)
            square += float(offset.square().sum())
            frames += len(offset)
        mean = total / frames
        variance = square / (mean.numel() * frames) - float(mean.square().mean())
        self.module.mean.copy_(mean)
        self.module.deviation.fill_(max(math.sqrt(max(variance, 0.0)), LEAST_DEVIATION))


def train_santesteban(
    bones: VirtualBones,
    config: Config,
    names: Sequence[str],
    validation: Sequence[str],
    folder: Path,
    *,
    callback: Any = None,
) -> Santesteban:
    """Train the baseline with the loop, features, width and limits of the network.

    Parameters
    ----------
    bones : VirtualBones
    config : Config
    names, validation : sequence of str
        Clips; mirrored ones too.
    folder : Path
        For the state: an interrupted training continues, a finished one is read.
    callback : callable, optional
        Called with a :class:`~garmentnet.training.loop.Progress` after every epoch.
    """
    folder.mkdir(parents=True, exist_ok=True)
    plain = dataclasses.replace(config, data=dataclasses.replace(config.data, condition=False))
    reader = build_network(plain, bones, names)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.train.seed)
        module = Santesteban(reader, bones.store, config.low.hidden)
    objective = SantestebanObjective(
        module, load_tracks(reader, bones, names), load_tracks(reader, bones, validation)
    )
    objective.fit_statistics()
    o = config.train
    history = fit(
        objective,
        o,
        name="santesteban",
        epochs=o.epochs,
        learning_rate=o.learning_rate,
        folder=folder,
        callback=callback,
    )
    write_bytes(folder / "history.json", json.dumps({"low": history}, indent=1).encode())
    return module
