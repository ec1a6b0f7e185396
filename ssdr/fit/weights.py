"""Skin weights of given bones: the sparse convex QP of every vertex, usable alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import (
    as_sequences,
    check_bone_model,
    check_count,
    check_influences,
    check_rest,
    check_transforms,
)
from ..sequence import MeshSequence
from ..skinning import BoneModel
from ..solver.alternation import vertex_step
from ..solver.initialization import single_bone_errors
from ..solver.model import Fixed, Model
from ..solver.smoothness import WeightSmoothness
from ..solver.trajectories import gather
from ..solver.vertex_newton import optimise_vertices

__all__ = ["WeightFit", "fit_weights"]


@dataclasses.dataclass(frozen=True, eq=False)
class WeightFit:
    """Weights and what they reach.

    Attributes
    ----------
    indices : (V, K) int32
    weights : (V, K) float64
        Descending, summing to 1, padded with joint 0, weight 0.
    squared_error : (V,) float64
        Σ_t |d|² of each vertex, in squared units of the mesh.
    rmse : float
        sqrt(Σ|d|² / (F V)).

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> start = ssdr.initialize(dancer, bones=4)
    >>> fit = ssdr.fit_weights(dancer, rest=start.rest, transforms=start.transforms)
    >>> fit.indices.shape, np.allclose(fit.weights.sum(axis=1), 1)
    ((799, 4), True)
    """

    indices: NDArray[np.int32]
    weights: NDArray[np.float64]
    squared_error: NDArray[np.float64]
    rmse: float


def fit_weights(
    sequence: MeshSequence | Any,
    faces: Any = None,
    *,
    rest: Any,
    transforms: Any,
    influences: int = 4,
    bone_model: BoneModel = "rigid",
    smoothness: float = 0.0,
    iterations: int = 20,
) -> WeightFit:
    """Best convex weights of at most K of the given bones, for every vertex.

    Minimises Σ_t |v^t − Σ_j w_j M_j^t p̃|² over w >= 0, Σ w = 1: an active-set
    solve over all bones, then over the K largest, then exchanges that lower the error.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
    faces : (T, 3) int array, optional
        With plain arrays; only `smoothness` reads it.
    rest : (V, 3) array
    transforms : (F, B, 3, 4) array
        From the rest pose to each frame, such as `bone_model` allows.
    influences : int
    bone_model : {"rigid", "similarity", "affine"}
    smoothness : float
        Length in the mesh's units: a jump of 1 in a weight across an edge costs
        as much as this distance in every frame at one vertex.  0: off.
    iterations : int
        Most sweeps over the mesh where `smoothness` couples the vertices.

    Returns
    -------
    WeightFit

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
    >>> fit = ssdr.fit_weights(
    ...     dancer, rest=start.rest, transforms=start.transforms, influences=2
    ... )
    >>> fit.weights.shape
    (799, 2)
    """
    sequences = as_sequences(sequence, faces)
    n = sequences[0].n_vertices
    k = check_influences(influences)
    rest = check_rest(rest, n)
    world = check_transforms(
        transforms, sum(len(s) for s in sequences), check_bone_model(bone_model)
    )
    iterations = check_count(iterations, "iterations")
    data = gather(sequences, bones=world.shape[1])
    inner, bones = data.from_world(rest, world)
    assert bones is not None
    cost, _ = single_bone_errors(data, inner, bones, np.arange(n))
    model = Model.start(bones, inner, cost.argmin(axis=1), min(k, world.shape[1]))
    fixed = Fixed(rest=True)
    smooth = WeightSmoothness.build(data, sequences[0].faces, smoothness)
    if smooth is None:
        vertex_step(data, model, fixed=fixed)
        # the K largest are not always the K best: exchange bones wherever that pays
        optimise_vertices(data, model, fixed=fixed)
    else:
        for _ in range(iterations):
            pull, stiff = smooth.terms(model)
            vertex_step(data, model, fixed=fixed, pull=pull, stiff=stiff)
    squared = model.error * data.scale**2
    padded = model.with_influences(k)
    indices, weights = padded.indices, padded.weights
    return WeightFit(
        indices=indices,
        weights=weights,
        squared_error=squared,
        rmse=float(np.sqrt(squared.sum() / (data.n_frames * n))),
    )
