"""Result of fitting one part of a model, and checks of the arguments."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import check_floats, check_squarable, check_transforms
from ..errors import InputError
from ..frames.error import rmse_of
from ..frames.normals import with_fitted_normals
from ..representation import short_repr
from ..sequence import MeshSequence, as_sequences
from ..skinning import Skinning
from ..solver.trajectories import Array, Trajectories, gather

__all__ = ["Fit", "checked", "fit_of", "gathered"]

Gathered = tuple[Trajectories, Array, Array]


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """A model of which one part was fitted, and its error.

    Attributes
    ----------
    skinning : Skinning
    squared_error : (V,) float64
        Squared distance of each vertex from its place in the sequence, summed over the frames.
    rmse : float
        Square root of the mean squared distance over all vertices and frames.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> fit = ssdr.fit_rest_pose(dancer, ssdr.initialize(dancer, bones=4))
    >>> np.allclose(fit.rmse, np.sqrt(fit.squared_error.sum() / (24 * 799)))
    True
    """

    skinning: Skinning
    squared_error: NDArray[np.float64]
    rmse: float

    __repr__ = short_repr


def checked(sequence: Any, skinning: Any) -> tuple[list[MeshSequence], Array, Array]:
    """Check the arguments; return the shots, and the model's rest pose and weights as float64."""
    sequences = as_sequences(sequence)
    if not isinstance(skinning, Skinning):
        raise InputError("skinning", "a Skinning", type(skinning).__name__)
    n = sequences[0].n_vertices
    if skinning.n_vertices != n:
        raise InputError("skinning", f"{n} vertices, as the sequence has", skinning.n_vertices)
    rest = np.asarray(check_floats(skinning.rest, "skinning.rest", (n, 3), copy=True), np.float64)
    check_squarable(rest, "skinning.rest")
    weights = np.array(skinning.weights, dtype=np.float64)
    return sequences, rest, weights / weights.sum(axis=1, keepdims=True)


def gathered(sequences: list[MeshSequence], skinning: Skinning, rest: Array) -> Gathered:
    """Take the shots, and the model's rest pose and transforms, into the solver's space.

    The model must have as many frames as the shots.
    """
    n_frames = sum(len(s) for s in sequences)
    world = check_transforms(skinning.transforms, n_frames, skinning.bone_model, "skinning.")
    data = gather(sequences, bones=world.shape[1])
    inner = data.points_from_world(rest, "skinning.rest")
    return data, inner, data.moves_from_world(world, "skinning.transforms")


def fit_of(
    sequences: list[MeshSequence], data: Trajectories, error: Array, skinning: Skinning
) -> Fit:
    """Fit of a model, from the squared error (V,) of its vertices in the solver's space."""
    squared = error * data.scale**2
    skinning = with_fitted_normals(sequences, skinning)
    return Fit(skinning=skinning, squared_error=squared, rmse=rmse_of(squared, data.n_frames))
