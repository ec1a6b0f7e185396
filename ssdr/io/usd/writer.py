"""Writing USD: UsdSkel characters and point caches."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...sequence import MeshSequence, Surface
from ...skinning import Skinning
from ..atomic import atomic_path, write_bytes
from ..axes import Up, check_up
from ..corners import corner_normals
from ..registry import SaveReport, require
from ..rig import Error, build_rig, unique_names
from .skeleton import bind, identifier, put_skeleton

__all__ = ["write_sequence", "write_skinning"]


def write_skinning(
    skinning: Skinning,
    path: Path,
    *,
    influences: int | None = None,
    up: Up = "y",
    meters_per_unit: float = 1.0,
    name: str | None = None,
    template: str | os.PathLike[str] | None = None,
    clip_names: Mapping[str, str] | None = None,
    strict: bool = False,
) -> SaveReport:
    """Write a UsdSkel character: skeleton, an animation a clip, skin weights, surface.

    The first clip is bound; its rate is the stage's, on whose time codes the
    others have their own.

    Parameters
    ----------
    skinning : Skinning
        Rigid or similarity bones.
    path : Path
        ``.usda`` (text), ``.usdc`` or ``.usd`` (binary).
    influences : int, optional
        Keep so many of the largest weights of a vertex; all by default.
    up : {"y", "z"}
        The model's up axis, stated in the file; nothing is turned.
    meters_per_unit : float
        The model's unit, stated in the file.
    name : str, optional
        Of the root prim; that of the skinning, else of the file, by default.
    template : path, optional
        The USD file that the model was made of, or one with the same points and
        triangles.  Its root layer is written again with the model's skin and clips; all
        else stays: materials and bindings, primvars, other prims.  The unit, the up
        axis and the time codes are the template's.
    clip_names : mapping of str to str, optional
        What clips of the template are called in the model, where that differs.
    strict : bool
        Refuse, rather than report, what of the template cannot be kept.

    Returns
    -------
    SaveReport
        UsdSkel stores scales in half precision: similarity bones cost more
        here than in glTF.

    Raises
    ------
    InputError
        If a bone is neither rigid nor a similarity, or an option is not usable.

    References
    ----------
    Pixar, "UsdSkel schemas", https://openusd.org/release/api/usd_skel_page_front.html
    """
    require("pxr.UsdSkel", "usd", "USD")
    rig = build_rig(skinning, influences=influences)
    # An animation stores all joints of a frame at once, so a key of one is a key of all.
    together = np.broadcast_to(rig.keys.any(axis=1, keepdims=True), rig.keys.shape)
    halves = None
    if rig.scales is not None:
        halves = rig.scales.astype(np.float16).astype(np.float32)
    rig = dataclasses.replace(
        rig, keys=together, scales=halves, weights=rig.weights.astype(np.float32).astype(float)
    )
    error, between = rig.error(skinning), rig.error(skinning, between=True)
    notes = [f"{up} up, {meters_per_unit:g} m a unit"]
    if halves is not None:
        notes.append("UsdSkel holds scales in half precision")
    first = rig.clips[0]
    lost: list[str] = []
    width = rig.indices.shape[1]
    if template is not None:
        from .template import put

        notes = notes[1:]
        with atomic_path(path) as temporary, _system_errors(path):
            lost += put(Path(template), temporary, path, skinning, rig, clip_names or {}, strict)
        return _report(path, width, error, between, notes, lost)
    with _stage(path, first.fps, first.n_frames, up, meters_per_unit) as stage:
        from pxr import Gf, Sdf, UsdSkel, Vt

        root = UsdSkel.Root.Define(stage, _root(name or skinning.name or path.stem))
        stage.SetDefaultPrim(root.GetPrim())
        top = root.GetPath()
        tokens = put_skeleton(stage, top.AppendChild("Skeleton"), rig, skinning.name, first.fps)
        mesh = _mesh(stage, top, skinning.faces, skinning.surface, path, notes)
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(rig.rest))
        extent = np.stack([rig.rest.min(axis=0), rig.rest.max(axis=0)])
        mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(extent))
        if len(skinning.faces):
            normals = corner_normals(rig.rest, skinning.faces, skinning.surface)
            _primvar(mesh, "normals", Sdf.ValueTypeNames.Normal3fArray, normals.reshape(-1, 3))
        skeleton = top.AppendChild("Skeleton")
        bind(mesh.GetPrim(), rig.indices, rig.weights, skeleton, Gf.Matrix4d(1.0), tokens)
    return _report(path, width, error, between, notes, lost)


def _report(
    path: Path, width: int, error: Error, between: Error, notes: list[str], lost: list[str]
) -> SaveReport:
    return SaveReport(
        path=path,
        bytes=path.stat().st_size,
        influences=width,
        error=error.rmse,
        max_error=error.largest,
        between_frames=between.rmse,
        note="; ".join(notes),
        lost=tuple(lost),
    )


def write_sequence(
    sequence: MeshSequence,
    path: Path,
    *,
    up: Up = "y",
    meters_per_unit: float = 1.0,
    name: str | None = None,
) -> SaveReport:
    """Write a point cache: one mesh with a sample of its points per frame, float32.

    Parameters
    ----------
    sequence : MeshSequence
    path, up, meters_per_unit, name
        As in :func:`write_skinning`.
    """
    require("pxr.UsdGeom", "usd", "USD")
    notes = [f"{up} up, {meters_per_unit:g} m a unit"]
    total, largest = 0.0, 0.0
    with _stage(path, sequence.fps, sequence.n_frames, up, meters_per_unit) as stage:
        from pxr import UsdGeom, Vt

        root = UsdGeom.Xform.Define(stage, _root(name or sequence.name or path.stem))
        stage.SetDefaultPrim(root.GetPrim())
        mesh = _mesh(stage, root.GetPath(), sequence.faces, sequence.surface, path, notes)
        if sequence.surface is not None and sequence.surface.normals is not None:
            notes.append("normals, of the first frame alone, are not kept")
        points, extent = mesh.CreatePointsAttr(), mesh.CreateExtentAttr()
        for first, block in sequence.chunks():
            stored = block.astype(np.float32)
            if not np.isfinite(stored).all():
                raise InputError("thing", "coordinates that float32 can hold", "an overflow")
            squares = ((stored.astype(np.float64) - block) ** 2).sum(axis=2)
            total, largest = total + float(squares.sum()), max(largest, float(squares.max()))
            for frame, values in enumerate(stored, start=first):
                points.Set(Vt.Vec3fArray.FromNumpy(values), float(frame))
                box = np.stack([values.min(axis=0), values.max(axis=0)])
                extent.Set(Vt.Vec3fArray.FromNumpy(box), float(frame))
    count = sequence.n_frames * sequence.n_vertices
    return SaveReport(
        path=path,
        bytes=path.stat().st_size,
        error=math.sqrt(total / count) if total else None,
        max_error=math.sqrt(largest) if total else None,
        note="; ".join(notes),
    )


@contextlib.contextmanager
def _stage(path: Path, fps: float, n_frames: int, up: Up, meters_per_unit: float) -> Iterator[Any]:
    check_up(up)
    if not (math.isfinite(meters_per_unit) and meters_per_unit > 0):
        raise InputError("meters_per_unit", "a positive number", meters_per_unit)
    from pxr import Usd, UsdGeom

    with atomic_path(path) as temporary, _system_errors(path):
        stage = Usd.Stage.CreateNew(str(temporary))
        UsdGeom.SetStageUpAxis(stage, up.upper())
        UsdGeom.SetStageMetersPerUnit(stage, meters_per_unit)
        stage.SetTimeCodesPerSecond(fps)
        stage.SetFramesPerSecond(fps)
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(n_frames - 1)
        yield stage
        stage.GetRootLayer().Save()


@contextlib.contextmanager
def _system_errors(path: Path) -> Iterator[None]:
    """What USD raises of its own where it cannot write, as the OSError that it stands for."""
    from pxr import Tf

    try:
        yield
    except Tf.ErrorException as error:
        text = str(error)
        known = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EROFS)
        number = next((n for n in known if os.strerror(n) in text), errno.EIO)
        said = os.strerror(number) if number != errno.EIO else " ".join(text.split())
        raise OSError(number, said, str(path)) from error


def _root(name: str) -> str:
    return "/" + identifier(name)


def _mesh(
    stage: Any,
    top: Any,
    faces: NDArray[np.int32],
    surface: Surface | None,
    path: Path,
    notes: list[str],
) -> Any:
    from pxr import Sdf, UsdGeom, Vt

    mesh = UsdGeom.Mesh.Define(stage, top.AppendChild("Mesh"))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.reshape(-1)))
    if surface is None:
        return mesh
    if surface.uv is not None:
        uv = np.asarray(surface.uv, dtype=np.float32).reshape(-1, 2)
        _primvar(mesh, "st", Sdf.ValueTypeNames.TexCoord2fArray, uv)
    if surface.materials:
        _materials(stage, top, mesh, surface, path, notes)
    return mesh


def _primvar(mesh: Any, name: str, kind: Any, values: NDArray[np.float32]) -> None:
    """Face-varying values with an index, so that equal corners are stored once."""
    from pxr import UsdGeom, Vt

    distinct, index = np.unique(values, axis=0, return_inverse=True)
    holder = Vt.Vec2fArray if values.shape[1] == 2 else Vt.Vec3fArray
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, kind, UsdGeom.Tokens.faceVarying)
    primvar.Set(holder.FromNumpy(np.ascontiguousarray(distinct, dtype=np.float32)))
    primvar.SetIndices(Vt.IntArray.FromNumpy(index.reshape(-1).astype(np.int32)))


def _materials(
    stage: Any, top: Any, mesh: Any, surface: Surface, path: Path, notes: list[str]
) -> None:
    from pxr import Gf, Sdf, UsdShade, Vt

    types = Sdf.ValueTypeNames
    names = unique_names([identifier(m.name) for m in surface.materials])
    looks = []
    for name, material in zip(names, surface.materials, strict=True):
        place = top.AppendChild("Looks").AppendChild(name)
        look = UsdShade.Material.Define(stage, place)
        shader = UsdShade.Shader.Define(stage, place.AppendChild("Surface"))
        shader.CreateIdAttr("UsdPreviewSurface")
        color = shader.CreateInput("diffuseColor", types.Color3f)
        color.Set(Gf.Vec3f(*map(float, material.base_color[:3])))
        shader.CreateInput("opacity", types.Float).Set(float(material.base_color[3]))
        shader.CreateInput("metallic", types.Float).Set(float(material.metallic))
        shader.CreateInput("roughness", types.Float).Set(float(material.roughness))
        if material.texture is not None:
            ending = {"image/png": ".png", "image/jpeg": ".jpg"}.get(material.texture_type, ".img")
            file = path.with_name(f"{path.stem}_{name}{ending}")
            write_bytes(file, material.texture)
            notes.append(f"texture in {file.name}")
            reader = UsdShade.Shader.Define(stage, place.AppendChild("Coordinates"))
            reader.CreateIdAttr("UsdPrimvarReader_float2")
            reader.CreateInput("varname", types.String).Set("st")
            reader.CreateOutput("result", types.Float2)
            picture = UsdShade.Shader.Define(stage, place.AppendChild("Texture"))
            picture.CreateIdAttr("UsdUVTexture")
            picture.CreateInput("file", types.Asset).Set(f"./{file.name}")
            picture.CreateInput("st", types.Float2).ConnectToSource(
                reader.ConnectableAPI(), "result"
            )
            for wrap in ("wrapS", "wrapT"):
                picture.CreateInput(wrap, types.Token).Set("repeat")
            # The colour of a textured material is a factor, as in glTF.
            picture.CreateInput("scale", types.Float4).Set(
                Gf.Vec4f(*map(float, material.base_color))
            )
            picture.CreateOutput("rgb", types.Float3)
            color.ConnectToSource(picture.ConnectableAPI(), "rgb")
        look.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
        looks.append(look)
    if any(material.double_sided for material in surface.materials):
        mesh.CreateDoubleSidedAttr(True)
    binding = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
    if len(looks) == 1 or surface.material_index is None:
        binding.Bind(looks[0])
        return
    for k, (name, look) in enumerate(zip(names, looks, strict=True)):
        index = np.flatnonzero(surface.material_index == k).astype(np.int32)
        subset = binding.CreateMaterialBindSubset(name, Vt.IntArray.FromNumpy(index))
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(look)
