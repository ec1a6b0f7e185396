"""Fit of skin weights to given bones, a sparse convex QP for every vertex, usable alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.checks import (
    BoneModel,
    as_array,
    check_dense,
    check_frame_importance,
    check_importance,
    check_influences,
    check_nonnegative,
    check_skin,
    check_smoothness,
    check_whole,
)
from ..common.errors import InputError
from ..mesh.sequence import MeshSequence
from ..model.skinning import Skinning, skinning_in
from ..solver.alternation import vertex_step
from ..solver.initialization import single_bone_errors
from ..solver.model import Constraints, Model
from ..solver.objective import WeightSmoothness, strength_of
from ..solver.trajectories import Array, Trajectories
from ..solver.vertex_newton import optimise_vertices
from .fit import Fit, checked, fit_of


def fit_weights(
    sequence: MeshSequence | Any,
    rest: Skinning | Any,
    transforms: Any = None,
    *,
    influences: int = 4,
    allowed: Any = None,
    prior: Any = None,
    prior_length: float | None = None,
    smoothness: float = 0.0,
    vertex_importance: Any = None,
    frame_importance: Any = None,
    bone_model: BoneModel | None = None,
    iterations: int = 20,
) -> Fit:
    """Fit convex weights of at most K bones to every vertex, under given bones.

    For each vertex it minimises Σ_t |v^t − Σ_j w_j M_j^t p̃|² over w >= 0 with Σ w = 1, where v^t
    is the vertex in frame t of the sequence, p̃ its rest position in homogeneous coordinates, and
    M_j^t the transform of bone j.  An active-set method solves for all bones, then for the K bones
    of largest weight; then, without a prior and smoothness, bones are exchanged while this lowers
    the error.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
    rest : (V, 3) array or Skinning
        Rest pose.  A skinning brings the transforms, too; its weights are not used.
    transforms : (F, B, 3, 4) array, optional
        ``[R | T]`` from the rest pose to each frame of the sequence.
    influences : int
        Most influences per vertex (K).
    allowed : (V, B) or (B,) bool array, optional
        Bones that each vertex, or every vertex, may follow; all by default.
    prior : (V, B) array, sparse array or Skinning, optional
        Weights that the result is to resemble, such as painted ones.  The objective then also has
        F λ² |w − prior|² of each vertex, with λ the `prior_length`.
    prior_length : float, optional
        With `prior`: length in the mesh's units; a difference of 1 from the prior, in one weight,
        costs as much as an error of this length in every frame.
    smoothness : float
        Length in the mesh's units; a difference of 1 in a weight between the ends of an edge costs
        as much as an error of this length at one vertex in every frame.  With 0 there is no such
        cost.
    vertex_importance : (V,) array, optional
        Factors of the squared errors, scaled to a mean of 1; the costs of `prior` and `smoothness`
        are not multiplied by them.
    frame_importance : (F,) array, optional
        Factors of the squared errors, above 0.
    bone_model : {"rigid", "similarity", "affine"}, optional
        Kind of the transforms; by default that of the skinning, or rigid without one.
    iterations : int
        Most sweeps over the mesh if `smoothness` couples the vertices.

    Returns
    -------
    Fit
        Its errors are those of positions alone, without importances.

    Raises
    ------
    InputError
        If an argument is not usable, or a vertex may follow no bone.

    References
    ----------
    Le and Deng 2012, section 3.2: they solve by bounded variable least squares, keep the K largest
    weights and solve again.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> start = ssdr.initialize(dancer, bones=4)
    >>> fit = ssdr.fit_weights(dancer, start.rest, start.transforms, influences=2)
    >>> fit.skinning.weights.shape
    (799, 2)
    """
    given = checked(sequence, rest, bone_model, transforms=transforms)
    sequences, skinning, n = given.sequences, given.skinning, len(given.rest)
    k = check_influences(influences)
    may = _check_allowed(allowed, n, skinning.n_bones)
    target, length = _check_prior(prior, prior_length, n, skinning.n_bones)
    iterations = check_whole(iterations, "iterations", 1)
    smoothness = check_smoothness(smoothness, given.faces)
    importance = check_importance(vertex_importance, "vertex_importance", n)
    frame_importance = check_frame_importance(frame_importance, given.n_frames)
    each, importance, first, row = given.without_copies(importance, given.rest, may, target)
    may = None if may is None else may[first]
    target = None if target is None else target[first]
    data, inner, bones = each.gathered(importance, frame_importance)
    cost = single_bone_errors(data, inner, bones, np.arange(len(inner)))
    if may is not None:
        data = _Barred(**vars(data), allowed=may)
        cost[~may] = np.inf
    model = Model.start(bones, inner, cost.argmin(axis=1), min(k, bones.shape[1]))
    constraints = Constraints(lock_rest=True)
    smooth = WeightSmoothness.build(data, each.faces, smoothness)
    if smooth is None and target is None:
        vertex_step(data, model, constraints=constraints)
        # the K largest are not always the K best: exchange bones wherever that pays
        optimise_vertices(data, model, constraints=constraints)
    else:
        stands_for = np.bincount(row) * (len(inner) / n)  # vertices, relative to the mean
        stiffness = strength_of(data, length) * stands_for / np.maximum(data.importance, 1e-6)
        constant = 0.0 if target is None else stiffness[:, None] * target
        for _ in range(1 if smooth is None else iterations):
            pull, stiff = (0.0, 0.0) if smooth is None else smooth.terms(model)
            pulls = np.ascontiguousarray(pull + constant)
            terms = pulls, stiff + stiffness
            vertex_step(data, model, constraints=constraints, terms=terms)
    padded = model.with_influences(k)
    indices, weights = padded.indices[row], padded.weights[row]
    found = dataclasses.replace(skinning, indices=indices, weights=weights)
    return fit_of(sequences, found)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class _Barred(Trajectories):
    """Trajectories of vertices that may not follow every bone.

    Attributes
    ----------
    allowed : (V, B) bool
    """

    allowed: NDArray[np.bool_]

    def products(self, rows: Any, reduced: Array, length: float) -> Array:
        y = super().products(rows, reduced, length)
        # the gradient of such a weight is infinite, so that no step lets its bone in
        y[:, 0, 3][~self.allowed[rows]] = -np.inf
        return y


def _check_allowed(allowed: Any, n_vertices: int, n_bones: int) -> NDArray[np.bool_] | None:
    """Check `allowed`; return a mask (V, B) of the bones that vertices may follow (None: all)."""
    if allowed is None:
        return None
    wanted = f"a bool mask of shape ({n_vertices}, {n_bones}) or ({n_bones},)"
    mask = as_array(allowed, "allowed", wanted)
    if mask.dtype != bool or mask.shape not in ((n_vertices, n_bones), (n_bones,)):
        raise InputError("allowed", wanted, f"{mask.dtype} {mask.shape}")
    mask = np.broadcast_to(mask, (n_vertices, n_bones))
    none = ~mask.any(axis=1)
    if none.any():
        raise InputError("allowed", "a bone for each vertex", f"none for {int(none.argmax())}")
    return mask


def _check_prior(
    prior: Any, length: Any, n_vertices: int, n_bones: int
) -> tuple[Array | None, float]:
    """Check the prior; return its weights (V, B), or None, and its length."""
    if prior is None:
        if length is not None:
            raise InputError("prior_length", "None without a prior", repr(length))
        return None, 0.0
    value = check_nonnegative(length, "prior_length", "a length >= 0 in the mesh's units")
    model = skinning_in(prior)
    try:
        dense = check_dense(model.dense_weights() if isinstance(model, Skinning) else prior)
        if dense.shape != (n_vertices, n_bones):
            raise InputError("weights", f"shape ({n_vertices}, {n_bones})", f"shape {dense.shape}")
        indices = np.broadcast_to(np.arange(n_bones), dense.shape)
        check_skin(indices, dense, n_vertices, n_bones)
    except InputError as error:
        raise InputError("prior", error.expected, error.got) from error
    return np.asarray(dense, dtype=np.float64), value
