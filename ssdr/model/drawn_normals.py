"""Rest normals, which engines skin with the bones, and their angles to the normals of a surface."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.parallel import chunk_bounds, run_chunks
from ..kernels.normals import angles_range, fit_range
from ..mesh.executor import Executor, Frames, spans_of
from ..mesh.normals import NormalHolders, normal_holders, normals_at_corners, surface_normals, unit
from ..mesh.sequence import MeshSequence
from ..mesh.surface import Surface
from .frame_error import of_each_span
from .lbs import skin, skin_each
from .shaped_normals import shaped_normals
from .shapes import ShapedSkinning, Skinned, skinning_and_shapes
from .skinning import Skinning

Array = NDArray[np.float64]

_CHUNK = 512  # normals in a task
_COMPARED = 6  # frames in which copies of a vertex coincide
_PULL = 1e-9  # towards the rest pose's own normal, relative to the sum of all squares
_LEAST = 1e-6  # norm of a fitted normal: a smaller one has no direction
_BINS = 18001  # of the histogram of angles, each a hundredth of a degree


def holders_of(
    sequence: MeshSequence, model: MeshSequence | Skinned | None = None
) -> NormalHolders:
    """Normals of a sequence, with its hard edges or, if it has no normals, those of `model`.

    If hard edges are known, copies of a vertex, as there are at seams of UVs, have the same
    normals.  Vertices that coincide in several frames are taken for copies.
    """
    given = [x for x in (sequence, model) if x is not None]
    faces = next((x.faces for x in reversed(given) if len(x.faces)), sequence.faces)
    known = [x for x in given if x.surface is not None and x.surface.normals is not None]
    surface = next((x.surface for x in known if np.array_equal(x.faces, faces)), None)
    places = None
    if surface is not None:
        chosen = np.linspace(0, sequence.n_frames - 1, min(_COMPARED, sequence.n_frames))
        places = np.concatenate(sequence.frames(np.unique(chosen.astype(int))), axis=1)
    return normal_holders(faces, sequence.n_vertices, surface, places)


def with_fitted_normals(
    sequences: Sequence[MeshSequence], skinning: Skinning, *, executor: Executor | None = None
) -> Skinning:
    """Copy of a skinning with the rest normals that fit the surface of the sequences best.

    Engines draw a rest normal n as A_t n / |A_t n| in frame t, with A_t = Σ_k w_k R_k^t the blended
    3×3 matrix of its vertex.  With n_t the surface's own normal, Σ_t |A_t n − n_t|² is least where
    Σ_t A_tᵀ A_t n = Σ_t A_tᵀ n_t.  Where frames do not determine n, it is that of the rest pose.

    Parameters
    ----------
    sequences : sequence of MeshSequence
        All frames of the skinning.  Edges are hard where they are in the first sequence or, if it
        has no normals, in `skinning`.
    skinning : Skinning
        Returned as it is if it has no triangles.
    executor : Executor, optional
        Where the work is done; in this process by default.
    """
    if not len(skinning.faces):
        return skinning
    holders = holders_of(sequences[0], skinning)
    gram, right = np.zeros((len(holders.vertex), 6)), np.zeros((len(holders.vertex), 3))
    shared = (*_skin_of(skinning), holders, np.asarray(skinning.transforms, dtype=np.float64))
    for part in of_each_span(_fit_of_span, sequences, shared, executor):
        gram += part[0]
        right += part[1]
    own = normals_at_corners(skinning.rest, holders)
    fitted = np.zeros_like(right)
    fitted[holders.corner] = own
    system = gram[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    pull = _PULL * np.trace(system, axis1=1, axis2=2)[:, None]
    known = pull[:, 0] > 0
    right = (right + pull * fitted)[known, :, None]
    system = system[known] + pull[known, :, None] * np.eye(3)
    fitted[known] = np.linalg.solve(system, right)[..., 0]
    normals = unit(fitted[holders.corner], own, _LEAST).astype(np.float32)
    surface = dataclasses.replace(skinning.surface or Surface(), normals=normals)
    return dataclasses.replace(skinning, surface=surface)


def drawn_angles(
    sequences: Sequence[MeshSequence],
    model: Skinned,
    *,
    executor: Executor | None = None,
    most: int | None = None,
) -> tuple[NDArray[np.int64], Angles, Angles]:
    """Angles between the surface normals of sequences and those that engines draw of a model.

    Parameters
    ----------
    sequences, executor
        As for :func:`with_fitted_normals`.
    model : Skinning or ShapedSkinning
        A model without normals has those of its rest pose.
    most : int, optional
        If there are more frames, about this number of them is measured, in runs of eight that are
        evenly spread.

    Returns
    -------
    (f,) int64
        Indices of the measured frames.
    Angles
        To the drawn normals.
    Angles
        To the normals of the skinning's own surface in each frame.
    """
    skinning, shapes = skinning_and_shapes(model)
    holders = holders_of(sequences[0], model)
    position = np.asarray(skinning.rest, dtype=np.float64)[None]
    rest, amounts = rest_vectors(model, holders), np.zeros((skinning.n_frames, 0))
    if len(rest) > 1 and shapes is not None:
        position = np.concatenate([position, shapes.displacements])
        amounts = shapes.amounts
    spans = spans_of(skinning.n_frames, most)
    shared = (
        *(position, rest, *_skin_of(skinning), holders),
        np.asarray(skinning.transforms, dtype=np.float64),
    )
    walk = sequences, shared, executor, spans, (amounts,)
    found = list(of_each_span(_angles_of_span, *walk))
    frames = np.concatenate([np.arange(*span) for span in spans])
    return frames, Angles.joined(one for one, _ in found), Angles.joined(one for _, one in found)


def rest_vectors(model: Skinned, holders: NormalHolders) -> Array:
    """Vectors ``(1 + S, N, 3)`` in the rest pose that engines skin to draw normals; of any norm.

    The first are those without shapes, the others what each shape adds.
    """
    skinning, shapes = skinning_and_shapes(model)
    normals = None if skinning.surface is None else skinning.surface.normals
    if normals is None:
        normals = normals_at_corners(skinning.rest, holders)
    at_corners = normals[None]
    if shapes is not None and len(skinning.faces):
        fitted = shaped_normals(ShapedSkinning(skinning, shapes))
        at_corners = np.concatenate([fitted.rest[None], fitted.added])[:, fitted.corner]
    rest = np.zeros((len(at_corners), len(holders.vertex), 3))
    for row, some in zip(rest, at_corners, strict=True):
        np.add.at(row, holders.corner.reshape(-1), some.reshape(-1, 3))
    return rest


def posed(base: Array, indices: Any, weights: Any, moves: Array, factors: Array) -> Any:
    """Points or vectors ``(f, N, 3)`` in some frames, from ``(1 + S, N, 3)`` in the rest pose.

    `indices` and `weights` ``(N, K)`` are their influences, `moves` ``(f, B, 3, 4)`` the transforms
    of the bones, and `factors` ``(f, S)`` the amounts of the shapes.
    """
    if len(base) == 1:
        return skin(base[0], indices, weights, moves)
    return skin_each(base[0] + np.tensordot(factors, base[1:], 1), indices, weights, moves)


def _skin_of(skinning: Skinning) -> tuple[NDArray[np.int32], Array]:
    return skinning.indices, np.asarray(skinning.weights, dtype=np.float64)


def _fit_of_span(
    frames: Frames,
    transforms: Array,
    indices: NDArray[np.int32],
    weights: Array,
    holders: NormalHolders,
) -> tuple[Array, Array]:
    vertex = holders.vertex
    gram, right = np.zeros((len(vertex), 6)), np.zeros((len(vertex), 3))
    for start, block in frames.blocks():
        normals = surface_normals(block, holders)
        moves = np.ascontiguousarray(transforms[start : start + len(block)])

        def work(_: int, i: int, k: int, n: Array = normals, m: Array = moves) -> None:
            fit_range(n, vertex, indices, weights, m, gram, right, i, k)

        run_chunks(work, chunk_bounds(len(vertex), _CHUNK))
    return gram, right


def _angles_of_span(
    frames: Frames,
    transforms: Array,
    amounts: Array,
    rest: Array,
    rest_normals: Array,
    indices: NDArray[np.int32],
    weights: Array,
    holders: NormalHolders,
) -> tuple[Angles, Angles]:
    # `rest` (1 + S, V, 3) and `rest_normals` (1 + S, N, 3): those without shapes, then what each
    # shape adds
    skin_of_normals = indices[holders.vertex], weights[holders.vertex]
    drawn, own = [], []

    for start, block in frames.blocks():
        some = slice(start, start + len(block))
        moves, factors = transforms[some], amounts[some]
        normals = surface_normals(block, holders)
        turned = posed(rest_normals, *skin_of_normals, moves * [1, 1, 1, 0], factors)
        drawn.append(Angles.between(normals, turned, holders.vertex))
        surface = surface_normals(posed(rest, indices, weights, moves, factors), holders)
        own.append(Angles.between(normals, surface, holders.vertex))
    return Angles.joined(drawn), Angles.joined(own)


@dataclasses.dataclass(frozen=True, eq=False)
class Angles:
    """Statistics of the angles, in degrees, between the normals of a surface and those drawn.

    Attributes
    ----------
    histogram : (18001,) int64
        Number of angles in each hundredth of a degree.
    largest : float
    frame_sum, frame_count : (F,) float64
        Sum and number of the angles in each frame.
    vertex_sum, vertex_count : (V',) float64
        Sum and number of the angles at each vertex, up to the last that has a normal.
    """

    histogram: NDArray[np.int64]
    largest: float
    frame_sum: Array
    frame_count: Array
    vertex_sum: Array
    vertex_count: Array

    @classmethod
    def between(cls, normals: Array, drawn: NDArray[Any], vertex: NDArray[np.int32]) -> Angles:
        """Angles between `normals` ``(F, N, 3)``, which are 0 where unknown, and vectors `drawn`.

        `vertex` (N,) holds the vertex index of each normal.
        """
        angles = np.empty(normals.shape[:2])

        def work(_: int, first: int, last: int) -> None:
            angles_range(normals, drawn, angles, first, last)

        run_chunks(work, chunk_bounds(len(angles), 1))
        known = angles >= 0
        histogram = np.bincount((100 * angles[known]).astype(np.int64), minlength=_BINS)
        largest = float(angles.max(initial=0.0))
        angles[~known] = 0.0
        in_frame = [x.sum(axis=1, dtype=np.float64) for x in (angles, known)]
        at_vertex = [np.bincount(vertex, x.sum(axis=0)) for x in (angles, known)]
        return cls(histogram, largest, *in_frame, *at_vertex)

    @classmethod
    def joined(cls, parts: Iterable[Angles]) -> Angles:
        """Combine statistics of consecutive parts: frames are concatenated, the rest is summed.

        `largest` is the maximum over the parts.
        """
        listed = list(parts)

        def of(name: str) -> list[Any]:
            return [getattr(part, name) for part in listed]

        frames = (np.concatenate(of(name)) for name in ("frame_sum", "frame_count"))
        sums = (sum(of(name)) for name in ("vertex_sum", "vertex_count"))
        return cls(sum(of("histogram")), max(of("largest")), *frames, *sums)
