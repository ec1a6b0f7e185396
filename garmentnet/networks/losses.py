"""Terms of the losses, each the mean over frames (Pan et al. 2022, sections 4.2 and 4.3)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from torch import Tensor, nn

from ssdr import Skinning
from ssdr.laplacian import uniform_laplacian

from .skinning import TorchSkinning, apply_frame

__all__ = ["BodyShape", "closest_vertices", "collision_depth", "frame_norm", "mesh_laplacian"]

_PAIRS = 1 << 24  # distances held at once in the search for closest vertices


def frame_norm(difference: Tensor, mask: Tensor | None = None) -> Tensor:
    """Mean over frames of ‖d‖₂ / √V, the RMSE of a frame.

    The paper's norm is not squared; over √V it does not depend on resolution.

    Parameters
    ----------
    difference : (..., V, 3)
    mask : (...) bool, optional
        Frames that count.
    """
    # An exact fit has no direction; the floor (1 µm) keeps its gradient finite.
    norm: Tensor = (difference.square().sum(-1).mean(-1) + 1e-12).sqrt()
    if mask is None:
        return norm.mean()
    return (norm * mask).sum() / mask.sum().clamp(min=1)


def mesh_laplacian(faces: Any, n_vertices: int) -> csr_array:
    """Δ(x)_i = x_i − mean of its neighbours, by the mesh's edges; ``(V, V)`` float64."""
    laplacian = uniform_laplacian(faces, n_vertices)
    scale = 1.0 / np.maximum(laplacian.diagonal(), 1.0)
    return csr_array(laplacian.multiply(scale[:, None]))


class BodyShape(nn.Module):
    """Vertices and normals of the skinned body."""

    faces: Tensor

    def __init__(self, body: Skinning) -> None:
        super().__init__()
        self.skinning = TorchSkinning.of(body)
        self.register_buffer(
            "faces", torch.from_numpy(np.asarray(body.faces, dtype=np.int64)), persistent=False
        )

    def forward(self, joints: Tensor, frame: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Positions and unit normals ``(N, V_B, 3)`` under ``(N, J, 3, 4)``.

        With `frame` the joints are relative to it and the result is in the world.
        """
        v = self.skinning(joints)
        if frame is not None:
            v = apply_frame(frame, v)
        a, b, c = (v[:, self.faces[:, k]] for k in range(3))
        area = torch.linalg.cross(b - a, c - a, dim=-1)
        normal = torch.zeros_like(v)
        for k in range(3):
            normal = normal.index_add(1, self.faces[:, k], area)
        return v, nn.functional.normalize(normal, dim=-1, eps=1e-12)


@torch.no_grad()
def closest_vertices(points: Tensor, body: Tensor) -> Tensor:
    """Index ``(N, V)`` of the body vertex closest to each point, frame by frame."""
    if points.device.type == "cpu":
        found = [
            cKDTree(q).query(p)[1]
            for p, q in zip(points.detach().numpy(), body.detach().numpy(), strict=True)
        ]
        return torch.from_numpy(np.stack(found).astype(np.int64))
    step = max(1, _PAIRS // (points.shape[1] * body.shape[1]))
    parts = []
    for i in range(0, len(points), step):
        p, q = points[i : i + step].detach(), body[i : i + step]
        # |p − q|² less |p|²: the same minimum by one product.
        distance = torch.baddbmm(q.square().sum(-1)[:, None], p, q.transpose(1, 2), alpha=-2)
        parts.append(distance.argmin(dim=-1))
    return torch.cat(parts)


def collision_depth(vertices: Tensor, body: Tensor, normals: Tensor) -> Tensor:
    """max(−n_B·(v − v_B), 0) ``(N, V)`` with the closest body vertex; metres inside."""
    index = closest_vertices(vertices, body)[..., None].expand(*vertices.shape)
    near, normal = body.gather(1, index), normals.gather(1, index)
    return (-(normal * (vertices - near)).sum(-1)).clamp(min=0)
