"""Hausdorff distances, frame by frame: of the vertices as point sets, and of the surfaces."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from ..errors import InputError, check_flag, is_whole
from ..kernels.closest import farthest, fit_boxes, tree_order
from ..parallel import chunk_bounds, run_chunks
from ..sequence import MeshSequence
from .inputs import Frames, as_sequence, check_finite, read, squares

__all__ = ["Hausdorff", "hausdorff"]

_FRAMES = 8  # of one chunk: the search starts from the triangles found in the frame before
_LEAF = 4  # triangles, about
_FIRST = 32  # points that are looked up before the bound is tried


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Hausdorff:
    """Symmetric Hausdorff distances of two animated meshes, in their units.

    Attributes
    ----------
    vertex_per_frame : (F,) float64
        Between the two sets of vertices.
    surface_per_frame : (F,) float64 or None
        Between the surfaces, probed at the vertices (and samples); None without
        faces.
    subdivisions : int
        As given.

    Examples
    --------
    >>> reference = np.zeros((2, 3, 3))
    >>> result = ssdr.metrics.hausdorff(reference, reference + [3, 0, 0])
    >>> result.vertex_per_frame.shape, round(result.vertex_max, 3), result.surface_max
    ((2,), 3.0, None)
    """

    vertex_per_frame: NDArray[np.float64]
    surface_per_frame: NDArray[np.float64] | None
    subdivisions: int

    @property
    def vertex_max(self) -> float:
        """The worst frame's distance between the vertices."""
        return float(self.vertex_per_frame.max())

    @property
    def vertex_mean(self) -> float:
        """Mean over the frames of the distance between the vertices."""
        return float(self.vertex_per_frame.mean())

    @property
    def surface_max(self) -> float | None:
        """The worst frame's distance between the surfaces."""
        return None if self.surface_per_frame is None else float(self.surface_per_frame.max())

    @property
    def surface_mean(self) -> float | None:
        """Mean over the frames of the distance between the surfaces."""
        return None if self.surface_per_frame is None else float(self.surface_per_frame.mean())


def hausdorff(
    reference: Frames,
    other: Frames,
    faces: ArrayLike | None = None,
    *,
    other_faces: ArrayLike | None = None,
    surface: bool = True,
    subdivisions: int = 1,
) -> Hausdorff:
    """Symmetric Hausdorff distance of each frame.

    max( max_a min_b ‖a − b‖, max_b min_a ‖a − b‖ ), over the vertices, or with
    the inner minimum over the whole other surface.  It does not use the
    correspondence of vertices, so that sliding along the surface costs nothing.

    Parameters
    ----------
    reference, other : MeshSequence or (F, V, 3) array
        The numbers of vertices may differ.
    faces : (T, 3) int array, optional
        Triangles of the reference; those of the sequence by default.
    other_faces : (T', 3) int array, optional
        Triangles of `other`; its own by default, else those of the reference.
    surface : bool
        Whether to compare the surfaces too.
    subdivisions : int
        Probe each surface at the corners of its triangles cut into this squared
        number of similar ones; 1 takes the vertices alone.  The distance to the
        other surface is exact; its maximum over the surface is found from below.

    Returns
    -------
    Hausdorff

    Raises
    ------
    InputError
        If the numbers of frames differ or an argument is not usable.

    Notes
    -----
    Points no triangle uses are no part of a surface.  Distances to triangles
    are exact, by a bounding-volume hierarchy refitted to each frame; a search
    ends early where it cannot raise the maximum.

    Examples
    --------
    >>> flat = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], float)
    >>> result = ssdr.metrics.hausdorff(flat, flat + [0, 0, 2], [[0, 1, 2]])
    >>> round(result.surface_max, 3)
    2.0
    """
    first = as_sequence(reference, faces, "reference")
    second = as_sequence(other, other_faces, "other")
    if first.n_frames != second.n_frames:
        raise InputError("other", f"{first.n_frames} frames", f"{second.n_frames} frames")
    if len(second.faces) == 0 and len(first.faces) and other_faces is None:
        second = as_sequence(second, first.faces, "other")
    elif len(first.faces) == 0 and len(second.faces) and faces is None:
        first = as_sequence(first, second.faces, "reference")
    if not is_whole(subdivisions) or subdivisions < 1:
        raise InputError("subdivisions", "an integer >= 1", repr(subdivisions))
    check_flag(surface, "surface")
    bounds = chunk_bounds(first.n_frames, _FRAMES)
    vertex = np.empty(first.n_frames)

    def compare_vertices(_: int, start: int, stop: int) -> None:
        pairs = zip(read(first, start, stop), read(second, start, stop), strict=True)
        for t, (a, b) in enumerate(pairs, start):
            vertex[t] = max(_one_way(a, b), _one_way(b, a))

    with squares():
        run_chunks(compare_vertices, bounds)
    check_finite(first, second, vertex)
    if not (surface and len(first.faces) and len(second.faces)):
        return Hausdorff(
            vertex_per_frame=vertex, surface_per_frame=None, subdivisions=int(subdivisions)
        )
    one, two = _Surface(first, int(subdivisions)), _Surface(second, int(subdivisions))
    between = np.empty(first.n_frames)

    def compare_surfaces(_: int, start: int, stop: int) -> None:
        forward, backward = _Search(one, two), _Search(two, one)
        pairs = zip(read(first, start, stop), read(second, start, stop), strict=True)
        for t, (a, b) in enumerate(pairs, start):
            between[t] = max(forward.distance(a, b), backward.distance(b, a))

    with squares():
        run_chunks(compare_surfaces, bounds)
    check_finite(first, second, between)
    return Hausdorff(
        vertex_per_frame=vertex, surface_per_frame=between, subdivisions=int(subdivisions)
    )


def _one_way(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    tree = cKDTree(b, balanced_tree=False, compact_nodes=False)
    if len(a) != len(b):
        return float(np.max(tree.query(a)[0]))
    # A vertex is no farther from the set than from its twin: few can hold the maximum.
    bound = np.sqrt(((a - b) ** 2).sum(axis=1))
    order = np.argsort(-bound, kind="stable")
    worst, start, step = 0.0, 0, _FIRST
    while start < len(order) and bound[order[start]] > worst:
        part = a[order[start : start + step]]
        worst = max(worst, float(np.max(tree.query(part)[0])))
        start, step = start + step, 4 * step
    return worst


class _Surface:
    """Probe points and the order of triangles in a tree, fixed for all frames."""

    def __init__(self, sequence: MeshSequence, subdivisions: int) -> None:
        first = read(sequence, 0, 1)[0]
        self.depth = max(0, math.ceil(math.log2(max(1, len(sequence.faces)) / _LEAF)))
        self.triangles = np.ascontiguousarray(
            sequence.faces[tree_order(first, sequence.faces, self.depth)]
        )
        self.probes = _probes(sequence.faces, sequence.n_vertices, subdivisions)


class _Search:
    """From the probes of one surface to the triangles of another, frame after frame."""

    def __init__(self, source: _Surface, target: _Surface) -> None:
        self.source, self.target = source, target
        self.hints = np.zeros(source.probes.shape[0], dtype=np.int64)
        self.boxes = np.empty((2 ** (target.depth + 1) - 1, 6))
        self.lead = 0

    def distance(self, own: NDArray[np.float64], others: NDArray[np.float64]) -> float:
        tree = self.target
        others = np.ascontiguousarray(others)
        fit_boxes(others, tree.triangles, tree.depth, self.boxes)
        points = np.ascontiguousarray(self.source.probes @ own)
        square, self.lead = farthest(
            points, others, tree.triangles, tree.depth, self.boxes, self.hints, self.lead
        )
        return math.sqrt(square)


def _probes(faces: NDArray[np.int32], n_vertices: int, subdivisions: int) -> csr_array:
    """Matrix that takes the vertices to the probe points of the surface."""
    used = np.unique(faces)
    ones = csr_array((np.ones(len(used)), used, np.arange(len(used) + 1)), (len(used), n_vertices))
    if subdivisions == 1:
        return ones
    n = subdivisions
    grid = [(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]
    inner = np.array([g for g in grid if max(g) < n], dtype=np.float64) / n
    count = len(inner) * len(faces)
    columns = np.repeat(faces, len(inner), axis=0).ravel()
    values = np.tile(inner, (len(faces), 1)).ravel()
    extra = csr_array((values, columns, np.arange(0, 3 * count + 1, 3)), (count, n_vertices))
    return csr_array(
        (
            np.concatenate([ones.data, extra.data]),
            np.concatenate([ones.indices, extra.indices]),
            np.concatenate([ones.indptr, extra.indptr[1:] + ones.indptr[-1]]),
        ),
        (len(used) + count, n_vertices),
    )
