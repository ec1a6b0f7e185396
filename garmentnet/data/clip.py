"""One clip of a store; its frames are read when they are used."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.common.errors import FormatError, InputError
from ssdr.io.file_errors import reading
from ssdr.mesh.sequence import MeshSequence
from ssdr.model.lbs import skin

from .clip_files import Split, StoredFrames, open_array
from .motion import CLASSES
from .outfit import Outfit
from .parameters import SimulationParameters
from .skeleton import check_finite, mirror_transforms

# Suffix of a mirrored clip's name; no name on disk may hold it.
MIRRORED = "~mirrored"


@dataclasses.dataclass(frozen=True, eq=False)
class Clip:
    """One clip of a store.

    Attributes
    ----------
    outfit : Outfit
        Garment and body, those of the store.
    name : str
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
    is_mirrored : bool
        Whether the clip is reflected in x as it is read; only the original is stored.
    """

    outfit: Outfit
    name: str
    split: Split
    motion: str
    parameters: SimulationParameters
    seed: int
    perturbation: float
    quality: dict[str, Any]
    provenance: dict[str, Any]
    n_frames: int
    step: float
    is_mirrored: bool
    path: Path

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
        with reading(self.path):
            values = np.asarray(open_array(self.path, "joints", shape)[:])
            check_finite(values, "joints")
        if self.is_mirrored:
            values = mirror_transforms(values, self.outfit.skeleton.mirror())
        return values

    @functools.cached_property
    def classes(self) -> NDArray[np.int8]:
        """Class of motion ``(F,)`` of each frame, an index into ``CLASSES``."""
        with reading(self.path):
            values = np.asarray(open_array(self.path, "classes", (self.n_frames,))[:])
            if values.min() < 0 or values.max() >= len(CLASSES):
                raise FormatError(f"classes: {values.min()} to {values.max()}")
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
