"""Copying of USD files, as they are or with a new skin, and a list of what reading them loses."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel, UsdUtils, Vt

from ...clips import pick
from ...normals import unit
from ...skinning import Skinning
from ...space import Space
from ..atomic import atomic_path
from ..registry import SaveReport, check, reading
from ..rig import Rig
from ..scene import check_kept, match_template, template_normals
from .parts import MeshPrim
from .reader import StageReader
from .skeleton import bind, put_skeleton
from .stage import system_errors

_REMOVED = ("velocities", "accelerations", "skel:blendShapes", "skel:blendShapeTargets")
_READ = ("diffuseColor", "opacity", "metallic", "roughness")


def template_problem(path: Path) -> str:
    """Reason why a readable file cannot be a template of the writer, empty if it can."""
    with reading(path):
        reader = StageReader(path)
        return _problem([mesh.prim for mesh in reader.sample(reader.clips[0]).parts])


def template_space(path: Path) -> Space:
    """Unit and up axis that a template states."""
    with reading(path):
        return StageReader(path).space


def _problem(prims: list[Any]) -> str:
    if any(prim.IsInstanceProxy() for prim in prims):
        return "its meshes are instances"
    return "" if _scope(prims) else "its meshes have no common parent"


def put(
    template: Path,
    temporary: Path,
    target: Path,
    model: Skinning,
    rig: Rig,
    meshes: Any,
    clip_names: Mapping[str, str | None],
    strict: bool,
) -> list[str]:
    """Write a template with the model's skin to `temporary` and return the contents that are lost.

    Parameters
    ----------
    template : Path
    temporary, target : Path
        File to write, and the file that it will be renamed to.
    model : Skinning
    rig : Rig
        The rig of `model`.
    meshes, clip_names
        As for the writer, :func:`~ssdr.io.usd.writer.write_skinning`.
    strict : bool
        Whether to raise an error if contents of the template are lost.

    Raises
    ------
    FormatError
        If the file cannot be read, or cannot be a template (see `template_problem`).
    InputError
        If the model has other triangles or another number of points than the template, or if
        `strict` is true and contents are lost.
    """
    with reading(template, "meshes"):
        reader = StageReader(template, meshes=meshes)
        samples = [reader.sample(clip) for clip in reader.clips]
        names = [clip_names.get(s.clip.name, s.clip.name) for s in samples]
        starts = {n: float(s.time[0]) for n, s in zip(names, samples, strict=True) if n}
        parts = samples[0].parts
        problem = _problem([mesh.prim for mesh in parts])
        check(not problem, f"{problem}; it cannot be a template")
    vertices = match_template(parts, model, template)
    ours = {None, *(clip.name for clip in rig.clips)}
    lost = [
        f"the clip {clip.name}, which the model does not have"
        for clip, name in zip(reader.clips, names, strict=True)
        if clip.animation is not None and name not in ours
    ]
    check_kept(lost, strict)
    stage = _transfer(reader, temporary, target)
    scope = _scope([stage.GetPrimAtPath(mesh.prim.GetPath()) for mesh in parts])
    if not scope.IsA("SkelRoot"):
        scope.SetTypeName("SkelRoot")
    _remove_skeletons(stage, parts, [clip.animation for clip in reader.clips])
    place = _free_path(stage, scope, "Skeleton")
    tempo = float(stage.GetTimeCodesPerSecond())
    tokens = put_skeleton(stage, place, rig, "", tempo, starts)
    # The model's bones move the mesh in the world, not relative to the skeleton's parents.
    UsdGeom.Xformable(stage.GetPrimAtPath(place)).SetResetXformStack(True)
    first = float(samples[0].time[0])
    normals = template_normals(parts, vertices, model, rig.rest)
    for mesh, index, own in zip(parts, vertices, normals, strict=True):
        prim = stage.GetPrimAtPath(mesh.prim.GetPath())
        matrix = _put_points(prim, mesh, rig.rest[index], own, first)
        bind(prim, rig.indices[index], rig.weights[index], place, matrix, tokens)
    clip = rig.clips[0]
    begin = starts.get(clip.name, 0.0)
    end = begin + (clip.n_frames - 1) * tempo / clip.fps
    if not stage.HasAuthoredTimeCodeRange():
        stage.SetStartTimeCode(begin)
        stage.SetEndTimeCode(end)
    elif stage.GetEndTimeCode() < end:
        stage.SetEndTimeCode(end)
    stage.GetRootLayer().Save()
    return lost


def _scope(prims: list[Any]) -> Any:
    """Common ancestor of the prims that is or can become their SkelRoot; None if there is none.

    It is the lowest common ancestor that is a SkelRoot or, if there is none, the lowest that can
    become one.
    """
    common = prims[0].GetPath().GetParentPath()
    for prim in prims[1:]:
        common = common.GetCommonPrefix(prim.GetPath().GetParentPath())
    above = []
    while common != common.absoluteRootPath and not common.isEmpty:
        above.append(prims[0].GetStage().GetPrimAtPath(common))
        common = common.GetParentPath()
    roots = [prim for prim in above if prim.IsA("SkelRoot")]
    usable = [prim for prim in above if str(prim.GetTypeName()) in ("Xform", "Scope", "")]
    return (roots or usable or [None])[0]


def _free_path(stage: Any, scope: Any, name: str) -> Any:
    """Path of a new prim below `scope`: its child `name`, with a number if that is taken."""
    place, k = scope.GetPath().AppendChild(name), 1
    while stage.GetPrimAtPath(place):
        place, k = scope.GetPath().AppendChild(f"{name}_{k}"), k + 1
    return place


def _remove_skeletons(stage: Any, meshes: Sequence[MeshPrim], animations: list[Any]) -> None:
    """Remove the prims at the paths `animations`, and the skeletons that moved these meshes.

    A skeleton stays if other prims than animations are below it.
    """
    queries = [mesh.joints for mesh in meshes if mesh.joints is not None]
    for path in {query.GetSkeleton().GetPrim().GetPath() for query in queries}:
        prim = stage.GetPrimAtPath(path)
        kinds = {str(child.GetTypeName()) for child in Usd.PrimRange(prim)}
        if prim and kinds <= {"Skeleton", "SkelAnimation"}:
            stage.RemovePrim(path)
    for path in animations:
        if path is not None and stage.GetPrimAtPath(path):
            stage.RemovePrim(path)


def _put_points(
    prim: Any,
    mesh: MeshPrim,
    rest: NDArray[np.float32],
    normals: NDArray[np.float32],
    first: float,
) -> Any:
    """Put a mesh into the rest pose `rest` (in world space), and return the mesh's matrix.

    Points and normals are replaced, and blend shapes are removed. The matrix takes the new points
    to world space: it is the mesh's matrix at the time code `mesh.seen` or, for a mesh with a skin,
    at `first`; if that is not invertible, it is the identity.
    `normals` (T, 3, 3) are those at triangle corners, in world space.
    """
    code = first if mesh.seen is None else mesh.seen
    world = UsdGeom.XformCache(code).GetLocalToWorldTransform(mesh.prim)
    if abs(world.GetDeterminant()) <= 1e-12:
        world = Gf.Matrix4d(1.0)
    inverse = np.array(world.GetInverse()).T
    points = rest.astype(np.float64) @ inverse[:3, :3].T + inverse[:3, 3]
    for name in _REMOVED:
        prim.RemoveProperty(name)
    prim.RemoveProperty("skel:joints")  # the order of the old skeleton
    for child in prim.GetChildren():
        if str(child.GetTypeName()) == "BlendShape":
            prim.GetStage().RemovePrim(child.GetPath())
    shape = UsdGeom.Mesh(prim)
    _set(shape.GetPointsAttr(), points)
    if shape.GetExtentAttr().HasAuthoredValue():
        _set(shape.GetExtentAttr(), np.stack([points.min(axis=0), points.max(axis=0)]))
    _put_normals(prim, mesh, normals.astype(np.float64) @ np.linalg.inv(inverse[:3, :3]))
    return world


def _set(attribute: Any, values: NDArray[np.floating]) -> None:
    """Replace all time samples of an attribute by a single value."""
    attribute.Clear()
    attribute.Set(Vt.Vec3fArray.FromNumpy(values.astype(np.float32)))


def _put_normals(prim: Any, mesh: MeshPrim, normals: NDArray[np.float64]) -> None:
    """Replace the normals of a mesh by those at its triangle corners, and keep the interpolation.

    A value that several corners share is the mean of their normals.
    """
    values, interpolation, attribute = mesh.normal_values()
    index = mesh.value_index(interpolation)
    if values is None or index is None or not len(index) or index.max() >= len(values):
        return
    new = np.zeros((len(values), 3))
    np.add.at(new, index.reshape(-1), unit(normals).reshape(-1, 3))
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    if primvar and primvar.IsIndexed():
        primvar.BlockIndices()
    old = np.array(values, dtype=np.float64).reshape(-1, 3)
    _set(prim.GetAttribute(attribute.GetName()), unit(new, old, 1e-9))


def copy(path: Path, target: Path, *, clips: Sequence[str | int] | None = None) -> SaveReport:
    """Copy the root layer of a USD file with all its contents, as text or binary.

    Parameters
    ----------
    path, target : Path
    clips : names or indices, optional
        The animations to keep; all by default.

    Raises
    ------
    FormatError
        If the file cannot be read.
    InputError
        If the file has no such clip.
    """
    with reading(path):
        reader = StageReader(path)
        found = reader.clips
    names = [clip.name for clip in found]
    kept = {pick(names, clip) for clip in clips} if clips is not None else set(range(len(found)))
    with atomic_path(target) as temporary, system_errors(target, path):
        stage = _transfer(reader, temporary, target)
        for number, clip in enumerate(found):
            if number not in kept and clip.animation is not None:
                stage.RemovePrim(clip.animation)
        if kept and 0 not in kept and found[0].animation is not None:
            binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(found[0].skeleton))
            binding.CreateAnimationSourceRel().SetTargets([found[min(kept)].animation])
        stage.GetRootLayer().Save()
    return SaveReport(path=target, bytes=target.stat().st_size)


def _transfer(reader: StageReader, temporary: Path, target: Path) -> Any:
    """Create a stage in the file `temporary`, with the contents of the reader's root layer.

    Relative paths of assets are changed to be relative to the folder of `target`.
    """
    layer = Sdf.Layer.CreateNew(str(temporary))
    layer.TransferContent(reader.stage.GetRootLayer())
    old, new = reader.path.parent.resolve(), target.parent.resolve()

    def moved(asset: str) -> str:
        if not asset or os.path.isabs(asset) or not os.path.exists(old / asset):
            return asset  # a resolver finds it elsewhere
        return Path(os.path.relpath(old / asset, new)).as_posix()

    if old != new:
        UsdUtils.ModifyAssetPaths(layer, moved)
    return Usd.Stage.Open(layer)


def left_out(path: Path, *, meshes: str | Sequence[str] | None = None) -> tuple[str, ...]:
    """Contents of a file that are lost when it is read as a sequence or skinning."""
    found: dict[str, None] = {}
    with reading(path, "meshes"):
        reader = StageReader(path, meshes=meshes)
        parts = reader.sample(reader.clips[0]).parts
        for mesh in parts:
            for primvar in UsdGeom.PrimvarsAPI(mesh.prim).GetPrimvarsWithValues():
                name = str(primvar.GetPrimvarName())
                if name not in ("st", "normals") and not name.startswith("skel:"):
                    found[f"the primvar {name}"] = None
            if mesh.has_axes:
                found["orientations of the joints"] = None
        if meshes is not None:
            found["meshes that were not chosen"] = None
        if len(parts) > 1:
            found["names and number of the meshes"] = None
        for prim in reader.stage.Traverse():
            shader = UsdShade.Shader(prim)
            if prim.IsA(UsdGeom.Camera):
                found["cameras"] = None
            elif str(prim.GetTypeName()).endswith("Light"):
                found["lights"] = None
            elif shader and shader.GetIdAttr().Get() == "UsdPreviewSurface":
                for holder in shader.GetInputs():
                    name = str(holder.GetBaseName())
                    picture = holder.HasConnectedSource() and name != "diffuseColor"
                    if picture or name not in _READ:
                        found[f"{name} of materials"] = None
    return tuple(found)
