"""Reading of USD: meshes moved by samples of their points, by transforms or by UsdSkel."""

from __future__ import annotations

import collections
import dataclasses
import logging
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdSkel

from ...common.errors import is_real, is_whole
from ...mesh.clips import Clip, unique_names
from ...mesh.surface import Material, Space
from ..file_errors import SceneBudget, check
from ..frame_rates import Frames, frame_rate, frames_between, off_frames
from ..mesh_names import choose
from ..sampling import Sample
from ..scene_file import SceneFile
from .mesh_prims import MeshPrim, SkeletonPoints, upwards, visibility_codes
from .stage import open_stage
from .usd_materials import read_materials

_log = logging.getLogger(__name__)
_ALL = Usd.TraverseInstanceProxies()
# kinds of prims that are read, or hold what is; all others are named
_READ = re.compile("|Mesh|GeomSubset|Scope|Xform|Skel.*|BlendShape|Material|Shader|NodeGraph")
_POINT_BYTES, _CORNER_BYTES = 36, 72  # of a MeshPrim, at least


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class StageClip:
    """A clip of a stage.

    If the stage has a single skeleton with usable SkelAnimations, each animation is a clip.
    Otherwise the stage has one clip, which is its whole animation.

    Attributes
    ----------
    name : str
    skeleton, animation : Sdf.Path or None
        The SkelAnimation that plays in the clip and the skeleton to bind it to; None for the whole
        animation of the stage.
    bound : bool
        Whether the file itself binds this animation; if so, the stage's time range is the clip's.
    clock : (float, int) or None
        Frames per second and number of frames, from time code 0 on, if the file has several clips
        and states them.
    """

    name: str
    skeleton: Any = None
    animation: Any = None
    bound: bool = True
    clock: tuple[float, int] | None = None


class StageFile(SceneFile):
    """An open stage and its clips.

    Attributes
    ----------
    name : str
        Name of the default prim or, if there is none, of the file.
    clip_names : list of str
        That of the bound animation comes first.
    space : Space
        Unit and up axis that the stage states.

    Raises
    ------
    FormatError
        If the file is not a stage, or opening it would be unsafe.
    """

    def __init__(self, path: Path, max_bytes: int | None = None, meshes: Any = None) -> None:
        self.path = path
        self._wanted = meshes
        self.stage = open_stage(path)
        root = self.stage.GetDefaultPrim()
        self.name = str(root.GetName()) if root else path.stem
        self._clips = self._find_clips()
        self.clip_names = [clip.name for clip in self._clips]
        files = [Path(layer.realPath) for layer in self.stage.GetUsedLayers() if layer.realPath]
        self.budget = SceneBudget(
            path, sum(f.stat().st_size for f in files if f.is_file()), max_bytes
        )
        self._counted: set[Any] = set()  # paths of the meshes whose arrays are in the budget
        self.space = self._find_space()
        _log.info("%s: %s", path, self.space)

    def _find_space(self) -> Space:
        # What a stage does not state has a default in USD, which files seldom mean.
        stage, units, up = self.stage, None, None
        if UsdGeom.StageHasAuthoredMetersPerUnit(stage):
            units = float(UsdGeom.GetStageMetersPerUnit(stage))
            check(0 < units < math.inf, f"metersPerUnit is {units}")
        if stage.HasAuthoredMetadata(UsdGeom.Tokens.upAxis):
            up = "z" if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else "y"
        return Space(units, up)  # type: ignore[arg-type]

    def _find_clips(self) -> list[StageClip]:
        prims = list(Usd.PrimRange(self.stage.GetPseudoRoot(), _ALL))
        skeletons = [prim for prim in prims if prim.IsA(UsdSkel.Skeleton)]
        if len(skeletons) != 1 or skeletons[0].IsInstanceProxy():
            return [StageClip(name=self.name)]
        joints = set(UsdSkel.Skeleton(skeletons[0]).GetJointsAttr().Get() or ())
        usable = [
            prim
            for prim in prims
            if prim.IsA(UsdSkel.Animation)
            and joints & set(UsdSkel.Animation(prim).GetJointsAttr().Get() or ())
        ]
        bound = UsdSkel.BindingAPI(skeletons[0]).GetInheritedAnimationSource()
        usable.sort(key=lambda prim: prim != bound)  # stable: the others keep their order
        if not usable or (bound and usable[0] != bound):
            return [StageClip(name=self.name)]
        clips = []
        for prim in usable:
            own = prim.GetCustomDataByKey("ssdr")
            own = own if isinstance(own, dict) else {}
            stated: list[Any] = [own.get(key) for key in ("fps", "frames")]
            fps, frames = stated
            # A clip that is the only one has the time range of the stage.
            known = len(usable) > 1 and is_real(fps) and fps > 0 and is_whole(frames) and frames > 0
            default = self.name if len(usable) == 1 and own else str(prim.GetName())
            clips.append(
                StageClip(
                    name=str(own.get("name") or default),
                    skeleton=skeletons[0].GetPath(),
                    animation=prim.GetPath(),
                    bound=prim == bound,
                    clock=(float(fps), int(frames)) if known else None,
                )
            )
        names = unique_names([clip.name for clip in clips])
        return [dataclasses.replace(clip, name=n) for clip, n in zip(clips, names, strict=True)]

    def materials(self, parts: Sequence[MeshPrim]) -> list[Material]:
        return read_materials(parts)

    def sample(self, index: int, fps: float | None, joints_alone: bool = False) -> Sample:
        """Bind a clip and return the visible meshes and the time codes of the clip's frames.

        `fps` replaces the frame rate of the clip. If `joints_alone` and there are no meshes, the
        joints of skeletons are returned in their place.

        Raises
        ------
        FormatError
            If there is no visible mesh, or a mesh is damaged.
        """
        clip = self._clips[index]
        if clip.animation is not None:
            with Usd.EditContext(self.stage, self.stage.GetSessionLayer()):
                binding = UsdSkel.BindingAPI.Apply(self.stage.GetPrimAtPath(clip.skeleton))
                binding.CreateAnimationSourceRel().SetTargets([clip.animation])
        prims = list(Usd.PrimRange(self.stage.GetPseudoRoot(), _ALL))
        cache = UsdSkel.Cache()
        bound: dict[str, tuple[Any, Any]] = {}
        skeletons: list[Any] = []
        for root in (UsdSkel.Root(prim) for prim in prims if prim.IsA(UsdSkel.Root)):
            cache.Populate(root, _ALL)
            below = (prim for prim in Usd.PrimRange(root.GetPrim(), _ALL))
            found = (UsdSkel.Skeleton(prim) for prim in below if prim.IsA(UsdSkel.Skeleton))
            skeletons += [cache.GetSkelQuery(skeleton) for skeleton in found]
            for binding in cache.ComputeSkelBindings(root, _ALL):
                skeleton = cache.GetSkelQuery(binding.GetSkeleton())
                for query in binding.GetSkinningTargets():
                    bound.setdefault(str(query.GetPrim().GetPath()), (skeleton, query))
        shown = self._shown(prims)
        above = [str(prim.GetPath()).split("/")[1:] for prim in shown]
        names = [{own, *some} for own, some in zip(_names(shown), above, strict=True)]
        places = [shown[k] for k in choose(self._wanted, names)]
        self._spend(places)
        meshes = [MeshPrim(self.path, p, *bound.get(str(p.GetPath()), ())) for p in places]
        if not meshes and joints_alone:
            meshes = [SkeletonPoints(self.path, skeleton) for skeleton in skeletons]
        check(meshes, "no visible mesh")
        rate, frames, codes = self._frames(meshes, clip, fps)
        known = Clip(clip.name, 0, len(codes), rate)
        return Sample(clip=known, parts=meshes, time=codes, at=np.asarray, frames=frames)

    def mesh_names(self) -> tuple[str, ...]:
        """Names of the visible meshes, or their paths where two names are equal."""
        return _names(self._shown(Usd.PrimRange(self.stage.GetPseudoRoot(), _ALL)))

    def _shown(self, prims: Iterable[Any]) -> list[Any]:
        return [prim for prim in prims if prim.IsA(UsdGeom.Mesh) and self._is_shown(prim)]

    def _spend(self, prims: Sequence[Any]) -> None:
        """Charge the budget for the arrays of meshes before they are read.

        A small file may hold many meshes that share their points. Each mesh is counted once, for
        all clips.
        """
        first = Usd.TimeCode.EarliestTime()
        new = [p for p in prims if p.GetPath() not in self._counted]
        for mesh in map(UsdGeom.Mesh, new):
            attributes = mesh.GetPointsAttr(), mesh.GetFaceVertexIndicesAttr()
            points, corners = (len(one.Get(first) or ()) for one in attributes)
            what = f"{mesh.GetPath()} of {points} points and {corners} corners beside others"
            self.budget.spend(_POINT_BYTES * points + _CORNER_BYTES * corners, what)
        self._counted.update(p.GetPath() for p in new)

    def _is_shown(self, prim: Any) -> bool:
        """Whether a mesh is visible at some time, no proxy and not of an instancer."""
        seen, first = UsdGeom.Imageable(prim), Usd.TimeCode.EarliestTime()
        states = [seen.ComputeVisibility(one) for one in (first, *visibility_codes(prim))]
        visible = any(one != UsdGeom.Tokens.invisible for one in states)
        visible &= not any(upwards(prim, UsdGeom.PointInstancer))
        if visible and seen.ComputePurpose() in ("default", "render"):
            return True
        _log.info("%s: %s is not shown and left out", self.path, prim.GetPath())
        return False

    def left_out(self) -> list[str]:
        """Prims of other kinds than those read, by their number, and meshes that are not shown."""
        prims = list(Usd.PrimRange(self.stage.GetPseudoRoot(), _ALL))
        kinds = collections.Counter(str(prim.GetTypeName()) for prim in prims)
        hidden = [p for p in prims if p.IsA(UsdGeom.Mesh) and not self._is_shown(p)]
        names = [f"{prim.GetName()} (hidden)" for prim in hidden]
        return names + [f"{n} {kind}" for kind, n in kinds.items() if not _READ.fullmatch(kind)]

    def _frames(
        self, meshes: list[MeshPrim], clip: StageClip, fps: float | None
    ) -> tuple[float, Frames, NDArray[np.float64]]:
        """Frames per second of a clip, its frames in time codes, and the code (F,) of each."""
        stage = self.stage
        tempo = float(stage.GetTimeCodesPerSecond())
        check(0 < tempo < math.inf, f"timeCodesPerSecond is {tempo}")
        stamps = np.unique(np.concatenate([np.zeros(0), *(mesh.stamps() for mesh in meshes)]))
        if clip.clock is not None and fps in (None, clip.clock[0]):
            first, (rate, count) = 0.0, clip.clock
            stamps = stamps[(stamps >= first) & (stamps <= count * tempo / rate)]
            missed = off_frames(stamps, first, rate / tempo, count)
            frames = Frames(first, rate / tempo, count, missed)
        else:
            first, last = (float(stamps[0]), float(stamps[-1])) if len(stamps) else (0.0, 0.0)
            if clip.bound and stage.HasAuthoredTimeCodeRange():
                first, last = float(stage.GetStartTimeCode()), float(stage.GetEndTimeCode())
            usable = -math.inf < first <= last < math.inf
            check(usable, f"the time codes run from {first} to {last}")
            stamps = stamps[(stamps >= first) & (stamps <= last)]
            on_codes = not len(off_frames(stamps, first, 1.0))
            rate = fps or (None if on_codes else frame_rate(stamps / tempo)) or tempo
            frames = frames_between(stamps, first, last, rate / tempo, asked=fps is not None)
        frames = dataclasses.replace(frames, tempo=1.0).within(self.asked)
        n_bones = sum(mesh.n_bones for mesh in meshes)
        self.budget.spend(
            96.0 * frames.count * n_bones, f"{frames.count} frames of {n_bones} bones"
        )
        return rate, frames, np.asarray(frames.first + np.arange(frames.count) * (tempo / rate))


def _names(prims: Sequence[Any]) -> tuple[str, ...]:
    """Name of each prim, or its path if another prim has the same name."""
    count = collections.Counter(str(prim.GetName()) for prim in prims)
    return tuple(
        str(prim.GetName() if count[str(prim.GetName())] == 1 else prim.GetPath()) for prim in prims
    )
