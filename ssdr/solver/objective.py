"""The objective that the solver minimises, with a penalty on joints away from the skin.

    [1 + mean_j (d_j² + d_j⁴)] · [1 + c S] · [1 + N/ν] · [E + smoothness]

    E = Σ_i u_i Σ_t s_t² |v_i^t − Σ_j w_ij M_j^t p̃_i|²
    N = mean of |n_i^t − Σ_j w_ij R_j^t n_i|², weighted in the same way

with c = 3 and ν = (1°)².

u_i is the importance of vertex i and s_t² the importance of frame t.  S is the strain of the rest
pose (:mod:`~ssdr.solver.rest_surface`); its factor is 1 if the rest pose is free or given.  N is
the error of the normals that engines draw, before these are normalised: rest normals n_i, rotated
by the blended matrices.  Its factor is 1 until a solve includes normals, near its end.  All but the
smoothness are factors, since then a change of one counts as much as the same relative change of
another, whatever the data.  The smoothness (:class:`WeightSmoothness`) is 0 unless requested.  The
first bracket is 1 unless ``rig="rigid"`` has to find the joints; d_j² is the squared distance of
joint j from where the skin of its two bones meets, plus the squared gap there, in the solver's
unit.  Below, E includes the smoothness, and a constant, the slack F V s², if errors of positions
below a length s are to count for nothing: once E is far below it, only the factors fall.

A step does not minimise the product itself: around the present model, each factor 1 + x becomes a
quadratic term of strength E/(1 + x) beside the error.  Every function that gives such a term, and
where the term enters:

    term        function                 vertex step          bone step       polish
    normals     normal_length            a second point       a second point  a second point
    rest pose   rest_pulls               a pull on p_i        -               through the vertices
    smoothness  WeightSmoothness.terms   a pull on w_i        -               ignored
    joints      Objective.joint_penalty  -                    -               bones

The length at which a normal counts as a point is √(E / (F V (ν + N))).

Motion often hardly determines a joint: if a leg swings in a plane, the hip could lie anywhere on a
line, and a wrong place adds almost no error.  There the skin decides.  The penalty is a factor of
the error, so that data without error keep their exact joints.  The term d⁴ keeps joints from going
far outside the body, where a rotation of the bone imitates a translation.  With 0, 1 and 10 times
d² alone, on horse_gallop with 20 bones, E is 1.71, 1.94 and 2.21, and the numbers of joints outside
the body are 5, 2 and 0.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array

from ..common.checks import LARGEST
from .model import FREE, Constraints, Model
from .rest_surface import RestSurface
from .trajectories import Array, Trajectories

# Relative overlap at which the overlap's centroid and the midpoint have equal weight.
_SHARED = 1e-2
_UNSEEN = math.radians(1.0) ** 2  # ν: errors of normals far below a degree are not seen


def strength_of(data: Trajectories, length: float) -> float:
    """Factor with which |w|² = 1 costs as much as a vertex that is off by `length` in every frame.

    `length` is in the input's units.
    """
    # bounded, since the square must not overflow; near the bound the error hardly counts anyway
    return data.n_frames * min(length / data.alignment.scale, LARGEST) ** 2


@dataclasses.dataclass(frozen=True, eq=False)
class WeightSmoothness:
    """The penalty λ Σ_edges |w_i − w_k|², and an upper bound of it that is a sum over vertices.

    The graph Laplacian L satisfies L ⪯ 2D, where D is the diagonal matrix of the vertex degrees
    d_i.  For any weights w⁰, the penalty is therefore at most a constant plus Σ_i [2λ d_i
    |w_i|² − 2λ w_iᵀ (2d_i w_i⁰ − (L w⁰)_i)], with equality at w⁰.  So solving the vertices one by
    one under this bound cannot raise the objective.

    Attributes
    ----------
    adjacency : (V, V) sparse array
        1 for each edge of the mesh.
    degree : (V,) array
    strength : float
        λ.
    importance : (V,) array
        Importance of the vertices, at least 1e-6.
    """

    adjacency: csr_array
    degree: Array
    strength: float
    importance: Array

    @staticmethod
    def build(
        data: Trajectories, faces: NDArray[np.int32], smoothness: float
    ) -> WeightSmoothness | None:
        """The penalty for a mesh and a checked `smoothness`; None if `smoothness` is 0."""
        if smoothness == 0:
            return None
        from ..laplacian.operators import uniform_laplacian  # which most solves need not load

        laplacian = uniform_laplacian(faces, data.n_vertices)
        degree = laplacian.diagonal()
        adjacency = csr_array(diags_array(degree) - laplacian)
        strength = strength_of(data, smoothness)
        return WeightSmoothness(adjacency, degree, strength, np.maximum(data.importance, 1e-6))

    def terms(self, model: Model) -> tuple[Array, Array]:
        """`pull` (V, B) and `stiff` (V,) of the vertex step: the bound at the model's weights."""
        w = model.dense_weights()
        around = np.asarray(self.adjacency @ w)
        scale = self.strength / self.importance
        pull = scale[:, None] * (around + self.degree[:, None] * w)
        return np.ascontiguousarray(pull), 2.0 * scale * self.degree

    def penalty(self, model: Model) -> float:
        """The penalty λ Σ_edges |w_i − w_k|² of a model."""
        w = model.dense_weights()
        around = np.asarray(self.adjacency @ w)
        jumps = float(np.vdot(w, self.degree[:, None] * w - around))
        return self.strength * max(jumps, 0.0)  # rounding may make 0 negative


@dataclasses.dataclass(frozen=True, eq=False)
class Objective:
    """The function of a model that a solve minimises.

    Attributes
    ----------
    constraints : Constraints
        If its `near_skin` is true, joints are penalised.
    smoothness : WeightSmoothness or None
        Penalty on weights that differ along edges of the mesh.
    """

    constraints: Constraints = FREE
    smoothness: WeightSmoothness | None = None

    def value(self, data: Trajectories, model: Model) -> float:
        """The objective of a model, in the solver's units."""
        value = seen_error(data, model)
        if self.smoothness is not None:
            value += self.smoothness.penalty(model)
        if data.surface is not None and not self.constraints.lock_rest:
            value *= data.surface.factor(model.rest)
        value *= 1.0 + mean_normal_error(data, model) / _UNSEEN
        if self.constraints.near_skin and model.tree is not None:
            _, squared = joint_offsets(model)
            value *= 1.0 + mean_joint_penalty(squared[model.tree.non_roots])
        return value

    def joint_penalty(
        self, data: Trajectories, model: Model, joints: NDArray[np.intp]
    ) -> JointPenalty:
        """Quadratic approximation, at `model`, of the penalty on joints.

        `joints` (J,) are the indices of the bones whose joints may move.  Without a penalty, the
        stiffness is 0.
        """
        error = seen_error(data, model)
        factor = dataclasses.replace(self, smoothness=None).value(data, model) / max(error, 1e-300)
        if not self.constraints.near_skin or not len(joints):
            return JointPenalty.none(len(joints), factor)
        hung = model.hierarchy.non_roots
        offsets, squared = joint_offsets(model)
        stiffness = error / (len(hung) * (1.0 + mean_joint_penalty(squared[hung])))
        return JointPenalty(
            factor, stiffness * (1.0 + 2.0 * squared[joints, None]), offsets[joints]
        )


@dataclasses.dataclass(frozen=True, eq=False)
class JointPenalty:
    """Quadratic approximation of the joint penalty around a model.

    If joints move by δ_j, the objective is approximated, up to a constant, by
    factor · (Q + Σ_j stiffness_j |offset_j + δ_j|²), where Q is the squared error with the terms of
    rest pose and normals.  The gradients agree; the curvature of the penalty is made positive and
    isotropic.  The points where the skin of a bone meets that of its parent
    (:func:`meeting_points`) are held constant.

    Attributes
    ----------
    factor : float
    stiffness : (J, 1) array
    offsets : (J, 3) array
        Vectors to the joints from these points.
    """

    factor: float
    stiffness: Array
    offsets: Array

    @staticmethod
    def none(count: int, factor: float = 1.0) -> JointPenalty:
        """A penalty of 0 on `count` joints."""
        return JointPenalty(factor, np.zeros((count, 1)), np.zeros((count, 3)))


def normal_length(data: Trajectories, model: Model, penalty: float = 0.0) -> float:
    """Scale l of normals n: the squared error of points (l n, 0) stands for the factor of normals.

    It is √(E / (F V (ν + N))), and 0 without normals.  E includes `penalty`, what the objective
    adds to the error.
    """
    if data.normals is None or not model.normals.shape[1]:
        return 0.0
    count = data.n_frames * data.n_vertices
    unit = count * (mean_normal_error(data, model) + _UNSEEN)
    return math.sqrt((seen_error(data, model) + penalty) / unit)


def rest_pulls(
    data: Trajectories, model: Model, constraints: Constraints, penalty: float = 0.0
) -> Array:
    """Pulls (V, 4) on the rest positions towards the surface, in the form of ``RestSurface.pulls``.

    They are 0 if the rest pose is free or locked, and for a start, which has no errors yet.
    `penalty` is what the objective adds to the error.
    """
    surface = _surface_of(data, model, constraints)
    if surface is None:
        return np.zeros((len(model.rest), 4))
    error = seen_error(data, model) + penalty
    return surface.pulls(model.rest, error, data.importance)


def rest_strength(data: Trajectories, model: Model, constraints: Constraints) -> float:
    """λ of the edges that :func:`rest_pulls` bounds; 0 where there are no pulls."""
    surface = _surface_of(data, model, constraints)
    return 0.0 if surface is None else surface.strength(model.rest, seen_error(data, model))


def _surface_of(data: Trajectories, model: Model, constraints: Constraints) -> RestSurface | None:
    """Surface that pulls on the rest pose; None if it is free or locked, or has no errors yet."""
    known = np.isfinite(model.error).all()
    return None if constraints.lock_rest or not known else data.surface


def seen_error(data: Trajectories, model: Model) -> float:
    """Squared error of a model plus the slack of its data."""
    return model.weighted_error(data) + data.slack


def mean_normal_error(data: Trajectories, model: Model) -> float:
    """Mean squared error N of the normals; 0 while these are not solved."""
    if data.normals is None or not model.normals.shape[1]:
        return 0.0
    return float(data.importance @ model.normal_error) / (data.n_frames * data.n_vertices)


def mean_joint_penalty(squared: Array) -> float:
    """Mean of d² + d⁴ over joints, given d² of each joint; 0 if there are no joints."""
    return float((squared * (1.0 + squared)).mean()) if len(squared) else 0.0


def joint_offsets(model: Model) -> tuple[Array, Array]:
    """Vectors (B, 3) to each bone's joint from the point where its skin meets its parent's, and d².

    d² (B,) is the squared norm of the vector plus the squared gap of :func:`meeting_points`, which
    is large if the skins of the two bones are apart, and small if their weights overlap much.  At
    roots d² is 0.
    """
    tree = model.hierarchy
    points, gaps = meeting_points(model)
    offsets = tree.points - points
    squared = np.where(tree.parents >= 0, (offsets**2).sum(axis=1) + gaps**2, 0.0)
    return offsets, squared


def meeting_points(model: Model) -> tuple[Array, Array]:
    """Points (B, 3) where the skin of each bone meets its parent's, and gaps (B,) of the skin.

    If the weights of the two bones overlap much, the point is the mean of the vertices, weighted by
    w_child · w_parent, and the gap is 0.  If they do not overlap, the point is the midpoint between
    the centroids of the two bones, and the gap is half the distance of the centroids.  In between,
    point and gap are blended.  For roots, and if one of the two bones moves no vertices, the point
    is the joint and the gap 0.
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
