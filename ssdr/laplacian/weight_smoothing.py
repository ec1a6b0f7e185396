"""Diffusion of skin weights over a mesh."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..common.checks import check_influences
from ..common.errors import InputError
from ..model.skinning import Skinning, check_skinning
from .factor import Backend
from .operators import MassKind
from .smoothing import LaplacianKind, LaplacianSmoother


def smooth_weights(
    skinning: Skinning | Any,
    length: float,
    *,
    influences: int | None = None,
    kind: LaplacianKind = "cotangent",
    mass: MassKind = "barycentric",
    backend: Backend | None = None,
) -> Skinning:
    """Copy of a model with weights diffused over its rest pose, by :class:`LaplacianSmoother`.

    The weights of each bone become the solution w of (M + ℓ²L) w = M w₀.  Their sums stay 1.
    Negative weights, which the cotangent Laplacian can make at edges that are not Delaunay, become
    0, and the other weights of the vertex are normalised again.  The motion of the model changes:
    ``metrics.compare(sequence, smoothed)`` measures by how much.  As the `prior` of
    :func:`~ssdr.fit_weights`, smooth weights are weighed against the error.

    Parameters
    ----------
    skinning : Skinning, or a result that has one
        Its triangles and rest pose are the mesh.
    length : float
        ℓ in the mesh's units: steps between weights are spread over about twice this length.
    influences : int, optional
        Most influences per vertex; the largest are kept.  By default as many as the model has.
    kind, mass, backend
        As in :class:`LaplacianSmoother`; "uniform" makes no weight negative.

    Returns
    -------
    Skinning

    Raises
    ------
    InputError
        If an argument is not usable, or the model has no triangles.

    References
    ----------
    Desbrun et al., "Implicit fairing of irregular meshes using diffusion and curvature flow", 1999.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> model = ssdr.initialize(dancer, bones=4, influences=1)
    >>> smooth = ssdr.laplacian.smooth_weights(model, 0.05, influences=4)
    >>> smooth.weights.shape, bool(smooth.weights[:, 1].max() > 0.3)
    ((799, 4), True)
    """
    model = check_skinning(skinning)
    count = model.n_influences if influences is None else check_influences(influences)
    if not len(model.faces):
        wanted = "a model with triangles (dataclasses.replace(model, faces=faces) has them)"
        raise InputError("skinning", wanted, "none")
    smoother = LaplacianSmoother(
        model.rest, model.faces, length, kind=kind, mass=mass, backend=backend
    )
    weights = np.maximum(smoother.smooth(model.dense_weights().astype(np.float64)), 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    found = Skinning.from_dense(model.rest, weights, model.transforms, influences=count)
    return dataclasses.replace(model, indices=found.indices, weights=found.weights)
