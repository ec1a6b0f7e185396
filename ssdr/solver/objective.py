"""The objective that the solver minimises, and its penalty on joints away from the skin.

    [1 + mean_j (d_j² + d_j⁴)] · Σ_i u_i Σ_t s_t² |v_i^t − Σ_j w_ij M_j^t p̃_i|²  +  smoothness

u_i is the importance of a vertex and s_t² that of a frame.  The bracket is 1 unless a tree with
rigid joints was asked for; d_j is the distance of joint j from where the skin of its two bones
meets.  The last term is that of :mod:`~ssdr.solver.smoothness`, 0 unless asked for.

Motion often hardly says where a joint is: of a leg that swings in a plane, the hip may lie
anywhere on a line, and a wrong place costs next to nothing.  The skin decides what motion leaves
open.  The penalty is a factor, so that joints of exact data stay exact; d⁴ keeps joints out of
places far outside, where a rotation does what a translation should.  On horse_gallop with 20 bones
E is 1.71, 1.94 and 2.21 with 0, 1 and 10 times d² alone, and 5, 2 and no joints lie outside the
body.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from .model import FREE, Locked, Model
from .smoothness import WeightSmoothness
from .trajectories import Array, Trajectories

__all__ = ["JointPenalty", "Objective", "joint_offsets", "mean_joint_penalty", "meeting_points"]

_SHARED = 1e-2  # relative overlap at which the overlap's centroid and the middle have equal weight


@dataclasses.dataclass(frozen=True, eq=False)
class Objective:
    """The function of a model that a solve minimises.

    Attributes
    ----------
    locked : Locked
        Joints are penalised where it says `near_skin`.
    smoothness : WeightSmoothness or None
        Penalty on weights that differ along edges of the mesh.
    """

    locked: Locked = FREE
    smoothness: WeightSmoothness | None = None

    def value(self, data: Trajectories, model: Model) -> float:
        """The objective of a model, in the solver's units."""
        value = model.weighted_error(data)
        if self.locked.near_skin and model.tree is not None:
            _, squared = joint_offsets(model)
            value *= 1.0 + mean_joint_penalty(squared[model.tree.non_roots])
        if self.smoothness is not None:
            value += self.smoothness.penalty(model)
        return value

    def joint_penalty(
        self, data: Trajectories, model: Model, joints: NDArray[np.intp]
    ) -> JointPenalty:
        """Quadratic model of the penalty on the joints of some bones."""
        if not self.locked.near_skin or not len(joints):
            return JointPenalty.none(len(joints))
        hung = model.hierarchy.non_roots
        offsets, squared = joint_offsets(model)
        factor = 1.0 + mean_joint_penalty(squared[hung])
        stiffness = model.weighted_error(data) / (len(hung) * factor)
        return JointPenalty(
            factor, stiffness * (1.0 + 2.0 * squared[joints, None]), offsets[joints]
        )


@dataclasses.dataclass(frozen=True, eq=False)
class JointPenalty:
    """Quadratic model of the joint penalty at a model.

    With joints moved by δ the objective is, beside constants and to second order, `factor` times
    (squared error + Σ_j stiffness_j |offset_j + δ_j|²).  Meeting points are taken to stay.

    Attributes
    ----------
    factor : float
    stiffness : (J, 1) array
    offsets : (J, 3) array
    """

    factor: float
    stiffness: Array
    offsets: Array

    @staticmethod
    def none(count: int) -> JointPenalty:
        """No penalty on `count` joints."""
        return JointPenalty(1.0, np.zeros((count, 1)), np.zeros((count, 3)))


def mean_joint_penalty(squared: Array) -> float:
    """Mean of d² + d⁴ over joints, from their d²; 0 without joints."""
    return float((squared * (1.0 + squared)).mean()) if len(squared) else 0.0


def joint_offsets(model: Model) -> tuple[Array, Array]:
    """Vectors (B, 3) to joints from where the skin of their bones meets, and d² (B,).

    d² is the squared length, plus the squared distance of the skin of both bones from the meeting
    point where it does not touch.  It is 0 at roots.
    """
    tree = model.hierarchy
    points, gaps = meeting_points(model)
    offsets = tree.points - points
    squared = np.where(tree.parents >= 0, (offsets**2).sum(axis=1) + gaps**2, 0.0)
    return offsets, squared


def meeting_points(model: Model) -> tuple[Array, Array]:
    """Points (B, 3) where the skin of each bone and of its parent meets, and its gaps (B,).

    The point is the mean of the vertices weighted by w_child · w_parent.  The less the weights
    overlap, the more it is the middle between the centroids of both bones, and the gap is half
    their distance.  At roots and beside bones that move nothing it is the joint, with gap 0.
    """
    tree = model.hierarchy
    n_bones, weights, indices = model.n_bones, model.weights, model.indices
    # weight of each influence's parent at the same vertex
    parents = tree.parents[indices]
    both = np.where(parents[:, :, None] == indices[:, None, :], weights[:, None, :], 0.0)
    product = weights * both.sum(axis=2)

    def sums(each: Array) -> Array:
        out = np.bincount(indices.ravel(), each.ravel(), minlength=n_bones)
        return np.asarray(out, dtype=np.float64)

    overlap, mass = sums(product), model.bone_masses()
    shared = np.stack([sums(product * model.rest[:, None, d]) for d in range(3)], axis=1)
    shared /= np.maximum(overlap, 1e-300)[:, None]
    centres = np.stack([sums(weights**2 * model.rest[:, None, d]) for d in range(3)], axis=1)
    centres /= np.maximum(mass, 1e-300)[:, None]
    up = np.maximum(tree.parents, 0)
    relative = overlap / np.maximum(np.sqrt(mass * mass[up]), 1e-300)
    near = relative / (relative + _SHARED)
    middle = 0.5 * (centres + centres[up])
    points = np.where((overlap > 0)[:, None], shared, middle)
    points = near[:, None] * points + (1.0 - near)[:, None] * middle
    gaps = (1.0 - near) * 0.5 * np.linalg.norm(centres - centres[up], axis=1)
    unknown = (tree.parents < 0) | ~(mass > 0) | ~(mass[up] > 0)
    points[unknown], gaps[unknown] = tree.points[unknown], 0.0
    return points, gaps
