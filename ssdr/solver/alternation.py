"""The alternation of Le and Deng 2012: solve the bones, then weights and rest pose, in turns."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..common.parallel import chunk_bounds, run_chunks, serial_blas
from ..kernels.bones import sweep_bones
from ..kernels.removal import removal_cost
from ..kernels.vertices import solve_vertices
from .affine_fit import leap_rigid, solve_affine
from .model import CHUNK, FREE, Constraints, Model
from .moments import bone_sums, coupled_bones, transform_sums
from .objective import WeightSmoothness, normal_length, rest_pulls
from .trajectories import Array, Trajectories


def repeat_alternation(
    data: Trajectories,
    model: Model,
    count: int,
    constraints: Constraints,
    smoothness: WeightSmoothness | None = None,
) -> None:
    """Take `count` alternations of bones, weights and rest pose (in place).

    The objective never increases, except when a vertex's influences are reduced to K: that keeps
    the largest weights, even if other bones would fit better (Le and Deng 2012, section 3).
    """
    penalty, terms = 0.0, None
    for _ in range(count):
        if smoothness is not None:
            penalty, terms = smoothness.penalty(model), smoothness.terms(model)
        bone_step(data, model, constraints=constraints, length=normal_length(data, model, penalty))
        vertex_step(data, model, constraints=constraints, terms=terms, penalty=penalty)


def vertex_step(
    data: Trajectories,
    model: Model,
    *,
    constraints: Constraints = FREE,
    terms: tuple[Array, Array] | None = None,
    penalty: float = 0.0,
) -> None:
    """Solve the weights, then the rest position of every vertex, and set its error (in place).

    Parameters
    ----------
    data : Trajectories
    model : Model
    constraints : Constraints
    terms : ((V, B), (V,)) arrays, optional
        Coefficients `pull` and `stiff` of a penalty stiff_i |w_i|² − 2 pull_i · w_i on the weights
        w_i of vertex i.
    penalty : float
        Penalty that the objective adds to the error of the model.
    """
    keep = constraints.vertex_mask(data.n_vertices)
    with serial_blas():
        length = normal_length(data, model, penalty)
        hold = rest_pulls(data, model, constraints, penalty)
        _, gram, _, reduced = transform_sums(data, model.transforms)
        pairs = np.ascontiguousarray(gram.transpose(0, 2, 1))
        pull, stiff = terms or (np.zeros((0, 0)), np.zeros(0))

        def work(_: int, i: int, k: int) -> None:
            sums = data.products(slice(i, k), reduced, length), data.squares(slice(i, k), length)
            rows = pull[i:k], stiff[i:k], *model.vertex_rows(i, k), hold[i:k]
            arrays: Any = *sums, gram, pairs, *rows, length, keep[i:k], not constraints.lock_rest
            solve_vertices(*arrays)

        run_chunks(work, chunk_bounds(data.n_vertices, CHUNK))
    # a difference of large numbers, which rounding may have made negative
    for error in (model.error, model.normal_error):
        np.maximum(error, 0.0, out=error)


def bone_step(
    data: Trajectories,
    model: Model,
    *,
    sweeps: int = 3,
    constraints: Constraints = FREE,
    leaps: int = 0,
    length: float | None = None,
) -> None:
    """Fit the transforms of every frame under the weights and rest pose (in place).

    Rigid and similarity bones take Gauss–Seidel sweeps; affine ones take one linear solve.

    Parameters
    ----------
    data : Trajectories
    model : Model
    sweeps : int
        Passes over the bones of each frame.
    constraints : Constraints
    leaps : int
        Number of rounds in which rigid bones, which may be far from their optimum, first take a
        :func:`~ssdr.solver.affine_fit.leap_rigid` and then the sweeps.  If 0, there are sweeps
        without a leap.
    length : float, optional
        Length of a normal treated as a point; by default that of the objective.
    """
    length = normal_length(data, model) if length is None else length
    u, c = bone_sums(data, model, length=length)
    if constraints.bone_model == "affine":
        solve_affine(model.transforms, u, c)
        return
    scaled = constraints.bone_model == "similarity"
    for k in range(max(1, leaps)):
        if k < leaps and not scaled:
            leap_rigid(model.transforms, u, c)
        sweep(model.transforms, u, c, sweeps=sweeps, scaled=scaled)


def sweep(transforms: Array, u: Array, c: Array, *, sweeps: int, scaled: bool = False) -> None:
    """Fit each bone given the others, one after the other, in every frame (Gauss–Seidel, in place).

    Parameters
    ----------
    transforms : (F, B, 3, 4) array
    u, c : arrays
        As :func:`~ssdr.solver.moments.bone_sums` returns them.  Quadratic penalties on pairs of
        bones may have been added to `u`.
    sweeps : int
        Passes over the bones of each frame.
    scaled : bool
        Whether bones may also change their size (similarity).
    """
    start, neighbour = coupled_bones(u)

    def work(_: int, i: int, k: int) -> None:
        sweep_bones(transforms[i:k], c[i:k], u, start, neighbour, scaled, sweeps)

    run_chunks(work, chunk_bounds(len(transforms), max(1, -(-len(transforms) // 16))))


def bone_costs(data: Trajectories, model: Model) -> Array:
    """Rise (B,) of the squared error by the removal of each bone alone, with weights re-solved."""
    n_bones = model.n_bones
    with serial_blas():
        _, gram, _, reduced = transform_sums(data, model.transforms)

        def work(_: int, i: int, k: int) -> Array:
            cost = np.zeros(n_bones)
            y = (data.z[i:k] @ reduced).reshape(k - i, 1, 4, n_bones)
            arrays: Any = y, gram, *model.vertex_rows(i, k)[:4], data.importance[i:k], cost
            removal_cost(*arrays)
            return cost

        parts = run_chunks(work, chunk_bounds(data.n_vertices, CHUNK))
    return np.asarray(np.sum(parts, axis=0))


def free_gauge(data: Trajectories, model: Model, constraints: Constraints) -> None:
    """Apply :func:`normalise_gauge` (in place), unless a surface holds the rest pose."""
    if data.surface is None:
        normalise_gauge(model, data.importance, constraints)


def normalise_gauge(model: Model, importance: Array, constraints: Constraints) -> None:
    """Give bones a mean stretch of 1 (in place); no vertex moves in any frame.

    A part of the mesh is a set of bones and their vertices that no other bone moves.  Replacing the
    rest positions p of a part by A p and the 3×3 blocks L of its bones by L A⁻¹ leaves the
    animation as it is.  Here A is the square root of the mean of LᵀL over the bones and frames of
    the part, so that its rest pose has the mean size and proportions of the motion; for similarity
    bones A is only a factor.  A acts about the centroid of the part.
    """
    if constraints.bone_model == "rigid" or constraints.lock_rest:
        return
    n_bones = model.n_bones
    used = model.weights > 0
    first = np.broadcast_to(model.indices[:, :1], used.shape)[used]
    links = coo_array((np.ones(len(first)), (first, model.indices[used])), shape=(n_bones, n_bones))
    count, part = connected_components(links, directed=False)
    share = importance[:, None] * model.weights
    mass = np.bincount(model.indices.ravel(), weights=share.ravel(), minlength=n_bones)
    linear, shift = model.transforms[..., :3], model.transforms[..., 3]
    stretch = np.einsum("tjca,tjcb->jab", linear, linear) / len(linear)
    for k in range(count):
        bones, mine = part == k, part[model.indices[:, 0]] == k
        if not mass[bones].sum() > 0:
            continue
        mean = np.einsum("j,jab->ab", mass[bones] / mass[bones].sum(), stretch[bones])
        if constraints.bone_model == "similarity":
            mean = np.eye(3) * np.trace(mean) / 3
        values, vectors = np.linalg.eigh(mean)
        root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))
        shape, back = (vectors * root) @ vectors.T, (vectors / root) @ vectors.T
        centre = model.rest[mine].mean(axis=0)
        old = linear[:, bones]
        new = old @ back
        shift[:, bones] += (old - new) @ centre
        linear[:, bones] = new
        model.rest[mine] = (model.rest[mine] - centre) @ shape.T + centre
