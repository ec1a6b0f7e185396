"""Reading USD: meshes with sampled points, under moving transforms, or moved by UsdSkel."""

from __future__ import annotations

import dataclasses
import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...clips import Clip, in_order, pick, unique_names
from ...errors import FormatError
from ...sequence import MeshSequence
from ...skinning import Skinning, skin
from ..registry import reading, require
from ..rig import (
    MAX_BYTES,
    Up,
    check_size,
    check_up,
    frame_rate,
    model_of,
    turn_skinning_up,
    turn_up,
)
from .stage import Take, name_of, open_stage, takes_of
from .surface import Polygons, join_surface

__all__ = ["list_clips", "read", "read_skinning"]

_log = logging.getLogger(__name__)
_Clock = tuple[float, NDArray[np.float64]]  # frames per second, time codes


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
        Which SkelAnimation, by number or name, where one skeleton has several;
        the one that is bound by default.
    fps : float, optional
        Where to sample; one frame a time code by default, or a frame a sample
        where samples lie between time codes.
    up : {"y", "z"}, optional
        Turn the scene to have that axis up; as in the file by default.
    max_bytes : int, optional
        Largest size of the vertices; 16 GiB by default.

    Returns
    -------
    MeshSequence
        float32, in the file's unit (the log says how many metres); polygons
        are cut into fans of triangles.

    Raises
    ------
    FormatError
        If the file is damaged or holds no mesh, or its topology changes.
    MissingDependencyError
        Without usd-core.
    """
    check_up(up, optional=True)
    require("pxr.UsdSkel", "usd", "USD")
    with reading(path):
        takes = takes_of(path)
    index = pick([take.name for take in takes], clip)
    if len(takes) > 1:
        _log.info("%s: clip %r of %s", path, takes[index].name, [take.name for take in takes])
    with reading(path):
        take = takes[index]
        stage, meshes = _open(path, take)
        rate, codes = _clock(stage, meshes, fps, take)
        count = sum(mesh.n_points for mesh in meshes)
        check_size(len(codes), count, MAX_BYTES if max_bytes is None else max_bytes)
        frames = np.empty((len(codes), count, 3), dtype=np.float32)
        first = 0
        for mesh in meshes:
            mesh.bake(codes, frames[:, first : first + mesh.n_points])
            first += mesh.n_points
        found = _up(stage)
        faces, surface = join_surface(path, stage, [m.polygons for m in meshes], codes[0])
        if up is not None and surface is not None and surface.normals is not None:
            surface = dataclasses.replace(surface, normals=turn_up(surface.normals, found, up))
        return MeshSequence(
            frames if up is None else turn_up(frames, found, up),
            faces,
            rate,
            name=name_of(stage, path),
            clip=take.name,
            surface=surface,
        )


def list_clips(path: Path, *, fps: float | None = None) -> tuple[Clip, ...]:
    """The animations of a file, in the frames of :func:`read_skinning`."""
    require("pxr.UsdSkel", "usd", "USD")
    with reading(path):
        clips = []
        for take in takes_of(path):
            rate, codes = _clock(*_open(path, take), fps, take)
            clips.append(Clip(take.name, 0, len(codes), rate))
        return in_order(clips)


def read_skinning(path: Path, *, fps: float | None = None, up: Up | None = None) -> Skinning:
    """Read UsdSkel skins as they are; a rigid mesh without one becomes one bone.

    Parameters
    ----------
    path, fps, up
        As in :func:`read`, of every animation.

    Raises
    ------
    FormatError
        Also where points or blend shapes move a mesh: no skinning holds them.
    MissingDependencyError
        Without usd-core.
    """
    check_up(up, optional=True)
    require("pxr.UsdSkel", "usd", "USD")
    with reading(path):
        clips, moved = [], []
        for take in takes_of(path):
            stage, meshes = _open(path, take)
            rate, codes = _clock(stage, meshes, fps, take)
            clips.append(Clip(take.name, 0, len(codes), rate))
            moved.append(_transforms(path, meshes, codes))
            if len(clips) == 1:
                points = [mesh.points(codes[0]) for mesh in meshes]
                polygons = [mesh.polygons for mesh in meshes]
                faces, surface = join_surface(path, stage, polygons, codes[0])
        width = max(mesh.joints.shape[1] for mesh in meshes)

        def wide(values: NDArray[Any]) -> NDArray[Any]:
            return np.pad(values, ((0, 0), (0, width - values.shape[1])))

        starts, names = _bones(meshes)
        joints = np.concatenate([wide(m.joints + starts[m.bones_key]) for m in meshes])
        weights = np.concatenate([wide(m.weights) for m in meshes])
        transforms = np.concatenate(moved)
        model = Skinning(
            np.concatenate(points),
            np.where(weights > 0, joints, 0),
            weights,
            transforms,
            faces=faces,
            clips=in_order(clips),
            bone_model=model_of(transforms),
            surface=surface,
            bone_names=unique_names(names),
            name=name_of(stage, path),
        )
        return model if up is None else turn_skinning_up(model, _up(stage), up)


def _bones(meshes: list[_Mesh]) -> tuple[dict[Any, int], list[str]]:
    """First bone of each skeleton, and the names of all bones."""
    starts: dict[Any, int] = {}
    names: list[str] = []
    for mesh in meshes:
        if mesh.bones_key not in starts:
            starts[mesh.bones_key] = len(names)
            names += mesh.bone_names
    return starts, names


def _transforms(path: Path, meshes: list[_Mesh], codes: NDArray[np.float64]) -> NDArray[np.float64]:
    if any(mesh.deforms for mesh in meshes):
        raise FormatError(
            f"{path}: points or blend shapes move a mesh, which no skinning holds; "
            "ssdr.load bakes them"
        )
    starts, names = _bones(meshes)
    check_size(len(codes), 4 * len(names), MAX_BYTES)
    first = {mesh.bones_key: mesh for mesh in reversed(meshes)}
    return np.concatenate([first[key].transforms(codes) for key in starts], axis=1)


def _up(stage: Any) -> Up:
    from pxr import UsdGeom

    return "z" if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else "y"


def _open(path: Path, take: Take) -> tuple[Any, list[_Mesh]]:
    from pxr import Usd, UsdGeom, UsdSkel

    stage = open_stage(path)
    every = Usd.TraverseInstanceProxies()
    if take.animation is not None:
        with Usd.EditContext(stage, stage.GetSessionLayer()):
            binding = UsdSkel.BindingAPI.Apply(stage.GetPrimAtPath(take.skeleton))
            binding.CreateAnimationSourceRel().SetTargets([take.animation])
    cache = UsdSkel.Cache()
    bound: dict[str, tuple[Any, Any]] = {}
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), every):
        if prim.IsA(UsdSkel.Root):
            root = UsdSkel.Root(prim)
            cache.Populate(root, every)
            for binding in cache.ComputeSkelBindings(root, every):
                skeleton = cache.GetSkelQuery(binding.GetSkeleton())
                for query in binding.GetSkinningTargets():
                    bound.setdefault(str(query.GetPrim().GetPath()), (skeleton, query))
    meshes = []
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), every):
        if not prim.IsA(UsdGeom.Mesh):
            continue
        shown = UsdGeom.Imageable(prim)
        if shown.ComputePurpose() not in ("default", "render") or (
            shown.ComputeVisibility(Usd.TimeCode.EarliestTime()) == UsdGeom.Tokens.invisible
        ):
            _log.info("%s: %s is not shown and left out", path, prim.GetPath())
            continue
        meshes.append(_Mesh(path, prim, *bound.get(str(prim.GetPath()), (None, None))))
    if not meshes:
        raise FormatError(f"{path}: no visible mesh")
    _log.info(
        "%s: %s up, %g m a unit",
        path,
        UsdGeom.GetStageUpAxis(stage),
        UsdGeom.GetStageMetersPerUnit(stage),
    )
    return stage, meshes


def _clock(stage: Any, meshes: list[_Mesh], fps: float | None, take: Take) -> _Clock:
    tempo = float(stage.GetTimeCodesPerSecond())
    if not (math.isfinite(tempo) and tempo > 0):
        raise FormatError(f"timeCodesPerSecond is {tempo}")
    stamps = np.unique(np.concatenate([np.zeros(0), *(mesh.stamps() for mesh in meshes)]))
    if take.fps is not None and take.frames is not None and fps in (None, take.fps):
        check_size(take.frames, 1, MAX_BYTES)
        ticks = np.arange(take.frames, dtype=np.float64)
        return take.fps, take.start + ticks * (tempo / take.fps)
    if take.bound and stage.HasAuthoredTimeCodeRange():
        first, last = float(stage.GetStartTimeCode()), float(stage.GetEndTimeCode())
    elif len(stamps):
        first, last = float(stamps[0]), float(stamps[-1])
    else:
        first = last = 0.0
    if not (math.isfinite(first) and math.isfinite(last) and first <= last):
        raise FormatError(f"the time codes run from {first} to {last}")
    rate = fps
    if rate is None:
        on_codes = not len(stamps) or np.abs(stamps - first - np.rint(stamps - first)).max() < 0.01
        rate = tempo if on_codes else frame_rate([stamps / tempo]) or tempo
    need = (last - first) / tempo * rate
    check_size(int(min(need, 1e15)), 1, MAX_BYTES)
    count = np.arange(math.floor(need + 1e-3) + 1, dtype=np.float64)
    return rate, np.asarray(first + count * (tempo / rate), dtype=np.float64)


class _Mesh:
    """One mesh prim and what moves it."""

    def __init__(self, path: Path, prim: Any, skeleton: Any, query: Any) -> None:
        from pxr import Usd, UsdGeom, UsdSkel

        self.path, self.prim = path, prim
        self.polygons = Polygons(path, prim)
        self._attribute = UsdGeom.Mesh(prim).GetPointsAttr()
        self._skeleton: Any = skeleton if query is not None and query.HasJointInfluences() else None
        self._query = query
        self._shapes = None
        if query is not None and query.HasBlendShapes() and skeleton.GetAnimQuery():
            self._shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim))
            self._shaper = skeleton.GetAnimQuery()
        self.n_points = len(self._raw(Usd.TimeCode.EarliestTime()))
        self.polygons.check(self.n_points)
        self.bones_key: Any = str(prim.GetPath())
        self.bone_names = [str(prim.GetName())]
        self.joints = np.zeros((self.n_points, 1), dtype=np.int32)
        self.weights = np.ones((self.n_points, 1))
        if self._skeleton is not None:
            self._read_influences()

    def _fail(self, what: str) -> FormatError:
        return FormatError(f"{self.path}: {self.prim.GetPath()}: {what}")

    def _read_influences(self) -> None:
        query = self._query
        if str(query.GetSkinningMethod()) == "dualQuaternion":
            raise self._fail("dual quaternion skinning; linear blend skinning is read")
        found = query.ComputeVaryingJointInfluences(self.n_points)
        if not found:
            raise self._fail("its joint influences do not match its points")
        joints = np.array(found[0], dtype=np.int64).reshape(self.n_points, -1)
        weights = np.array(found[1], dtype=np.float64).reshape(self.n_points, -1)
        order = query.GetJointOrder() or self._skeleton.GetJointOrder()
        if not joints.shape[1] or joints.min() < 0 or joints.max() >= len(order):
            raise self._fail(f"a joint index outside 0 to {len(order) - 1}")
        total = weights.sum(axis=1, keepdims=True)
        if not np.isfinite(weights).all() or (weights < 0).any() or (total <= 0).any():
            raise self._fail("skin weights that are negative, not finite or all zero")
        if np.abs(total - 1).max() > 1e-3:
            _log.warning("%s: skin weights that do not sum to 1 are scaled", self.prim.GetPath())
        self.joints = np.where(weights > 0, joints, 0).astype(np.int32)
        self.weights = weights / total
        self._bind = np.array(query.GetGeomBindTransform(), dtype=np.float64).T
        self.bone_names = [str(token).rsplit("/", 1)[-1] for token in order]
        place = str(self._skeleton.GetSkeleton().GetPrim().GetPath())
        self.bones_key = (place, tuple(map(str, order)), self._bind.tobytes())

    @property
    def deforms(self) -> bool:
        if len(self._attribute.GetTimeSamples()) > 1:
            return True
        return self._shapes is not None and self._shaper.BlendShapeWeightsMightBeTimeVarying()

    def stamps(self) -> NDArray[np.float64]:
        """Time codes at which anything about this mesh is sampled."""
        from pxr import UsdGeom

        found = list(self._attribute.GetTimeSamples())
        if self._skeleton is not None and self._skeleton.GetAnimQuery():
            found += self._skeleton.GetAnimQuery().GetJointTransformTimeSamples()
        if self._shapes is not None:
            found += self._shaper.GetBlendShapeWeightTimeSamples()
        prim = self.prim if self._skeleton is None else self._skeleton.GetPrim()
        while prim and not prim.IsPseudoRoot():
            if prim.IsA(UsdGeom.Xformable):
                found += UsdGeom.Xformable(prim).GetTimeSamples()
            prim = prim.GetParent()
        return np.array(found, dtype=np.float64)

    def _raw(self, code: Any) -> NDArray[np.float64]:
        values = self._attribute.Get(code)
        if values is None or not len(values):
            raise self._fail("no points")
        return np.array(values, dtype=np.float64)

    def points(self, code: float) -> NDArray[np.float64]:
        """Points before skinning ``(V, 3)``, blend shapes applied."""
        points = self._raw(code)
        if len(points) != self.n_points:
            raise self._fail(f"{self.n_points} points at first, {len(points)} at {code:g}")
        if self._shapes is None:
            return points
        weights = self._shaper.ComputeBlendShapeWeights(code)
        mapper = self._query.GetBlendShapeMapper()
        if mapper:
            weights = mapper.Remap(weights)
        amounts, shapes, parts = self._shapes.ComputeSubShapeWeights(weights)
        rows, offsets = (
            self._shapes.ComputeBlendShapePointIndices(),
            self._shapes.ComputeSubShapePointOffsets(),
        )
        for amount, shape, part in zip(amounts, shapes, parts, strict=True):
            moved = np.array(offsets[part], dtype=np.float64).reshape(-1, 3)
            row = np.array(rows[shape], dtype=np.int64)
            row = row if len(row) else np.arange(self.n_points)
            if len(row) != len(moved) or row.min() < 0 or row.max() >= self.n_points:
                raise self._fail("a blend shape that does not match its points")
            np.add.at(points, row, amount * moved)
        return points

    def transforms(self, codes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transforms ``(F, B, 3, 4)`` from points to world space."""
        return np.stack([self._transforms_at(code) for code in codes])

    def _transforms_at(self, code: float) -> NDArray[np.float64]:
        from pxr import UsdGeom

        world = UsdGeom.XformCache(code)
        if self._skeleton is None:
            return np.array(world.GetLocalToWorldTransform(self.prim)).T[None, :3]
        found = self._skeleton.ComputeSkinningTransforms(code)
        if not found:
            raise self._fail("its skeleton has no usable bind or rest transforms")
        mapper = self._query.GetJointMapper()
        if mapper and not mapper.IsIdentity():
            found = mapper.RemapTransforms(found)
        place = np.array(world.GetLocalToWorldTransform(self._skeleton.GetPrim())).T
        matrices = np.swapaxes(np.array(found, dtype=np.float64).reshape(-1, 4, 4), 1, 2)
        return np.asarray((place @ matrices @ self._bind)[:, :3])

    def bake(self, codes: NDArray[np.float64], out: NDArray[np.float32]) -> None:
        """Points in world space at each time code."""
        for frame, code in enumerate(codes):
            out[frame] = skin(
                self.points(float(code)),
                self.joints,
                self.weights,
                self._transforms_at(float(code)),
                dtype=np.float64,
            )
