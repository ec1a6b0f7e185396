"""Base class of the unknowns by which a Gauss–Newton step moves the bones."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from ...parallel import chunk_bounds
from ..conjugate_gradients import Operator
from ..model import Model
from ..objective import JointPenalty
from ..trajectories import Array, Trajectories

_TRANSFORMS = 4096  # fewest transforms of a task: fewer are not worth a thread


class Tangent(ABC):
    """Unknowns x of a step that moves the bones of a model.

    :meth:`image` is the first-order change of the transforms under x, :meth:`move` the step itself.

    Parameters
    ----------
    data : Trajectories
    model : Model
        Methods read the transforms that it has when they are called.

    Attributes
    ----------
    precision : type
        Data type of images and of products with the Schur complement.
    conjugate_steps : int
        Largest number of products with the Schur complement in a step.
    joints : (J,) int array
        Indices of the bones whose joints are unknowns, too.
    penalty : JointPenalty
        Penalty on these joints at the present model.
    """

    precision: type[np.floating[Any]] = np.float64
    conjugate_steps = 12
    joints: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
    penalty: JointPenalty = JointPenalty.none(0)

    def __init__(self, data: Trajectories, model: Model) -> None:
        self.data, self.model = data, model
        frames = max(-(-_TRANSFORMS // model.n_bones), -(-data.n_frames // 16))
        self.chunks = chunk_bounds(data.n_frames, frames)

    @abstractmethod
    def image(self, x: Array) -> Array:
        """First-order change (3F, 4B) of the stacked transforms under x."""

    @abstractmethod
    def pullback(self, gradient: Array) -> Array:
        """Gradient with respect to x, from that (3F, 4B) with respect to the stacked transforms.

        This is the transpose of :meth:`image`.
        """

    @abstractmethod
    def move(self, model: Model, x: Array) -> None:
        """Move the bones of `model`, a copy of this model, by the step x (in place)."""

    @abstractmethod
    def precondition(self, u: Array, damping: float) -> tuple[Operator, Operator]:
        """An approximate inverse of H + λD, and λD, both as operators, with λ = `damping`.

        H is the Gauss–Newton matrix of the unknowns x for fixed weights and rest pose, and D the
        scale of its diagonal.  `u` (B, B, 4, 4) is Σ_i w_j w_k p̃ p̃ᵀ for bones j and k.
        """

    def joint_part(self, x: Array) -> Array:
        """View (J, 3) of the unknowns in x that move joints."""
        return x.reshape(-1)[:0].reshape(0, 3)


def inverse_of(matrix: Array) -> Array:
    """Exactly symmetric inverse of a positive definite matrix, by Cholesky factorisation.

    This takes half the operations of a general inverse.  If rounding has made the matrix
    indefinite, the general inverse is used.
    """
    factor, failed = lapack.dpotrf(matrix, lower=1)
    if not failed:
        inverse, failed = lapack.dpotri(factor, lower=1)
    if failed:
        inverse = np.linalg.inv(matrix)
    lower = np.tril(inverse)
    return np.asarray(lower + np.tril(inverse, -1).T)
