"""Skin weights of given bones: the sparse convex QP of every vertex, usable alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..checks import check_influences, check_smoothness, check_whole
from ..sequence import MeshSequence
from ..skinning import Skinning
from ..solver.alternation import vertex_step
from ..solver.initialization import single_bone_errors
from ..solver.model import Locked, Model
from ..solver.smoothness import WeightSmoothness
from ..solver.vertex_newton import optimise_vertices
from .fit import Fit, checked, fit_of, gathered

__all__ = ["fit_weights"]


def fit_weights(
    sequence: MeshSequence | Any,
    skinning: Skinning,
    *,
    influences: int = 4,
    smoothness: float = 0.0,
    iterations: int = 20,
) -> Fit:
    """Best convex weights of at most K bones for every vertex of a model.

    Minimises Σ_t |v^t − Σ_j w_j M_j^t p̃|² over w >= 0, Σ w = 1: an active-set
    solve over all bones, then over the K largest, then exchanges that lower the error.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
    skinning : Skinning
        Its rest pose and transforms, of as many frames, are used; its weights are not.
    influences : int
        Most bones a vertex (K).
    smoothness : float
        Length in the mesh's units: a jump of 1 in a weight across an edge costs
        as much as this distance in every frame at one vertex.  0: off.
    iterations : int
        Most sweeps over the mesh where `smoothness` couples the vertices.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        If an argument is not usable.

    References
    ----------
    Le and Deng 2012, section 3.2 (there by bounded variable least squares);
    keeping the K largest and solving again as in their section 3.2.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> start = ssdr.initialize(dancer, bones=4)
    >>> fit = ssdr.fit_weights(dancer, start, influences=2)
    >>> fit.skinning.weights.shape
    (799, 2)
    """
    sequences, rest, _ = checked(sequence, skinning)
    k, n = check_influences(influences), len(rest)
    iterations = check_whole(iterations, "iterations", 1)
    data, inner, bones = gathered(sequences, skinning, rest)
    cost, _ = single_bone_errors(data, inner, bones, np.arange(n))
    model = Model.start(bones, inner, cost.argmin(axis=1), min(k, bones.shape[1]))
    locked = Locked(rest=True)
    faces = sequences[0].faces if len(sequences[0].faces) else skinning.faces
    check_smoothness(smoothness, faces)
    smooth = WeightSmoothness.build(data, faces, smoothness)
    if smooth is None:
        vertex_step(data, model, locked=locked)
        # the K largest are not always the K best: exchange bones wherever that pays
        optimise_vertices(data, model, locked=locked)
    else:
        for _ in range(iterations):
            pull, stiff = smooth.terms(model)
            vertex_step(data, model, locked=locked, pull=pull, stiff=stiff)
    padded = model.with_influences(k)
    skin = dataclasses.replace(skinning, indices=padded.indices, weights=padded.weights)
    return fit_of(data, model.error, skin)
