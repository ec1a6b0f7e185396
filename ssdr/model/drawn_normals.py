"""Rest normals, which engines skin with the bones, and their angles to the normals of a surface."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.parallel import chunk_bounds, run_chunks
from ..common.short_repr import short_repr
from ..kernels.normals import angles_range, fit_range
from ..mesh.executor import Executor, Frames, spans_of
from ..mesh.normals import NormalHolders, normal_holders, normals_at_corners, surface_normals, unit
from ..mesh.sequence import MeshSequence
from ..mesh.surface import Surface
from .frame_error import of_each_span
from .lbs import skin, skin_each
from .shaped_normals import shaped_normals
from .shapes import ShapedSkinning, Skinned
from .skinning import Skinning

Array = NDArray[np.float64]

_CHUNK = 512  # normals in a task
_COMPARED = 6  # frames in which copies of a vertex coincide
# Towards the rest pose's own normal, relative to the sum of all squares: fitted normals are
# hardly drawn worse, and the rest pose itself is lit as its surface is.
_PULL = 0.06
_LEAST = 1e-6  # norm of a fitted normal: a smaller one has no direction
_MOST = 500  # frames measured of a result of the solver, or a few less
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
    3×3 matrix of its vertex.  With n_t the surface's own normal and n_r that of the rest pose,
    Σ_t |A_t n − n_t|² + ρ |n − n_r|² is least where (Σ_t A_tᵀ A_t + ρ) n = Σ_t A_tᵀ n_t + ρ n_r,
    where ρ is 6 % of the trace of Σ_t A_tᵀ A_t.

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
    weights = np.asarray(skinning.weights, dtype=np.float64)
    transforms = np.asarray(skinning.transforms, dtype=np.float64)
    shared = skinning.indices, weights, holders, transforms
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
    skinning = model.skinning
    shapes = model.shapes if isinstance(model, ShapedSkinning) and len(model.shapes) else None
    holders = holders_of(sequences[0], model)
    position = np.asarray(skinning.rest, dtype=np.float64)[None]
    rest, amounts = rest_vectors(model, holders), np.zeros((skinning.n_frames, 0))
    if len(rest) > 1 and shapes is not None:
        position = np.concatenate([position, shapes.displacements])
        amounts = shapes.amounts
    spans = spans_of(skinning.n_frames, most)
    shared = (
        *(position, rest, skinning.indices, np.asarray(skinning.weights, dtype=np.float64)),
        *(holders, np.asarray(skinning.transforms, dtype=np.float64)),
    )
    walk = sequences, shared, executor, spans, (amounts,)
    found = list(of_each_span(_angles_of_span, *walk))
    frames = np.concatenate([np.arange(*span) for span in spans])
    drawn, own = map(Angles.joined, zip(*found, strict=True))
    return frames, drawn, own


def rest_vectors(model: Skinned, holders: NormalHolders) -> Array:
    """Vectors ``(1 + S, N, 3)`` in the rest pose that engines skin to draw normals; of any norm.

    The first are those without shapes, the others what each shape adds.
    """
    skinning = model.skinning
    shapes = model.shapes if isinstance(model, ShapedSkinning) and len(model.shapes) else None
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
        fields = zip(*[vars(part).values() for part in parts], strict=True)
        histograms, largest, in_frame, frame_counts, at_vertex, vertex_counts = fields
        frames = np.concatenate(in_frame), np.concatenate(frame_counts)
        return cls(sum(histograms), max(largest), *frames, sum(at_vertex), sum(vertex_counts))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class NormalErrors:
    """Statistics of the angles, in degrees, between normals and those of a reference surface.

    Attributes
    ----------
    mean, max : float
        Mean and largest angle over all frames and vertices.
    p95 : float
        Angle that 95 % of all do not exceed, to a hundredth of a degree.
    beyond_20, inwards : float
        Share, from 0 to 1, of the angles of at least 20°, and of at least 90°.
    surface : float or None
        Of a skinning, the mean angle of the normals of its own surface, which are drawn by programs
        that compute normals anew in every frame.
    per_frame : (F,) float64
        Mean of each frame; NaN where no normal of the reference is known.
    per_vertex : (V,) float64
        Mean of each vertex; NaN where its normal is never known.
    frames : (F,) int64
        Indices of the measured frames: about 500 for a result of the solver with more frames, all
        otherwise.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> ssdr.metrics.normals(dancer, dancer).mean
    0.0
    """

    mean: float
    p95: float
    beyond_20: float
    inwards: float
    max: float
    surface: float | None
    per_frame: NDArray[np.float64]
    per_vertex: NDArray[np.float64]
    frames: NDArray[np.int64]

    __repr__ = short_repr

    def as_dict(self) -> dict[str, float | None]:
        """Dictionary of the plain numbers, for JSON."""
        return {k: v for k, v in vars(self).items() if not isinstance(v, np.ndarray)}

    def __str__(self) -> str:
        return (
            f"{self.mean:.3g}° mean, {self.p95:.3g}° for 95 %, {100 * self.inwards:.2g} % inwards"
        )


def errors_of_model(
    sequences: Sequence[MeshSequence],
    model: Skinned,
    *,
    executor: Executor | None = None,
    most: int | None = _MOST,
) -> NormalErrors | None:
    """Errors of a skinning's drawn normals against sequences, or None if no normal is known.

    `most` and `executor` are as in :func:`drawn_angles`.
    """
    frames, drawn, own = drawn_angles(sequences, model, executor=executor, most=most)
    return errors_of_angles(drawn, frames, model.n_vertices, own)


def errors_of_angles(
    angles: Angles, frames: NDArray[np.int64], n_vertices: int, own: Angles | None = None
) -> NormalErrors | None:
    """Errors of `angles` in the given frames, or None if there are no angles.

    `own` are those of the normals of the model's own surface.
    """
    count = int(angles.histogram.sum())
    if count == 0:
        return None
    most = np.searchsorted(np.cumsum(angles.histogram), 0.95 * count)
    per_vertex = np.full(n_vertices, np.nan)
    with np.errstate(invalid="ignore"):
        per_frame = angles.frame_sum / angles.frame_count
        per_vertex[: len(angles.vertex_sum)] = angles.vertex_sum / angles.vertex_count
    return NormalErrors(
        mean=float(angles.frame_sum.sum()) / count,
        p95=min(0.01 * (float(most) + 1), angles.largest),
        beyond_20=float(angles.histogram[2000:].sum()) / count,
        inwards=float(angles.histogram[9000:].sum()) / count,
        max=angles.largest,
        surface=None if own is None else float(own.frame_sum.sum()) / count,
        per_frame=per_frame,
        per_vertex=per_vertex,
        frames=frames,
    )
