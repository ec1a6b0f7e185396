"""Clips as the training loop reads them: side by side, window after window."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..data.clip import Clip
from ..data.virtual_bones import ClipBones, VirtualBones
from ..networks.features import transforms_in_frame
from ..networks.network import MotionNetwork
from ..networks.skinning import remove_frame

__all__ = ["Batch", "Track", "batches", "load_tracks"]


@dataclasses.dataclass(frozen=True, eq=False)
class Track:
    """One clip, ready for a network: inputs in memory, targets on disk.

    Attributes
    ----------
    clip : Clip
    bones : ClipBones
    inputs : (F, D) float32 tensor
    frame : (F, 3, 4) float64
        The moving frame of the answer.
    extra : (F, ...) float32 tensor, optional
        What a task computed beforehand.
    """

    clip: Clip
    bones: ClipBones
    inputs: Tensor
    frame: NDArray[np.float64]
    extra: Tensor | None = None

    @property
    def n_frames(self) -> int:
        return len(self.inputs)

    def target(self, part: str, frames: Any = slice(None)) -> Tensor:
        """Frames of "low" or "high" in the moving frame, ``(f, V, 3)`` float32."""
        world = torch.from_numpy(self.bones.read(part, frames))
        frame = torch.from_numpy(self.frame[frames])
        if part == "high":  # a difference of positions: turned, not moved
            return world @ frame[..., :3].float()
        return remove_frame(frame, world.double()).float()

    def joints(self, frames: Any = slice(None)) -> Tensor:
        """Joint transforms in the moving frame, ``(f, J, 3, 4)`` float32."""
        moved = transforms_in_frame(self.clip.joints[frames], self.frame[frames])
        return torch.from_numpy(moved.astype(np.float32))


def load_tracks(network: MotionNetwork, bones: VirtualBones, names: Sequence[str]) -> list[Track]:
    """Tracks of the named clips, for the inputs of a network."""
    tracks = []
    for name in names:
        clip = bones.store.clip(name)
        features, frame, _ = network.features(clip.joints)
        theta = clip.parameters.normalised() if network.condition else None
        tracks.append(Track(clip, bones.clip(name), network.inputs(features, theta), frame))
    return tracks


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """A window of each lane.

    Attributes
    ----------
    windows : list of (Track, start, stop) or None
        What each of the N lanes shows; None: nothing any more.
    mask : (N, T) bool tensor
        Frames that are there.
    fresh : (N,) bool tensor
        Lanes where a clip begins: their memory is forgotten.
    """

    windows: list[tuple[Track, int, int] | None]
    mask: Tensor
    fresh: Tensor

    def inputs(self) -> Tensor:
        """``(N, T, D)``, zero where there is no frame."""
        return self.stack([w and w[0].inputs[w[1] : w[2]] for w in self.windows])

    def stack(self, parts: Sequence[Tensor | None]) -> Tensor:
        """Pad what the lanes hold to ``(N, T, ...)``."""
        shape = next(p.shape[1:] for p in parts if p is not None)
        out = torch.zeros(*self.mask.shape, *shape)
        for lane, part in enumerate(parts):
            if part is not None:
                out[lane, : len(part)] = part
        return out

    def forget(self, state: Tensor | None) -> Tensor | None:
        """A GRU's state ``(1, N, H)`` with that of fresh lanes set to zero."""
        if state is None:
            return None
        return state * (~self.fresh).to(state)[None, :, None]


def batches(
    tracks: Sequence[Track], lanes: int, window: int, rng: np.random.Generator | None
) -> Iterator[Batch]:
    """One epoch: every frame of every track once, each track in order.

    Tracks are shuffled, dealt to the lane with fewest frames, and cut into
    windows; the first of a track has a random length, so that the cuts move from
    epoch to epoch.  Without `rng` nothing is random.
    """
    order = np.arange(len(tracks)) if rng is None else rng.permutation(len(tracks))
    queues: list[list[tuple[Track, int, int]]] = [[] for _ in range(lanes)]
    load = np.zeros(lanes, int)
    for k in order:
        track = tracks[int(k)]
        lane = int(load.argmin())
        load[lane] += track.n_frames
        stop = window if rng is None else int(rng.integers(window // 2 + 1, window + 1))
        start = 0
        while start < track.n_frames:
            queues[lane].append((track, start, min(stop, track.n_frames)))
            start, stop = stop, stop + window
    for step in range(max((len(q) for q in queues), default=0)):
        windows = [q[step] if step < len(q) else None for q in queues]
        mask = torch.zeros(lanes, window, dtype=torch.bool)
        fresh = torch.ones(lanes, dtype=torch.bool)
        for lane, w in enumerate(windows):
            if w is not None:
                mask[lane, : w[2] - w[1]] = True
                fresh[lane] = w[1] == 0
        yield Batch(windows, mask, fresh)
