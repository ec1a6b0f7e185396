"""Angles between the normals of an animated surface and those that an engine shades with."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..common.errors import InputError
from ..common.parallel import chunk_bounds
from ..common.short_repr import short_repr
from ..mesh.executor import Executor
from ..mesh.normals import surface_normals
from ..mesh.sequence import MeshSequence
from ..model.drawn_normals import Angles, drawn_angles, holders_of
from ..model.shapes import Skinned
from ..model.skinning import skinning_in
from .matching import Frames, as_pair, as_sequence, chunk_size, matched, read

_MOST = 500  # frames measured of a result of the solver, or a few less


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


def normals(reference: Frames, model: Frames, faces: ArrayLike | None = None) -> NormalErrors:
    """Angles between the normals of a reference and those that are drawn of a model.

    The normals of a surface are means over the triangles around a vertex, weighted by their angles
    at the vertex, and separate on the two sides of a hard edge.  Game engines and renderers draw a
    skinned mesh by its rest normals n, which they transform by the blended 3×3 matrices of the
    bones: Σ_k w_k R_k n, normalised.  Triangles without area have no normal, and a vertex without
    other triangles is left out in that frame.

    Parameters
    ----------
    reference : MeshSequence, Skinning or (F, V, 3) array
        Read by chunks of frames.
    model : Skinning, a result that has one, MeshSequence or (F, V, 3) array
        A skinning is measured as engines draw it, by the normals that it has or, if it has none, by
        those of its rest pose; frames by the normals of their surface.
    faces : (T, 3) int array, optional
        Triangles of reference and model; by default those of either.

    Returns
    -------
    NormalErrors

    Raises
    ------
    InputError
        If shapes or triangles differ, or there is no triangle with an area.

    References
    ----------
    Thürmer & Wüthrich, "Computing vertex normals from polygonal facets", 1998; Khronos, "glTF 2.0
    specification", section 3.7.3.3, for how skins turn normals.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> model = ssdr.decompose(dancer, bones=8, effort="fast").skinning
    >>> errors = ssdr.metrics.normals(dancer, model)
    >>> errors.mean < 10, errors.per_vertex.shape
    (True, (799,))
    """
    first = as_sequence(reference, faces, "reference")
    model = skinning_in(model)
    if isinstance(model, Skinned):
        first = matched(first, model)
    else:
        first, model = as_pair(first, model, faces)
    result = known_errors(first, model)
    if result is None:
        raise InputError("faces", "a triangle with an area", "none")
    return result


def known_errors(reference: MeshSequence, model: Skinned | MeshSequence) -> NormalErrors | None:
    """Angles as by :func:`normals`, for a model with the reference's frames and vertices.

    The result is None if no angle can be measured.
    """
    if not isinstance(model, Skinned):
        holders, parts = holders_of(reference, model), []
        for span in chunk_bounds(reference.n_frames, chunk_size(reference)):
            one, other = (surface_normals(read(x, *span), holders) for x in (reference, model))
            parts.append(Angles.between(one, other, holders.vertex))
        frames = np.arange(reference.n_frames)
        return _errors(Angles.joined(parts), frames, reference.n_vertices)
    both = len(reference.faces) and len(model.faces)
    if both and not np.array_equal(reference.faces, model.faces):
        raise InputError("model", "the triangles of the reference", "others")
    return errors_of_model([reference], model, most=None)


def errors_of_model(
    sequences: Sequence[MeshSequence],
    model: Skinned,
    *,
    executor: Executor | None = None,
    most: int | None = _MOST,
) -> NormalErrors | None:
    """Errors of a skinning's drawn normals against sequences, or None if no normal is known.

    `most` and `executor` are as in :func:`~ssdr.model.drawn_normals.drawn_angles`.
    """
    frames, drawn, own = drawn_angles(sequences, model, executor=executor, most=most)
    return _errors(drawn, frames, model.n_vertices, own)


def _errors(
    angles: Angles, frames: NDArray[np.int64], n_vertices: int, own: Angles | None = None
) -> NormalErrors | None:
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
