"""Writing of USD: UsdSkel characters and point caches."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from ...mesh.clips import Clip, readable, unique_names
from ...mesh.sequence import MeshSequence
from ...mesh.surface import METRES_Y_UP, Space
from ...model.shapes import Shapes, Skinned
from ...model.transforms import parents_first
from ..atomic import atomic_path
from ..corners import rest_normals
from ..played_model import PlayedModel, as_played
from ..save_report import Rounding, SaveReport
from .stage import identifier, system_errors
from .usd_materials import write_materials


def write_skinning(skinning: Skinned, path: Path) -> SaveReport:
    """Write a UsdSkel character: skeleton, one animation per clip, skin weights, surface.

    The first clip is bound to the skeleton, and the stage has its frame rate. Clips with another
    rate have their frames between the time codes of the stage. The stage states the model's unit
    and up axis or, where the model has none, 1 m and y. The root prim has the name of the skinning
    or, if it has none, of the file.

    Parameters
    ----------
    skinning : Skinning or ShapedSkinning
        A bone that stretches becomes two joints.  Its shapes become blend shapes without normals of
        their own.
    path : Path
        ``.usda`` (text), ``.usdc`` or ``.usd`` (binary).

    Returns
    -------
    SaveReport
        Its errors are larger than those of glTF if bones scale, because UsdSkel stores scales in
        half precision.

    Raises
    ------
    InputError
        If a bone mirrors or an option is not usable.

    References
    ----------
    Pixar, "UsdSkel schemas", https://openusd.org/release/api/usd_skel_page_front.html
    """
    played = as_played(skinning, stretch=True)
    # A SkelAnimation stores all joints at each time code, so a key of one joint is a key of all.
    together = np.broadcast_to(played.keys.any(axis=1, keepdims=True), played.keys.shape)
    played = dataclasses.replace(
        played,
        keys=together,
        scales=None
        if played.scales is None
        else played.scales.astype(np.float16).astype(np.float32),
    )
    first = played.clips[0]
    notes: list[str] = []
    if played.scales is not None:
        notes.append("UsdSkel holds scales in half precision")
    with _new_stage(path, first.fps, first.n_frames, skinning.space, notes) as stage:
        top = Sdf.Path("/" + identifier(skinning.name or path.stem))
        stage.SetDefaultPrim(UsdSkel.Root.Define(stage, top).GetPrim())
        skeleton = top.AppendChild("Skeleton")
        tokens = _put_skeleton(stage, skeleton, played, skinning.name)
        mesh = _define_mesh(stage, top, skinning, notes)
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(played.rest))
        mesh.CreateExtentAttr(_extent(played.rest))
        normals = rest_normals(skinning.skinning, played.rest)
        if normals is not None:
            _put_primvar(mesh, "normals", Sdf.ValueTypeNames.Normal3fArray, normals)
        _bind(mesh.GetPrim(), played, skeleton, tokens)
        if played.shapes is not None:
            _bind_shapes(stage, mesh.GetPrim(), played.shapes)
    size = path.stat().st_size
    return played.report(skinning, path=path, bytes=size, notes=tuple(notes))


def write_sequence(sequence: MeshSequence, path: Path) -> SaveReport:
    """Write a point cache: one mesh with a float32 sample of its points per frame."""
    notes: list[str] = []
    error = Rounding()
    with _new_stage(path, sequence.fps, sequence.n_frames, sequence.space, notes) as stage:
        top = Sdf.Path("/" + identifier(sequence.name or path.stem))
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, top).GetPrim())
        mesh = _define_mesh(stage, top, sequence, notes)
        if sequence.surface is not None and sequence.surface.normals is not None:
            notes.append("normals, of the first frame alone, are not kept")
        points, extent = mesh.CreatePointsAttr(), mesh.CreateExtentAttr()
        for first, block in sequence.chunks():
            for frame, values in enumerate(error.round(block, first), start=first):
                points.Set(Vt.Vec3fArray.FromNumpy(values), float(frame))
                extent.Set(_extent(values), float(frame))
    return error.report(path, notes=tuple(notes))


@contextlib.contextmanager
def _new_stage(
    path: Path, fps: float, n_frames: int, space: Space, notes: list[str]
) -> Iterator[Any]:
    taken = METRES_Y_UP.but(space)
    notes.append(f"{space}" if space == taken else f"{space}: taken for {taken}")
    with atomic_path(path) as temporary, system_errors(path):
        stage = Usd.Stage.CreateNew(str(temporary))
        UsdGeom.SetStageUpAxis(stage, str(taken.up).upper())
        UsdGeom.SetStageMetersPerUnit(stage, taken.units)
        stage.SetTimeCodesPerSecond(fps)
        stage.SetFramesPerSecond(fps)
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(n_frames - 1)
        yield stage
        stage.GetRootLayer().Save()


def _define_mesh(stage: Any, top: Any, thing: MeshSequence | Skinned, notes: list[str]) -> Any:
    """Define and return a mesh below `top`, with the triangles and UVs of `thing`."""
    faces, surface = thing.faces, thing.surface
    mesh = UsdGeom.Mesh.Define(stage, top.AppendChild("Mesh"))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.reshape(-1)))
    if surface is not None and surface.uv is not None:
        _put_primvar(mesh, "st", Sdf.ValueTypeNames.TexCoord2fArray, surface.uv)
    if surface is not None and surface.colors is not None:
        _put_primvar(mesh, "displayColor", Sdf.ValueTypeNames.Color3fArray, surface.colors[..., :3])
        _put_primvar(mesh, "displayOpacity", Sdf.ValueTypeNames.FloatArray, surface.colors[..., 3:])
    if surface is not None and surface.materials:
        write_materials(stage, top, mesh, surface)
        notes.append("of materials, the names alone are kept")
    return mesh


def _extent(points: NDArray[np.float32]) -> Any:
    return Vt.Vec3fArray.FromNumpy(np.stack([points.min(axis=0), points.max(axis=0)]))


def _put_primvar(mesh: Any, name: str, kind: Any, values: NDArray[Any]) -> None:
    """Add a face-varying primvar, with an index so that equal values are stored once."""
    rows = np.asarray(values, dtype=np.float32).reshape(-1, values.shape[-1])
    distinct, index = np.unique(rows, axis=0, return_inverse=True)
    holder = {1: Vt.FloatArray, 2: Vt.Vec2fArray, 3: Vt.Vec3fArray}[rows.shape[1]]
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, kind, UsdGeom.Tokens.faceVarying)
    primvar.Set(holder.FromNumpy(distinct))
    primvar.SetIndices(Vt.IntArray.FromNumpy(index.reshape(-1).astype(np.int32)))


def _put_skeleton(stage: Any, place: Any, played: PlayedModel, title: str) -> list[str] | None:
    """Define a skeleton with an animation for each clip at a path, and bind the first animation.

    Parameters
    ----------
    stage : Usd.Stage
    place : Sdf.Path
        Path of the skeleton.
    played : PlayedModel
    title : str
        Name of the model. If a single clip has the same name, its name is not stored.

    Returns
    -------
    list of str or None
        Paths of the joints that move vertices, in the order of the model's bones. None if these are
        all joints, in the skeleton's order. The order differs if a bone of the model comes before
        its parent, which USD forbids.
    """
    plain = unique_names([identifier(bone) for bone in played.names])
    order = np.arange(played.n_bones)
    paths = list(plain)
    if played.parents is not None:
        if (played.parents >= order).any():
            order = parents_first(played.parents)
        for bone in order:
            if played.parents[bone] >= 0:
                paths[bone] = f"{paths[played.parents[bone]]}/{plain[bone]}"
    tokens = [paths[bone] for bone in order]
    skeleton = UsdSkel.Skeleton.Define(stage, place)
    skeleton.CreateJointsAttr(tokens)
    if plain != played.names:
        skeleton.CreateJointNamesAttr([readable(played.names[bone]) for bone in order])

    def translations(points: NDArray[np.float32]) -> Any:
        moves = [Gf.Vec3d(*map(float, point)) for point in points[order]]
        return Vt.Matrix4dArray([Gf.Matrix4d(1.0).SetTranslate(move) for move in moves])

    skeleton.CreateBindTransformsAttr(translations(played.centers))
    skeleton.CreateRestTransformsAttr(translations(played.offsets))
    alone = len(played.clips) == 1 and played.clips[0].name in ("", title)
    names = unique_names(["Animation" if alone else identifier(c.name) for c in played.clips])
    places = [skeleton.GetPath().AppendChild(name) for name in names]
    for where, clip in zip(places, played.clips, strict=True):
        animation = UsdSkel.Animation.Define(stage, where)
        animation.CreateJointsAttr(tokens)
        _put_keys(animation, played, order, clip)
        stated: dict[str, Any] = {"fps": clip.fps, "frames": clip.n_frames}
        if not alone:
            stated["name"] = clip.name
        animation.GetPrim().SetCustomDataByKey("ssdr", stated)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([places[0]])
    if played.moving is not None:
        return [paths[bone] for bone in played.moving]
    return paths if (order != np.arange(played.n_bones)).any() else None


def _put_keys(animation: Any, played: PlayedModel, order: NDArray[np.int64], clip: Clip) -> None:
    """Add the keys of a clip to a SkelAnimation, with the first frame at the time code 0.

    `order` (B,) holds the bone indices in the order of the skeleton's joints. The stage has as many
    time codes per second as the first clip has frames.
    """
    tempo = played.clips[0].fps
    translations, rotations = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    scales = animation.CreateScalesAttr()
    ones = np.ones((played.n_bones, 3), dtype=np.float16)
    if played.scales is None:
        scales.Set(Vt.Vec3hArray.FromNumpy(ones))
    for frame in clip.start + np.flatnonzero(played.keys[clip.frames, 0]):
        code = float(frame - clip.start) * (tempo / clip.fps)
        translations.Set(Vt.Vec3fArray.FromNumpy(played.translations[frame, order]), code)
        rotations.Set(Vt.QuatfArray.FromNumpy(played.rotations[frame, order]), code)
        if played.scales is not None:
            scales.Set(
                Vt.Vec3hArray.FromNumpy(played.scales[frame, order].astype(np.float16)), code
            )
    if played.shapes is not None:
        animation.CreateBlendShapesAttr(_shape_tokens(played.shapes))
        weights = animation.CreateBlendShapeWeightsAttr()
        for frame in np.arange(clip.start, clip.stop):
            code = float(frame - clip.start) * (tempo / clip.fps)
            weights.Set(Vt.FloatArray.FromNumpy(played.shapes.amounts[frame]), code)


def _bind_shapes(stage: Any, prim: Any, shapes: Shapes) -> None:
    """Define blend shapes below a mesh that is bound to a skeleton, with the points they move."""
    tokens = _shape_tokens(shapes)
    places = [prim.GetPath().AppendChild(token) for token in tokens]
    for place, displacements in zip(places, shapes.displacements, strict=True):
        rows = np.flatnonzero(displacements.any(axis=1))
        shape = UsdSkel.BlendShape.Define(stage, place)
        # a blend shape without point indices would apply to all points
        rows = rows if len(rows) else np.zeros(1, dtype=np.int64)
        shape.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(displacements[rows].astype(np.float32)))
        shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(rows.astype(np.int32)))
    binding = UsdSkel.BindingAPI(prim)
    binding.CreateBlendShapesAttr(tokens)
    binding.CreateBlendShapeTargetsRel().SetTargets(places)


def _shape_tokens(shapes: Shapes) -> list[str]:
    return list(unique_names([identifier(name) for name in shapes.names], "shape"))


def _bind(prim: Any, played: PlayedModel, skeleton: Any, tokens: Sequence[str] | None) -> None:
    """Bind a mesh to the skeleton at the path `skeleton`.

    `tokens` are the joints in the order of the bones; None if the skeleton has them in that order.
    """
    joints, weights = played.indices.reshape(-1), played.weights.reshape(-1)
    binding = UsdSkel.BindingAPI.Apply(prim)
    width = played.indices.shape[1]
    binding.CreateJointIndicesPrimvar(False, width).Set(Vt.IntArray.FromNumpy(joints))
    binding.CreateJointWeightsPrimvar(False, width).Set(Vt.FloatArray.FromNumpy(weights))
    binding.CreateSkeletonRel().SetTargets([skeleton])
    if tokens is not None:
        binding.CreateJointsAttr(tokens)
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
