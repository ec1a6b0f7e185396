"""Writing of Alembic caches: the vertices of every frame, UVs, normals and names of materials."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...mesh.clips import unique_names
from ...mesh.normals import corner_normals
from ...mesh.sequence import MeshSequence
from ..atomic import atomic_path
from ..optional import require
from ..save_report import Rounding, SaveReport


def write_sequence(sequence: MeshSequence, path: Path) -> SaveReport:
    """Write a cache of one mesh, whose first frame is at 0 s.

    If the sequence has normals, those of every frame are written, with the same hard edges. Each
    material is written as a set of faces with its name, and nothing else of it.

    Parameters
    ----------
    sequence : MeshSequence
    path : Path

    Raises
    ------
    InputError
        If a coordinate is beyond the range of float32.
    MissingDependencyError
        If alembic3d is not installed.
    """
    library = require("alembic", "writing Alembic")
    error = Rounding()
    with atomic_path(path) as temporary:
        _write(library, sequence, temporary, error)
    return error.report(path)


def _write(library: Any, sequence: MeshSequence, path: Path, error: Rounding) -> None:
    """Write to `path`; the file is complete once all objects of the library are deleted."""
    import imath

    abc, geometry = library.Abc, library.AbcGeom
    surface, faces = sequence.surface, sequence.faces

    def corners(values: NDArray[Any]) -> NDArray[np.float32]:
        # Alembic's polygons are clockwise
        flat = np.asarray(values, dtype=np.float32)[:, ::-1].reshape(-1, values.shape[-1])
        return np.ascontiguousarray(flat)

    def integers(values: Any) -> Any:
        flat = np.ascontiguousarray(np.ravel(values), dtype=np.int32)
        return imath.IntArrayFromBuffer(flat) if flat.size else imath.IntArray(0)

    archive = abc.CreateArchiveWithInfo(str(path), sequence.fps, "ssdr", "")
    sampling = library.AbcCoreAbstract.TimeSampling(1 / sequence.fps, 0.0)
    clock = archive.addTimeSampling(sampling)
    name = (sequence.name or "mesh").replace("/", "_")
    above = geometry.OXform(archive.getTop(), name)
    mesh = geometry.OPolyMesh(above, f"{name}Shape", clock).getSchema()
    for start, block in sequence.chunks():
        for points in error.round(block, start):
            sample = geometry.OPolyMeshSchemaSample()
            sample.setPositions(imath.V3fArrayFromBuffer(np.ascontiguousarray(points)))
            if not mesh.getNumSamples():
                sample.setFaceIndices(integers(faces[:, ::-1]))
                sample.setFaceCounts(integers(np.full(len(faces), 3)))
                if surface is not None and surface.uv is not None:
                    uv = imath.V2fArrayFromBuffer(corners(surface.uv))
                    scope = geometry.GeometryScope.kFacevaryingScope
                    sample.setUVs(geometry.OV2fGeomParamSample(uv, scope))
            if surface is not None and surface.normals is not None:
                normals = imath.V3fArrayFromBuffer(corners(corner_normals(points, faces, surface)))
                scope = geometry.GeometryScope.kFacevaryingScope
                sample.setNormals(geometry.ON3fGeomParamSample(normals, scope))
            mesh.set(sample)
    if surface is not None and surface.materials:
        index = surface.material_index
        index = np.zeros(len(faces), dtype=np.int32) if index is None else index
        for k, one in enumerate(unique_names([m.name for m in surface.materials])):
            chosen = geometry.OFaceSetSchemaSample()
            chosen.setFaces(integers(np.flatnonzero(index == k)))
            mesh.createFaceSet(one.replace("/", "_")).getSchema().set(chosen)
