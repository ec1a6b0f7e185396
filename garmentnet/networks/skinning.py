"""Linear blend skinning and rotations in torch, differentiable and on any device."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ssdr import Skinning
from ssdr.common.errors import InputError

# Columns shorter than this are divided by it instead of their length: no division by 0.
_SHORT = 1e-8


class TorchSkinning(nn.Module):
    """Linear blend skinning as one matrix product (equation 1 of the paper).

    v = A M with A = w ⊗ (p, 1), dense ``(V, 4B)``, and M the transposed
    transforms ``(4B, 3 F)`` of all frames side by side.  For about 80 bones this is
    faster than gathering K transforms per vertex, and its gradient is one product, too.

    Parameters
    ----------
    rest : (V, 3) array
    indices, weights : (V, K) arrays
    n_bones : int

    Examples
    --------
    >>> lbs = TorchSkinning([[0, 0, 0], [1, 0, 0]], [[0], [0]], [[1.0], [1.0]], n_bones=1)
    >>> lbs(torch.tensor([[[[1.0, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0]]]])).tolist()
    [[[5.0, 0.0, 0.0], [6.0, 0.0, 0.0]]]
    """

    matrix: Tensor

    def __init__(self, rest: Any, indices: Any, weights: Any, n_bones: int) -> None:
        super().__init__()
        rest, weights = np.asarray(rest, np.float64), np.asarray(weights, np.float64)
        indices = np.asarray(indices)
        n = len(rest)
        dense = np.zeros((n, n_bones))
        np.add.at(dense, (np.arange(n)[:, None], indices), weights)
        extended = np.concatenate([rest, np.ones((n, 1))], axis=1)
        matrix = (dense[:, :, None] * extended[:, None]).reshape(n, 4 * n_bones)
        self.n_bones = n_bones
        # Not in the state dict: a checkpoint has rest pose and weights, which determine it.
        self.register_buffer("matrix", torch.from_numpy(matrix).float(), persistent=False)

    @classmethod
    def of(cls, skinning: Skinning) -> TorchSkinning:
        """Module with the rest pose and weights of a skinning; its transforms are not used."""
        return cls(skinning.rest, skinning.indices, skinning.weights, skinning.n_bones)

    def forward(self, transforms: Tensor) -> Tensor:
        """Positions ``(..., V, 3)`` under transforms ``(..., B, 3, 4)``.

        Raises
        ------
        InputError
            If the transforms are not those of as many bones.
        """
        if transforms.shape[-3:] != (self.n_bones, 3, 4):
            raise InputError(
                "transforms", f"shape (..., {self.n_bones}, 3, 4)", tuple(transforms.shape)
            )
        lead = transforms.shape[:-3]
        m = transforms.reshape(-1, self.n_bones, 3, 4).permute(1, 3, 0, 2)
        posed = self.matrix @ m.reshape(4 * self.n_bones, -1)
        return (
            posed.view(len(self.matrix), -1, 3).transpose(0, 1).reshape(*lead, len(self.matrix), 3)
        )


def matrix_from_euler(degrees: Tensor) -> Tensor:
    """Rotation matrices ``(..., 3, 3)`` of Euler angles ``(..., 3)`` in degrees: Rz Ry Rx.

    Examples
    --------
    >>> matrix_from_euler(torch.tensor([0.0, 0.0, 90.0])).round().abs().tolist()
    [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    angles = torch.deg2rad(degrees)
    (sx, sy, sz), (cx, cy, cz) = angles.sin().unbind(-1), angles.cos().unbind(-1)
    rows = [
        cy * cz, sx * sy * cz - cx * sz, cx * sy * cz + sx * sz,
        cy * sz, sx * sy * sz + cx * cz, cx * sy * sz - sx * cz,
        -sy, sx * cy, cx * cy,
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(*degrees.shape, 3)


def matrix_from_sixd(sixd: Tensor) -> Tensor:
    """Rotation matrices ``(..., 3, 3)`` from two columns ``(..., 6)`` (Zhou et al. 2019).

    The columns are made orthonormal by Gram–Schmidt.

    Examples
    --------
    >>> matrix_from_sixd(torch.tensor([2.0, 0, 0, 1, 3, 0])).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    x, other = sixd[..., :3], sixd[..., 3:]
    a = nn.functional.normalize(x, dim=-1, eps=_SHORT)
    b = nn.functional.normalize(other - (a * other).sum(-1, keepdim=True) * a, dim=-1, eps=_SHORT)
    return torch.stack([a, b, torch.linalg.cross(a, b, dim=-1)], dim=-1)


def apply_frame(frame: Any, points: Any) -> Any:
    """Points ``(..., V, 3)`` from a moving frame ``(..., 3, 4)`` to the world; tensors or arrays.

    Examples
    --------
    >>> frame = torch.eye(3, 4) + torch.tensor([0.0, 0, 0, 2])
    >>> apply_frame(frame, torch.zeros(1, 3)).tolist()
    [[2.0, 2.0, 2.0]]
    """
    return points @ frame[..., :3].swapaxes(-1, -2) + frame[..., None, :, 3]


def remove_frame(frame: Any, points: Any) -> Any:
    """Points ``(..., V, 3)`` from the world to a moving frame ``(..., 3, 4)``; tensors or arrays.

    Examples
    --------
    >>> frame = torch.eye(3, 4) + torch.tensor([0.0, 0, 0, 2])
    >>> remove_frame(frame, torch.zeros(1, 3)).tolist()
    [[-2.0, -2.0, -2.0]]
    """
    return (points - frame[..., None, :, 3]) @ frame[..., :3]
