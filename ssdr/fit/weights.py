"""Fit of skin weights to given bones, a sparse convex QP for every vertex, usable alone."""

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
    """Fit convex weights of at most K bones to every vertex of a model.

    For each vertex it minimises Σ_t |v^t − Σ_j w_j M_j^t p̃|² over w >= 0 with Σ w = 1, where v^t
    is the vertex in frame t of the sequence, p̃ its rest position in homogeneous coordinates, and
    M_j^t the transform of bone j.  An active-set method solves for all bones, then for the K bones
    of largest weight; then bones are exchanged while this lowers the error.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
    skinning : Skinning
        Its rest pose and transforms are used, its weights are not; it must have as many frames as
        the sequence.
    influences : int
        Most influences per vertex (K).
    smoothness : float
        Length in the mesh's units; a difference of 1 in a weight between the ends of an edge costs
        as much as an error of this length at one vertex in every frame.  With 0 there is no such
        cost.
    iterations : int
        Most sweeps over the mesh if `smoothness` couples the vertices.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        If an argument is not usable.

    References
    ----------
    Le and Deng 2012, section 3.2: they solve by bounded variable least squares, keep the K largest
    weights and solve again.

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
    return fit_of(sequences, data, model.error, skin)
