"""Loss of the low-frequency module (Pan et al. 2022, section 4.2, equation 2).

    L_LF = ‖Ĝ_LF − LBS(M_v)‖ + λ_Lap ‖Δ(Ĝ_LF) − Δ(LBS(M_v))‖

LBS is linear in the transforms, LBS(M_v) = A M, so both terms are ‖A M − G‖ with another matrix
and another target; :class:`_SkinnedNorm` computes them without the vertices.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..networks.gru import dropout_mask
from ..networks.losses import EXACT, BodyShape, collision_depth, mesh_laplacian
from ..networks.network import MotionNetwork
from .batches import Batch, Track
from .loop import Objective
from .precision import mixed_precision

__all__ = ["LowFrequencyObjective"]


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


class LowFrequencyObjective(Objective):
    """L_LF over the vertices that the module predicts.

    Those that the body carries are exact, and so is their part of Δ.

    Parameters
    ----------
    network : MotionNetwork
    tracks, validation : list of Track
    """

    def __init__(
        self, network: MotionNetwork, tracks: list[Track], validation: list[Track]
    ) -> None:
        self.network, self.module, self.free = network, network.low, network.free
        garment = network.subject.garment
        skinned = network.lbs.matrix.double().cpu().numpy()[self.free]
        laplacian = mesh_laplacian(garment.faces, garment.n_vertices)
        self._laplacian = laplacian[self.free][:, self.free]
        self._position = _SkinnedNorm(skinned, network.device)
        self._bending = _SkinnedNorm(self._laplacian @ skinned, network.device)
        self.body = BodyShape(network.subject.body).to(network.device)
        self.tracks = [self._with_targets(t) for t in tracks]
        self.validation = [self._with_targets(t) for t in validation]

    def _with_targets(self, track: Track) -> Track:
        codes = []
        for part in track.parts():
            g = track.target("low", part).double().numpy()[:, self.free]
            bent = np.stack([self._laplacian @ frame for frame in g])
            codes.append(np.hstack([self._position.code(g), self._bending.code(bent)]))
        return dataclasses.replace(track, extra=torch.from_numpy(np.concatenate(codes)).float())

    def _squares(self, z: Tensor, code: Tensor) -> tuple[Tensor, Tensor]:
        """Mean squared distance of vertices, and of their Laplacians, for each frame."""
        transforms = self.network.low.code(z)
        terms = (self._position, self._bending)
        codes = code.to(self.network.device).split([t.size for t in terms], dim=1)
        position, bending = (t(transforms, c) for t, c in zip(terms, codes, strict=True))
        return position / len(self.free), bending / len(self.free)

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        """L_LF of a batch, the mean over its frames, and the GRU's new state."""
        device, config = self.network.device, self.network.config
        x = batch.inputs().to(device)
        mask = dropout_mask(rng, (*x.shape[:2], config.low.hidden), config.low.dropout, device)
        with mixed_precision(config.train, device):
            z, state = self.module(x, state, mask)
        z = z.float()
        position, bending = self._squares(z[batch.mask.to(device)], batch.extra())
        loss = (position + EXACT).sqrt().mean()
        loss = loss + config.low.laplacian * (bending + EXACT).sqrt().mean()
        if config.low.collision:
            lanes, frames, chosen = batch.some_frames(config.high.frames, rng)
            some = z[lanes, torch.from_numpy(chosen)[lanes].T].transpose(0, 1)
            vertices = self.network.mesh(some)[:, :, self.free].flatten(0, 1)
            joints = [t.joints(f) for t, f in frames]
            body, normals = self.body(torch.cat(joints).to(device))
            loss = loss + config.low.collision * collision_depth(vertices, body, normals).mean()
        return loss, state

    def squared_error(self, track: Track) -> Tensor:
        """Mean squared distance ``(F,)`` of the low-frequency mesh, metres²."""
        z = self.module(track.inputs[None].to(self.network.device))[0][0]
        return self._squares(z, track.extra)[0]
