"""Fit of the rest pose to given weights and bones, usable alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..common.checks import BoneModel
from ..common.errors import check_choice
from ..mesh.sequence import MeshSequence
from ..model.skinning import Skinning
from ..solver.alternation import vertex_step
from ..solver.model import Constraints, Model
from ..solver.objective import Objective
from ..solver.rest_surface import RestPose, RestSurface
from ..solver.trajectories import Trajectories
from ..solver.vertex_elimination import ReducedSystem
from ..solver.vertex_newton import optimise_vertices
from .fit import Fit, checked, fit_of

_STEPS, _GAIN = 40, 1e-6  # most steps, and relative decrease of the objective that ends them


def fit_rest_pose(
    sequence: MeshSequence | Any,
    rest: Skinning | Any,
    indices: Any = None,
    weights: Any = None,
    transforms: Any = None,
    *,
    bone_model: BoneModel | None = None,
    rest_pose: RestPose = "surface",
) -> Fit:
    """Fit the rest position of every vertex of a model by least squares.

    For each vertex it minimises Σ_t |v^t − Σ_j w_j (R_j^t p + T_j^t)|² over the rest position p,
    where v^t is the vertex in frame t of the sequence, w_j its weight for bone j, and R_j^t and
    T_j^t are the matrix and the translation of that bone.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
    rest : (V, 3) array or Skinning
        Rest pose to start from, such as the first frame.  It is kept where the motion does not
        determine positions.  A skinning brings the weights and transforms, too,
        and must have as many frames as the sequence.
    indices, weights : (V, K) int and float arrays, optional
        Skin weights.  Without `indices`, weights are those of all bones, (V, B) and possibly
        sparse.
    transforms : (F, B, 3, 4) array, optional
    bone_model : {"rigid", "similarity", "affine"}, optional
        Kind of the transforms; by default that of the skinning, or rigid without one.
    rest_pose : {"surface", "free"}
        With "surface", edges are to resemble those of `rest`, as in :func:`decompose`; with
        "free", only the error counts.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        If an argument is not usable.

    References
    ----------
    Le and Deng 2012, section 3.4.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> start = ssdr.initialize(dancer, bones=4)
    >>> fit = ssdr.fit_rest_pose(dancer, start)
    >>> fit.skinning.rest.shape
    (799, 3)
    >>> parts = start.indices, start.weights, start.transforms
    >>> alike = ssdr.fit_rest_pose(dancer, start.rest, *parts)
    >>> np.allclose(alike.skinning.rest, fit.skinning.rest)
    True
    """
    parts = {"indices": indices, "weights": weights, "transforms": transforms}
    given = checked(sequence, rest, bone_model, **parts)
    skinning = given.skinning
    check_choice(rest_pose, "rest_pose", RestPose)
    each, importance, _, row = given.without_copies(None, given.indices, given.weights)
    data, inner, bones = each.gathered(importance)
    model = Model.start(bones, inner, each.indices[:, 0], skinning.n_influences)
    model.indices, model.weights = each.indices.copy(), each.weights
    every = np.ones(len(inner), dtype=bool)
    if rest_pose == "surface":
        data = dataclasses.replace(data, faces=each.faces)
        data = dataclasses.replace(data, surface=RestSurface.build(data.faces, inner))
    _solve_rest_pose(data, model, Constraints(weights=every))
    found = data.alignment.points_to_world(model.rest)[row]
    return fit_of(given.sequences, dataclasses.replace(skinning, rest=found))


def _solve_rest_pose(data: Trajectories, model: Model, constraints: Constraints) -> None:
    """Solve the rest pose (in place).

    Without a reference surface, one step solves it.  Otherwise steps of all rest positions together
    follow until the objective settles.
    """
    held = dataclasses.replace(constraints, lock_rest=True)
    vertex_step(data, model, constraints=held)  # sets the errors
    if data.surface is None:
        vertex_step(data, model, constraints=constraints)
        return
    objective, before, still = Objective(constraints), np.inf, None
    for _ in range(_STEPS):
        vertices = optimise_vertices(data, model, constraints=constraints, entering=-1, rounds=0)
        value = objective.value(data, model)
        if not value < (1 - _GAIN) * before:
            return
        before, still = value, np.zeros_like(vertices.stacked)
        system = ReducedSystem(data, model, constraints, vertices, np.float64)
        system.move_vertices(model, still)
