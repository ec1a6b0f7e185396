"""Batches for truncated back-propagation through time: several clips in parallel, in windows."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..data.clip import Clip
from ..networks.features import PoseReader, transforms_in_frame
from ..paper.bones import VirtualBones, remove_frame

# Number of frames whose vertices are in memory at once.
_FRAMES_AT_ONCE = 64


@dataclasses.dataclass(frozen=True, eq=False)
class Track:
    """One clip with the inputs of a network in memory and its vertices on disk.

    Attributes
    ----------
    name : str
    bones : VirtualBones
    inputs : (F, D) float32 tensor
    frame : (F, 3, 4) float64
        Transforms from the moving frame, in which the network predicts, to the world.
    extra : (F, ...) tensor
        Further data of every frame that an objective computed beforehand.
    """

    name: str
    bones: VirtualBones
    inputs: Tensor
    frame: NDArray[np.float64]
    extra: Tensor = dataclasses.field(default_factory=lambda: torch.empty(0))

    @property
    def n_frames(self) -> int:
        return len(self.inputs)

    @property
    def clip(self) -> Clip:
        return self.bones.store.clip(self.name)

    def parts(self) -> list[slice]:
        """Slices of at most 64 frames that cover the track."""
        starts = range(0, self.n_frames, _FRAMES_AT_ONCE)
        return [slice(i, min(i + _FRAMES_AT_ONCE, self.n_frames)) for i in starts]

    def mesh(self, frames: Any = slice(None)) -> Tensor:
        """Vertices of the garment in the moving frame, ``(f, V, 3)`` float32."""
        local = remove_frame(self.frame[frames], self.clip.sequence.frames(frames))
        return torch.from_numpy(local.astype(np.float32))

    def detail(self, frames: Any = slice(None)) -> Tensor:
        """High frequencies of the garment in the moving frame, ``(f, V, 3)`` float32."""
        # A difference of positions is only rotated.
        high = self.bones.split(self.name, frames)[1]
        return torch.from_numpy((high @ self.frame[frames][..., :3]).astype(np.float32))

    def joints(self, frames: Any = slice(None)) -> Tensor:
        """Joint transforms in the moving frame, ``(f, J, 3, 4)`` float32."""
        moved = transforms_in_frame(self.clip.joints[frames], self.frame[frames])
        return torch.from_numpy(moved.astype(np.float32))


def load_tracks(reader: PoseReader, bones: VirtualBones, names: Sequence[str]) -> list[Track]:
    """Tracks of the named clips, with the inputs of a network."""
    tracks = []
    for name in names:
        clip = bones.store.clip(name)
        features, frame, _ = reader.features(clip.joints)
        theta = clip.parameters.normalised() if reader.condition else None
        inputs = torch.from_numpy(reader.inputs(features, theta))
        tracks.append(Track(name, bones, inputs, frame))
    return tracks


class Window(NamedTuple):
    """Frames `start` to `stop` of a track."""

    track: Track
    start: int
    stop: int

    @property
    def frames(self) -> slice:
        return slice(self.start, self.stop)


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """One window of each lane, where a lane is a sequence of clips processed one after another.

    Attributes
    ----------
    windows : sequence of Window
        Window of each of the N lanes; empty if the lane is finished.
    mask : (N, T) bool tensor
        Mask of the frames that exist; shorter windows are padded.
    fresh : (N,) bool tensor
        Mask of the lanes in which a clip begins, so that the GRU's state is reset.
    """

    windows: Sequence[Window]
    mask: Tensor
    fresh: Tensor

    def inputs(self) -> Tensor:
        """Inputs ``(N, T, D)`` of the network, zero where there is no frame."""
        return self.stack([w.track.inputs[w.frames] for w in self.windows])

    def extra(self, every: slice = slice(None)) -> Tensor:
        """Rows of `Track.extra` for the frames that exist, one lane after the other.

        The slice `every` selects frames of each window.
        """
        return torch.cat([w.track.extra[w.frames][every] for w in self.windows])

    def some_frames(
        self, count: int, rng: np.random.Generator
    ) -> tuple[list[int], list[tuple[Track, NDArray[np.int64]]], NDArray[np.int64]]:
        """`count` random frames of each window, for loss terms that are too expensive for all.

        Returns
        -------
        lanes : list of int
            Indices of the lanes that have a window.
        frames : list of (Track, (S,) int array)
            Track of each of these lanes, and the chosen frames of the track.
        chosen : (N, S) int array
            The chosen frames of every lane, counted from the start of the window.
        """
        lanes, frames = [], []
        chosen = np.zeros((len(self.windows), count), np.int64)
        for k, w in enumerate(self.windows):
            length = w.stop - w.start
            if length:
                # Some frames occur twice if the window has fewer than `count`.
                chosen[k] = np.sort(rng.choice(length, count, replace=length < count))
                lanes.append(k)
                frames.append((w.track, w.start + chosen[k]))
        return lanes, frames, chosen

    def stack(self, parts: Sequence[Tensor]) -> Tensor:
        """Tensor of all lanes' parts, padded with zeros to ``(N, T, ...)``."""
        out = torch.zeros(*self.mask.shape, *parts[0].shape[1:])
        out[self.mask] = torch.cat(list(parts))
        return out

    def forget(self, state: Tensor | None) -> Tensor | None:
        """A GRU's state ``(1, N, H)`` with zeros for the lanes in which a clip begins."""
        if state is None:
            return None
        return state * (~self.fresh).to(state)[None, :, None]


def batches(
    tracks: Sequence[Track], lanes: int, window: int, rng: np.random.Generator | None
) -> Iterator[Batch]:
    """Batches of one epoch, which has every frame of every track once, each track in order.

    Tracks are shuffled, assigned to the lane with the fewest frames and cut into windows.  All
    lanes of a batch are equally long, up to the ends of clips: padding before would change the
    GRU's state.  The length is random, so that the cuts change from epoch to epoch.

    Parameters
    ----------
    tracks : sequence of Track
    lanes : int
        Number of clips in parallel.
    window : int
        Largest number of frames of a window; the least is three quarters of it.
    rng : numpy.random.Generator or None
        If None, tracks are not shuffled, and all windows have full length.
    """
    order = np.arange(len(tracks)) if rng is None else rng.permutation(len(tracks))
    queues: list[list[Track]] = [[] for _ in range(lanes)]
    load, start = np.zeros(lanes, int), [0] * lanes
    for k in order:
        lane = int(load.argmin())
        load[lane] += tracks[k].n_frames
        queues[lane].append(tracks[k])
    while any(queues):
        length = window if rng is None else int(rng.integers(window - window // 4, window + 1))
        windows = [Window(tracks[0], 0, 0)] * lanes
        for lane, queue in enumerate(queues):
            if queue:
                stop = min(start[lane] + length, queue[0].n_frames)
                windows[lane] = Window(queue[0], start[lane], stop)
                start[lane] = stop
                if stop == queue[0].n_frames:
                    queue.pop(0)
                    start[lane] = 0
        lengths = torch.tensor([w.stop - w.start for w in windows])
        fresh = torch.tensor([w.start == 0 for w in windows])
        yield Batch(windows, torch.arange(length) < lengths[:, None], fresh)
