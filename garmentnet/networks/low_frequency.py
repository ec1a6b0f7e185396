"""The low-frequency module: body motion to bone motion (Pan et al. 2022, section 4.2)."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

from ssdr.errors import InputError
from ssdr.rigid import sixd_from_matrix

from .gru import GRULinear
from .skinning import matrix_from_euler, matrix_from_sixd

__all__ = ["BoneCode", "LowFrequency"]

# For each encoding of rotations its width, its decoder, and the smallest deviation that bone motion
# is divided by, in degrees or none: a bone that hardly moves in training must not move wildly for
# a small output.
_ROTATIONS = {"euler": (3, matrix_from_euler, 0.5), "sixd": (6, matrix_from_sixd, 0.01)}
_LEAST_TRANSLATION = 1e-3  # metres


class BoneCode(nn.Module):
    """Transforms of the bones as normalised numbers, and back.

    A bone rotates about its centre c: v = R (p − c) + t.  With any other centre its translation
    would depend on its rotation.

    Parameters
    ----------
    centres : (B, 3) array
        Centroids, in the rest pose, of the vertices that each bone moves; metres.
    rotation : {"euler", "sixd"}
        Euler angles in degrees, or two columns of the matrix.

    Examples
    --------
    >>> code = BoneCode(np.zeros((2, 3)), "sixd")
    >>> code.shape, code(torch.tensor([[[1.0, 0, 0, 0, 1, 0, 0, 0, 7]] * 2])).shape
    ((2, 9), torch.Size([1, 2, 3, 4]))
    """

    centres: Tensor
    mean: Tensor
    deviation: Tensor

    def __init__(self, centres: Any, rotation: str) -> None:
        super().__init__()
        self.rotation = rotation
        width = _ROTATIONS[rotation][0] + 3
        self.register_buffer("centres", torch.from_numpy(np.array(centres, np.float32)))
        self.register_buffer("mean", torch.zeros(len(centres), width))
        self.register_buffer("deviation", torch.ones(len(centres), width))

    @property
    def shape(self) -> tuple[int, int]:
        """Number of bones, and of numbers for each."""
        return int(self.mean.shape[0]), int(self.mean.shape[1])

    def fit(self, transforms: Any) -> None:
        """Set mean and deviation from fitted transforms ``(F, B, 3, 4)``."""
        numbers = self.numbers(transforms)
        least = np.full(self.shape[1], _ROTATIONS[self.rotation][2])
        least[-3:] = _LEAST_TRANSLATION
        self.mean.copy_(torch.from_numpy(numbers.mean(axis=0)))
        self.deviation.copy_(torch.from_numpy(np.maximum(numbers.std(axis=0), least)))

    def numbers(self, transforms: Any) -> NDArray[np.float64]:
        """Rotation and translation ``(F, B, C)`` of transforms, not normalised."""
        m = np.asarray(transforms, dtype=np.float64)
        if m.shape[1:] != (self.shape[0], 3, 4):
            raise InputError("transforms", f"shape (F, {self.shape[0]}, 3, 4)", m.shape)
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

    def forward(self, z: Tensor) -> Tensor:
        """Transforms ``(..., B, 3, 4)`` of normalised numbers ``(..., B, C)``."""
        numbers = z * self.deviation + self.mean
        r = _ROTATIONS[self.rotation][1](numbers[..., :-3])
        t = numbers[..., -3:] - (r @ self.centres[..., None])[..., 0]
        return torch.cat([r, t[..., None]], dim=-1)


class LowFrequency(GRULinear):
    """D_LF: body motion M_b to bone motion M_v by a GRU and a linear layer (section 4.2).

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
