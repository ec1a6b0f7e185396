"""Names of the materials of a stage, and the triangles that have each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pxr import UsdShade, Vt

from ...mesh.clips import unique_names
from ...mesh.surface import Material, Surface
from ..file_errors import check
from .mesh_prims import MeshPrim
from .stage import identifier


def read_materials(meshes: Sequence[MeshPrim]) -> list[Material]:
    """Materials of meshes, with their names alone; sets `material` of each mesh."""
    known: dict[str, int] = {}  # by path
    materials: list[Material] = []

    def number(prim: Any) -> int:
        look = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        if not look:
            return -1
        if str(look.GetPath()) not in known:
            known[str(look.GetPath())] = len(materials)
            materials.append(Material(name=str(look.GetPrim().GetName())))
        return known[str(look.GetPath())]

    for mesh in meshes:
        count = len(mesh.counts)
        index = np.full(count, number(mesh.prim), dtype=np.int64)
        for subset in UsdShade.MaterialBindingAPI(mesh.prim).GetMaterialBindSubsets():
            rows = np.array(subset.GetIndicesAttr().Get() or [], dtype=np.int64)
            there = not len(rows) or 0 <= rows.min() <= rows.max() < count
            check(there, f"{subset.GetPath()}: a face that is not there")
            index[rows] = number(subset.GetPrim())
        mesh.material = index[mesh.polygon]
    return materials


def write_materials(stage: Any, top: Any, mesh: Any, surface: Surface) -> None:
    """Define the materials of a surface by name alone, below `top`, and bind them to a mesh."""
    names = unique_names([identifier(m.name) for m in surface.materials])
    places = [top.AppendChild("Looks").AppendChild(name) for name in names]
    looks = [UsdShade.Material.Define(stage, place) for place in places]
    binding = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
    if len(looks) == 1 or surface.material_index is None:
        binding.Bind(looks[0])
        return
    for k, (name, look) in enumerate(zip(names, looks, strict=True)):
        index = np.flatnonzero(surface.material_index == k).astype(np.int32)
        subset = binding.CreateMaterialBindSubset(name, Vt.IntArray.FromNumpy(index))
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(look)
