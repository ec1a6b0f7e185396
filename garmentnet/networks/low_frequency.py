"""The low-frequency module: body motion to bone motion (Pan et al. 2022, section 4.2)."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

from ssdr.common.errors import InputError
from ssdr.model.rigid import sixd_from_matrix

from .features import relative, transforms_in_frame
from .gru import GRULinear
from .skinning import matrix_from_euler, matrix_from_sixd

# For each encoding of rotations its width, its decoder, and the smallest deviation that bone motion
# is divided by, in degrees or none: a bone that hardly moves in training must not move wildly for
# a small output.
_ROTATIONS = {"euler": (3, matrix_from_euler, 0.5), "sixd": (6, matrix_from_sixd, 0.01)}
_LEAST_TRANSLATION = 1e-3  # metres
# Metres from its centre at which a bone's rotation is felt where it is compared with translation.
REACH = 0.1


class BoneCode(nn.Module):
    """Transforms of the bones as normalised numbers, and back.

    A bone rotates about its centre c: v = R (p − c) + t.  With any other centre its translation
    would depend on its rotation.

    Bones of a garment that lies close follow the body: the numbers are then those of N in M = J N,
    with J the transform of the joint that each bone follows best: what skinning by it leaves.

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
        if m.shape[1:] != (self.shape[0], 3, 4):
            raise InputError("transforms", f"shape (F, {self.shape[0]}, 3, 4)", m.shape)
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
