"""The high-frequency module: detail on the low-frequency mesh (Pan et al. 2022, section 4.3)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

__all__ = ["EdgeConv", "HighFrequency", "neighbour_table"]


def neighbour_table(faces: Any, n_vertices: int) -> Tensor:
    """Neighbours ``(V, D)`` of every vertex by the mesh's edges.

    Short rows repeat their last neighbour, which does not change a maximum; a vertex without
    neighbours is its own.

    Examples
    --------
    >>> neighbour_table([[0, 1, 2]], 4).tolist()
    [[1, 2], [0, 2], [0, 1], [3, 3]]
    """
    faces = np.asarray(faces, dtype=np.int64)
    ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    ends = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)
    ends = ends[ends[:, 0] != ends[:, 1]]
    degree = np.bincount(ends[:, 0], minlength=n_vertices)
    first = np.concatenate([[0], np.cumsum(degree)])
    table = np.tile(np.arange(n_vertices)[:, None], (1, max(1, int(degree.max(initial=0)))))
    for k in range(table.shape[1]):
        some = degree > 0
        slot = first[:-1] + np.minimum(k, np.maximum(degree - 1, 0))
        table[some, k] = ends[slot[some], 1]
    return torch.from_numpy(table)


class _Highest(torch.autograd.Function):
    """Maximum over the neighbours; its gradient goes to the first that attains it.

    Written out because autograd would store two tensors for every neighbour.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, neighbours: Tensor) -> Tensor:
        highest = x.index_select(0, neighbours[:, 0])
        if not ctx.needs_input_grad[0]:
            for k in range(1, neighbours.shape[1]):
                torch.maximum(highest, x.index_select(0, neighbours[:, k]), out=highest)
            return highest
        winner = torch.zeros(highest.shape, dtype=torch.uint8, device=x.device)
        for k in range(1, neighbours.shape[1]):
            other = x.index_select(0, neighbours[:, k])
            winner.masked_fill_(other > highest, k)
            torch.maximum(highest, other, out=highest)
        ctx.save_for_backward(winner, neighbours)
        return highest

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor, None]:
        winner, neighbours = ctx.saved_tensors
        (slope,) = slopes
        out = torch.zeros_like(slope)
        for k in range(neighbours.shape[1]):
            out.index_add_(0, neighbours[:, k], slope * (winner == k))
        return out, None


class EdgeConv(nn.Module):
    """x_i' = max_j act(W [x_i, x_j − x_i] + b) over the neighbours j (Wang et al. 2019).

    The activation is monotone, so the maximum can be taken before it.  With W = [W_a, W_b] the
    layer is act((W_a − W_b) x_i + b + max_j W_b x_j): matrix products for every vertex instead of
    every edge, and a gather.

    Parameters
    ----------
    inputs, outputs : int
    scale : float
        Divides x_j − x_i: the mean edge length where x are positions, so that differences are
        of the size of the positions.

    Examples
    --------
    >>> layer = EdgeConv(3, 8)
    >>> layer(torch.zeros(4, 2, 3), neighbour_table([[0, 1, 2], [0, 2, 3]], 4)).shape
    torch.Size([4, 2, 8])
    """

    def __init__(self, inputs: int, outputs: int, scale: float = 1.0) -> None:
        super().__init__()
        self.linear = nn.Linear(2 * inputs, outputs)
        self.scale = scale

    def forward(self, x: Tensor, neighbours: Tensor) -> Tensor:
        """``(V, N, outputs)`` of ``(V, N, inputs)``; with vertices first a gather copies rows."""
        w_a, w_b = self.linear.weight.chunk(2, dim=1)
        w_b = w_b / self.scale
        highest: Tensor = _Highest.apply(x @ w_b.T, neighbours)
        return torch.relu(x @ (w_a - w_b).T + self.linear.bias + highest)


class HighFrequency(nn.Module):
    """Detail from global features (GRU) and local features (EdgeConv), by one MLP for all vertices.

    Parameters
    ----------
    inputs : int
        Numbers that the GRU reads in a frame: the motion of the bones.
    faces : (T, 3) int array
    n_vertices : int
    hidden : int
    global_features : int
        Of each vertex.
    edge_features : sequence of int
        Widths of the EdgeConv layers; empty: no local features.
    mlp : sequence of int
        Widths of the hidden layers.
    edge_length : float
        Mean length of an edge, metres.

    Examples
    --------
    >>> module = HighFrequency(
    ...     6, [[0, 1, 2]], 3, hidden=8, global_features=4, edge_features=[5], mlp=[8],
    ...     edge_length=0.03,
    ... )
    >>> detail, state = module(torch.zeros(1, 5, 6), torch.zeros(1, 5, 3, 3))
    >>> detail.shape
    torch.Size([1, 5, 3, 3])
    """

    neighbours: Tensor
    mean: Tensor
    deviation: Tensor
    centre: Tensor

    def __init__(
        self,
        inputs: int,
        faces: Any,
        n_vertices: int,
        *,
        hidden: int,
        global_features: int,
        edge_features: Sequence[int],
        mlp: Sequence[int],
        edge_length: float,
    ) -> None:
        super().__init__()
        self.n_vertices, self.global_features = n_vertices, global_features
        self.gru = nn.GRU(inputs, hidden, batch_first=True)
        self.spread = nn.Linear(hidden, n_vertices * global_features)
        widths = [3, *edge_features] if edge_features else []
        self.edges = nn.ModuleList(
            EdgeConv(a, b, edge_length if k == 0 else 1.0)
            for k, (a, b) in enumerate(itertools.pairwise(widths))
        )
        sizes = [global_features + (widths[-1] if widths else 0), *mlp]
        layers: list[nn.Module] = []
        for a, b in itertools.pairwise(sizes):
            layers += [nn.Linear(a, b), nn.ReLU()]
        self.mlp = nn.Sequential(*layers, nn.Linear(sizes[-1], 3))
        self.register_buffer("neighbours", neighbour_table(faces, n_vertices), persistent=False)
        self.register_buffer("mean", torch.zeros(n_vertices, 3))
        self.register_buffer("deviation", torch.ones(()))
        self.register_buffer("centre", torch.zeros(3))

    def forward(
        self, x: Tensor, low: Any, state: Tensor | None = None, frames: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Detail and new state.

        Parameters
        ----------
        x : (N, T, inputs)
        low : (N, S, V, 3)
            Low-frequency mesh of the chosen frames, in the moving frame.
        state : (1, N, H), optional
        frames : (N, S) int, optional
            Frames whose detail is computed; all by default.

        Returns
        -------
        (N, S, V, 3) metres, and (1, N, H)
        """
        h, state = self.gru(x, state)
        if frames is not None:
            h = h.gather(1, frames[..., None].expand(-1, -1, h.shape[-1]))
        lead = h.shape[:2]
        wide = torch.relu(self.spread(h)).reshape(-1, self.n_vertices, self.global_features)
        features = wide.transpose(0, 1)
        if len(self.edges):
            y = (low.reshape(-1, self.n_vertices, 3) - self.centre).transpose(0, 1).contiguous()
            for layer in self.edges:
                y = layer(y, self.neighbours)
            features = torch.cat([features, y], dim=-1)
        out = self.mlp(features).transpose(0, 1).reshape(*lead, self.n_vertices, 3)
        return out * self.deviation + self.mean, state
