"""Reading and writing of USD's preview materials."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, UsdGeom, UsdShade, Vt

from ...mesh.clips import unique_names
from ...mesh.surface import Material, Surface
from ..atomic import write_bytes
from ..file_errors import check
from ..references import find_inside
from ..signatures import PICTURE_SUFFIXES, picture_type
from .mesh_prims import MeshPrim
from .stage import identifier

_log = logging.getLogger(__name__)


def read_materials(path: Path, meshes: Sequence[MeshPrim]) -> list[Material]:
    """Read the materials of the meshes of the file `path`, and set `material` of each mesh."""
    found = _Materials(path)
    for mesh in meshes:
        mesh.material = found.of_polygons(mesh)[mesh.polygon]
    return found.materials


class _Materials:
    """The materials that the meshes of a stage use, in the order of their first use."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.materials: list[Material] = []
        self._known: dict[str, int] = {}

    def of_polygons(self, mesh: MeshPrim) -> NDArray[np.int64]:
        prim, count = mesh.prim, len(mesh.counts)
        sided = bool(UsdGeom.Mesh(prim).GetDoubleSidedAttr().Get())
        index = np.full(count, self._number(prim, sided), dtype=np.int64)
        for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
            rows = np.array(subset.GetIndicesAttr().Get() or [], dtype=np.int64)
            there = not len(rows) or 0 <= rows.min() <= rows.max() < count
            check(there, f"{subset.GetPath()}: a face that is not there")
            index[rows] = self._number(subset.GetPrim(), sided)
        color = UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor")
        values = color.Get() if color and color.HasValue() else None
        if values and (index < 0).any():
            # A material has one colour, so it gets the mean of colours that vary over the mesh.
            r, g, b = np.array(values, dtype=np.float64).reshape(-1, 3).mean(axis=0).tolist()
            index[index < 0] = len(self.materials)
            name = str(prim.GetName())
            self.materials.append(
                Material(name=name, base_color=(r, g, b, 1.0), double_sided=sided)
            )
        return index

    def _number(self, prim: Any, sided: bool) -> int:
        look = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        if not look:
            return -1
        key = str(look.GetPath())
        if key not in self._known:
            self._known[key] = len(self.materials)
            self.materials.append(self._read(look, sided))
        return self._known[key]

    def _read(self, look: Any, sided: bool) -> Material:
        name = str(look.GetPrim().GetName())
        shader = look.ComputeSurfaceSource()[0]
        if not shader or shader.GetIdAttr().Get() != "UsdPreviewSurface":
            _log.warning("%s: %s is no UsdPreviewSurface", self.path, look.GetPath())
            return Material(name=name, double_sided=sided)

        def value(key: str, default: Any) -> Any:
            attribute = _source(shader.GetInput(key))
            found = attribute.Get() if attribute else None
            return default if found is None or hasattr(found, "path") else found

        color, texture = value("diffuseColor", (0.18, 0.18, 0.18)), None
        attribute = _source(shader.GetInput("diffuseColor"))
        picture = UsdShade.Shader(attribute.GetPrim()) if attribute else None
        if picture and picture.GetIdAttr().Get() == "UsdUVTexture":
            texture = self._texture(picture)
            scale = picture.GetInput("scale")
            factor = scale.Get() if scale else None
            color = (1.0, 1.0, 1.0) if factor is None else tuple(factor)[:3]
        r, g, b = (float(c) for c in color)
        return Material(
            name=name,
            base_color=(r, g, b, float(value("opacity", 1.0))),
            metallic=float(value("metallic", 0.0)),
            roughness=float(value("roughness", 0.5)),
            double_sided=sided,
            texture=texture,
            texture_type=picture_type(texture or b"") or "image/png",
        )

    def _texture(self, picture: Any) -> bytes | None:
        holder = picture.GetInput("file")
        asset = holder.Get() if holder else None
        name = str(asset.resolvedPath or asset.path) if asset else ""
        file = find_inside(self.path, "texture", name) if name else None
        return None if file is None else file.read_bytes()


def _source(holder: Any) -> Any:
    """The attribute that gives a shader input its value, or None if there is no such attribute."""
    found = UsdShade.Utils.GetValueProducingAttributes(holder) if holder else []
    return found[0] if found else None


def write_materials(
    stage: Any, top: Any, mesh: Any, surface: Surface, path: Path, notes: list[str]
) -> None:
    """Define the materials of a surface as prims below `top`, and bind them to a mesh.

    Each texture is written to a file beside `path`, and a note of the file is added to `notes`.
    """
    types = Sdf.ValueTypeNames
    names = unique_names([identifier(m.name) for m in surface.materials])
    looks = []
    for name, material in zip(names, surface.materials, strict=True):
        place = top.AppendChild("Looks").AppendChild(name)
        look = UsdShade.Material.Define(stage, place)
        shader = _shader(stage, place.AppendChild("Surface"), "UsdPreviewSurface")
        color = shader.CreateInput("diffuseColor", types.Color3f)
        color.Set(Gf.Vec3f(*map(float, material.base_color[:3])))
        shader.CreateInput("opacity", types.Float).Set(float(material.base_color[3]))
        shader.CreateInput("metallic", types.Float).Set(float(material.metallic))
        shader.CreateInput("roughness", types.Float).Set(float(material.roughness))
        if material.texture is not None:
            suffix = PICTURE_SUFFIXES.get(material.texture_type, ".img")
            file = path.with_name(f"{path.stem}_{name}{suffix}")
            write_bytes(file, material.texture)
            notes.append(f"texture in {file.name}")
            reader = _shader(stage, place.AppendChild("Coordinates"), "UsdPrimvarReader_float2")
            reader.CreateInput("varname", types.String).Set("st")
            reader.CreateOutput("result", types.Float2)
            picture = _shader(stage, place.AppendChild("Texture"), "UsdUVTexture")
            picture.CreateInput("file", types.Asset).Set(f"./{file.name}")
            coordinates = picture.CreateInput("st", types.Float2)
            coordinates.ConnectToSource(reader.ConnectableAPI(), "result")
            for wrap in ("wrapS", "wrapT"):
                picture.CreateInput(wrap, types.Token).Set("repeat")
            # The base colour of a textured material multiplies its texture, as in glTF.
            scale = picture.CreateInput("scale", types.Float4)
            scale.Set(Gf.Vec4f(*map(float, material.base_color)))
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


def _shader(stage: Any, place: Any, kind: str) -> Any:
    shader = UsdShade.Shader.Define(stage, place)
    shader.CreateIdAttr(kind)
    return shader
