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
from ..meshes.polygons import at_corners, check_polygons, cut, opaque
from ..scene import Bones, Shape, facing

_log = logging.getLogger(__name__)
_LEAST = 1e-6  # seconds; equal times of two objects may differ by their rounding

Arrays = Mapping[str, NDArray[Any]]


def object_name(names: Sequence[str]) -> str:
    """Name that Blender gives the object of a mesh, from the names on the path to the mesh.

    It is the name of the transform above the mesh.
    """
    return names[-2:][0]


class SampledArray:
    """Values (S, ...) of an array over time, interpolated linearly between its samples.

    An array that never changes has one value, however many samples are stated.

    Raises
    ------
    FormatError
        If times do not increase, or not those of the values.
    """

    def __init__(self, times: NDArray[np.float64], values: NDArray[Any]) -> None:
        self.times, self.values = times, values
        self._index = np.arange(len(times), dtype=np.float64)
        rising = len(times) and np.isfinite(times).all() and (np.diff(times) > _LEAST).all()
        check(rising, "its samples do not follow each other by more than a microsecond")
        check(len(values) in (1, len(self.times)), "samples that its times do not match")

    @property
    def moves(self) -> bool:
        return len(self.values) > 1

    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values (F, ...) at `times` (F,) in seconds; within 0.1 ms of a sample, its own value."""
        values, exact = self.values, np.float64
        if not self.moves:
            return np.broadcast_to(values[0].astype(exact), (len(times), *values.shape[1:]))
        place = np.interp(times, self.times, self._index)
        near = np.rint(place).astype(np.int64)
        place = np.where(np.abs(times - self.times[near]) < 1e-4, near, place)
        left = np.minimum(place.astype(np.int64), len(values) - 2)
        share = (place - left).reshape(-1, *(1 for _ in values.shape[1:]))
        before, after = values[left].astype(exact), values[left + 1].astype(exact)
        return np.asarray((1 - share) * before + share * after)


class Transforms:
    """The transforms of a cache, each relative to its parent, from local to world space.

    Attributes
    ----------
    clocks : list of (S,) arrays
        Times of all samples of each transform and of those above it.

    Raises
    ------
    FormatError
        If a transform is not finite, or its matrix is not affine.
    """

    def __init__(self, records: Sequence[Mapping[str, Any]], arrays: Arrays) -> None:
        self._parents = [int(record["parent"]) for record in records]
        self._tracks = [SampledArray(arrays[r["times"]], arrays[r["values"]]) for r in records]
        self.clocks: list[NDArray[np.float64]] = []
        for parent, track in zip(self._parents, self._tracks, strict=True):
            check(np.isfinite(track.values).all(), "a transform that is not finite")
            affine = np.abs(track.values[:, :, 3] - [0, 0, 0, 1]).max(initial=0) < 1e-6
            check(affine, "a transform that is not affine: its last column is not 0, 0, 0, 1")
            above = track.times if parent < 0 else self.clocks[parent]
            same = np.array_equal(above, track.times)
            self.clocks.append(above if same else np.union1d(above, track.times))
        self._worlds: tuple[bytes, dict[int, NDArray[np.float64]]] = b"", {}

    def world(self, k: int, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Matrices (F, 4, 4) from the space of transform `k` to world space, for column vectors."""
        if self._worlds[0] != times.tobytes():
            self._worlds = times.tobytes(), {-1: np.broadcast_to(np.eye(4), (len(times), 4, 4))}
        known, chain = self._worlds[1], [k]
        while chain[-1] not in known:
            chain.append(self._parents[chain[-1]])
        for above, one in zip(chain[:0:-1], chain[-2::-1], strict=True):
            known[one] = known[above] @ np.swapaxes(self._tracks[one].at(times), 1, 2)
        return known[k]


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
        Times of the samples of the points, and of those of the transforms above the mesh.
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
        self.points = SampledArray(arrays[record["times"]], arrays[record["points"]])
        self.clocks = [self.points.times]
        if self._above >= 0:
            self.clocks.append(transforms.clocks[self._above])
        self.n_points = self.points.values.shape[1]
        self.name = object_name(self.names)
        self._shown = record["shown"]
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
        colors = self._at_corners(record["colors"], arrays, "colours")
        self.colors = None if colors is None else opaque(colors)
        if record["subdivision"]:
            _log.info("%s: a subdivision surface, of which the cage is read", self.path)

    def _read_polygons(self, counts: NDArray[np.int64], indices: NDArray[np.int64]) -> None:
        check_polygons(counts, indices, self.n_points, self.path)
        # Alembic's polygons are clockwise.
        ends = 2 * (np.cumsum(counts) - counts) + counts - 1
        order = np.repeat(ends, counts) - np.arange(len(indices))
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
        own = None if index is None else arrays[index]
        return at_corners(self, arrays[values], how, f"{self.path}: {what}", own)

    def shape(self, times: NDArray[np.float64]) -> Shape:
        """Points (V, 3) before the transforms; if they change, a function from frame to points."""
        if not self.points.moves:
            return np.asarray(self.points.values[0], dtype=np.float64)
        return lambda frame: self.points.at(times[frame : frame + 1])[0]

    def transforms(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transforms (F, 1, 3, 4) from the space of the points to world space."""
        return self._transforms.world(self._above, times)[:, None, :3]

    def shown(self, times: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Mask (F,) of the frames in which the mesh is visible."""
        stamps, states = self._shown
        return np.asarray(states)[np.maximum(np.searchsorted(stamps, times + 1e-4, "right") - 1, 0)]

    def bones(self, transforms: NDArray[np.float64]) -> Bones:
        """One bone without a parent."""
        return Bones([self.names[-1]], np.full(1, -1), np.zeros((1, 3)), transforms)
