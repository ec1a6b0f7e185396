"""Script that reads the meshes of an Alembic archive as they are stored.

``reading_process.py`` runs it, in a process of its own because a damaged archive can crash the
library. It needs only NumPy and alembic3d, not the package.
"""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from alembic3d import Abc, AbcGeom

_SCOPES = {
    "kFacevaryingScope": "faceVarying",
    "kVertexScope": "vertex",
    "kVaryingScope": "varying",
    "kUniformScope": "uniform",
    "kConstantScope": "constant",
}
_MOST_SAMPLES = 1 << 22  # of a property; two days at 24 a second


class Refused(Exception):
    """An archive is not read; the message is all that the user sees."""


class Reader:
    """Records of the transforms and meshes of an archive, and the arrays that they name.

    Attributes
    ----------
    meshes, transforms : lists of dicts
        Each transform comes after its parent.
    names : list of lists of str
        For each visible mesh, read or not: names of all objects above it, then its own name.
    arrays : dict
    """

    def __init__(self, job: dict[str, Any]) -> None:
        self.wanted = None if job["meshes"] is None else set(job["meshes"])
        self.most, self.need = int(job["max_bytes"]), 0
        self.names: list[list[str]] = []
        self.hidden: list[str] = []
        self.meshes: list[dict[str, Any]] = []
        self.transforms: list[dict[str, Any]] = []
        self.arrays: dict[str, Any] = {}
        self._known: dict[str, int] = {}

    def read(self, top: Any) -> None:
        for names, chain, mesh in self.find(top):
            self.names.append(names)
            if self.wanted is None or not self.wanted.isdisjoint(names):
                try:
                    self.read_mesh(names, chain, mesh)
                except Refused as error:
                    raise Refused(f"/{'/'.join(names)}: {error}") from error

    def read_mesh(self, names: list[str], chain: list[tuple[str, Any]], mesh: Any) -> None:
        above = -1
        for path, node in chain:
            if path not in self._known:
                self._known[path] = len(self.transforms)
                self.transforms.append(self.transform(node.getSchema(), above))
            above = self._known[path]
        self.meshes.append(self.mesh(mesh, names, above))

    def find(self, top: Any) -> Iterator[tuple[list[str], list[tuple[str, Any]], Any]]:
        """Yield names, transforms above and object of each visible mesh.

        The paths of meshes that are not visible are added to `hidden`.
        """
        waiting: list[Any] = [(top, [], [], False)]
        while waiting:
            item, names, chain, hidden = waiting.pop()
            below = []
            for k in range(item.getNumChildren()):
                header = item.getChildHeader(k)
                child, name = item.getChild(k), header.getName()
                shown = str(AbcGeom.GetVisibility(child))
                unseen = shown == "kVisibilityHidden" or (hidden and shown != "kVisibilityVisible")
                path, above = [*names, name], chain
                if AbcGeom.IXform.matches(header):
                    above = [*chain, ("/".join(path), AbcGeom.IXform(item, name))]
                for kind in (AbcGeom.IPolyMesh, AbcGeom.ISubD):
                    if kind.matches(header) and unseen:
                        self.hidden.append("/".join(path))
                    elif kind.matches(header):
                        yield path, chain, kind(item, name)
                below.append((child, path, above, unseen))
            waiting += below[::-1]

    def afford(self, n_bytes: int, what: str) -> None:
        self.need += n_bytes
        if self.need > self.most:
            raise Refused(
                f"{what} needs {self.need} bytes, above the limit of {self.most} "
                "(max_bytes= raises it)"
            )

    def transform(self, schema: Any, above: int) -> dict[str, Any]:
        """Store the matrices of a transform, for row vectors, and return its record.

        `above` is the index of the transform above it.
        """
        if not schema.getNumSamples():
            values = self.put(np.eye(4)[None])
            return {"parent": above, "clock": ([0.0], 1.0, 1), "values": values}
        times = selectors(schema)
        self.afford(128 * len(times), f"a transform of {len(times)} samples")
        found = [np.array(schema.getValue(t).getMatrix(), dtype=np.float64) for t in times]
        parent = above if schema.getInheritsXforms() else -1
        values = self.put(np.array(found).reshape(-1, 4, 4))
        return {"parent": parent, "clock": clock(schema), "values": values}

    def mesh(self, item: Any, names: list[str], above: int) -> dict[str, Any]:
        """Store the arrays of a mesh and return its record."""
        schema = item.getSchema()
        points = schema.getPositionsProperty()
        times = selectors(points)
        first = array(points, np.float32).reshape(-1, 3)
        self.afford(first.nbytes * len(times), f"{len(times)} samples of {len(first)} vertices")
        topology = [schema.getFaceCountsProperty(), schema.getFaceIndicesProperty()]
        record: dict[str, Any] = {
            "names": names,
            "transform": above,
            "clock": clock(points),
            "subdivision": isinstance(item, AbcGeom.ISubD),
            "counts": self.put(array(topology[0], np.int64)),
            "indices": self.put(array(topology[1], np.int64)),
            "changes": change(points, topology),
            "uv": self.param(schema.getUVsParam(), 2),
            "normals": None,
            "sets": [],
        }
        if not record["changes"]:
            values = np.empty((len(times), *first.shape), dtype=np.float32)
            for k, time in enumerate(times):
                values[k] = array(points, np.float32, time).reshape(-1, 3)
            record["points"] = self.put(values)
        if isinstance(item, AbcGeom.IPolyMesh):
            record["normals"] = self.param(schema.getNormalsParam(), 3)
        for name in schema.getFaceSetNames():
            faces = schema.getFaceSet(name).getSchema().getFacesProperty()
            record["sets"].append((str(name), self.put(array(faces, np.int64))))
        return record

    def param(self, param: Any, width: int) -> tuple[str, str, str | None] | None:
        """Store UVs or normals, if any; return their scope and the keys of values and indices."""
        if not (param and param.valid() and param.getNumSamples()):
            return None
        # Not its expanded values: indices of a damaged archive would be read beyond the values.
        values = array(param.getValueProperty(), np.float32)
        index = array(param.getIndexProperty(), np.int64) if param.isIndexed() else None
        scope = _SCOPES.get(str(param.getScope()), "unknown")
        whole = values.size // width * width
        key = self.put(values.ravel()[:whole].reshape(-1, width))
        return scope, key, None if index is None else self.put(index)

    def put(self, values: Any) -> str:
        key = f"array_{len(self.arrays)}"
        self.arrays[key] = values
        return key


def clock(item: Any) -> tuple[list[float], float, int]:
    """Stored times of a schema or property in seconds, their period, and the number of samples."""
    sampling, count = item.getTimeSampling(), item.getNumSamples()
    stored = [sampling.getSampleTime(k) for k in range(min(count, sampling.getNumStoredTimes()))]
    return stored, sampling.getTimeSamplingType().getTimePerCycle(), count


def selectors(item: Any) -> list[Any]:
    """Selectors of all samples of a schema or property; a single one if they are the same.

    Raises
    ------
    Refused
        If there are no samples or too many, or a time does not select its own sample.
    """
    sampling, count = item.getTimeSampling(), item.getNumSamples()
    if not 0 < count <= _MOST_SAMPLES:
        raise Refused(f"{count} samples, from 1 to {_MOST_SAMPLES} were expected")
    found = []
    for k in range(1 if item.isConstant() else count):
        # The bindings take any number as a time, even an integer that is meant as an index.
        selector = Abc.ISampleSelector(sampling.getSampleTime(k))
        if selector.getIndex(sampling, count) != k:
            raise Refused(f"the time of sample {k} does not follow those before it")
        found.append(selector)
    return found


def array(item: Any, dtype: Any, selector: Any = None) -> Any:
    """Values of an array property, in its first sample by default."""
    values = item.getValue(selector or selectors(item)[0])
    return np.array(values if len(values) else [], dtype=dtype)


def change(points: Any, topology: list[Any]) -> str:
    """Text on the first sample whose faces or number of vertices differ; empty if none does."""
    moving = [item for item in topology if not item.isConstant()]
    times = max((selectors(item) for item in (points, *moving)), key=len)

    def counts(selector: Any) -> str:
        size, faces = (item.getDimension(selector).numPoints() for item in (points, topology[0]))
        return f"{size} vertices and {faces} polygons"

    had, old = counts(times[0]), [array(item, np.int64) for item in moving]
    for k, time in enumerate(times):
        new = [array(item, np.int64, time) for item in moving]
        has = counts(time)
        if has != had or not all(map(np.array_equal, old, new)):
            where = f"frame {k} ({time.getRequestedTime():g} s)"
            return f"{had} in frame 0, {has if has != had else 'others'} in {where}"
    return ""


def read(job: dict[str, Any]) -> dict[str, Any]:
    """Arrays for the package, which checks them."""
    reader = Reader(job)
    reader.read(Abc.IArchive(job["path"]).getTop())
    fields = ("names", "hidden", "meshes", "transforms")
    found = json.dumps({name: getattr(reader, name) for name in fields})
    return {"found": np.array(found), **reader.arrays}
