"""Stages of USD: meshes made by hand, and prims by their kind."""

from __future__ import annotations


def items(stage, kind):
    """Every prim of a schema, such as ``UsdGeom.Mesh``."""
    return [kind(prim) for prim in stage.Traverse() if prim.IsA(kind)]


def mesh(stage, name, points, corners=(0, 1, 2)):
    """A mesh of one polygon."""
    from pxr import UsdGeom, Vt

    made = UsdGeom.Mesh.Define(stage, name)
    made.CreatePointsAttr(Vt.Vec3fArray([tuple(map(float, point)) for point in points]))
    made.CreateFaceVertexCountsAttr([len(corners)])
    made.CreateFaceVertexIndicesAttr(list(corners))
    return made
