"""An animated mesh of fixed topology, the input of the other modules.

``MeshSequence`` checks its arrays once; every function after it trusts them.  Vertices may be held
in memory, in a memory map or in a chunked array (zarr, dask), and are read by chunks of frames.
"""

from __future__ import annotations

import dataclasses
import itertools
import operator
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..common.checks import are_meshes, as_array, check_faces, check_range, remedy_of_shape
from ..common.errors import InputError, is_real
from ..common.short_repr import notebook_html
from .surface import (
    UNKNOWN,
    Selected,
    Space,
    Surface,
    as_trimesh,
    check_space,
    check_surface,
    coincident,
    distinct,
    protect,
)

_CHUNK_BYTES = 64 << 20  # bytes of frames that are read at a time


@dataclasses.dataclass(frozen=True)
class WeldReport:
    """Number of vertices before and after :meth:`MeshSequence.weld`, and its tolerance.

    Attributes
    ----------
    before, after : int
        Number of vertices.
    tolerance : float
        Largest distance, in the mesh's units, at which vertices were merged.

    Examples
    --------
    >>> corners = np.array([[[0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0]]], float)
    >>> welded, report = ssdr.MeshSequence(corners).weld()
    >>> report.before, report.after
    (4, 3)
    """

    before: int
    after: int
    tolerance: float


@dataclasses.dataclass(frozen=True, eq=False)
class MeshSequence:
    """Vertex positions of one mesh over F frames.

    Parameters
    ----------
    vertices : (F, V, 3) float array, or meshes of trimesh
        float32 and float64 are kept as they are; integers become float64.  Any
        object with ``shape``, ``dtype`` and slicing along the first axis will
        do (``numpy.memmap``, zarr, dask) and is not read as a whole.  Of a ``trimesh.Trimesh``, or
        a list of them with a frame each, triangles and texture coordinates are taken, too.
    faces : (T, 3) int array, optional
        Triangles; none (a point cloud) by default.
    fps : float
        Frames per second.
    name : str
        Name of the mesh.
    clip : str
        Name of the animation; empty if it has none.
    surface : Surface, optional
        Texture coordinates, normals and materials of the triangles.
    vertex_map : (V0,) int array, optional
        For a welded sequence: the welded vertex of each vertex of the original mesh.
    space : Space
        Unit of length and up axis, as far as they are known.
    validate : bool
        Whether to check for NaN and Inf, which reads all frames; ``False`` is for data known to
        be finite.

    Raises
    ------
    InputError
        If a shape, a number or a face index is not usable; the message names
        the argument and the first offender.

    Examples
    --------
    >>> vertices = np.zeros((10, 3, 3))
    >>> sequence = ssdr.MeshSequence(vertices, [[0, 1, 2]], fps=30)
    >>> sequence.n_frames, sequence.n_vertices, sequence.faces.shape
    (10, 3, (1, 3))
    """

    vertices: Any
    faces: Any = None
    fps: float = 24.0
    _: dataclasses.KW_ONLY
    name: str = ""
    clip: str = ""
    surface: Surface | None = None
    vertex_map: Any = None
    space: Space = UNKNOWN
    validate: dataclasses.InitVar[bool] = True

    def __post_init__(self, validate: bool) -> None:
        put = object.__setattr__
        if are_meshes([self.vertices]):  # of one frame
            put(self, "vertices", [self.vertices])
        if are_meshes(self.vertices):
            self._take_surface(self.vertices)
        put(self, "vertices", _check_vertices(self.vertices, "vertices", validate))
        put(self, "faces", check_faces(self.faces, self.vertices.shape[1]))
        if not (is_real(self.fps) and self.fps > 0):
            raise InputError("fps", "a positive number", repr(self.fps))
        put(self, "fps", float(self.fps))
        if self.vertex_map is not None:
            put(self, "vertex_map", check_vertex_map(self.vertex_map, self.n_vertices))
        if self.surface is not None:
            put(self, "surface", check_surface(self.surface, len(self.faces)))
        check_space(self.space)
        protect(self)

    def _take_surface(self, meshes: Sequence[Any]) -> None:
        """Take triangles and texture coordinates of meshes of trimesh, unless others are given."""
        first = meshes[0]
        for k, mesh in enumerate(meshes):
            if not np.array_equal(mesh.faces, first.faces):
                raise InputError("vertices", "meshes with the same faces", f"others in mesh {k}")
        uv = getattr(first.visual, "uv", None)
        if self.faces is None:
            object.__setattr__(self, "faces", first.faces)
            if uv is not None and self.surface is None:
                surface = Surface(uv=np.asarray(uv, dtype=np.float32)[first.faces])
                object.__setattr__(self, "surface", surface)

    @property
    def n_frames(self) -> int:
        return int(self.vertices.shape[0])

    @property
    def n_vertices(self) -> int:
        return int(self.vertices.shape[1])

    @property
    def is_lazy(self) -> bool:
        """Whether the vertices are read on demand instead of being an array in memory."""
        return type(self.vertices) is not np.ndarray

    def __len__(self) -> int:
        return self.n_frames

    def __iter__(self) -> Iterator[NDArray[np.floating]]:
        """Frames ``(V, 3)``, read by chunks."""
        return itertools.chain.from_iterable(block for _, block in self.chunks())

    def __getitem__(self, index: int | slice | ArrayLike) -> Any:
        """The frame ``(V, 3)`` of an integer, or the sequence of several frames, in memory."""
        frames = self.frames(index)
        if frames.ndim == 2:
            return frames
        return dataclasses.replace(self, vertices=frames, validate=False)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[np.floating]:
        """All vertices ``(F, V, 3)``."""
        whole = np.asarray(self.frames(slice(None)), dtype=dtype)
        return whole.copy() if copy else whole

    def mesh(self, frame: int) -> Any:
        """One frame as a ``trimesh.Trimesh``, with copies of vertices and triangles."""
        return as_trimesh(self.frames(int(frame)), self.faces)

    def __repr__(self) -> str:
        name = f"{self.name!r}, " if self.name else ""
        return (
            f"MeshSequence({name}F={self.n_frames}, V={self.n_vertices}, "
            f"T={len(self.faces)}, fps={self.fps:g}, {self.vertices.dtype})"
        )

    _repr_html_ = notebook_html

    def frames(self, index: int | slice | ArrayLike) -> NDArray[np.floating]:
        """Read frames into memory: ``(n, V, 3)``, or ``(V, 3)`` if `index` is an integer."""
        if isinstance(index, (int, np.integer, slice)):
            return native(self.vertices[index])
        order = np.asarray(index)
        if order.dtype == bool:
            order = np.flatnonzero(order)
        if not self.is_lazy:
            return np.asarray(self.vertices[order])
        return np.stack([native(self.vertices[int(t)]) for t in order])

    def chunks(self, max_bytes: int = _CHUNK_BYTES) -> Iterator[tuple[int, NDArray[np.floating]]]:
        """Yield chunks of frames in order: index of the first frame, and array ``(n, V, 3)``."""
        yield from _chunks(self.vertices, max_bytes)

    def diagonal(self) -> float:
        """Length of the bounding box's diagonal, in the frame where it is largest."""
        largest = 0.0
        for _, block in self.chunks():
            extent = block.max(axis=1).astype(np.float64) - block.min(axis=1)
            with np.errstate(over="ignore"):
                length = np.sqrt((extent**2).sum(axis=1)).max()
            if not np.isfinite(length):  # a square has overflowed
                length = np.hypot(np.hypot(extent[:, 0], extent[:, 1]), extent[:, 2]).max()
            largest = max(largest, float(length))
        return largest

    def weld(self, tolerance: float = 1e-6) -> tuple[MeshSequence, WeldReport]:
        """Merge vertices that coincide in every frame, such as seams of UVs or normals.

        Parameters
        ----------
        tolerance : float
            Largest distance in any frame, relative to the diagonal of the first
            frame's bounding box.

        Returns
        -------
        sequence : MeshSequence
            With `vertex_map` set.  All triangles are kept, in their order, so
            that `surface` stays valid.
        report : WeldReport

        Raises
        ------
        InputError
            If `tolerance` is negative or not finite.
        """
        if not (is_real(tolerance) and tolerance >= 0):
            raise InputError("tolerance", "a number >= 0", repr(tolerance))
        first = np.asarray(self.vertices[0], dtype=np.float64)
        diagonal = float(np.linalg.norm(first.max(axis=0) - first.min(axis=0)))
        distance = tolerance * diagonal
        n = self.n_vertices
        # Exact copies first: n of them at one place would be n² pairs.
        label = labels_of([self])
        if distance > 0:
            _, place = np.unique(label, return_index=True)
            pairs = place[cKDTree(first[place]).query_pairs(distance, output_type="ndarray")]
            for _, block in self.chunks():
                if len(pairs) == 0:
                    break
                gap = block[:, pairs[:, 0]].astype(np.float64) - block[:, pairs[:, 1]]
                pairs = pairs[np.sqrt((gap**2).sum(axis=2)).max(axis=0) <= distance]
            joined = label[pairs]
            graph = coo_array(
                (np.ones(len(pairs), dtype=np.int8), (joined[:, 0], joined[:, 1])),
                (len(place), len(place)),
            )
            _, component = connected_components(graph, directed=False)
            label = component.astype(np.intp)[label]
        keep, index = distinct(label)
        outer = index if self.vertex_map is None else index[self.vertex_map]
        welded = self.with_vertices(keep, index)
        blocks = [block for _, block in welded.chunks()]
        welded = dataclasses.replace(
            welded,
            vertices=np.concatenate(blocks),
            vertex_map=outer.astype(np.int32),
            validate=False,
        )
        return welded, WeldReport(before=n, after=len(keep), tolerance=distance)

    def with_vertices(self, kept: NDArray[np.intp], row: NDArray[np.intp]) -> MeshSequence:
        """Sequence of the vertices `kept`, where ``kept[row[i]]`` replaces vertex i in triangles.

        Vertices that are read on demand remain so.
        """
        if not self.is_lazy or hasattr(self.vertices, "__dask_graph__"):
            vertices = self.vertices[:, kept]
        else:
            vertices = Selected(self.vertices, kept)
        faces = row[self.faces].astype(np.int32)
        return dataclasses.replace(
            self, vertices=vertices, faces=faces, vertex_map=None, validate=False
        )


def labels_of(sequences: Sequence[MeshSequence]) -> NDArray[np.intp]:
    """Labels (V,), equal for vertices whose positions are equal in every frame of all shots."""
    first = [(0, sequences[0].frames(slice(0, 1)))]  # which tells most vertices apart
    blocks = itertools.chain(first, *[sequence.chunks() for sequence in sequences])
    return coincident(map(operator.itemgetter(1), blocks), sequences[0].n_vertices)


def without_copies(
    sequences: list[MeshSequence],
    label: NDArray[np.intp],
    importance: NDArray[np.float64] | None = None,
) -> tuple[list[MeshSequence], NDArray[np.float64] | None, NDArray[np.intp], NDArray[np.intp]]:
    """Shots of the first vertex of each label, and the sum of `importance` (or a count) per label.

    Returns also the indices of these U vertices and, for each vertex (V,), the index, among the U,
    of its replacement.  If all labels differ, shots and importance are returned unchanged.
    """
    kept, row = distinct(label)
    if len(kept) < len(row):
        sequences = [s.with_vertices(kept, row) for s in sequences]
        importance = np.bincount(row, weights=importance).astype(np.float64)
    return sequences, importance, kept, row


def _chunks(vertices: Any, max_bytes: int) -> Iterator[tuple[int, NDArray[np.floating]]]:
    n_frames, n_vertices = int(vertices.shape[0]), int(vertices.shape[1])
    step = max(1, max_bytes // max(1, n_vertices * 3 * vertices.dtype.itemsize))
    for start in range(0, n_frames, step):
        yield start, native(vertices[start : start + step])


def native(block: Any) -> NDArray[np.floating]:
    """Block of frames in memory and in native byte order (a memory map may have the other)."""
    array = np.asarray(block)
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def _check_vertices(vertices: Any, argument: str, validate: bool) -> Any:
    # a tensor's dtype is none of NumPy's
    sliced = all(hasattr(vertices, a) for a in ("shape", "dtype", "__getitem__"))
    if not sliced or not isinstance(vertices.dtype, np.dtype):
        given = as_array(vertices, argument, "an array of shape (F, V, 3)")
        if given.dtype.kind not in "fiu" and given.ndim == 0:
            raise InputError(
                argument,
                "an array of shape (F, V, 3)",
                f"an object of type {type(vertices).__name__}",
            )
        vertices = given
    if np.ma.is_masked(vertices):
        raise InputError(argument, "numbers everywhere", "an array with masked entries")
    shape = tuple(vertices.shape)
    if len(shape) != 3 or shape[2] != 3:
        remedy = remedy_of_shape(shape, ("F", "V", 3))
        raise InputError(argument, f"an array of shape (F, V, 3){remedy}", f"shape {shape}")
    if any(size != size for size in shape):
        raise InputError(
            argument, "a known number of frames (dask: compute_chunk_sizes())", f"shape {shape}"
        )
    if shape[0] < 1 or shape[1] < 1:
        raise InputError(argument, "at least one frame and one vertex", f"shape {shape}")
    kind = np.dtype(vertices.dtype).kind
    if kind in "iu":
        vertices = np.asarray(vertices, dtype=np.float64)
    elif kind != "f":
        raise InputError(argument, "real numbers", f"dtype {vertices.dtype}")
    elif vertices.dtype.itemsize not in (4, 8):
        vertices = np.asarray(
            vertices, dtype=np.float32 if vertices.dtype.itemsize == 2 else np.float64
        )
    if type(vertices) is np.ndarray and not vertices.dtype.isnative:
        vertices = vertices.astype(vertices.dtype.newbyteorder("="))
    if validate and not _finite_by_dask(vertices):
        for start, block in _chunks(vertices, _CHUNK_BYTES):
            bad = ~np.isfinite(block)
            if bad.any():
                t, i, c = (int(k) for k in np.argwhere(bad)[0])
                raise InputError(
                    argument,
                    "finite numbers",
                    f"{block[t, i, c]} at frame {start + t}, vertex {i} "
                    f"({int(bad.any(axis=2).sum())} such vertices in frames "
                    f"{start} to {start + len(block) - 1})",
                )
    return vertices


def _finite_by_dask(vertices: Any) -> bool:
    """True if Dask finds all numbers finite, on the workers that hold the chunks."""
    if not hasattr(vertices, "__dask_graph__"):
        return False
    return bool(np.isfinite(vertices).all().compute())


def check_vertex_map(vertex_map: Any, n_vertices: int) -> NDArray[np.int32]:
    array = np.asarray(vertex_map)
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise InputError("vertex_map", "a vector of integers", f"{array.dtype} {array.shape}")
    check_range(array, "vertex_map", n_vertices)
    return np.ascontiguousarray(array, dtype=np.int32)


def as_sequences(sequence: Any, faces: Any = None) -> list[MeshSequence]:
    """Check that a sequence, a list, or an array with faces is valid; return a list of sequences.

    All sequences of the list are of one mesh.
    """
    shots = list(sequence) if isinstance(sequence, Sequence) else [sequence]
    if not any(isinstance(shot, MeshSequence) for shot in shots):
        several = isinstance(sequence, Sequence) and len(shots) > 0
        if several and all(getattr(shot, "ndim", 0) == 3 for shot in shots):
            came = f"a list of {len(shots)} arrays (F, V, 3)"
            raise InputError("sequence", "several shots as a list of MeshSequence", came)
        return [MeshSequence(sequence, faces)]
    if faces is not None:
        raise InputError("faces", "None beside a MeshSequence, which has its own", type(faces))
    for k, shot in enumerate(shots):
        if not isinstance(shot, MeshSequence):
            raise InputError(f"sequence[{k}]", "a MeshSequence", type(shot).__name__)
        if shot.n_vertices != shots[0].n_vertices:
            raise InputError(
                f"sequence[{k}]",
                f"{shots[0].n_vertices} vertices, as in the first shot",
                shot.n_vertices,
            )
        if not np.array_equal(shot.faces, shots[0].faces):
            raise InputError(f"sequence[{k}].faces", "the faces of the first shot", "others")
    return shots


def sequence_in(thing: Any) -> Any:
    """The sequence of a ``trimesh.Trimesh`` or a list of them; any other object unchanged."""
    return MeshSequence(thing) if are_meshes([thing]) or are_meshes(thing) else thing


def joined(shots: Sequence[MeshSequence]) -> MeshSequence:
    """Sequence with the frames of all shots of a mesh, one shot after the other."""
    if len(shots) == 1:
        return shots[0]
    vertices = np.concatenate([block for shot in shots for _, block in shot.chunks()])
    return dataclasses.replace(shots[0], vertices=vertices, clip="", validate=False)
