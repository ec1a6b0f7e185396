"""Angles between the normals of an animated surface and those that an engine shades with."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..common.errors import InputError
from ..common.parallel import chunk_bounds
from ..mesh.normals import surface_normals
from ..mesh.sequence import MeshSequence
from ..model.drawn_normals import (
    Angles,
    NormalErrors,
    errors_of_angles,
    errors_of_model,
    holders_of,
)
from ..model.shapes import Skinned
from ..model.skinning import skinning_in
from .matching import Frames, as_pair, as_sequence, chunk_size, matched, read


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
        return errors_of_angles(Angles.joined(parts), frames, reference.n_vertices)
    both = len(reference.faces) and len(model.faces)
    if both and not np.array_equal(reference.faces, model.faces):
        raise InputError("model", "the triangles of the reference", "others")
    return errors_of_model([reference], model, most=None)
