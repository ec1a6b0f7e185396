"""Hausdorff distances, frame by frame: of the vertices as point sets, and of the surfaces."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from ..common.errors import InputError, check_flag
from ..common.parallel import chunk_bounds, run_chunks
from ..common.short_repr import short_repr
from ..kernels.closest import farthest, fit_boxes, tree_order
from ..mesh.sequence import MeshSequence
from .matching import Frames, as_sequence, check_finite, read

_FRAMES = 8  # frames in a task: a search starts from the triangles found in the frame before
_LEAF = 4  # approximate number of triangles in a leaf of the tree
_FIRST = 32  # points searched before the bound is tested for the first time


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Hausdorff:
    """Symmetric Hausdorff distances of two animated meshes, in their units.

    Attributes
    ----------
    vertex_max, vertex_mean : float
        Between the sets of vertices: maximum and mean over the frames.
    surface_max, surface_mean : float or None
        Between the surfaces, probed at their vertices; None without faces.
    vertex_per_frame : (F,) float64
    surface_per_frame : (F,) float64 or None

    Examples
    --------
    >>> reference = np.zeros((2, 3, 3))
    >>> result = ssdr.metrics.hausdorff(reference, reference + [3, 0, 0])
    >>> result.vertex_per_frame.shape, round(result.vertex_max, 3), result.surface_max
    ((2,), 3.0, None)
    """

    vertex_max: float
    vertex_mean: float
    surface_max: float | None
    surface_mean: float | None
    vertex_per_frame: NDArray[np.float64]
    surface_per_frame: NDArray[np.float64] | None

    __repr__ = short_repr


def hausdorff(
    reference: Frames,
    other: Frames,
    faces: ArrayLike | None = None,
    *,
    surface: bool = True,
) -> Hausdorff:
    """Symmetric Hausdorff distance of each frame.

    The distance is max( max_a min_b ‖a − b‖, max_b min_a ‖a − b‖ ), where a and b are vertices of
    the two meshes; for surfaces, the inner minimum is over the whole other surface.  The
    correspondence of vertices is not used, so that sliding along the surface costs nothing.

    Parameters
    ----------
    reference, other : MeshSequence, Skinning, a result that has one, or (F, V, 3) array
        The numbers of vertices may differ.
    faces : (T, 3) int array, optional
        Triangles of the reference; those of the sequence by default.
    surface : bool
        Whether to compare the surfaces as well.  The distance of a vertex to the other surface is
        exact, and the maximum over the vertices is a lower bound on that over the surface.

    Returns
    -------
    Hausdorff

    Raises
    ------
    InputError
        If the numbers of frames differ or an argument is not usable.

    Notes
    -----
    Vertices without triangles do not belong to a surface.  Distances to triangles are found by a
    bounding-volume hierarchy that is refitted to each frame; a search ends as soon as it cannot
    raise the maximum.

    Examples
    --------
    >>> flat = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], float)
    >>> result = ssdr.metrics.hausdorff(flat, flat + [0, 0, 2], [[0, 1, 2]])
    >>> round(result.surface_max, 3)
    2.0
    """
    first = as_sequence(reference, faces, "reference")
    second = as_sequence(other, None, "other")
    if first.n_frames != second.n_frames:
        raise InputError("other", f"{first.n_frames} frames", f"{second.n_frames} frames")
    if len(second.faces) == 0 and len(first.faces):
        second = as_sequence(second, first.faces, "other")
    elif len(first.faces) == 0 and len(second.faces) and faces is None:
        first = as_sequence(first, second.faces, "reference")
    check_flag(surface, "surface")
    bounds = chunk_bounds(first.n_frames, _FRAMES)
    vertex, between = np.empty(first.n_frames), None

    def compare_vertices(_: int, start: int, stop: int) -> None:
        pairs = zip(read(first, start, stop), read(second, start, stop), strict=True)
        for t, (a, b) in enumerate(pairs, start):
            vertex[t] = max(_one_way(a, b), _one_way(b, a))

    with np.errstate(over="ignore", invalid="ignore"):
        run_chunks(compare_vertices, bounds)
    check_finite(first, second, vertex)
    if surface and len(first.faces) and len(second.faces):
        between = _between_surfaces(first, second, bounds)
    return Hausdorff(
        vertex_max=float(vertex.max()),
        vertex_mean=float(vertex.mean()),
        surface_max=None if between is None else float(between.max()),
        surface_mean=None if between is None else float(between.mean()),
        vertex_per_frame=vertex,
        surface_per_frame=between,
    )


def _one_way(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Largest distance from a point of `a` to its nearest point of `b`."""
    tree = cKDTree(b, balanced_tree=False, compact_nodes=False)
    if len(a) != len(b):
        return float(np.max(tree.query(a)[0]))
    # A vertex is at most as far from the other set as from its counterpart there, so that only few
    # vertices can be the farthest.
    bound = np.sqrt(((a - b) ** 2).sum(axis=1))
    order = np.argsort(-bound, kind="stable")
    worst, start, step = 0.0, 0, _FIRST
    while start < len(order) and bound[order[start]] > worst:
        part = a[order[start : start + step]]
        worst = max(worst, float(np.max(tree.query(part)[0])))
        start, step = start + step, 4 * step
    return worst


def _between_surfaces(
    first: MeshSequence, second: MeshSequence, bounds: list[tuple[int, int]]
) -> NDArray[np.float64]:
    """Hausdorff distance of the surfaces in each frame, ``(F,)``."""
    result = np.empty(first.n_frames)
    one, two = _Surface(first), _Surface(second)

    def work(_: int, start: int, stop: int) -> None:
        forward, backward = _Search(one, two), _Search(two, one)
        pairs = zip(read(first, start, stop), read(second, start, stop), strict=True)
        for t, (a, b) in enumerate(pairs, start):
            result[t] = max(forward.distance(a, b), backward.distance(b, a))

    with np.errstate(over="ignore", invalid="ignore"):
        run_chunks(work, bounds)
    check_finite(first, second, result)
    return result


class _Surface:
    """Vertices of a surface, and a tree over its triangles, used for all frames."""

    def __init__(self, sequence: MeshSequence) -> None:
        faces = sequence.faces
        self.depth = max(0, math.ceil(math.log2(max(1, len(faces)) / _LEAF)))
        order = tree_order(read(sequence, 0, 1)[0], faces, self.depth)
        self.triangles = np.ascontiguousarray(faces[order])
        self.probes = np.unique(faces)


class _Search:
    """Search from the probes of one surface to the triangles of another, frame after frame."""

    def __init__(self, source: _Surface, target: _Surface) -> None:
        self.source, self.target = source, target
        self.hints = np.zeros(len(source.probes), dtype=np.int64)
        self.boxes = np.empty((2 ** (target.depth + 1) - 1, 6))
        self.lead = 0

    def distance(self, own: NDArray[np.float64], others: NDArray[np.float64]) -> float:
        """Largest distance of a probe to the other surface, given the vertices of both."""
        tree, others = self.target, np.ascontiguousarray(others)
        fit_boxes(others, tree.triangles, tree.depth, self.boxes)
        points = np.ascontiguousarray(own[self.source.probes])
        square, self.lead = farthest(
            points, others, tree.triangles, tree.depth, self.boxes, self.hints, self.lead
        )
        return math.sqrt(square)
