"""The high-frequency module: detail on the low-frequency mesh (Pan et al. 2022, section 4.3).

D_HF is :class:`HighFrequency` with its :class:`EdgeConv` layers; its loss is
:class:`HighFrequencyObjective`:

    L_HF = ‖target − G_HF‖ + λ_collision mean max(−n_B·(v − v_B), 0)

on the low-frequency mesh that the trained low-frequency module predicts, with a weight of our own
for the second term.  By default the target is all that this mesh leaves of the garment, Ĝ − G_LF,
not the high-frequency part alone (``high.target``).

Of the presets `faithful` alone has this module.  :mod:`garmentnet.networks.detail_basis`, which the
others have, predicts coefficients of principal components of the detail.  `MotionNetwork.add_high`
chooses between them, and is where others go.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ..configs.config import HighOptions
from ..data.outfit import neighbours
from ..networks.gru import dropout_mask
from ..training.batches import Batch, Track
from ..training.loop import TrainingObjective
from ..training.losses import BodyShape, collision_depth, frame_norm
from ..training.targets import bone_motion, detail_target

_MOMENTUM = 1e-3  # of the batch normalisation's statistics, that of the published code


def neighbour_table(faces: Any, n_vertices: int) -> Tensor:
    """Neighbours ``(V, D)`` of every vertex by the mesh's edges.

    Short rows repeat their last neighbour, which does not change a maximum; a vertex without
    neighbours is its own neighbour.

    Examples
    --------
    >>> neighbour_table([[0, 1, 2]], 4).tolist()
    [[1, 2], [0, 2], [0, 1], [3, 3]]
    """
    starts, others = neighbours(faces, n_vertices)
    degree, own = np.diff(starts)[:, None], np.arange(n_vertices)[:, None]
    slots = np.minimum(np.arange(max(1, int(degree.max(initial=0)))), degree - 1)
    # The appended number stands for a mesh without edges; a vertex without any reads none.
    table = np.where(degree > 0, np.append(others, 0)[starts[:-1, None] + slots], own)
    return torch.from_numpy(table)


class EdgeConv(nn.Module):
    """x_i' = max_j act(W [x_i, (x_j − x_i) / scale] + b) over the neighbours j (Wang et al. 2019).

    The activation is a PReLU with one slope per channel, kept at 0 or above, so that it is monotone
    and the maximum can be taken before it.  With W = [W_a, W_b] the layer is
    act((W_a − W_b) x_i + b + max_j W_b x_j): matrix products for every vertex instead of every
    edge, and a gather.

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
        self.linear, self.act = nn.Linear(2 * inputs, outputs), _PReLU(outputs)
        self.scale = scale

    def forward(self, x: Tensor, neighbours: Tensor, dropped: Tensor | None = None) -> Tensor:
        """Features ``(V, N, outputs)`` of features ``(V, N, inputs)``.

        Vertices come first, so that a gather copies whole rows.  `dropped` ``(V, D)`` is a mask of
        neighbours to leave out; a vertex that has no others gets 0.
        """
        w_a, w_b = self.linear.weight.chunk(2, dim=1)
        candidates = x @ (w_b / self.scale).T
        columns = (candidates[n] for n in neighbours.T)
        if dropped is not None:
            lost = dropped.T[..., None, None]
            columns = (c.masked_fill(d, -math.inf) for c, d in zip(columns, lost, strict=True))
        highest = functools.reduce(torch.maximum, columns)
        if dropped is not None:
            alone = dropped.all(dim=1)[:, None, None]
            highest = highest.masked_fill(alone, 0.0)
        out: Tensor = self.act(x @ (w_a - w_b / self.scale).T + self.linear.bias + highest)
        return out if dropped is None else out.masked_fill(alone, 0.0)


class _PReLU(nn.Module):
    """max(x, 0) + a min(x, 0) with a >= 0 for each channel."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.slope = nn.Parameter(torch.full((channels,), 0.25))

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x) + self.slope.clamp(min=0) * x.clamp(max=0)


class HighFrequency(nn.Module):
    """D_HF, the network of the detail (section 4.3).

    A linear layer, the same for all vertices, reads global features from a GRU on the bone motion
    M_v and local ones from EdgeConv layers on the low-frequency mesh G_LF.

    Parameters
    ----------
    inputs : int
        Numbers that the GRU reads in a frame: the motion of the bones.
    faces : (T, 3) int array
    n_vertices : int
    options : HighOptions
    edge_length : float
        Mean length of an edge, metres.
    vertices : (n,) int array, optional
        Vertices whose detail is predicted, all by default; the detail of the others is 0.

    Examples
    --------
    >>> small = HighOptions(hidden=8, global_features=4, edge_features=(5,))
    >>> module = HighFrequency(6, [[0, 1, 2]], 3, small, edge_length=0.03)
    >>> detail, state = module(torch.zeros(1, 5, 6), torch.zeros(1, 5, 3, 3))
    >>> detail.shape
    torch.Size([1, 5, 3, 3])
    """

    neighbours: Tensor
    vertices: Tensor
    mean: Tensor
    deviation: Tensor
    centre: Tensor

    def __init__(
        self,
        inputs: int,
        faces: Any,
        n_vertices: int,
        options: HighOptions,
        *,
        edge_length: float,
        vertices: Any = None,
    ) -> None:
        super().__init__()
        o, self.n_vertices, self.global_features = options, n_vertices, options.global_features
        chosen = np.arange(n_vertices) if vertices is None else np.asarray(vertices)
        self.gru = nn.GRU(inputs, o.hidden, batch_first=True)
        wide = len(chosen) * o.global_features
        self.spread = nn.Linear(o.hidden, wide)
        self.spread_act = _PReLU(wide)
        self.norm = nn.BatchNorm1d(wide, momentum=_MOMENTUM) if o.batch_norm else nn.Identity()
        widths = [3, *o.edge_features] if o.local else [3]
        self.edges = nn.ModuleList(
            EdgeConv(a, b, edge_length if k == 0 else 1.0)
            for k, (a, b) in enumerate(itertools.pairwise(widths))
        )
        self.out = nn.Linear(o.global_features + (widths[-1] if len(self.edges) else 0), 3)
        index = torch.from_numpy(chosen.astype(np.int64))
        self.register_buffer("vertices", index, persistent=False)
        self.register_buffer("neighbours", neighbour_table(faces, n_vertices), persistent=False)
        self.register_buffer("mean", torch.zeros(n_vertices, 3))
        self.register_buffer("deviation", torch.ones(()))
        self.register_buffer("centre", torch.zeros(3))

    def draw_edges(self, rng: np.random.Generator, share: float) -> list[Tensor] | None:
        """Masks ``(V, D)``, one per EdgeConv layer, of neighbours that a training step leaves out.

        An edge is left out with probability `share`, in both directions.  None if no edges are.
        """
        if not (share and len(self.edges)):
            return None
        table = self.neighbours.cpu().numpy()
        here = np.arange(len(table))[:, None]
        # One number for both directions of an edge.
        name = np.minimum(table, here) * len(table) + np.maximum(table, here)
        _, edge = np.unique(name, return_inverse=True)
        edge = edge.reshape(table.shape)
        lost = [rng.random(int(edge.max()) + 1) < share for _ in self.edges]
        return [torch.from_numpy(x[edge]).to(self.neighbours.device) for x in lost]

    def forward(
        self,
        x: Tensor,
        low: Any,
        state: Tensor | None = None,
        frames: Tensor | None = None,
        mask: Tensor | None = None,
        dropped: list[Tensor] | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Detail of the chosen frames, and the GRU's new state.

        Parameters
        ----------
        x : (N, T, inputs)
        low : (N, S, V, 3)
            Low-frequency mesh of the chosen frames, in the moving frame.
        state : (1, N, H), optional
        frames : (N, S) int, optional
            Frames whose detail is computed; all by default.
        mask : (N, S, H), optional
            Factors of the GRU's outputs; see :func:`~garmentnet.networks.gru.dropout_mask`.
        dropped : list of (V, D) bool, optional
            Result of :meth:`draw_edges`.

        Returns
        -------
        (N, S, V, 3) metres, and (1, N, H)
        """
        h, state = self.gru(x, state)
        if frames is not None:
            h = h.gather(1, frames[..., None].expand(-1, -1, h.shape[-1]))
        if mask is not None:
            h = h * mask
        lead = h.shape[:2]
        if self.training and isinstance(self.norm, nn.BatchNorm1d):
            # A training of some hundred steps would end with the statistics that it began with.
            self.norm.momentum = max(_MOMENTUM, 10 / (10 + int(self.norm.num_batches_tracked or 0)))
        wide = self.norm(self.spread_act(self.spread(h.flatten(0, 1))))
        features = wide.view(-1, len(self.vertices), self.global_features).transpose(0, 1)
        if len(self.edges):
            y = (low.reshape(-1, self.n_vertices, 3) - self.centre).transpose(0, 1).contiguous()
            for k, layer in enumerate(self.edges):
                y = layer(y, self.neighbours, dropped[k] if dropped else None)
            features = torch.cat([features, y[self.vertices]], dim=-1)
        out = self.out(features) * self.deviation + self.mean[self.vertices][:, None]
        if len(self.vertices) < self.n_vertices:
            everywhere = out.new_zeros(self.n_vertices, *out.shape[1:])
            out = everywhere.index_copy(0, self.vertices, out)
        return out.transpose(0, 1).reshape(*lead, self.n_vertices, 3), state


# Smallest deviation, metres, by which the output of a module is scaled.
LEAST_DEVIATION = 1e-4


class HighFrequencyObjective(TrainingObjective):
    """Loss L_HF of the paper's module, over the vertices that it predicts.

    The GRU reads every frame of a window; the loss is computed on a few frames, because the layers
    after the GRU are the expensive ones.

    Parameters
    ----------
    network : MotionNetwork
    tracks, validation : list of Track
    start : bool
        Whether to keep the statistics that the module already has.
    """

    def __init__(
        self,
        network: Any,
        tracks: list[Track],
        validation: list[Track],
        *,
        start: bool = False,
    ) -> None:
        assert isinstance(network.high, HighFrequency)
        self.network, self.module, self.free = network, network.high, network.free
        self.tracks = [self._with_motion(t) for t in tracks]
        self.validation = [self._with_motion(t) for t in validation]
        self._known: dict[str, tuple[Tensor, Tensor]] = {}
        self.body = BodyShape(network.subject.body).to(network.device)
        if not start:
            self._fit_statistics()

    def _with_motion(self, track: Track) -> Track:
        return dataclasses.replace(track, extra=bone_motion(self.network, track).cpu())

    def _read(self, track: Track) -> tuple[Tensor, Tensor]:
        """Targets ``(F, V, 3)`` and joints ``(F, J, 3, 4)`` of a clip, read once."""
        if track.name not in self._known:
            parts = track.parts()
            found = [detail_target(self.network, track, track.extra[p], p).half() for p in parts]
            self._known[track.name] = torch.cat(found), track.joints()
        return self._known[track.name]

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        """Loss L_HF of a batch, averaged over the chosen frames, and the GRU's new state."""
        device, options = self.network.device, self.network.config.high
        # Lanes that are finished must not count in the batch normalisation.
        lanes, frames, chosen = batch.some_frames(options.frames, rng)
        z = batch.stack([w.track.extra[w.frames] for w in batch.windows])[lanes].to(device)
        known = [(*self._read(t), torch.from_numpy(f)) for t, f in frames]
        joints = torch.stack([joints[f] for _, joints, f in known]).to(device)
        pick = torch.from_numpy(chosen[lanes]).to(device)
        with torch.no_grad():
            low = self.network.mesh(z[torch.arange(len(z), device=device)[:, None], pick], joints)
        x = self.network.high_inputs(batch.inputs()[lanes].to(device), z)
        mask = dropout_mask(rng, (*pick.shape, options.hidden), options.dropout, device)
        dropped = self.module.draw_edges(rng, options.edge_dropout)
        memory = None if state is None else state[:, lanes]
        high, memory = self.module(x, low, memory, pick, mask, dropped)
        state = memory.new_zeros(1, len(chosen), memory.shape[-1])
        state[:, lanes] = memory
        truth = torch.stack([goal[f] for goal, _, f in known]).float().to(device)
        loss = frame_norm((high - truth)[:, :, self.free])
        if options.collision:
            body, normals = self.body(joints.flatten(0, 1))
            mesh = (low + high)[:, :, self.free].flatten(0, 1)
            loss = loss + options.collision * collision_depth(mesh, body, normals).mean()
        return loss, state

    def squared_error(self, track: Track) -> Tensor:
        """Mean squared distance ``(F,)`` of the detail, metres².

        The garment is not compared, since the error of the low frequencies is ten times as large
        and would hide that of the detail.
        """
        state, found, device = None, [], self.network.device
        for part in track.parts():
            goal, joints = (a[part] for a in self._read(track))
            z, joints = (a[None].to(device) for a in (track.extra[part], joints))
            x = self.network.high_inputs(track.inputs[None, part].to(device), z)
            high, state = self.module(x, self.network.mesh(z, joints), state)
            gap = (high[0].cpu() - goal)[:, self.free]
            found.append(gap.double().square().sum(-1).mean(-1))
        return torch.cat(found)

    def _fit_statistics(self) -> None:
        """Set each vertex's mean detail and one common deviation, from the training clips."""
        total, square, frames = torch.zeros(()), 0.0, 0
        for track in self.tracks:
            high = self._read(track)[0].double()
            total = total + high.sum(0)
            square += float(high[:, self.free].square().sum())
            frames += len(high)
        mean = total / frames
        variance = square / (3 * len(self.free) * frames) - float(mean[self.free].square().mean())
        first, device = self.tracks[0], self.network.device
        low = self.network.mesh(first.extra[:1].to(device), first.joints(slice(1)).to(device))
        self.module.mean.copy_(mean)
        self.module.deviation.fill_(max(math.sqrt(max(variance, 0.0)), LEAST_DEVIATION))
        self.module.centre.copy_(low[0].mean(0))
