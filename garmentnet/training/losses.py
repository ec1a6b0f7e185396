"""Laplacian, norm and collision of the losses (Pan et al. 2022, sections 4.2 and 4.3).

Equation 2 itself is in :mod:`garmentnet.paper.low`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from torch import Tensor, nn

from ssdr import Skinning
from ssdr.laplacian import uniform_laplacian

from ..paper.bones import TorchSkinning

# Square of 1 µm: a fit that is exact has no direction, and its gradient must stay finite.
EXACT = 1e-12


def frame_norm(difference: Tensor) -> Tensor:
    """Mean over frames of ‖d‖₂ / √V, the RMSE of a frame.

    The paper's norm is not squared; divided by √V it does not depend on resolution.

    Parameters
    ----------
    difference : (..., V, 3)

    Examples
    --------
    >>> float(frame_norm(torch.ones(2, 5, 3)).square().round())
    3.0
    """
    return (difference.square().sum(-1).mean(-1) + EXACT).sqrt().mean()


def mesh_laplacian(faces: Any, n_vertices: int) -> csr_array:
    """The Laplacian Δ(x)_i = x_i − mean of its neighbours; ``(V, V)`` float64.

    Examples
    --------
    >>> mesh_laplacian([[0, 1, 2]], 3).toarray()[0].tolist()
    [1.0, -0.5, -0.5]
    """
    laplacian = uniform_laplacian(faces, n_vertices)
    scale = 1.0 / np.maximum(laplacian.diagonal(), 1.0)
    return csr_array(laplacian.multiply(scale[:, None]))


class BodyShape(nn.Module):
    """Vertices and normals of the skinned body, for :func:`collision_depth`."""

    faces: Tensor

    def __init__(self, body: Skinning) -> None:
        super().__init__()
        self.skinning = TorchSkinning.of(body)
        self.register_buffer(
            "faces", torch.from_numpy(np.asarray(body.faces, dtype=np.int64)), persistent=False
        )

    def forward(self, joints: Tensor) -> tuple[Tensor, Tensor]:
        """Positions and unit normals ``(N, V_B, 3)`` under joints ``(N, J, 3, 4)``."""
        v = self.skinning(joints)
        a, b, c = (v[:, self.faces[:, k]] for k in range(3))
        area = torch.linalg.cross(b - a, c - a, dim=-1)
        normal = torch.zeros_like(v)
        for k in range(3):
            normal = normal.index_add(1, self.faces[:, k], area)
        return v, nn.functional.normalize(normal, dim=-1, eps=1e-12)


@torch.no_grad()
def closest_vertices(points: Tensor, body: Tensor) -> Tensor:
    """Index ``(N, V)`` of the body vertex closest to each point of the same frame.

    Examples
    --------
    >>> body = torch.tensor([[[0.0, 0, 0], [1, 0, 0]]])
    >>> closest_vertices(torch.tensor([[[0.8, 0, 0]]]), body).tolist()
    [[1]]
    """
    if points.device.type == "cpu":
        nearest = [
            cKDTree(q).query(p)[1]
            for p, q in zip(points.detach().numpy(), body.detach().numpy(), strict=True)
        ]
        return torch.from_numpy(np.stack(nearest).astype(np.int64))
    # Frame by frame, because all distances at once would fill the memory.
    return torch.stack([torch.cdist(p, q).argmin(1) for p, q in zip(points, body, strict=True)])


def collision_depth(vertices: Tensor, body: Tensor, normals: Tensor) -> Tensor:
    """L_collision, the depth ``(N, V)`` inside the body: max(−n_B·(v − v_B), 0), metres.

    v_B is the body vertex closest to v and n_B its unit normal.

    Examples
    --------
    >>> body, normals = torch.zeros(1, 1, 3), torch.tensor([[[0.0, 1, 0]]])
    >>> collision_depth(torch.tensor([[[0.0, -0.5, 0], [0, 0.5, 0]]]), body, normals).tolist()
    [[0.5, 0.0]]
    """
    index = closest_vertices(vertices, body)[..., None].expand(*vertices.shape)
    near, normal = body.gather(1, index), normals.gather(1, index)
    return (-(normal * (vertices - near)).sum(-1)).clamp(min=0)
