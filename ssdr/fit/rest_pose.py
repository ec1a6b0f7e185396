"""The rest pose of given weights and bones, usable alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import (
    as_sequences,
    check_bone_model,
    check_mask,
    check_rest,
    check_transforms,
    check_weights,
)
from ..errors import InputError
from ..sequence import MeshSequence
from ..skinning import BoneModel
from ..solver.alternation import vertex_step
from ..solver.model import Fixed, Model
from ..solver.trajectories import gather

__all__ = ["RestPoseFit", "fit_rest_pose"]


@dataclasses.dataclass(frozen=True, eq=False)
class RestPoseFit:
    """Rest pose and what it reaches.

    Attributes
    ----------
    rest : (V, 3) float64
    squared_error : (V,) float64
        Σ_t |d|² of each vertex, in squared units of the mesh.
    rmse : float
        sqrt(Σ|d|² / (F V)).

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> start = ssdr.initialize(dancer, bones=4)
    >>> fit = ssdr.fit_rest_pose(
    ...     dancer, indices=start.indices, weights=start.weights, transforms=start.transforms
    ... )
    >>> np.allclose(fit.rmse, np.sqrt(fit.squared_error.sum() / (24 * 799)))
    True
    """

    rest: NDArray[np.float64]
    squared_error: NDArray[np.float64]
    rmse: float


def fit_rest_pose(
    sequence: MeshSequence | Any,
    faces: Any = None,
    *,
    indices: Any,
    weights: Any,
    transforms: Any,
    bone_model: BoneModel = "rigid",
    rest: Any = None,
    locked_vertices: Any = None,
) -> RestPoseFit:
    """Least-squares rest position of every vertex: a 3×3 solve each.

    Minimises Σ_t |v^t − Σ_j w_j (R_j^t p + T_j^t)|² over p.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
    faces : (T, 3) int array, optional
    indices, weights : (V, K) arrays
    transforms : (F, B, 3, 4) array
        Such as `bone_model` allows.
    bone_model : {"rigid", "similarity", "affine"}
    rest : (V, 3) array, optional
        Positions of locked vertices, and what stays where the motion does not
        determine a position; the first frame by default.
    locked_vertices : mask or indices, optional
        Vertices that keep their position in `rest`.

    Returns
    -------
    RestPoseFit

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
    >>> fit = ssdr.fit_rest_pose(
    ...     dancer, indices=start.indices, weights=start.weights, transforms=start.transforms
    ... )
    >>> fit.rest.shape
    (799, 3)
    """
    sequences = as_sequences(sequence, faces)
    n = sequences[0].n_vertices
    indices, weights = check_weights(indices, weights, n)
    world = check_transforms(
        transforms, sum(len(s) for s in sequences), check_bone_model(bone_model)
    )
    if indices.max() >= world.shape[1]:
        raise InputError("indices", f"indices from 0 to {world.shape[1] - 1}", int(indices.max()))
    locked = check_mask(locked_vertices, "locked_vertices", n)
    if locked is not None and rest is None:
        raise InputError("rest", "the positions of the locked vertices", "None")
    outer = check_rest(sequences[0].vertices[0] if rest is None else rest, n)
    data = gather(sequences, bones=world.shape[1])
    inner, bones = data.from_world(outer, world)
    assert bones is not None
    model = Model.start(bones, inner, indices[:, 0], indices.shape[1])
    model.indices, model.weights = indices.copy(), weights.copy()
    keep = np.ones(n, dtype=bool)
    vertex_step(data, model, fixed=Fixed(weights=keep))
    if locked is not None and locked.any():
        free = model.rest
        model.rest = np.where(locked[:, None], inner, free)
        vertex_step(data, model, fixed=Fixed(weights=keep, rest=True))
    out, _ = data.to_world(model.rest, model.transforms)
    if locked is not None:
        out[locked] = outer[locked]
    squared = model.error * data.scale**2
    return RestPoseFit(
        rest=out,
        squared_error=squared,
        rmse=float(np.sqrt(squared.sum() / (data.n_frames * n))),
    )
