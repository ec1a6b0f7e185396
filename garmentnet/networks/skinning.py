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
    """Linear blend skinning with one matrix product (equation 1 of the paper).

    The dense weights ``(V, B)`` times the transforms ``(B, 12 F)`` of all frames side by side.  For
    about 80 bones this is faster than gathering K transforms per vertex, and its gradient is one
    product, too.

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

    rest: Tensor
    weights: Tensor

    def __init__(self, rest: Any, indices: Any, weights: Any, n_bones: int) -> None:
        super().__init__()
        self.n_bones, count = n_bones, len(np.asarray(rest))
        dense = np.zeros((count, n_bones))
        np.add.at(dense, (np.arange(count)[:, None], np.asarray(indices)), np.asarray(weights))
        # Not in the state dict: a checkpoint has rest pose and weights, which determine them.
        self.register_buffer("rest", torch.from_numpy(np.array(rest, np.float32)), persistent=False)
        self.register_buffer("weights", torch.from_numpy(dense).float(), persistent=False)

    @classmethod
    def of(cls, skinning: Skinning) -> TorchSkinning:
        """Module with the rest pose and weights of a skinning; its transforms are not used."""
        return cls(skinning.rest, skinning.indices, skinning.weights, skinning.n_bones)

    def blend(self, transforms: Tensor) -> Tensor:
        """Columns ``(..., 4, 3, V)`` of the vertices' transforms, of those ``(..., B, 3, 4)``.

        Vertices come last, so that what follows works on whole rows of memory.

        Raises
        ------
        InputError
            If the transforms are not those of as many bones.
        """
        lead = transforms.shape[:-3]
        if transforms.shape[-3:] != (self.n_bones, 3, 4):
            expected = f"shape (..., {self.n_bones}, 3, 4)"
            raise InputError("transforms", expected, tuple(transforms.shape))
        flat = transforms.transpose(-1, -2).reshape(-1, self.n_bones, 12).transpose(1, 2)
        blended = flat.reshape(-1, self.n_bones) @ self.weights.T
        return blended.view(*lead, 4, 3, -1)

    def forward(self, transforms: Tensor) -> Tensor:
        """Positions ``(..., V, 3)`` under transforms ``(..., B, 3, 4)``."""
        return moved(self.blend(transforms), self.rest)


def moved(blend: Tensor, points: Tensor, *, turned: bool = False) -> Tensor:
    """Points ``(V, 3)`` moved by columns ``(..., 4, 3, V)``, or `turned` alone: ``(..., V, 3)``."""
    a, b, c, t = blend.unbind(-3)
    x, y, z = points.T
    out = a * x + b * y + c * z
    return (out if turned else out + t).transpose(-1, -2)


def surface_frame(blend: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Orthonormal columns ``(..., 3, V)`` of a skinned surface, by Gram–Schmidt of the blend's.

    Detail turns with them: d = x a + y b + z c.
    """
    a, b = _unit(blend[..., 0, :, :], -2), blend[..., 1, :, :]
    b = _unit(b - (a * b).sum(-2, keepdim=True) * a, -2)
    return a, b, torch.linalg.cross(a, b, dim=-2)


def turn(blend: Tensor, local: Tensor) -> Tensor:
    """Detail ``(..., V, 3)`` of the frame of the surface, in the space of the transforms.

    Examples
    --------
    >>> turn(2 * torch.eye(4, 3)[..., None], torch.tensor([[1.0, 2, 3]])).tolist()
    [[1.0, 2.0, 3.0]]
    """
    x, y, z = local.unbind(-1)
    a, b, c = surface_frame(blend)
    every = a * x[..., None, :] + b * y[..., None, :] + c * z[..., None, :]
    return every.transpose(-1, -2)


def turn_back(blend: Tensor, detail: Tensor) -> Tensor:
    """Detail ``(..., V, 3)`` in the frame of the surface; the inverse of :func:`turn`."""
    d = detail.transpose(-1, -2)
    return torch.stack([(column * d).sum(-2) for column in surface_frame(blend)], dim=-1)


def _unit(x: Tensor, dim: int) -> Tensor:
    return x / x.square().sum(dim, keepdim=True).sqrt().clamp(min=_SHORT)


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
    a, other = _unit(sixd[..., :3], -1), sixd[..., 3:]
    b = _unit(other - (a * other).sum(-1, keepdim=True) * a, -1)
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
