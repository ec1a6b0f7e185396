"""The low-frequency module: body motion to bone motion (Pan et al. 2022, section 4.2).

D_LF is :class:`LowFrequency`; its loss, equation 2, is :class:`LowFrequencyObjective`:

    L_LF = ‖Ĝ_LF − LBS(M_v)‖ + λ_Lap ‖Δ(Ĝ_LF) − Δ(LBS(M_v))‖

over the n vertices that the module predicts, divided by √n, and averaged over every third frame.
LBS is linear in the transforms, LBS(M_v) = A M, so both terms are norms ‖A M − G‖, each with its
own matrix and target.  :class:`_SkinnedNorm` computes them without the vertices.

Another network goes in place of :class:`LowFrequency` where `MotionNetwork.__init__` makes it, in
training and when a checkpoint is read: with its `code`, and a `forward` with the same arguments and
one tensor as state, (1, N, H), where H is the configuration's ``low.hidden``.
"""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

from ssdr.model.rigid import sixd_from_matrix

from ..networks.features import relative, transforms_in_frame
from ..networks.gru import GRULinear, dropout_mask
from ..training.batches import Batch, Track
from ..training.loop import TrainingObjective
from ..training.losses import EXACT
from ..training.targets import LowTargets
from .bones import matrix_from_euler, matrix_from_sixd

# For each encoding of rotations its width, its decoder, and the smallest deviation that bone motion
# is divided by, in degrees or none: a bone that hardly moves in training must not move wildly for
# a small output.
_ROTATIONS = {"euler": (3, matrix_from_euler, 0.5), "sixd": (6, matrix_from_sixd, 0.01)}
_LEAST_TRANSLATION = 1e-3  # metres
# Metres from its centre at which a bone's rotation is felt where it is compared with translation.
REACH = 0.1


class BoneCode(nn.Module):
    """Transforms of the bones as normalised numbers, and back.

    A bone rotates about its centre c: v = R (p − c) + t, where t is the posed centre, R c + T in
    terms of the paper.  With any other centre its translation would depend on its rotation.

    Bones of a garment that lies close follow the body: the numbers are then those of N in M = J N,
    with J the transform of the joint that each bone follows best: its motion relative to it.

    Parameters
    ----------
    centres : (B, 3) array
        Centroids, in the rest pose, of the vertices that each bone moves; metres.
    rotation : {"euler", "sixd"}
        Euler angles in degrees, or two columns of the matrix.
    follows : bool
        Whether bones follow joints.

    Examples
    --------
    >>> code = BoneCode(np.zeros((2, 3)), "sixd")
    >>> code.shape, code(torch.tensor([[[1.0, 0, 0, 0, 1, 0, 0, 0, 7]] * 2])).shape
    ((2, 9), torch.Size([1, 2, 3, 4]))
    """

    centres: Tensor
    mean: Tensor
    deviation: Tensor
    followed: Tensor | None

    def __init__(self, centres: Any, rotation: str, *, follows: bool = False) -> None:
        super().__init__()
        self.rotation = rotation
        width = _ROTATIONS[rotation][0] + 3
        self.register_buffer("centres", torch.from_numpy(np.array(centres, np.float32)))
        self.register_buffer("mean", torch.zeros(len(centres), width))
        self.register_buffer("deviation", torch.ones(len(centres), width))
        # Joint of each bone; -1: none, the moving frame.
        followed = torch.full((len(centres),), -1) if follows else None
        self.register_buffer("followed", followed)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of bones, and of numbers for each."""
        return int(self.mean.shape[0]), int(self.mean.shape[1])

    def fit(self, transforms: Any, joints: Any = None) -> None:
        """Set mean, deviation and the joints that are followed, from fitted transforms.

        A bone follows the joint, or the moving frame, relative to which it moves least.

        Parameters
        ----------
        transforms : (F, B, 3, 4) array
            Transforms of the bones in the moving frame.
        joints : (F, J, 3, 4) array, optional
            Those of the body's joints, if bones follow them.
        """
        if self.followed is not None:
            m = np.asarray(transforms, np.float64)
            centres = self.centres.double().cpu().numpy()
            spread = []
            for base in _bases(joints).swapaxes(0, 1):
                n = transforms_in_frame(m, base)
                place = np.einsum("fbij,bj->fbi", n[..., :3], centres) + n[..., 3]
                turned = REACH**2 * n[..., :3].var(axis=0).sum(axis=(1, 2))
                spread.append(place.var(axis=0).sum(axis=1) + turned)
            best = np.argmin(spread, axis=0)
            self.followed.copy_(torch.from_numpy(np.where(best < len(spread) - 1, best, -1)))
        numbers = self.numbers(transforms, joints)
        least = np.full(self.shape[1], _ROTATIONS[self.rotation][2])
        least[-3:] = _LEAST_TRANSLATION
        self.mean.copy_(torch.from_numpy(numbers.mean(axis=0)))
        self.deviation.copy_(torch.from_numpy(np.maximum(numbers.std(axis=0), least)))

    def numbers(self, transforms: Any, joints: Any = None) -> NDArray[np.float64]:
        """Rotation and translation ``(F, B, C)``, not normalised; arguments as of :meth:`fit`."""
        m = np.asarray(transforms, dtype=np.float64)
        if self.followed is not None:
            m = relative(m, _bases(joints)[:, self.followed.cpu().numpy()])
        r = m[..., :3]
        if self.rotation == "sixd":
            code = np.asarray(sixd_from_matrix(r))
        else:
            with warnings.catch_warnings():
                # In gimbal lock one angle is free; any will do.
                warnings.simplefilter("ignore", UserWarning)
                angles = Rotation.from_matrix(r.reshape(-1, 3, 3)).as_euler("xyz", degrees=True)
            code = np.asarray(angles).reshape(*r.shape[:2], 3)
        centre = np.einsum("fbij,bj->fbi", r, self.centres.double().cpu().numpy()) + m[..., 3]
        return np.concatenate([code, centre], axis=-1)

    def forward(self, z: Tensor, joints: Tensor | None = None) -> Tensor:
        """Transforms ``(..., B, 3, 4)`` in the moving frame, of normalised numbers ``(..., B, C)``.

        Bones that follow joints need those, ``(..., J, 3, 4)`` in the moving frame.
        """
        numbers = z * self.deviation + self.mean
        r = _ROTATIONS[self.rotation][1](numbers[..., :-3])
        t = numbers[..., -3:] - (r @ self.centres[..., None])[..., 0]
        if self.followed is not None:
            assert joints is not None
            still = torch.eye(3, 4, device=z.device).expand(*joints.shape[:-3], 1, 3, 4)
            base = torch.cat([joints, still], dim=-3)[..., self.followed, :, :]
            t = (base[..., :3] @ t[..., None])[..., 0] + base[..., 3]
            r = base[..., :3] @ r
        return torch.cat([r, t[..., None]], dim=-1)


def _bases(joints: Any) -> NDArray[np.float64]:
    """Joints ``(F, J, 3, 4)``, and behind them the moving frame."""
    still = np.tile(np.eye(3, 4), (len(joints), 1, 1, 1))
    return np.concatenate([np.asarray(joints, np.float64), still], axis=1)


class LowFrequency(GRULinear):
    """Network from body motion M_b to bone motion M_v, a GRU and a linear layer.

    It is D_LF of Pan et al. 2022, section 4.2.

    Parameters
    ----------
    inputs : int
    hidden : int
    code : BoneCode

    Examples
    --------
    >>> module = LowFrequency(4, 8, BoneCode(np.zeros((2, 3)), "euler"))
    >>> z, state = module(torch.zeros(1, 5, 4))
    >>> z.shape, state.shape
    (torch.Size([1, 5, 2, 6]), torch.Size([1, 1, 8]))
    """

    def __init__(self, inputs: int, hidden: int, code: BoneCode) -> None:
        bones, width = code.shape
        super().__init__(inputs, hidden, bones * width)
        self.code = code

    def forward(
        self,
        x: Tensor,
        state: Tensor | None = None,
        mask: Tensor | None = None,
        frames: slice = slice(None),
    ) -> tuple[Tensor, Tensor]:
        """Normalised bone motion ``(N, T', B, C)`` of some frames, and the last state (1, N, H).

        `mask` ``(N, T', H)`` multiplies the input of the linear layer.
        """
        h, state = self.gru(x, state)
        h = h[:, frames]
        z = self.out(h if mask is None else h * mask)
        return z.unflatten(-1, self.code.shape), state


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
        m = transforms.permute(1, 3, 0, 2).reshape(self.r.shape[1], 3 * n)
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
        self, network: Any, targets: LowTargets, tracks: list[Track], validation: list[Track]
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

        def prepared(track: Track) -> Track:
            rows = torch.from_numpy(targets.rows(track.name))
            if network.low.code.followed is not None:
                rows = torch.cat([rows.float(), track.joints().flatten(1)], dim=1)
            return dataclasses.replace(track, extra=rows)

        self.tracks = [prepared(t) for t in tracks]
        self.validation = [prepared(t) for t in validation]

    def _squares(self, z: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Mean squared distance of the vertices, and of their Laplacians, in each frame."""
        rows = rows.to(self.network.device).float()
        rows, joints = rows[:, : self._width], rows[:, self._width :].unflatten(1, (-1, 3, 4))
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
        z, state = self.module(x, state, mask, every)
        chosen = z[batch.mask[:, every].to(device)]
        position, bending = self._squares(chosen, batch.extra(every))
        loss = (position + EXACT).sqrt().mean()
        loss = loss + config.low.laplacian * (bending + EXACT).sqrt().mean()
        return loss, state

    def squared_error(self, track: Track) -> Tensor:
        """Mean squared distance ``(F,)`` of the low-frequency mesh, metres²."""
        z = self.module(track.inputs[None].to(self.network.device))[0][0]
        return self._squares(z, track.extra)[0]
