"""Gauss–Newton on the bones, with weights and rest pose projected out.

With Q the squared error and the terms of rest pose and normals, and v the unknowns of the vertices
(weights and rest pose), the bones M are to minimise φ(M), the minimum of Q(M, v) over v; the term
of the joints is added.  In unknowns x that move the bones (see
:mod:`~ssdr.solver.tangents`), a step solves

    [Jᵀ (H_mm − H_mv H_vv⁻¹ H_vm) J + λD] x = −Jᵀ ∇φ

by conjugate gradients.  H is the Gauss–Newton Hessian of Q in the stacked transforms m and in v,
and J = ∂m/∂x is the derivative that `Tangent.image` applies.  λ is the damping, and D is its scale
for each unknown, which the tangent defines.

References
----------
Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least squares problems
whose variables separate", 1973; Ruhe and Wedin, "Algorithms for separable nonlinear least squares
problems", 1980 (the approximation that drops second derivatives).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from ..common.parallel import serial_blas
from .alternation import bone_step
from .conjugate_gradients import Recycled, conjugate_gradients
from .model import FREE, SOLVED, Constraints, Model
from .objective import Objective
from .tangents import AffineTangent, ChainTangent, RigidTangent, SimilarityTangent, Tangent
from .trajectories import Array, Trajectories
from .vertex_elimination import ReducedSystem
from .vertex_newton import optimise_vertices

_DAMPING = 1e-3  # λ of the first step
# Without and with edges that hold the rest pose: the least λ, and the number of steps over which
# the stopping test measures the gain.  With edges a step gains more, and λ has to bound it.
_LEAST_DAMPING, _WINDOW = (1e-8, 1e-4), (8, 6)
_STEPPED = ("transforms", *SOLVED)  # arrays that a step changes
# In every third step, up to three bones may enter the support of a vertex: to try this in every
# step costs more than it brings.
_ENTERING_EVERY, _ENTERING_BONES = 3, 3
# Most steps of bones with joints, and the relative gain of a step below which no further step is
# taken.
_STEPS, _LEAST_GAIN = 12, 1e-3


class GaussNewton:
    """Gauss–Newton steps that each move all bones, weights and the rest pose of a model.

    Parameters
    ----------
    data : Trajectories
    model : Model
        Accepted steps change it in place.  If other code changes it, this object is invalid.
    constraints : Constraints
    damping : float, optional
        λ with which an earlier object for the same model stopped: this one continues exactly from
        there.  If None, the vertices are optimised first.

    Attributes
    ----------
    value : float
        Objective of the model.
    accepted, converged : bool
        Whether the last step was accepted, and whether it ended by the stopping test.
    damping : float
        λ of the next step.
    recycled : Recycled or None
        Conjugate directions of the last step.
    """

    def __init__(
        self,
        data: Trajectories,
        model: Model,
        *,
        constraints: Constraints = FREE,
        damping: float | None = None,
    ) -> None:
        self.data, self.model, self.constraints = data, model, constraints
        self.tangent, self.objective = tangent_of(data, model, constraints), Objective(constraints)
        self.damping = _DAMPING if damping is None else damping
        self.recycled: Recycled | None = None
        self.accepted = self.converged = False
        # with a damping, the vertices are optimised already and need only be factored
        first = {"entering": 3, "rounds": 2} if damping is None else {"entering": -1, "rounds": 0}
        self._vertices = optimise_vertices(data, model, constraints=constraints, **first)
        self._held = self._vertices.strength > 0  # by edges
        self._system: ReducedSystem | None = None
        self.value = self.objective.value(data, model)

    def steps(self, most: int, *, gain: float = 0.0, entering: bool = True) -> Iterator[None]:
        """Make up to `most` steps, and yield after each.

        Parameters
        ----------
        most : int
        gain : float
            The steps end if the last six that were accepted (eight, if no edge holds the rest
            pose) lower the error by less than this fraction of it, or if as many in a row are
            rejected.
        entering : bool
            Whether further bones may become influences of a vertex, in the first step and in every
            third after it.
        """
        values, rejected, window = [self.value], 0, _WINDOW[self._held]
        for k in range(most):
            enter = entering and k % _ENTERING_EVERY == 0
            self.accepted = self.step(entering=_ENTERING_BONES if enter else -1)
            if self.accepted:
                values = [*values, self.value][-window - 1 :]
            rejected = 0 if self.accepted else rejected + 1
            # the objective is a square: its relative change is twice that of the error
            change = 0.5 * (values[0] - values[-1]) / max(values[0], 1e-300)
            settled = len(values) > window and change < gain
            self.converged = settled or rejected == window
            yield
            if self.converged:
                return

    def run(self, count: int, *, entering: bool = True) -> float:
        """Make `count` steps of :meth:`steps`; return the damping of the next step."""
        for _ in self.steps(count, entering=entering):
            pass
        return self.damping

    @serial_blas()
    def step(self, *, entering: int = 0) -> bool:
        """Try one step and return whether it was accepted; the objective never rises.

        Parameters
        ----------
        entering : int
            Number of bones that may enter the influences of each vertex; −1 as in
            :func:`~ssdr.solver.vertex_newton.newton_vertices`.
        """
        data, model, system = self.data, self.model, self._reduced()
        x, predicted = self._solve(system)
        trial = dataclasses.replace(model, **{k: getattr(model, k).copy() for k in _STEPPED})
        system.move_vertices(trial, self.tangent.image(x))
        self.tangent.move(trial, x)
        vertices = optimise_vertices(
            data, trial, constraints=self.constraints, entering=entering, rounds=1
        )
        value = self.objective.value(data, trial)
        if not value <= self.value:
            self.damping = min(self.damping * 8.0, 1e6)
            return False
        ratio = (self.value - value) / predicted if predicted > 0 else 1.0
        if ratio > 0.7:
            self.damping = max(self.damping / 5.0, _LEAST_DAMPING[self._held])
        elif ratio < 0.25:
            self.damping *= 3.0
        for name in (*_STEPPED, "tree"):
            setattr(model, name, getattr(trial, name))
        self._vertices, self._system, self.value = vertices, None, value
        return True

    def _reduced(self) -> ReducedSystem:
        """The normal equations at the model, reused until a step is accepted."""
        if self._system is None:
            self._system = ReducedSystem(
                self.data, self.model, self.constraints, self._vertices, self.tangent.precision
            )
        return self._system

    def _solve(self, system: ReducedSystem) -> tuple[Array, float]:
        """Solve for the damped step x; return it and the predicted decrease of the objective."""
        tangent = self.tangent
        penalty = self.objective.joint_penalty(self.data, self.model, tangent.joints)
        tangent.penalty = penalty
        rhs = -tangent.pullback(system.gradient)
        tangent.joint_part(rhs)[:] -= penalty.stiffness * penalty.offsets
        precondition, damp = tangent.precondition(system.u, self.damping, system.patches)

        def apply(x: Array) -> Array:
            out = tangent.pullback(system.times(tangent.image(x)))
            out += damp(x)
            tangent.joint_part(out)[:] += penalty.stiffness * tangent.joint_part(x)
            return out

        steps = tangent.conjugate_steps
        if system.patches is not None and self._held:
            steps //= 2  # which the second level of the preconditioner allows
        x, residual, self.recycled = conjugate_gradients(
            apply, rhs, precondition, steps=steps, recycled=self.recycled
        )
        # the undamped quadratic falls by 2·rhs·x − xᵀAx, with A x = rhs − residual − λDx
        undamped = rhs - residual - damp(x)
        return x, penalty.factor * float(2.0 * np.vdot(rhs, x) - np.vdot(x, undamped))


def tangent_of(data: Trajectories, model: Model, constraints: Constraints) -> Tangent:
    """The tangent of the bone model, or a :class:`ChainTangent` if the model has a tree."""
    if model.tree is not None:
        return ChainTangent(data, model, constraints)
    kinds: dict[str, type[Tangent]] = {
        "rigid": RigidTangent,
        "similarity": SimilarityTangent,
        "affine": AffineTangent,
    }
    return kinds[constraints.bone_model](data, model)


def fit_motion(
    data: Trajectories,
    model: Model,
    *,
    constraints: Constraints,
    sweeps: int,
    leaps: int = 0,
    length: float = 0.0,
) -> None:
    """Fit the transforms of every frame under the model's weights and rest pose (in place).

    Bones of a tree rotate about their joints, whose rest positions are held, and roots move freely;
    all are fitted to positions alone, not to normals.

    Parameters
    ----------
    sweeps, leaps : int
        As in :func:`~ssdr.solver.alternation.bone_step`, for bones without a tree.  Bones of a
        tree take Gauss–Newton steps instead, as long as these lower the objective enough.
    length : float
        Length of a normal treated as a point, for bones without a tree.
    """
    if model.tree is None:
        bone_step(data, model, sweeps=sweeps, constraints=constraints, leaps=leaps, length=length)
        return
    data = dataclasses.replace(data, normals=None, n2=None)
    every = np.ones(data.n_vertices, dtype=bool)
    as_is = dataclasses.replace(constraints, lock_rest=True, weights=every, lock_joints=True)
    newton = GaussNewton(data, model, constraints=as_is)
    before = newton.value
    for _ in newton.steps(_STEPS, entering=False):
        if newton.accepted and newton.value > (1 - _LEAST_GAIN) * before:
            break
        before = newton.value
