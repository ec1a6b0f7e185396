"""Small glTF files for engines: coarse keys and coordinates, compressed by meshopt.

The arrays of a rig are rounded first, so that its error is that of the file; then
:class:`Packed` stores them in few buffer views, one for each kind of array, since a separate view
for each array would take more bytes than many arrays do.

References
----------
Khronos, ``KHR_mesh_quantization``; Kapoulkine, ``EXT_meshopt_compression``, whose appendices A and
B define the codecs and the filters.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...normals import unit
from ...shapes import Shapes
from ...skinning import Skinning
from ...storage.keyframes import Tracks
from ..corners import Corners
from ..optional import require
from ..rig import Rig, build_rig
from .builder import ARRAY, CODES, ELEMENTS, Builder
from .compression import MESHOPT
from .shapes import stored_amounts

Compression = Literal["none", "quantized", "meshopt"]
_SETTLES = 8
# Shares of the tolerance: a step of positions and translations, and how far a step of a rotation
# moves the farthest vertex.  Rounding is at most half a step; leaving out keys may use the rest.
_STEP, _TURN = 0.4, 0.3
_FINE = 1 / 65535  # least step of positions, as a share of the largest extent


@dataclasses.dataclass(frozen=True)
class Grid:
    """Origin and step sizes of the grid to which the numbers in a compact file are rounded.

    Attributes
    ----------
    low : (3,) float64
        Smallest coordinates of the rest pose.
    step : float
        Step of rest positions, which are stored as uint16 multiples of it.
    exponent : int
        Binary exponent of the step of translations.
    bits : int
        Bits of a component of a quaternion, sign included.
    """

    low: NDArray[np.float64]
    step: float
    exponent: int
    bits: int

    @staticmethod
    def of(rests: list[NDArray[Any]], reach: float, tolerance: float | None) -> Grid:
        """Grid for rest poses, and for bones whose vertices are at most `reach` from the joint."""
        low = np.min([rest.min(axis=0) for rest in rests], axis=0).astype(np.float64)
        extent = float(np.max([(rest - low).max() for rest in rests])) or 1.0
        step = max((tolerance or 0.0) * _STEP, extent * _FINE)
        turn = (tolerance or 0.0) * _TURN / max(reach, 1e-300)
        bits = min(16, max(6, math.ceil(-math.log2(turn)))) if turn > 0 else 16
        return Grid(low, step, math.floor(math.log2(step)), bits)

    def counts(self, rest: NDArray[Any]) -> NDArray[np.uint16]:
        counts = np.rint((rest - self.low) / self.step)
        return np.clip(counts, 0, 65535).astype(np.uint16)

    def displacements(self, moved: NDArray[Any]) -> NDArray[Any]:
        """Displacements of morph targets in steps: int16 or, beyond its range, float32."""
        counts = np.rint(moved / self.step)
        fits = np.abs(counts).max(initial=0) <= 32767
        return np.asarray(counts.astype(np.int16 if fits else np.float32))

    def round(self, rig: Rig) -> Rig:
        """Copy of `rig` with its arrays as a reader of the file decodes them."""
        unit = 2.0**self.exponent
        turns: NDArray[Any] = rig.rotations
        for _ in range(_SETTLES):  # rounding may change which component is the largest
            before, turns = turns, decoded_quaternions(encoded_quaternions(turns, self.bits))
            if np.array_equal(before, turns):
                break
        moved, at = (np.rint(x / unit) * unit for x in (rig.translations, rig.offsets))
        sign = np.where((turns * rig.rotations).sum(axis=-1, keepdims=True) < 0, -1, 1)
        return dataclasses.replace(
            rig,
            rest=(self.low + self.step * self.counts(rig.rest)).astype(np.float32),
            rotations=(sign * turns).astype(np.float32),
            # a joint that does not translate has no such keys: its node holds the float32 offset
            offsets=np.where(rig.translating[:, None], at, rig.offsets).astype(np.float32),
            translations=np.where(rig.translating[:, None], moved, rig.translations).astype(
                np.float32
            ),
            scales=None
            if rig.scales is None
            else (np.rint(rig.scales / 2.0**-14) * 2.0**-14).astype(np.float32),
            shapes=None if rig.shapes is None else self._rounded(rig.shapes),
        )

    def _rounded(self, shapes: Shapes) -> Shapes:
        stored = stored_amounts(shapes.amounts, True)
        whole = np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1
        moved = self.displacements(shapes.displacements) * self.step
        return Shapes(moved, stored / whole, names=shapes.names)


def coarse_rig(model: Skinning, tolerance: float | None, **options: Any) -> tuple[Rig, Grid]:
    """Rig with as few keys and as coarse numbers as the tolerance allows, and its grid.

    Parameters
    ----------
    model : Skinning
    tolerance : float or None
        Largest distance of a vertex, in any frame, from its position in the model. None keeps all
        keys and 16 bits.
    **options
        As for :func:`~ssdr.io.rig.build_rig`.

    Raises
    ------
    InputError
        If the numbers that a file can hold are too coarse for the tolerance.
    """
    rig = build_rig(model, **options)
    at = rig.centers if rig.moving is None else rig.centers[rig.moving]
    arm = np.linalg.norm(rig.rest[:, None] - at[rig.indices], axis=2)
    reach = float(arm[rig.weights > 0].max(initial=0.0))
    grid = Grid.of([rig.rest], reach, tolerance)
    whole = grid.round(rig)
    if tolerance is None or whole.n_frames == 1:
        return whole, grid
    least = whole.error(model)[1] or 0.0
    if least > tolerance:
        raise InputError(
            "tolerance", f"at least the error of rounding, {least:.3g}, or finer weights", tolerance
        )
    offsets = np.array([0, *(clip.stop for clip in model.clips)])

    def rounded(trial: Skinning) -> Rig:
        return grid.round(build_rig(trial, **options))

    def holds(trial: Skinning) -> bool:
        return (rounded(trial).error(model)[1] or 0.0) <= tolerance

    kept = Tracks(model, offsets).sparsest(tolerance, holds)
    return whole if kept is None else rounded(kept), grid


def encoded_quaternions(turns: NDArray[Any], bits: int) -> NDArray[np.int16]:
    """Quaternions (..., 4) as the filter QUATERNION stores them: the three smaller components."""
    largest = np.abs(turns).argmax(axis=-1)[..., None]
    order = (largest + 1 + np.arange(4)) % 4
    sorted_ = np.take_along_axis(turns / np.linalg.norm(turns, axis=-1, keepdims=True), order, -1)
    sign = np.where(sorted_[..., 3:] < 0, -1.0, 1.0)
    one = (1 << (bits - 1)) - 1
    out = np.rint(np.clip(sorted_ * sign * math.sqrt(2), -1, 1) * one)
    out[..., 3:] = (one & ~3) | largest
    return np.asarray(out, dtype=np.int16)


def decoded_quaternions(stored: NDArray[np.int16]) -> NDArray[np.float64]:
    """Quaternions (..., 4) that a reader decodes from the result of :func:`encoded_quaternions`."""
    largest, one = stored[..., 3:].astype(int) & 3, stored[..., 3:].astype(int) | 3
    small = stored[..., :3] / (one * math.sqrt(2))
    w = np.sqrt(np.maximum(0.0, 1 - (small**2).sum(axis=-1, keepdims=True)))
    place = (np.arange(4) - largest - 1) % 4
    turns = np.take_along_axis(np.concatenate([small, w], axis=-1), place, -1)
    return np.asarray(np.rint(turns * 32767) / 32767)


def fetch_order(corners: Corners, groups: NDArray[np.integer]) -> tuple[Corners, NDArray[Any]]:
    """Copy of a mesh whose triangles, and then vertices, come in the order that packs best.

    `groups` (T,) holds the material index of each triangle; it is returned in the new order.
    """
    library = require("meshoptimizer", "meshopt", "compression by meshopt")
    n, parts, order = len(corners.vertex), [], []
    for group in np.unique(groups):
        flat = corners.faces[groups == group].reshape(-1).astype(np.uint32)
        best = np.empty_like(flat)
        library.optimize_vertex_cache_strip(best, flat, len(flat), n)
        parts.append(best)
        order.append(np.full(len(flat) // 3, group))
    faces = np.concatenate(parts) if parts else np.zeros(0, dtype=np.uint32)
    # vertices come in the order in which triangles need them; those of no triangle are last
    first = np.full(n, len(faces))
    np.minimum.at(first, faces, np.arange(len(faces)))
    take = np.argsort(first, kind="stable")
    place = np.argsort(take).astype(np.int32)
    moved = dataclasses.replace(
        corners,
        vertex=corners.vertex[take],
        faces=place[faces].reshape(-1, 3),
        uv=None if corners.uv is None else corners.uv[take],
        normals=None if corners.normals is None else corners.normals[take],
        number=None if corners.number is None else corners.number[take],
    )
    return moved, np.concatenate(order) if order else groups


def steady_slots(rig: Rig, vertex: NDArray[np.integer]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Indices and weights (N, K) of the vertices `vertex`, in an order that compresses well.

    A bone that moves two consecutive vertices has the same column in both rows.
    """
    indices, weights = rig.indices[vertex].tolist(), rig.weights[vertex].tolist()
    last: list[int] = [-1] * rig.indices.shape[1]
    for i, (bones, shares) in enumerate(zip(indices, weights, strict=True)):
        left = {b: w for b, w in zip(bones, shares, strict=True) if w > 0}
        row = [(b, left.pop(b)) if b in left else None for b in last]
        others = iter(left.items())
        row = [slot or next(others, None) for slot in row]
        indices[i] = [slot[0] if slot else 0 for slot in row]
        weights[i] = [slot[1] if slot else 0 for slot in row]
        last = [slot[0] if slot else b for slot, b in zip(row, last, strict=True)]
    return np.array(indices, dtype=np.int32), np.array(weights, dtype=rig.weights.dtype)


@dataclasses.dataclass
class _Stream:
    """Arrays of one kind, which share a buffer view."""

    view: int
    stride: int
    filter: str
    target: int | None
    blocks: list[NDArray[Any]] = dataclasses.field(default_factory=list)
    count: int = 0


class Packed(Builder):
    """A glTF document whose arrays are quantized, and compressed if `meshopt` is true."""

    packs = True

    def __init__(self, grid: Grid, *, meshopt: bool) -> None:
        super().__init__()
        self.grid, self.meshopt = grid, meshopt
        self._streams: dict[Any, _Stream] = {}
        self.require("KHR_mesh_quantization")
        if meshopt:
            self.require(MESHOPT[0])

    def place(
        self, array: NDArray[Any], kind: str, target: int | None, use: str
    ) -> tuple[dict[str, Any], NDArray[Any]]:
        """Encode an array for its `use` and append it to the buffer view of such arrays.

        Parameters and result are those of :meth:`Builder.place`.
        """
        array, filter_, decoded = self._stored(array, use)
        key: Any = use, kind, array.dtype.name, array.shape[1:]
        if target == ELEMENTS:
            key = len(self._streams)
        if key not in self._streams:
            stride = array.dtype.itemsize * math.prod(array.shape[1:])
            self._streams[key] = _Stream(self.view(b""), stride, filter_, target)
        stream = self._streams[key]
        item = {"bufferView": stream.view}
        if stream.count:
            item["byteOffset"] = stream.count * stream.stride
        item["componentType"] = CODES[decoded or array.dtype.name]
        stream.blocks.append(array)
        stream.count += len(array)
        return item, array

    def _stored(self, array: NDArray[Any], use: str) -> tuple[NDArray[Any], str, str | None]:
        """Encode an array for its `use`: the stored array, its meshopt filter, its decoded type.

        The decoded type is None if it is that of the stored array.
        """
        if use == "POSITION":
            return np.pad(self.grid.counts(array), ((0, 0), (0, 1))), "NONE", None
        if use.startswith("+"):
            stored = self.stored_displacements(array, use[1:])
            room = 1 if stored.dtype.kind == "i" else 0  # elements are whole multiples of 4 bytes
            return np.pad(stored, ((0, 0), (0, room))), "NONE", None
        if use == "NORMAL":
            if self.meshopt:
                return _octahedral(array), "OCTAHEDRAL", None
            return np.pad(np.rint(array * 127).astype(np.int8), ((0, 0), (0, 1))), "NONE", None
        if use == "rotation":
            stored = encoded_quaternions(array, self.grid.bits)
            if self.meshopt:
                return stored, "QUATERNION", None
            return np.rint(decoded_quaternions(stored) * 32767).astype(np.int16), "NONE", None
        if use in ("translation", "scale") and self.meshopt:
            exponent = -14 if use == "scale" else self.grid.exponent
            mantissa = np.rint(array / 2.0**exponent).astype(np.int32)
            if np.abs(mantissa).max(initial=0) < 1 << 23:
                return (mantissa & 0xFFFFFF) | (exponent << 24), "EXPONENTIAL", "float32"
        if use == "inverse":
            # the inverse bind matrices take stored positions to those of the rest pose
            turn = array.reshape(-1, 4, 4).astype(np.float64)
            whole = np.diag([*[self.grid.step] * 3, 1.0])
            whole[3, :3] = self.grid.low
            return (whole @ turn).astype(np.float32).reshape(-1, 16), "NONE", None
        return array, "NONE", None

    def stored_displacements(self, array: NDArray[Any], use: str) -> NDArray[Any]:
        """Displacements of a sparse morph target as stored: integers where they hold the values."""
        if use == "POSITION":
            return self.grid.displacements(array)
        fits = np.abs(array).max(initial=0) <= 1
        return np.rint(array * 127).astype(np.int8) if fits else array.astype(np.float32)

    def decoded_normals(self, normals: NDArray[Any]) -> NDArray[np.float32]:
        """Normals ``(T, 3, 3)`` as a reader decodes them."""
        stored, filter_, _ = self._stored(normals.reshape(-1, 3), "NORMAL")
        if filter_ != "NONE":
            library = require("meshoptimizer", "meshopt", "compression by meshopt")
            stored = library.decode_filter_oct(stored, len(stored), 4)
        flat = stored[:, :3].astype(np.float64)
        return unit(flat).reshape(normals.shape).astype(np.float32)

    def save(self, path: Path) -> int:
        """Write the file as :meth:`Builder.save` does."""
        for stream in self._streams.values():
            whole = np.ascontiguousarray(np.concatenate(stream.blocks))
            view = self.json["bufferViews"][stream.view]
            if stream.target is not None:
                view["target"] = stream.target
            if stream.target == ARRAY:
                view["byteStride"] = stream.stride
            self.blocks[view["buffer"]] = whole.tobytes()
            if self.meshopt and (stream.stride % 4 == 0 or stream.target == ELEMENTS):
                self._compress(view, stream, whole)
        return super().save(path)

    def _compress(self, view: dict[str, Any], stream: _Stream, whole: NDArray[Any]) -> None:
        library = require("meshoptimizer", "meshopt", "compression by meshopt")
        mode = "ATTRIBUTES"
        if stream.target == ELEMENTS:
            mode = "TRIANGLES"
            flat = whole.astype(np.uint32)
            data = library.encode_index_buffer(flat, len(flat), int(flat.max()) + 1)
        else:
            library.encode_vertex_version(0)
            raw = np.frombuffer(whole.tobytes(), dtype=np.uint8).reshape(-1, stream.stride)
            data = library.encode_vertex_buffer(raw, stream.count, stream.stride)
        packed: dict[str, Any] = {"byteStride": stream.stride, "count": stream.count, "mode": mode}
        if stream.filter != "NONE":
            packed["filter"] = stream.filter
        view["extensions"] = {MESHOPT[0]: packed}
        self.blocks[view["buffer"]] = bytes(data)


def _octahedral(normals: NDArray[Any]) -> NDArray[np.int8]:
    """Unit vectors (N, 3) as the filter OCTAHEDRAL stores them in four bytes."""
    flat = normals / np.maximum(np.abs(normals).sum(axis=1, keepdims=True), 1e-30)
    x, y = flat[:, 0], flat[:, 1]
    down = flat[:, 2] < 0
    u = np.where(down, (1 - np.abs(y)) * np.where(x >= 0, 1, -1), x)
    v = np.where(down, (1 - np.abs(x)) * np.where(y >= 0, 1, -1), y)
    out = np.zeros((len(normals), 4), dtype=np.int8)
    out[:, 0], out[:, 1], out[:, 2] = np.rint(u * 127), np.rint(v * 127), 127
    return out
