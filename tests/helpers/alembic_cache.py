"""Alembic caches as the library's own bindings write them: clocks, transforms, scopes, polygons."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Clock = tuple[float | None, Sequence[float]]
"""A period in seconds with the times in it, or None with all times."""

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
OUTWARD = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
"""Its triangles as Alembic has them: clockwise, seen from outside."""


def moving(n_samples: int, seed: int = 0) -> Any:
    """Points (S, 4, 3) of a tetrahedron that trembles, float32."""
    rng = np.random.default_rng(seed)
    return (TETRAHEDRON + 0.1 * rng.normal(size=(n_samples, 4, 3))).astype(np.float32)


def uniform(fps: float, first: float = 0.0) -> Clock:
    """Clock of samples at equal distances."""
    return 1 / fps, [first]


class Cache:
    """An archive that is being written; `close` completes the file."""

    def __init__(self, path: Path) -> None:
        self.library = pytest.importorskip("alembic3d", reason="alembic3d is not installed")
        self.imath = pytest.importorskip("imath")
        self.geometry = self.library.AbcGeom
        self.path = path
        self._archive = self.library.Abc.OArchive(str(path))
        self.top = self._archive.getTop()

    def clock(self, period: float | None, times: Sequence[float]) -> int:
        core = self.library.AbcCoreAbstract
        stored = core.TimeVector()
        for time in times:
            stored.append(time)
        kind = core.TimeSamplingType(core.AcyclicFlag.kAcyclic)
        if period is not None:
            kind = core.TimeSamplingType(len(times), period)
        return int(self._archive.addTimeSampling(core.TimeSampling(kind, stored)))

    def above(self, name: str, matrices: Any, clock: int, parent: Any = None, **flags: bool) -> Any:
        """A transform with matrices (S, 4, 4) for column vectors."""
        node = self.geometry.OXform(parent or self.top, name, clock)
        for matrix in matrices:
            sample = self.geometry.XformSample()
            sample.setMatrix(self.imath.M44d(*np.asarray(matrix, dtype=np.float64).T.ravel()))
            if "inherits" in flags:
                sample.setInheritsXforms(flags["inherits"])
            node.getSchema().set(sample)
        return node

    def integers(self, values: Any) -> Any:
        return self.imath.IntArrayFromBuffer(np.ascontiguousarray(np.ravel(values), dtype=np.int32))

    def mesh(
        self,
        name: str,
        points: Any,
        clock: int,
        parent: Any = None,
        *,
        polygons: Any = OUTWARD,
        kind: str = "PolyMesh",
        uv: Any = None,
        normals: Any = None,
        hidden: bool = False,
    ) -> Any:
        """A mesh whose points are S arrays (V, 3); polygons are those of all samples or of each."""
        g, imath = self.geometry, self.imath
        item = getattr(g, f"O{kind}")(parent or self.top, name, clock)
        if hidden:
            visible = g.CreateVisibilityProperty(item, clock)
            visible.setValue(0)
        for k, frame in enumerate(points):
            sample = getattr(g, f"O{kind}SchemaSample")()
            frame = np.ascontiguousarray(frame, dtype=np.float32)
            sample.setPositions(imath.V3fArrayFromBuffer(frame))
            own = polygons if np.ndim(polygons[0][0]) == 0 else polygons[min(k, len(polygons) - 1)]
            sample.setFaceIndices(self.integers(np.concatenate(list(own))))
            sample.setFaceCounts(self.integers([len(face) for face in own]))
            if uv is not None:
                sample.setUVs(self.param("V2f", *uv))
            if normals is not None:
                sample.setNormals(self.param("N3f", *normals))
            item.getSchema().set(sample)
        return item

    def param(self, kind: str, values: Any, scope: str, indices: Any = None) -> Any:
        """UVs or normals: values, the word for what has them, and the value of each of these."""
        make = self.imath.V2fArrayFromBuffer if kind == "V2f" else self.imath.V3fArrayFromBuffer
        flat = make(np.ascontiguousarray(values, dtype=np.float32))
        param = getattr(self.geometry, f"O{kind}GeomParamSample")()
        param.setVals(flat)
        if indices is not None:
            array = np.ascontiguousarray(indices, dtype=np.uint32)
            whole = self.imath.UnsignedIntArray(len(array))
            for k, value in enumerate(array):
                whole[k] = int(value)
            param.setIndices(whole)
        param.setScope(getattr(self.geometry.GeometryScope, f"k{scope}Scope"))
        return param

    def colors(self, item: Any, rgba: Any) -> None:
        """Give a mesh a colour (V, 4) for each vertex."""
        g, values = self.geometry, self.imath.C4fArray(len(rgba))
        for k, color in enumerate(rgba):
            values[k] = self.imath.Color4f(*map(float, color))
        held, scope = item.getSchema().getArbGeomParams(), g.GeometryScope.kVertexScope
        param, sample = g.OC4fGeomParam(held, "Cs", False, scope, 1), g.OC4fGeomParamSample()
        sample.setVals(values)
        sample.setScope(scope)
        param.set(sample)

    def close(self) -> Path:
        del self.top, self._archive
        return self.path


def one_mesh(path: Path, points: Any, clock: Clock, above: Any = None, **more: Any) -> Path:
    """Cache of one mesh, ``/ball/ballShape``, below a transform."""
    cache = Cache(path)
    number = cache.clock(*clock)
    parent = cache.above("ball", [np.eye(4)] if above is None else above, number)
    cache.mesh("ballShape", points, number, parent, **more)
    del parent
    return cache.close()
