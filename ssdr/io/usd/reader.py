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
from ...skinning import Skinning
from ..axes import Up, check_up, turn_skinning_up, turn_up
from ..registry import reading, require
from ..rig import MAX_BYTES, check_size, frame_rate, join_trees, model_of
from .mesh import Mesh
from .stage import Take, name_of, open_stage, takes_of
from .surface import join_surface

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

    Joints hang on each other as their paths say; where none does, there is no hierarchy.

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
                parents, positions = _hierarchy(meshes)
        width = max(mesh.indices.shape[1] for mesh in meshes)

        def wide(values: NDArray[Any]) -> NDArray[Any]:
            return np.pad(values, ((0, 0), (0, width - values.shape[1])))

        starts, names = _bones(meshes)
        indices = np.concatenate([wide(m.indices + starts[m.bones_key]) for m in meshes])
        weights = np.concatenate([wide(m.weights) for m in meshes])
        transforms = np.concatenate(moved)
        model = Skinning(
            np.concatenate(points),
            np.where(weights > 0, indices, 0),
            weights,
            transforms,
            faces=faces,
            clips=in_order(clips),
            bone_model=model_of(transforms),
            surface=surface,
            bone_names=unique_names(names),
            name=name_of(stage, path),
            parents=parents,
            joint_positions=positions,
        )
        return model if up is None else turn_skinning_up(model, _up(stage), up)


def _bones(meshes: list[Mesh]) -> tuple[dict[Any, int], list[str]]:
    """First bone of each skeleton, and the names of all bones."""
    starts: dict[Any, int] = {}
    names: list[str] = []
    for mesh in meshes:
        if mesh.bones_key not in starts:
            starts[mesh.bones_key] = len(names)
            names += mesh.bone_names
    return starts, names


def _hierarchy(meshes: list[Mesh]) -> tuple[Any, Any]:
    """Parents and joints of all bones, None where nothing hangs on anything."""
    first = {mesh.bones_key: mesh for mesh in reversed(meshes)}
    return join_trees([first[key].hierarchy() for key in _bones(meshes)[0]])


def _transforms(path: Path, meshes: list[Mesh], codes: NDArray[np.float64]) -> NDArray[np.float64]:
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


def _open(path: Path, take: Take) -> tuple[Any, list[Mesh]]:
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
        meshes.append(Mesh(path, prim, *bound.get(str(prim.GetPath()), (None, None))))
    if not meshes:
        raise FormatError(f"{path}: no visible mesh")
    _log.info(
        "%s: %s up, %g m a unit",
        path,
        UsdGeom.GetStageUpAxis(stage),
        UsdGeom.GetStageMetersPerUnit(stage),
    )
    return stage, meshes


def _clock(stage: Any, meshes: list[Mesh], fps: float | None, take: Take) -> _Clock:
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
