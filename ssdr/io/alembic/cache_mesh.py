"""One mesh of an Alembic cache: polygons as triangles, points and transforms over time."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...mesh.clips import readable
from ...mesh.normals import unit
from ..file_errors import check
from ..meshes.polygons import cut, value_index
from ..scene import Bones, Shape, facing

_log = logging.getLogger(__name__)
_MOST_SAMPLES = 1 << 22

Arrays = Mapping[str, NDArray[Any]]


def object_name(names: Sequence[str]) -> str:
    """Name that Blender gives the object of a mesh, from the names on the path to the mesh.

    It is the name of the transform above the mesh.
    """
    return names[-2:][0]


def sample_times(stored: Sequence[float], period: float, count: int) -> NDArray[np.float64]:
    """Times (S,) in seconds of `count` samples, where the times `stored` repeat every `period`.

    Raises
    ------
    FormatError
        If there are too many samples, or their times do not increase.
    """
    check(0 < count <= _MOST_SAMPLES and len(stored), f"{count} samples at {len(stored)} times")
    cycle, place = np.divmod(np.arange(count), len(stored))
    with np.errstate(over="ignore", invalid="ignore"):
        # the period of times that never repeat is too large to be multiplied by 0
        times = np.asarray(stored, dtype=np.float64)[place] + np.where(cycle, cycle * period, 0.0)
        rising = np.isfinite(times).all() and (np.diff(times) > 0).all()
    check(rising, "its times do not rise")
    return times


class SampledArray:
    """Values (S, ...) of an array over time, interpolated linearly between its samples.

    An array that never changes has one value, however many samples are stated.
    """

    def __init__(self, record: Mapping[str, Any], values: NDArray[Any]) -> None:
        self.times, self.values = sample_times(*record["clock"]), values
        check(len(values) in (1, len(self.times)), "samples that its times do not match")

    @property
    def moves(self) -> bool:
        return len(self.values) > 1

    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values (F, ...) at `times` (F,) in seconds; within 0.1 ms of a sample, its own value."""
        values, exact = self.values, np.float64
        if not self.moves:
            return np.broadcast_to(values[0].astype(exact), (len(times), *values.shape[1:]))
        place = np.interp(times, self.times, np.arange(len(self.times)))
        near = np.rint(place).astype(np.int64)
        place = np.where(np.abs(times - self.times[near]) < 1e-4, near, place)
        left = np.minimum(place.astype(np.int64), len(values) - 2)
        share = (place - left).reshape(-1, *(1 for _ in values.shape[1:]))
        before, after = values[left].astype(exact), values[left + 1].astype(exact)
        return np.asarray((1 - share) * before + share * after)


class Transforms:
    """The transforms of a cache, each relative to its parent, from local to world space."""

    def __init__(self, records: Sequence[Mapping[str, Any]], arrays: Arrays) -> None:
        self.parents = [int(record["parent"]) for record in records]
        self.tracks = [SampledArray(record, arrays[record["values"]]) for record in records]

    def chain(self, k: int) -> list[int]:
        """Indices of transform `k` and of all above it, the highest first."""
        found = []
        while k >= 0:
            found.append(k)
            k = self.parents[k]
        return found[::-1]

    def world(self, k: int, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Matrices (F, 4, 4) from the space of transform `k` to world space, for column vectors."""
        found = np.broadcast_to(np.eye(4), (len(times), 4, 4))
        for one in self.chain(k):
            found = found @ np.swapaxes(self.tracks[one].at(times), 1, 2)
        return found


class CacheMesh:
    """A mesh of a cache, as a `ScenePart`; polygons are cut into triangles.

    Parameters
    ----------
    record, arrays
        As ``alembic_script.py`` writes them.
    transforms : Transforms
    materials : list of str
        Names of the materials that are known so far, to which those of this mesh are appended.

    Attributes
    ----------
    names : list of str
        Names of all objects above the mesh, the highest first, then its own.
    clocks : list of (S,) arrays
        Times of the samples of the points, and of those of each transform above the mesh.
    """

    def __init__(
        self,
        record: Mapping[str, Any],
        arrays: Arrays,
        transforms: Transforms,
        materials: list[str],
    ) -> None:
        self.names = [readable(name) for name in record["names"]]
        self.path = "/" + "/".join(self.names)
        check(not record["changes"], f"{self.path}: its topology changes: {record['changes']}")
        self._transforms, self._above = transforms, int(record["transform"])
        self.points = SampledArray(record, arrays[record["points"]])
        self.clocks = [self.points.times]
        tracks = [transforms.tracks[k] for k in transforms.chain(self._above)]
        finite = all(np.isfinite(track.values).all() for track in tracks)
        check(finite, f"{self.path}: a transform that is not finite")
        self.clocks += [track.times for track in tracks]
        self.n_points = self.points.values.shape[1]
        self.skeleton: Any = self.path
        self.indices = np.zeros((self.n_points, 1), dtype=np.int32)
        self.weights = np.ones((self.n_points, 1))
        linear = self.transforms(np.unique(np.concatenate(self.clocks)))[:, 0, :, :3]
        seen, self._mirrored = facing(linear)
        self._read_polygons(arrays[record["counts"]], arrays[record["indices"]])
        self.material = self._read_sets(record["sets"], arrays, materials)
        self.uv = self._at_corners(record["uv"], arrays, "UVs")
        normals = self._at_corners(record["normals"], arrays, "normals")
        if normals is not None:
            normals = unit(normals @ np.linalg.pinv(linear[seen])).astype(np.float32)
        self.normals = normals
        if record["subdivision"]:
            _log.info("%s: a subdivision surface, of which the cage is read", self.path)

    def _check(self, valid: Any, problem: str) -> None:
        """Raise a FormatError with the text `problem` unless `valid` is true."""
        check(valid, f"{self.path}: {problem}")

    def _read_polygons(self, counts: NDArray[np.int64], indices: NDArray[np.int64]) -> None:
        total, least, most = counts.sum(), indices.min(initial=0), indices.max(initial=-1)
        problem = f"its polygons have {total} corners, there are {len(indices)} indices"
        self._check((counts >= 0).all() and total == len(indices), problem)
        problem = f"indices from {least} to {most} for {self.n_points} vertices"
        self._check(least >= 0 and most < self.n_points, problem)
        # Alembic's polygons are clockwise.
        ends = 2 * (np.cumsum(counts) - counts) + counts - 1
        order = np.repeat(ends, counts) - np.arange(total)
        corners, self.polygon = cut(counts, indices[order], self.points.values[0])
        self.corners = order[corners]
        if self._mirrored:
            self.corners = self.corners[:, ::-1]  # a mirroring transform flips triangles
        self.faces = indices[self.corners]

    def _read_sets(
        self, sets: Sequence[Any], arrays: Arrays, materials: list[str]
    ) -> NDArray[np.int64]:
        """Append new materials to `materials`; return the material index (T,) of each triangle.

        Each set of faces is a material. A triangle without one has the index -1.
        """
        of_polygon = np.full(self.polygon.max(initial=-1) + 1, -1)
        for name, key in sets:
            faces, name = arrays[key], readable(name)
            if not len(faces):
                continue
            if not 0 <= faces.min() <= faces.max() < len(of_polygon):
                _log.warning("%s: the faces of %r are not its own and left out", self.path, name)
                continue
            if name not in materials:
                materials.append(name)
            of_polygon[faces] = materials.index(name)
        return np.asarray(of_polygon[self.polygon])

    def _at_corners(self, record: Any, arrays: Arrays, what: str) -> NDArray[np.float32] | None:
        if record is None:
            return None
        how, values, index = record
        rows, place = arrays[values], value_index(how, self.corners, self.faces, self.polygon)
        if place is not None and index is not None:
            own = arrays[index]
            inside = place.max(initial=-1) < len(own) and own.min(initial=0) >= 0
            place = own[place] if inside else None
        if place is None or place.max(initial=-1) >= len(rows) or not np.isfinite(rows).all():
            _log.warning("%s: %s do not match the mesh and are left out", self.path, what)
            return None
        return np.asarray(rows[place])

    def shape(self, times: NDArray[np.float64]) -> Shape:
        """Points (V, 3) before the transforms; if they change, a function from frame to points."""
        if not self.points.moves:
            return np.asarray(self.points.values[0], dtype=np.float64)
        return lambda frame: self.points.at(times[frame : frame + 1])[0]

    def transforms(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transforms (F, 1, 3, 4) from the space of the points to world space."""
        return self._transforms.world(self._above, times)[:, None, :3]

    def bones(self, transforms: NDArray[np.float64]) -> Bones:
        """One bone without a parent."""
        return Bones([self.names[-1]], np.full(1, -1), np.zeros((1, 3)), transforms)
