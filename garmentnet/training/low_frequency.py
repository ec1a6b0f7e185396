"""Loss of the low-frequency module (Pan et al. 2022, section 4.2, equation 2).

    L_LF = ‖Ĝ_LF − LBS(M_v)‖ + λ_Lap ‖Δ(Ĝ_LF) − Δ(LBS(M_v))‖

Over the n vertices that the module predicts, divided by √n, and averaged over every third frame.

LBS is linear in the transforms, LBS(M_v) = A M, so both terms are norms ‖A M − G‖, each with its
own matrix and target.  :class:`_SkinnedNorm` computes them without the vertices.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..networks.gru import dropout_mask
from ..networks.network import MotionNetwork
from .batches import Batch, Track
from .loop import TrainingObjective, mixed_precision
from .losses import EXACT
from .targets import LowTargets

# The loss is computed on every third frame, which takes a third of the time.
_EVERY = 3


class _SkinnedNorm(nn.Module):
    """Squared norms ‖A M − G‖² of many frames for G = m + Σ c_k P_k, without the vertices.

    With the thin QR factorisation A = Q R it is ‖R M − Qᵀ G‖² + ‖G − Q Qᵀ G‖².  R has 4B rows, A
    has V.  Both terms are quadratic in (1, c), whose matrices are computed once.

    Parameters
    ----------
    matrix : (V, 4B) array
        Matrix A of rest pose and weights, or the product of an operator on vertices and A.
    shapes : (1 + r, V, 3) array
        Shapes m and P_k, or the products of the operator and these.
    """

    r: Tensor
    inner: Tensor
    outer: Tensor

    def __init__(self, matrix: NDArray[np.float64], shapes: NDArray[np.float64]) -> None:
        super().__init__()
        q, r = np.linalg.qr(matrix)
        inner = np.einsum("va,kvd->kad", q, shapes, optimize=True)
        rest = (shapes - np.einsum("va,kad->kvd", q, inner, optimize=True)).reshape(len(shapes), -1)
        values, vectors = np.linalg.eigh(rest @ rest.T)
        arrays = r, inner.reshape(len(shapes), -1), vectors * np.sqrt(values.clip(0))
        for name, array in zip(("r", "inner", "outer"), arrays, strict=True):
            self.register_buffer(name, torch.from_numpy(array).float())

    def forward(self, transforms: Tensor, shape: Tensor) -> Tensor:
        """Squared norms ``(N,)`` for transforms ``(N, B, 3, 4)`` and (1, c) ``(N, 1 + r)``."""
        n = len(transforms)
        m = transforms.permute(1, 3, 0, 2).reshape(len(self.r), 3 * n)
        target = (shape @ self.inner).view(n, -1, 3).transpose(0, 1)
        gap = (self.r @ m).view(-1, n, 3) - target
        return gap.square().sum((0, 2)) + (shape @ self.outer).square().sum(1)


class LowFrequencyObjective(TrainingObjective):
    """Loss L_LF over the vertices that the module predicts.

    Vertices bound to the body are exact, and so is their part of Δ.  Targets are coefficients of
    principal components.  The squared norms of what these leave, 1 to 2 mm, are added as if
    LBS(M_v) had no part in it.

    Parameters
    ----------
    network : MotionNetwork
    targets : LowTargets
    tracks, validation : list of Track
    """

    def __init__(
        self,
        network: MotionNetwork,
        targets: LowTargets,
        tracks: list[Track],
        validation: list[Track],
    ) -> None:
        self.network, self.module, self.free = network, network.low, network.free
        basis, laplacian = targets.basis, targets.laplacian
        lbs, count = network.skinning, network.subject.garment.n_bones
        weights, rest = (x.double().cpu().numpy()[self.free] for x in (lbs.weights, lbs.rest))
        extended = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
        skinned = (weights[:, :count, None] * extended[:, None]).reshape(len(rest), -1)
        shapes = np.concatenate([basis.mean[None], basis.components])[:, self.free].astype(float)
        bent = laplacian @ shapes.transpose(1, 0, 2).reshape(len(self.free), -1)
        bent = bent.reshape(len(self.free), -1, 3).transpose(1, 0, 2)
        self._position = _SkinnedNorm(skinned, shapes).to(network.device)
        self._bending = _SkinnedNorm(laplacian @ skinned, bent).to(network.device)

        self._width = basis.rank + 2
        followed = network.low.code.followed
        self._followed = None if followed is None else followed[followed >= 0].unique()

        def prepared(track: Track) -> Track:
            rows = torch.from_numpy(targets.rows(track.name))
            if self._followed is not None:
                # Bits of single precision in columns of half precision: all frames are in memory.
                joints = track.joints()[:, self._followed.cpu()].flatten(1)
                rows = torch.cat([rows, joints.view(torch.float16)], dim=1)
            return dataclasses.replace(track, extra=rows)

        self.tracks = [prepared(t) for t in tracks]
        self.validation = [prepared(t) for t in validation]

    def _squares(self, z: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Mean squared distance of the vertices, and of their Laplacians, in each frame."""
        rows = rows.to(self.network.device)
        rows, behind = rows[:, : self._width].float(), rows[:, self._width :].contiguous()
        joints = None
        if self._followed is not None:
            joints = rows.new_zeros(len(rows), self.network.subject.skeleton.n_joints, 3, 4)
            some = (len(rows), len(self._followed), 3, 4)
            joints[:, self._followed] = behind.view(torch.float32).view(some)
        transforms = self.network.low.code(z, joints)
        shape = torch.cat([torch.ones_like(rows[:, :1]), rows[:, :-2]], dim=1)
        position, bending = (t(transforms, shape) for t in (self._position, self._bending))
        position, bending = position + rows[:, -2] ** 2, bending + rows[:, -1] ** 2
        return position / len(self.free), bending / len(self.free)

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        """Loss L_LF of a batch, averaged over frames, and the GRU's new state."""
        device, config = self.network.device, self.network.config
        x = batch.inputs().to(device)
        # Consecutive frames are alike, so some of them suffice; the GRU reads all.
        longest = int(batch.mask.sum(1).max())
        every = slice(int(rng.integers(min(_EVERY, longest))), None, _EVERY)
        shape = (*batch.mask[:, every].shape, config.low.hidden)
        mask = dropout_mask(rng, shape, config.low.dropout, device)
        with mixed_precision(config.train, device):
            z, state = self.module(x, state, mask, every)
        chosen = z.float()[batch.mask[:, every].to(device)]
        position, bending = self._squares(chosen, batch.extra(every))
        loss = (position + EXACT).sqrt().mean()
        loss = loss + config.low.laplacian * (bending + EXACT).sqrt().mean()
        return loss, state

    def squared_error(self, track: Track) -> Tensor:
        """Mean squared distance ``(F,)`` of the low-frequency mesh, metres²."""
        z = self.module(track.inputs[None].to(self.network.device))[0][0]
        return self._squares(z, track.extra)[0]
