"""Reading of scenes (glTF, USD, FBX, Alembic): baked or as a skinning, and lists of contents."""

from __future__ import annotations

import contextlib
import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..common.errors import InputError
from ..mesh.clips import Clip, in_order
from ..mesh.sequence import MeshSequence
from ..mesh.surface import Material, Space
from ..model.shapes import Skinned, shaped
from .file_clips import pick_clip
from .file_errors import SceneBudget, check, reading
from .frame_rates import Range
from .sampling import Sample, part_starts, vertices_of
from .scene import join_faces, join_skinning, join_surface


class SceneFile(ABC):
    """An open file of one format, and the functions that read files of that format.

    A format derives a class that opens a file, given its path, a limit of memory in bytes (or None)
    and the names of the meshes to read (or None for all).

    Attributes
    ----------
    name : str
        Name of what the file holds.
    space : Space
    clip_names : sequence of str
        At least one.
    driven : bool
        Whether the file says that each of its clips is an expression of a face.
    budget : SceneBudget
        Memory that reading the file may take.
    asked : (float, float) or None
        First and last frame to read, by the file's own numbers.
    """

    name: str
    space: Space
    budget: SceneBudget
    clip_names: Sequence[str]
    driven = False
    asked: Range = None

    @abstractmethod
    def __init__(self, path: Path, max_bytes: int | None = None, meshes: Any = None) -> None: ...

    @abstractmethod
    def sample(self, index: int, fps: float | None, joints_alone: bool = False) -> Sample:
        """One clip and the parts to show in it, which are the same in all clips of the file."""

    def samples(
        self, indices: Sequence[int], fps: float | None, joints_alone: bool = False
    ) -> list[Sample]:
        return [self.sample(k, fps, joints_alone) for k in indices]

    def clips(self, fps: float | None) -> list[Clip]:
        """All clips, of which only rates and numbers of frames are known."""
        return [self.sample(k, fps).clip for k in range(len(self.clip_names))]

    @abstractmethod
    def mesh_names(self) -> Sequence[str]:
        """Names of the meshes that are shown, or of the nodes that hold them."""

    @abstractmethod
    def left_out(self) -> Sequence[str]:
        """What the file holds and no function here reads, as "2 lights" and names of meshes."""

    @abstractmethod
    def materials(self, parts: Sequence[Any]) -> list[Material]:
        """Materials of the file, or of parts of it, in the order of their indices."""

    @classmethod
    def read(
        cls,
        path: Path,
        *,
        clip: str | int | None = None,
        fps: float | None = None,
        meshes: str | Sequence[str] | None = None,
        frames: Range = None,
        vanish: bool = False,
        max_bytes: int | None = None,
    ) -> MeshSequence:
        """Read all meshes that are shown, with skins, shapes and moving nodes baked to vertices.

        Parameters
        ----------
        path : Path
        clip : str or int, optional
            Name or index of the clip; by default the first or, in USD, the one that is bound. The
            log lists all of them. Clips of a USD file are the SkelAnimations of its only skeleton.
        fps : float, optional
            Frames per second at which to sample. By default those that the file states or its keys
            imply: in glTF else 24, in USD one frame per time code or, if samples lie between time
            codes, the rate of the samples.
        meshes : str or several of them, optional
            Names of the meshes to read, or of nodes that hold them (in USD, of prims above them);
            all by default.
        frames : (first, last), optional
            Frames to read, by the file's own numbers, both ends included; all by default. They are
            time codes of USD, and else times multiplied by the file's rate.
        vanish : bool
            Shrink a mesh to a point in the frames in which the file hides it, while it shows it in
            others; by default it is shown in all, with a warning.
        max_bytes : int, optional
            Most memory that reading may take; by default 1000 times the size of the file, but at
            least 1 GiB and at most 16 GiB.

        Returns
        -------
        MeshSequence
            Vertices in float32, in the file's unit and with its up axis; for glTF, metres with y
            up. Meshes follow each other in the order of the scene. Polygons are cut into triangles.

        Raises
        ------
        FormatError
            If the file is damaged, needs more memory than `max_bytes`, requires what is not
            supported, or holds no mesh that is shown, or a mesh's topology changes.
        InputError
            If there is no such clip, mesh or frame.
        """
        with reading(path, "clip", "meshes", "frames"):
            file = cls(path, max_bytes, meshes)
            file.asked = frames
            sample = file.sample(pick_clip(file.clip_names, clip, path), fps)
            sequence = _baked(file, sample, vanish)
            if fps is None:
                sample.tell_missed(path)
            return sequence

    @classmethod
    def list_clips(cls, path: Path, *, fps: float | None = None) -> tuple[Clip, ...]:
        """Clips of a file, with frames numbered as in :meth:`read_skinning`."""
        with reading(path):
            return in_order(cls(path).clips(fps))

    @classmethod
    def list_left_out(cls, path: Path) -> tuple[str, ...]:
        """What the file holds and nothing here reads."""
        with reading(path):
            return tuple(cls(path).left_out())

    @classmethod
    def list_meshes(cls, path: Path) -> tuple[str, ...]:
        """Names of the meshes that are shown."""
        with reading(path):
            return tuple(cls(path).mesh_names())

    @classmethod
    def read_skinning(
        cls,
        path: Path,
        *,
        fps: float | None = None,
        meshes: str | Sequence[str] | None = None,
        joints_alone: bool = False,
        frames: Range = None,
        vanish: bool = False,
        max_bytes: int | None = None,
    ) -> Skinned:
        """Read the skins of a file without baking them; a mesh without a skin gets one bone.

        The parent of a joint is the nearest joint above it that is of the same skin. If no joint
        has a parent, the skinning has no hierarchy.

        Parameters
        ----------
        path, meshes, frames, vanish, max_bytes
            As in :meth:`read`.
        fps : float, optional
            As in :meth:`read`, for every clip; all are read.
        joints_alone : bool
            Read a file without a mesh, with a vertex at each joint: in glTF the nodes that move,
            and those below them, in USD the joints of skeletons.

        Raises
        ------
        FormatError
            As in :meth:`read`, and if the points of a mesh move, which a skinning cannot store, or
            the file hides a mesh that is to `vanish`.
        InputError
            If there is no such mesh, or a clip has none of the frames.
        """
        with reading(path, "meshes", "frames"):
            file = cls(path, max_bytes, meshes)
            file.asked = frames
            samples = file.samples(range(len(file.clip_names)), fps, joints_alone)
            materials = file.materials(samples[0].parts)
            model = join_skinning(samples, materials, file.name, file.space)
            for one in samples:
                if fps is None:
                    one.tell_missed(path)
                seen = not (one.hidden(path, vanish) and vanish)
                check(seen, "a mesh is hidden in some frames: ssdr.load lets it vanish there")
            return _as_face(model) if file.driven else model


def _baked(file: SceneFile, sample: Sample, vanish: bool) -> MeshSequence:
    """Sequence of the skinned vertices of all parts in the frames of one clip.

    With `vanish`, a part is its centroid alone in the frames in which the file hides it.
    """
    clip, parts = sample.clip, sample.parts
    count = int(part_starts(parts)[-1])
    file.budget.spend(12.0 * clip.n_frames * count, f"{clip.n_frames} frames of {count} vertices")
    frames = vertices_of(parts, sample.time, clip.n_frames)
    shapes = [part.shape(sample.time) for part in parts]
    rest = [shape(0) if callable(shape) else shape for shape in shapes]
    surface = join_surface(parts, rest, file.materials(parts))
    for vertices, hidden in sample.hidden(file.budget.path, vanish):
        if vanish:
            block = frames[hidden, vertices]
            frames[hidden, vertices] = block.mean(axis=1, keepdims=True, dtype=np.float64)
    named: dict[str, Any] = {"name": file.name, "clip": clip.name, "space": file.space}
    return MeshSequence(frames, join_faces(parts), clip.fps, surface=surface, **named)


def _as_face(model: Skinned) -> Skinned:
    """Model that weights drive, unless its clips are no expressions (as at another frame rate)."""
    with contextlib.suppress(InputError):
        return dataclasses.replace(shaped(model), driven=True)
    return model
