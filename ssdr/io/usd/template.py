"""A skinning put into the USD file that its meshes came from: all else stays as it is there."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...clips import pick
from ...errors import FormatError, InputError
from ...skinning import Skinning
from ..atomic import atomic_path
from ..carried import carry_normals
from ..registry import SaveReport, reading, require
from ..rig import Rig
from .reader import _clock, _open
from .skeleton import bind, put_skeleton
from .stage import Take, open_stage, takes_of
from .writer import _system_errors

__all__ = ["copy", "left_out", "put", "template_problem"]

_MOVED = ("velocities", "accelerations")
_SHAPES = ("skel:blendShapes", "skel:blendShapeTargets")


def template_problem(path: Path) -> str:
    """Why a file that can be read cannot be a template; empty where it can."""
    require("pxr.UsdSkel", "usd", "USD")
    if path.suffix.lower() == ".usdz":
        return "it is a package"
    with reading(path):
        stage, meshes = _open(path, takes_of(path)[0])  # prims live as long as their stage
    prims = [mesh.prim for mesh in meshes]
    if any(prim.IsInstanceProxy() for prim in prims):
        return "its meshes are instances"
    if _scope(prims) is None or not stage:
        return "its meshes have no common parent"
    return ""


def left_out(path: Path) -> tuple[str, ...]:
    """What the file has and a sequence or skinning that is read from it has not."""
    require("pxr.UsdSkel", "usd", "USD")
    from pxr import UsdGeom, UsdShade

    found: dict[str, None] = {}
    with reading(path):
        stage, meshes = _open(path, takes_of(path)[0])
        for mesh in meshes:
            for primvar in UsdGeom.PrimvarsAPI(mesh.prim).GetPrimvarsWithValues():
                name = str(primvar.GetPrimvarName())
                if name not in ("st", "normals") and not name.startswith("skel:"):
                    found[f"the primvar {name}"] = None
            if mesh.has_axes:
                found["orientations of the joints"] = None
        if len(meshes) > 1:
            found["names and number of the meshes"] = None
        for prim in stage.Traverse():
            if prim.IsA(UsdShade.Shader):
                shader = UsdShade.Shader(prim)
                if shader.GetIdAttr().Get() == "UsdPreviewSurface":
                    kept = ("diffuseColor", "opacity", "metallic", "roughness")
                    for holder in shader.GetInputs():
                        name = str(holder.GetBaseName())
                        picture = holder.HasConnectedSource() and name != "diffuseColor"
                        if picture or name not in kept:
                            found[f"{name} of materials"] = None
            elif prim.IsA(UsdGeom.Camera):
                found["cameras"] = None
            elif str(prim.GetTypeName()).endswith("Light"):
                found["lights"] = None
    return tuple(found)


def copy(path: Path, target: Path, *, clips: Sequence[str | int] | None = None) -> SaveReport:
    """Write the root layer of a USD file again, as text or binary, with all that is in it.

    Parameters
    ----------
    path, target : Path
    clips : names or numbers, optional
        The animations to keep; all by default.

    Raises
    ------
    FormatError
        If the file cannot be read.
    InputError
        If it has no such clip.
    """
    require("pxr.UsdSkel", "usd", "USD")
    with reading(path):
        takes = takes_of(path)
    kept = range(len(takes))
    if clips is not None:
        kept = sorted({pick([take.name for take in takes], clip) for clip in clips})  # type: ignore[assignment]
    with atomic_path(target) as temporary, _system_errors(target):
        stage = _transferred(path, temporary, target)
        for number, take in enumerate(takes):
            if number not in kept and take.animation is not None:
                stage.RemovePrim(take.animation)
        if 0 not in kept and takes[0].animation is not None:
            from pxr import UsdSkel

            binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(takes[0].skeleton))
            binding.CreateAnimationSourceRel().SetTargets([takes[kept[0]].animation])
        stage.GetRootLayer().Save()
    return SaveReport(path=target, bytes=target.stat().st_size)


def _transferred(path: Path, temporary: Path, target: Path) -> Any:
    """A stage of `temporary` with the content of the file; files that it names are found again."""
    from pxr import Sdf, Usd, UsdUtils

    opened = open_stage(path)  # its layer lives as long as it does
    layer = Sdf.Layer.CreateNew(str(temporary))
    layer.TransferContent(opened.GetRootLayer())
    old, new = path.parent.resolve(), target.parent.resolve()
    if old != new:

        def moved(asset: str) -> str:
            if not asset or "://" in asset or os.path.isabs(asset):
                return asset
            if not (old / asset).exists():
                return asset  # what a resolver finds elsewhere
            return Path(os.path.relpath(old / asset, new)).as_posix()

        UsdUtils.ModifyAssetPaths(layer, moved)
    return Usd.Stage.Open(layer)


def put(
    template: Path,
    temporary: Path,
    target: Path,
    model: Skinning,
    rig: Rig,
    clip_names: Mapping[str, str],
    strict: bool,
) -> list[str]:
    """Write the template to `temporary` with the model's skin; what is lost.

    Raises
    ------
    FormatError
        If the template cannot be read.
    InputError
        If the model has other points or triangles, or `strict` and something is lost.
    """
    with reading(template):
        problem = template_problem(template)
        if problem:
            raise FormatError(f"{template}: {problem}; it cannot be a template")
        takes = takes_of(template)
        source, meshes = _open(template, takes[0])
        names = [clip_names.get(take.name, take.name) for take in takes]
        starts = _starts(template, takes, names)
        spread = _spread(template, meshes, model)
        first = float(_clock(source, meshes, None, takes[0])[1][0])
    ours = {clip.name for clip in rig.clips}
    lost = [
        f"the clip {take.name}, which the model does not have"
        for take, name in zip(takes, names, strict=True)
        if take.animation is not None and name not in ours
    ]
    if lost and strict:
        raise InputError("template", "a file all of which can be kept", "; ".join(lost))
    stage = _transferred(template, temporary, target)
    scope = _scope([stage.GetPrimAtPath(mesh.prim.GetPath()) for mesh in meshes])
    if not scope.IsA("SkelRoot"):
        scope.SetTypeName("SkelRoot")
    old = {
        str(mesh._skeleton.GetSkeleton().GetPrim().GetPath()) for mesh in meshes if mesh._skeleton
    }
    _remove_skeletons(stage, old, takes)
    place = _free(stage, scope, "Skeleton")
    tempo = float(stage.GetTimeCodesPerSecond())
    tokens = put_skeleton(stage, place, rig, "", tempo, starts)
    from pxr import UsdGeom

    # What the model's bones say is where the mesh stands in the world.
    skeleton = UsdGeom.Xformable(stage.GetPrimAtPath(place))
    skeleton.SetResetXformStack(True)
    begin = 0
    for mesh in meshes:
        index = spread[begin : begin + mesh.n_points]
        begin += mesh.n_points
        prim = stage.GetPrimAtPath(mesh.prim.GetPath())
        _put_mesh(prim, mesh, rig, index, place, first, tokens)
    last = max(
        starts.get(clip.name, 0.0) + (clip.n_frames - 1) * tempo / clip.fps
        for clip in rig.clips[:1]
    )
    if not stage.HasAuthoredTimeCodeRange():
        stage.SetStartTimeCode(starts.get(rig.clips[0].name, 0.0))
        stage.SetEndTimeCode(last)
    elif stage.GetEndTimeCode() < last:
        stage.SetEndTimeCode(last)
    stage.GetRootLayer().Save()
    return lost


def _starts(path: Path, takes: list[Take], names: list[str]) -> dict[str, float]:
    """Time code of the first frame of each of the file's clips."""
    return {
        name: float(_clock(*_open(path, take), None, take)[1][0])
        for take, name in zip(takes, names, strict=True)
    }


def _spread(path: Path, meshes: list[Any], model: Skinning) -> NDArray[np.integer]:
    """The model's vertex of each point of the file."""
    starts = np.cumsum([0, *(mesh.n_points for mesh in meshes)])
    count = int(starts[-1])
    spread: NDArray[np.integer] = np.arange(count)
    if model.vertex_map is not None and len(model.vertex_map) == count:
        spread = model.vertex_map
    elif model.n_vertices != count:
        raise InputError("template", f"a file of {model.n_vertices} vertices", f"{count} in {path}")
    faces = np.concatenate([m.polygons.faces + k for m, k in zip(meshes, starts[:-1], strict=True)])
    if not np.array_equal(spread[faces], model.faces):
        raise InputError("template", "a file with the model's triangles", str(path))
    return spread


def _scope(prims: list[Any]) -> Any:
    """The prim under which all of them hang and that is, or can become, a SkelRoot."""
    paths = [prim.GetPath() for prim in prims]
    common = paths[0].GetParentPath()
    for path in paths[1:]:
        common = common.GetCommonPrefix(path.GetParentPath())
    stage = prims[0].GetStage()
    above = []
    while common != common.absoluteRootPath and not common.isEmpty:
        above.append(stage.GetPrimAtPath(common))
        common = common.GetParentPath()
    roots = [prim for prim in above if prim.IsA("SkelRoot")]
    usable = [p for p in above if str(p.GetTypeName()) in ("Xform", "Scope", "")]
    return (roots or usable or [None])[0]


def _free(stage: Any, scope: Any, name: str) -> Any:
    """A path below `scope` that no prim has."""
    place, k = scope.GetPath().AppendChild(name), 1
    while stage.GetPrimAtPath(place):
        place, k = scope.GetPath().AppendChild(f"{name}_{k}"), k + 1
    return place


def _remove_skeletons(stage: Any, old: set[str], takes: list[Take]) -> None:
    """Remove the skeletons that moved these meshes, with their animations."""
    from pxr import Usd

    for path in sorted(old):
        prim = stage.GetPrimAtPath(path)
        kinds = {str(child.GetTypeName()) for child in Usd.PrimRange(prim)}
        if prim and kinds <= {"Skeleton", "SkelAnimation"}:
            stage.RemovePrim(prim.GetPath())
    for take in takes:
        if take.animation is not None and stage.GetPrimAtPath(take.animation):
            stage.RemovePrim(take.animation)


def _put_mesh(
    prim: Any,
    mesh: Any,
    rig: Rig,
    index: NDArray[np.integer],
    skeleton: Any,
    first: float,
    tokens: list[str] | None,
) -> None:
    from pxr import Gf, Usd, UsdGeom, Vt

    shape = UsdGeom.Mesh(prim)
    world = UsdGeom.XformCache(first).GetLocalToWorldTransform(mesh.prim)
    local = world if abs(world.GetDeterminant()) > 1e-12 else Gf.Matrix4d(1.0)
    inverse = np.array(local.GetInverse()).T
    source = mesh._raw(Usd.TimeCode.EarliestTime())
    points = rig.rest[index].astype(np.float64) @ inverse[:3, :3].T + inverse[:3, 3]
    for name in (*_MOVED, *_SHAPES):
        prim.RemoveProperty(name)
    for child in prim.GetChildren():
        if str(child.GetTypeName()) == "BlendShape":
            prim.GetStage().RemovePrim(child.GetPath())
    stored = points.astype(np.float32)
    attribute = shape.GetPointsAttr()
    attribute.Clear()
    attribute.Set(Vt.Vec3fArray.FromNumpy(stored))
    extent = shape.GetExtentAttr()
    if extent.HasAuthoredValue():
        extent.Clear()
        box = np.stack([stored.min(axis=0), stored.max(axis=0)])
        extent.Set(Vt.Vec3fArray.FromNumpy(box))
    _put_normals(prim, mesh, source, points)
    prim.RemoveProperty("skel:joints")  # the order of the old skeleton
    bind(prim, rig.indices[index], rig.weights[index], skeleton, local, tokens)


def _put_normals(
    prim: Any, mesh: Any, source: NDArray[np.float64], target: NDArray[np.float64]
) -> None:
    """Normals of the rest pose, stored as the file has them."""
    from pxr import Usd, UsdGeom, Vt

    polygons = mesh.polygons
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    shape = UsdGeom.Mesh(prim)
    primary = bool(primvar and primvar.HasValue())
    attribute = primvar.GetAttr() if primary else shape.GetNormalsAttr()
    how = str(primvar.GetInterpolation() if primary else shape.GetNormalsInterpolation())
    code = Usd.TimeCode.EarliestTime()
    values = primvar.ComputeFlattened(code) if primary else attribute.Get(code)
    holder = {
        "faceVarying": polygons.corners,
        "vertex": polygons.faces,
        "varying": polygons.faces,
        "uniform": np.repeat(polygons.polygon[:, None], 3, axis=1),
    }.get(how)
    if values is None or holder is None or not len(holder):
        return
    old = np.array(values, dtype=np.float64).reshape(-1, 3)
    if holder.max() >= len(old):
        return
    new = carry_normals(old, holder, polygons.faces, source, target)
    if primary and primvar.IsIndexed():
        primvar.BlockIndices()
    attribute.Clear()
    attribute.Set(Vt.Vec3fArray.FromNumpy(new))
