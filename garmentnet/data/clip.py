"""One clip of a store; its frames are read when they are used."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.common.errors import InputError
from ssdr.io.file_errors import check
from ssdr.mesh.sequence import MeshSequence
from ssdr.model.lbs import skin

from .clip_files import Split, StoredFrames, read_parts
from .outfit import Outfit
from .parameters import SimulationParameters
from .skeleton import mirror_transforms

# Classes of motion; "recorded" is motion capture, the others are made by a generator.  New ones are
# added at the end: stores hold indices into this list.
CLASSES = (
    *("stand", "walk", "sway", "spin", "kick", "squat", "jump", "stop"),
    *("recorded", "turn", "shift"),
)
# Suffix of a mirrored clip's name; no name on disk may hold it.
MIRRORED = "~mirrored"


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ClipDocument:
    """What the file of a clip states of it.

    Attributes
    ----------
    split : {"train", "validation", "test"}
    motion : str
        Name of the motion; clips of one motion under several parameters share it.
    parameters : SimulationParameters
    seed : int
    perturbation : float
        RMS displacement, metres, with which the first frame was perturbed; 0 except for the second
        clip of a pair that measures chaos.
    quality : dict
        ``accepted``, ``reason`` and the measurements of the quality gate.
    provenance : dict
        Scene and versions of the simulator, from which the clip can be made again.
    n_frames : int
    step : float
        Step, metres, to whose multiples the stored vertices are rounded; 0: they are float32.
    """

    split: Split
    motion: str
    parameters: SimulationParameters
    seed: int
    perturbation: float
    quality: dict[str, Any]
    provenance: dict[str, Any]
    n_frames: int
    step: float = 0.0


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Clip(ClipDocument):
    """One clip of a store.

    Attributes
    ----------
    outfit : Outfit
        Garment and body, those of the store.
    name : str
    path : Path
    is_mirrored : bool
        Whether the clip is reflected in x as it is read; only the original is stored.

    It also has the attributes of :class:`ClipDocument`.
    """

    outfit: Outfit
    name: str
    path: Path
    is_mirrored: bool = False

    @property
    def accepted(self) -> bool:
        return bool(self.quality["accepted"])

    @property
    def fps(self) -> float:
        return self.outfit.fps

    @functools.cached_property
    def sequence(self) -> MeshSequence:
        """Animation of the garment; frames are read from disk when they are used."""
        vertices = StoredFrames(
            self.path,
            (self.n_frames, self.outfit.n_vertices, 3),
            self.step,
            self.outfit.mirror_vertices if self.is_mirrored else None,
        )
        faces = self.outfit.faces
        return MeshSequence(vertices, faces, self.fps, name=self.name, validate=not self.accepted)

    @functools.cached_property
    def joints(self) -> NDArray[np.float32]:
        """Transforms ``(F, J, 3, 4)`` from the body's rest pose to the pose of each frame."""
        shape = (self.n_frames, self.outfit.skeleton.n_joints, 3, 4)
        values: NDArray[np.float32]
        values = read_parts(self.path, {"joints": shape}, np.float32)["joints"]
        if self.is_mirrored:
            return mirror_transforms(values, self.outfit.skeleton.mirror())
        return values

    @functools.cached_property
    def classes(self) -> NDArray[np.int8]:
        """Class of motion ``(F,)`` of each frame, an index into ``CLASSES``."""
        values: NDArray[np.int8]
        values = read_parts(self.path, {"classes": (self.n_frames,)}, np.int8)["classes"]
        known = values.min() >= 0 and values.max() < len(CLASSES)
        check(known, f"{self.path}: classes {values.min()} to {values.max()}")
        return values

    def body(self, frames: Any = slice(None)) -> NDArray[np.float32]:
        """Body vertices ``(f, V, 3)`` in the named frames."""
        rig = self.outfit.body
        return np.asarray(skin(rig.rest, rig.indices, rig.weights, self.joints[frames]))

    def mirrored(self) -> Clip:
        """The clip reflected in x; for a mirrored clip, the original.

        Raises
        ------
        InputError
            If the garment is not symmetric.
        """
        if self.outfit.mirror_vertices is None:
            raise InputError("clip", "a clip of a symmetric garment", self.name)
        name = self.name.removesuffix(MIRRORED) + ("" if self.is_mirrored else MIRRORED)
        return dataclasses.replace(self, name=name, is_mirrored=not self.is_mirrored)


def spread(lengths: Sequence[int], count: int) -> list[NDArray[np.int64]]:
    """Indices of frames of each clip, `count` in total (or all), spread evenly over all clips.

    Examples
    --------
    >>> [f.tolist() for f in spread([3, 1, 4], 3)]
    [[0], [0], [3]]
    """
    total = sum(lengths)
    chosen = np.unique(np.linspace(0, total - 1, min(total, count)).astype(np.int64))
    ends = np.cumsum(lengths)
    cuts = np.searchsorted(chosen, ends)[:-1]
    starts = ends - np.asarray(lengths)
    return [c - s for c, s in zip(np.split(chosen, cuts), starts, strict=True)]
