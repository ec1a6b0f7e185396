"""Reading USD: meshes with sampled points, under moving transforms, or moved by UsdSkel."""

from __future__ import annotations

import dataclasses
import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdSkel

from ...clips import Clip, in_order, pick
from ...errors import FormatError
from ...sequence import MeshSequence
from ...skinning import Skinning
from ..axes import Up, check_up, turn_skinning_up, turn_surface_up, turn_up
from ..registry import reading
from ..rig import frame_rate
from ..scene import SceneBudget, join_sequence, join_skinning
from .materials import read_looks
from .parts import MeshPrim
from .stage import StageClip, find_clips, open_stage, stage_name

__all__ = ["SampledClip", "StageReader", "list_clips", "read", "read_skinning"]

_log = logging.getLogger(__name__)
_ALL = Usd.TraverseInstanceProxies()


@dataclasses.dataclass(frozen=True, eq=False)
class SampledClip:
    """A clip of a stage: its visible meshes, frame rate and the time codes of its frames."""

    name: str
    meshes: list[MeshPrim]
    fps: float
    codes: NDArray[np.float64]

    @property
    def clip(self) -> Clip:
        return Clip(self.name, 0, len(self.codes), self.fps)


class StageReader:
    """An open stage and its clips.

    Raises
    ------
    FormatError
        If the file is no stage or must not be opened.
    """

    def __init__(self, path: Path, max_bytes: int | None = None) -> None:
        self.path = path
        self.stage = open_stage(path)
        self.clips = find_clips(self.stage, path)
        self.name = stage_name(self.stage, path)
        files = [Path(layer.realPath) for layer in self.stage.GetUsedLayers() if layer.realPath]
        self.budget = SceneBudget(
            path, sum(f.stat().st_size for f in files if f.is_file()), max_bytes
        )
        self.up: Up = "z" if UsdGeom.GetStageUpAxis(self.stage) == UsdGeom.Tokens.z else "y"
        unit = UsdGeom.GetStageMetersPerUnit(self.stage)
        _log.info("%s: %s up, %g m a unit", path, self.up, unit)

    def sample(self, clip: StageClip, fps: float | None = None) -> SampledClip:
        """The visible meshes while a clip is bound, and its time codes.

        Raises
        ------
        FormatError
            If there is no visible mesh, or a mesh is damaged.
        """
        if clip.animation is not None:
            with Usd.EditContext(self.stage, self.stage.GetSessionLayer()):
                binding = UsdSkel.BindingAPI.Apply(self.stage.GetPrimAtPath(clip.skeleton))
                binding.CreateAnimationSourceRel().SetTargets([clip.animation])
        prims = list(Usd.PrimRange(self.stage.GetPseudoRoot(), _ALL))
        cache = UsdSkel.Cache()
        bound: dict[str, tuple[Any, Any]] = {}
        for root in (UsdSkel.Root(prim) for prim in prims if prim.IsA(UsdSkel.Root)):
            cache.Populate(root, _ALL)
            for binding in cache.ComputeSkelBindings(root, _ALL):
                skeleton = cache.GetSkelQuery(binding.GetSkeleton())
                for query in binding.GetSkinningTargets():
                    bound.setdefault(str(query.GetPrim().GetPath()), (skeleton, query))
        meshes = [
            MeshPrim(self.path, prim, *bound.get(str(prim.GetPath()), ()))
            for prim in prims
            if prim.IsA(UsdGeom.Mesh) and self._is_shown(prim)
        ]
        if not meshes:
            raise FormatError(f"{self.path}: no visible mesh")
        rate, codes = self._clock(meshes, clip, fps)
        return SampledClip(clip.name, meshes, rate, codes)

    def _is_shown(self, prim: Any) -> bool:
        shown = UsdGeom.Imageable(prim)
        visible = shown.ComputeVisibility(Usd.TimeCode.EarliestTime())
        if visible != UsdGeom.Tokens.invisible and shown.ComputePurpose() in ("default", "render"):
            return True
        _log.info("%s: %s is not shown and left out", self.path, prim.GetPath())
        return False

    def _clock(
        self, meshes: list[MeshPrim], clip: StageClip, fps: float | None
    ) -> tuple[float, NDArray[np.float64]]:
        """Frames per second and the time code of each frame."""
        stage = self.stage
        tempo = float(stage.GetTimeCodesPerSecond())
        if not (math.isfinite(tempo) and tempo > 0):
            raise FormatError(f"timeCodesPerSecond is {tempo}")
        stamps = np.unique(np.concatenate([np.zeros(0), *(mesh.stamps() for mesh in meshes)]))
        if clip.fps is not None and clip.frames is not None and fps in (None, clip.fps):
            rate, first, count = clip.fps, clip.start, clip.frames
        else:
            first, last = (float(stamps[0]), float(stamps[-1])) if len(stamps) else (0.0, 0.0)
            if clip.bound and stage.HasAuthoredTimeCodeRange():
                first, last = float(stage.GetStartTimeCode()), float(stage.GetEndTimeCode())
            if not (math.isfinite(first) and math.isfinite(last) and first <= last):
                raise FormatError(f"the time codes run from {first} to {last}")
            ticks = stamps - first
            on_codes = not len(stamps) or np.abs(ticks - np.rint(ticks)).max() < 0.01
            rate = fps or (None if on_codes else frame_rate([stamps / tempo])) or tempo
            count = math.floor(min((last - first) / tempo * rate, 1e15) + 1e-3) + 1
        n_vertices = sum(mesh.n_points for mesh in meshes)
        n_bones = sum(mesh.n_bones for mesh in meshes)
        self.budget.spend(
            count * (12.0 * n_vertices + 96.0 * n_bones),
            f"{count} frames of {n_vertices} vertices and {n_bones} bones",
        )
        return rate, first + np.arange(count) * (tempo / rate)


def read(
    path: Path,
    *,
    clip: str | int | None = None,
    fps: float | None = None,
    up: Up | None = None,
    max_bytes: int | None = None,
) -> MeshSequence:
    """Read all visible meshes in world space, UsdSkel and blend shapes baked.

    Parameters
    ----------
    path : Path
    clip : str or int, optional
        Which SkelAnimation, by number or name, where one skeleton has several; by default the
        one that is bound.
    fps : float, optional
        Where to sample; by default one frame a time code, or one a sample where samples lie
        between time codes.
    up : {"y", "z"}, optional
        Turn the scene to have that axis up; by default it stays as in the file.
    max_bytes : int, optional
        Memory that the file may ask for; by default 1000 times its size, but at least 1 GiB and
        at most 16 GiB.

    Returns
    -------
    MeshSequence
        float32, in the file's unit (the log says how many metres); polygons are cut into fans of
        triangles.

    Raises
    ------
    FormatError
        If the file is damaged or holds no mesh, or its topology changes.
    InputError
        If there is no such clip.
    """
    check_up(up, optional=True)
    with reading(path):
        reader = StageReader(path, max_bytes)
    names = [one.name for one in reader.clips]
    index = pick(names, clip)
    if len(names) > 1:
        _log.info("%s: clip %r of %s", path, names[index], names)
    with reading(path):
        found = reader.sample(reader.clips[index], fps)
        meshes, codes = found.meshes, found.codes
        shapes = [mesh.shape(codes) for mesh in meshes]
        moved = (mesh.transforms(codes) for mesh in meshes)
        looks = read_looks(path, meshes)
        sequence = join_sequence(meshes, found.clip, shapes, moved, looks, reader.name)
        if up is None:
            return sequence
        return dataclasses.replace(
            sequence,
            vertices=turn_up(sequence.vertices, reader.up, up),
            surface=turn_surface_up(sequence.surface, reader.up, up),
        )


def list_clips(path: Path, *, fps: float | None = None) -> tuple[Clip, ...]:
    """The animations of a file, in the frames of :func:`read_skinning`."""
    with reading(path):
        reader = StageReader(path)
        return in_order(reader.sample(clip, fps).clip for clip in reader.clips)


def read_skinning(
    path: Path, *, fps: float | None = None, up: Up | None = None, max_bytes: int | None = None
) -> Skinning:
    """Read UsdSkel skins as they are; a rigid mesh without one becomes one bone.

    The parent of a joint is the one whose path contains its own; where no joint has a parent,
    there is no hierarchy.

    Parameters
    ----------
    path, fps, up, max_bytes
        As in :func:`read`, of every animation.

    Raises
    ------
    FormatError
        Also where points or blend shapes move a mesh: no skinning holds them.
    """
    check_up(up, optional=True)
    with reading(path):
        reader = StageReader(path, max_bytes)
        clips = [reader.sample(clip, fps) for clip in reader.clips]
        meshes = clips[0].meshes
        bones = {}
        for k, mesh in enumerate(meshes):
            if mesh.skeleton not in bones:
                moved = [clip.meshes[k].transforms(clip.codes) for clip in clips]
                bones[mesh.skeleton] = mesh.bones(np.concatenate(moved))
        model = join_skinning(
            meshes,
            [clip.clip for clip in clips],
            [mesh.shape(clip.codes) for clip in clips for mesh in clip.meshes],
            bones,
            read_looks(path, meshes),
            reader.name,
        )
        return model if up is None else turn_skinning_up(model, reader.up, up)
