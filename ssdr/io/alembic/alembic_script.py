"""Script that reads the meshes of an Alembic archive as they are stored.

``reading_process.py`` runs it, in a process of its own because a damaged archive can crash the
library. It needs only NumPy and alembic3d, not the package.
"""

import dataclasses
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
_WRAP = Abc.WrapExistingFlag.kWrapExisting
_MOST_SAMPLES = 1 << 22  # of a property; two days at 24 a second


class Refused(Exception):
    """An archive is not read; the message is all that the user sees."""


@dataclasses.dataclass(eq=False)
class Place:
    """An object of an archive, and the one above it.

    Attributes
    ----------
    shown : (list of float, list of bool)
        Times in seconds from which on the object is visible or not; before the first, it is as it
        is then.
    number : int
        Index of its transform, or else of the next one above, among those that were read; -1 where
        there is none, and None if it has not been looked for.
    size : int
        Characters of its path.
    """

    name: str
    above: Any
    item: Any
    shown: Any
    number: Any = None
    size: int = 0


class Reader:
    """Records of the transforms and meshes of an archive, and the arrays that they name.

    Attributes
    ----------
    meshes, transforms : lists of dicts
        Each transform comes after its parent.
    names : list of lists of str
        For each visible mesh, read or not: names of all objects above it, then its own name.
    others : dict
        Number of the objects of each further kind.
    arrays : dict
    """

    def __init__(self, job: dict[str, Any]) -> None:
        self.wanted = None if job["meshes"] is None else set(job["meshes"])
        self.most, self.need = int(job["max_bytes"]), 0
        self.names: list[list[str]] = []
        self.hidden: list[str] = []
        self.others: dict[str, int] = {}
        self.meshes: list[dict[str, Any]] = []
        self.transforms: list[dict[str, Any]] = []
        self.arrays: dict[str, Any] = {}

    def read(self, top: Any) -> None:
        for place, mesh in self.find(top):
            line = [place]
            while line[-1].above is not None:
                line.append(line[-1].above)
            names = [one.name for one in line[::-1]]
            size = sum(2 * len(name) + 64 for name in names)  # here and in the package
            self.afford(size, f"{len(names)} names of objects above a mesh, beside others,")
            if not any(place.shown[1]):
                self.hidden.append("/".join(names))
                continue
            self.names.append(names)
            if self.wanted is None or not self.wanted.isdisjoint(names):
                try:
                    self.meshes.append(self.mesh(mesh, names, self.transform_of(line[:0:-1])))
                    self.meshes[-1]["shown"] = place.shown
                except Refused as error:
                    raise Refused(f"/{'/'.join(names)}: {error}") from error

    def transform_of(self, line: list[Place]) -> int:
        """Read the transforms of a line of objects, the highest first; index of the last one."""
        above = -1
        for one in line:
            if one.number is None:
                one.number = above
                if AbcGeom.IXform.matches(one.item.getHeader()):
                    node = AbcGeom.IXform(one.item, _WRAP)
                    self.transforms.append(self.transform(node.getSchema(), above))
                    one.number = len(self.transforms) - 1
            above = one.number
        return above

    def find(self, top: Any) -> Iterator[tuple[Place, Any]]:
        """Yield place and object of each mesh, in their order, and count what is no mesh."""
        waiting: list[Any] = [(top, None, ([0.0], [True]))]
        while waiting:
            item, above, shown = waiting.pop()
            below = []
            for k in range(item.getNumChildren()):
                child = item.getChild(k)
                header = child.getHeader()  # of an instance, that of its source
                place = Place(child.getName(), above, child, visibility(child, shown))
                # the library holds the path of each object
                place.size = len(place.name) + (above.size if above else 0)
                self.afford(place.size, "the path of an object beside others")
                kinds = AbcGeom.IPolyMesh, AbcGeom.ISubD, AbcGeom.IXform, AbcGeom.IFaceSet
                found = [kind for kind in kinds if kind.matches(header)]
                if not found:
                    schema = str(header.getMetaData().get("schema")).split("_")[1:2]
                    self.others["".join(schema)] = self.others.get("".join(schema), 0) + 1
                elif found[0] in kinds[:2]:
                    yield place, found[0](child, _WRAP)
                below.append((child, place, place.shown))
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
            return {"parent": above, "times": self.put(np.zeros(1)), "values": values}
        times = selectors(schema)
        self.afford(128 * len(times), f"a transform of {len(times)} samples")
        found = np.empty((len(times), 4, 4))
        for k, time in enumerate(times):
            found[k] = np.array(schema.getValue(time).getMatrix(), dtype=np.float64)
        parent = above if schema.getInheritsXforms() else -1
        values = self.put(found)
        return {"parent": parent, "times": self.times(schema), "values": values}

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
            "times": self.times(points),
            "subdivision": isinstance(item, AbcGeom.ISubD),
            "counts": self.put(array(topology[0], np.int64)),
            "indices": self.put(array(topology[1], np.int64)),
            "changes": change(points, topology),
            "uv": self.param(schema.getUVsParam(), 2),
            "colors": self.colors(item),
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

    def colors(self, item: Any) -> tuple[str, str, str | None] | None:
        """Store the first colours of a mesh, if any, as `param` does."""
        geom = Abc.ICompoundProperty(item.getProperties(), ".geom")
        # the library crashes where what is asked for is missing
        if not geom.getPropertyHeader(".arbGeomParams"):
            return None
        held = Abc.ICompoundProperty(geom, ".arbGeomParams")
        for header in map(held.getPropertyHeader, range(held.getNumProperties())):
            for width, kind in ((3, AbcGeom.IC3fGeomParam), (4, AbcGeom.IC4fGeomParam)):
                if kind.matches(header):
                    return self.param(kind(held, header.getName()), width)
        return None

    def times(self, item: Any) -> str:
        """Store the times (S,) in seconds of all samples of a schema or property."""
        count, time = item.getNumSamples(), item.getTimeSampling().getSampleTime
        self.afford(32 * count, f"the times of {count} samples")
        return self.put(np.array([time(k) for k in range(count)], dtype=np.float64))

    def put(self, values: Any) -> str:
        key = f"array_{len(self.arrays)}"
        self.arrays[key] = values
        return key


def visibility(item: Any, above: Any) -> Any:
    """Times from which on an object is shown or hidden, and these states.

    `above` are those of the object above it, which hold where it states nothing of its own.
    """
    held = item.getProperties()
    if not held.getPropertyHeader("visible"):
        return above
    own = Abc.ICharProperty(held, "visible")
    chosen = selectors(own)
    stamps = [one.getRequestedTime() for one in chosen]
    times = np.union1d(above[0], stamps)

    def at(known: Any, values: Any) -> Any:
        return np.array(values)[np.maximum(np.searchsorted(known, times, "right") - 1, 0)]

    states = at(stamps, [int(own.getValue(one)) for one in chosen])
    shown = np.where(states < 0, at(*above), states > 0)
    changes = np.flatnonzero(np.diff(shown, prepend=~shown[:1]))
    return times[changes].tolist(), shown[changes].tolist()


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


def read(job: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Record and arrays for the package, which checks them."""
    reader = Reader(job)
    reader.read(Abc.IArchive(job["path"]).getTop())
    fields = ("names", "hidden", "others", "meshes", "transforms")
    return {name: getattr(reader, name) for name in fields}, reader.arrays
