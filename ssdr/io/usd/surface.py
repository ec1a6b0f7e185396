"""USD's polygons, primvars and preview materials as triangles and their surface."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ...sequence import Material, Surface

__all__ = ["Polygons", "join_surface"]

_log = logging.getLogger(__name__)


class Polygons:
    """The polygons of a mesh, cut into fans of triangles."""

    def __init__(self, path: Path, prim: Any) -> None:
        from pxr import UsdGeom

        mesh = UsdGeom.Mesh(prim)
        self.path, self.prim, self.mesh = path, prim, mesh
        for attribute in (mesh.GetFaceVertexIndicesAttr(), mesh.GetFaceVertexCountsAttr()):
            if len(attribute.GetTimeSamples()) > 1:
                raise self._fail("its topology changes over time")
        self.counts = self._integers(mesh.GetFaceVertexCountsAttr())
        self.indices = self._integers(mesh.GetFaceVertexIndicesAttr())
        if len(self.counts) and self.counts.min() < 3:
            raise self._fail(f"a face of {self.counts.min()} corners")
        if self.counts.sum() != len(self.indices):
            raise self._fail(
                f"faceVertexCounts add up to {self.counts.sum()}, "
                f"there are {len(self.indices)} faceVertexIndices"
            )
        fans = self.counts - 2
        starts = np.cumsum(self.counts) - self.counts
        self.polygon = np.repeat(np.arange(len(self.counts)), fans)
        place = np.arange(int(fans.sum())) - np.repeat(np.cumsum(fans) - fans, fans)
        first = starts[self.polygon]
        self.corners = np.stack([first, first + place + 1, first + place + 2], axis=1)
        if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
            self.corners = self.corners[:, ::-1]
        self.faces = self.indices[self.corners]

    def _fail(self, what: str) -> FormatError:
        return FormatError(f"{self.path}: {self.prim.GetPath()}: {what}")

    @staticmethod
    def _integers(attribute: Any) -> NDArray[np.int64]:
        from pxr import Usd

        values = attribute.Get(Usd.TimeCode.EarliestTime())
        return np.array([] if values is None else values, dtype=np.int64)

    def check(self, n_points: int) -> None:
        """Refuse indices of points that are not there."""
        if len(self.indices) and not 0 <= self.indices.min() <= self.indices.max() < n_points:
            raise self._fail(
                f"faceVertexIndices from {self.indices.min()} to {self.indices.max()} "
                f"for {n_points} points"
            )
        self.n_points = n_points

    def _spread(self, values: Any, interpolation: str, width: int, what: str) -> Any:
        array = np.array(values, dtype=np.float32).reshape(-1, width)
        shape = (len(self.faces), 3, width)
        sizes = {
            "faceVarying": (len(self.indices), self.corners),
            "vertex": (self.n_points, self.faces),
            "varying": (self.n_points, self.faces),
            "uniform": (len(self.counts), np.repeat(self.polygon[:, None], 3, axis=1)),
            "constant": (1, np.zeros(shape[:2], dtype=int)),
        }
        if interpolation not in sizes or len(array) < sizes[interpolation][0]:
            _log.warning(
                "%s: %s does not match the mesh and is left out", self.prim.GetPath(), what
            )
            return None
        return array[sizes[interpolation][1]]

    def uv(self, code: float) -> NDArray[np.float32] | None:
        from pxr import Sdf, UsdGeom

        api = UsdGeom.PrimvarsAPI(self.prim)
        chosen = api.GetPrimvar("st")
        if not chosen or not chosen.HasValue():
            names = (Sdf.ValueTypeNames.TexCoord2fArray, Sdf.ValueTypeNames.Float2Array)
            usable = [p for p in api.GetPrimvarsWithValues() if p.GetTypeName() in names]
            if not usable:
                return None
            chosen = usable[0]
        values = chosen.ComputeFlattened(code)
        found: NDArray[np.float32] | None = self._spread(
            values, str(chosen.GetInterpolation()), 2, "UV"
        )
        return found

    def normals(self, code: float) -> NDArray[np.float32] | None:
        from pxr import UsdGeom

        primvar = UsdGeom.PrimvarsAPI(self.prim).GetPrimvar("normals")
        if primvar and primvar.HasValue():
            values, how = primvar.ComputeFlattened(code), str(primvar.GetInterpolation())
        else:
            values = self.mesh.GetNormalsAttr().Get(code)
            how = str(self.mesh.GetNormalsInterpolation())
        if values is None:
            return None
        found = self._spread(values, how, 3, "normals")
        if found is None:
            return None
        length = np.linalg.norm(found, axis=2, keepdims=True)
        unit = np.where(length > 0, found / np.where(length > 0, length, 1), [0.0, 1.0, 0.0])
        return np.asarray(unit, dtype=np.float32)


def join_surface(
    path: Path, stage: Any, meshes: list[Polygons], code: float
) -> tuple[NDArray[np.int32], Surface | None]:
    """Triangles of all meshes one behind the other, and what they look like."""
    starts = np.cumsum([0] + [mesh.n_points for mesh in meshes])
    faces = np.concatenate(
        [mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]
    ).astype(np.int32)
    if not len(faces):
        return faces, None
    corners: dict[str, NDArray[np.float32] | None] = {}
    for name, width in (("uv", 2), ("normals", 3)):
        found = [getattr(mesh, name)(code) for mesh in meshes]
        corners[name] = None
        if all(values is not None for values in found):
            corners[name] = np.concatenate(found)
        elif name == "uv" and any(values is not None for values in found):
            corners[name] = np.concatenate(
                [
                    np.zeros((len(m.faces), 3, width), np.float32) if v is None else v
                    for m, v in zip(meshes, found, strict=True)
                ]
            )
    materials: list[Material] = []
    known: dict[str, int] = {}
    index = np.concatenate([_assign(path, mesh, materials, known) for mesh in meshes])
    if materials and (index < 0).any():
        index = np.where(index < 0, len(materials), index)
        materials.append(Material(name="default"))
    if not materials and all(values is None for values in corners.values()):
        return faces, None
    return faces, Surface(
        uv=corners["uv"],
        normals=corners["normals"],
        material_index=index.astype(np.int32) if materials else None,
        materials=tuple(materials),
    )


def _assign(
    path: Path, mesh: Polygons, materials: list[Material], known: dict[str, int]
) -> NDArray[np.int64]:
    from pxr import UsdGeom, UsdShade

    def number(prim: Any) -> int:
        look = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        if not look:
            return -1
        key = str(look.GetPath())
        if key not in known:
            known[key] = len(materials)
            materials.append(_material(path, look, mesh))
        return known[key]

    index = np.full(len(mesh.counts), number(mesh.prim), dtype=np.int64)
    for subset in UsdShade.MaterialBindingAPI(mesh.prim).GetMaterialBindSubsets():
        rows = np.array(subset.GetIndicesAttr().Get() or [], dtype=np.int64)
        if len(rows) and not 0 <= rows.min() <= rows.max() < len(index):
            raise FormatError(f"{path}: {subset.GetPath()}: a face that is not there")
        index[rows] = number(subset.GetPrim())
    if (index < 0).any():
        color = UsdGeom.PrimvarsAPI(mesh.prim).GetPrimvar("displayColor")
        values = color.Get() if color and color.HasValue() else None
        if values:
            # Colours that vary over the mesh have no place in a material: their mean stands.
            mean = np.array(values, dtype=np.float64).reshape(-1, 3).mean(axis=0)
            index[index < 0] = len(materials)
            materials.append(
                Material(
                    name=str(mesh.prim.GetName()),
                    base_color=(float(mean[0]), float(mean[1]), float(mean[2]), 1.0),
                    double_sided=bool(mesh.mesh.GetDoubleSidedAttr().Get()),
                )
            )
    return index[mesh.polygon]


def _material(path: Path, look: Any, mesh: Polygons) -> Material:
    plain = Material(
        name=str(look.GetPrim().GetName()),
        double_sided=bool(mesh.mesh.GetDoubleSidedAttr().Get()),
    )
    shader = look.ComputeSurfaceSource()[0]
    if not shader or shader.GetIdAttr().Get() != "UsdPreviewSurface":
        _log.warning("%s: %s is no UsdPreviewSurface", path, look.GetPath())
        return plain

    def value(name: str, default: Any) -> Any:
        attribute = _source(shader.GetInput(name))
        found = attribute.Get() if attribute else None
        return default if found is None or hasattr(found, "path") else found

    color, texture, kind = value("diffuseColor", (0.18, 0.18, 0.18)), None, "image/png"
    attribute = _source(shader.GetInput("diffuseColor"))
    from pxr import UsdShade

    picture = UsdShade.Shader(attribute.GetPrim()) if attribute else None
    if picture and picture.GetIdAttr().Get() == "UsdUVTexture":
        texture, kind = _texture(path, picture)
        scale = picture.GetInput("scale")
        factor = scale.Get() if scale else None
        color = (1.0, 1.0, 1.0) if factor is None else tuple(factor)[:3]
    return Material(
        name=plain.name,
        base_color=(
            float(color[0]),
            float(color[1]),
            float(color[2]),
            float(value("opacity", 1.0)),
        ),
        metallic=float(value("metallic", 0.0)),
        roughness=float(value("roughness", 0.5)),
        double_sided=plain.double_sided,
        texture=texture,
        texture_type=kind,
    )


def _source(holder: Any) -> Any:
    from pxr import UsdShade

    if not holder:
        return None
    found = UsdShade.Utils.GetValueProducingAttributes(holder)
    return found[0] if found else None


def _texture(path: Path, picture: Any) -> tuple[bytes | None, str]:
    holder = picture.GetInput("file")
    asset = holder.Get() if holder else None
    where = Path(str(asset.resolvedPath or asset.path)) if asset else None
    if where is None or not str(where):
        return None, "image/png"
    folder = path.parent.resolve()
    file = (folder / where).resolve()
    if not file.is_relative_to(folder):
        _log.warning("%s: the texture %s lies outside its folder and is left out", path, where)
        return None, "image/png"
    if not file.is_file():
        _log.warning("%s: the texture %s is missing", path, where)
        return None, "image/png"
    data = file.read_bytes()
    return data, "image/jpeg" if data.startswith(b"\xff\xd8\xff") else "image/png"
