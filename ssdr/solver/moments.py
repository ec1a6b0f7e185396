"""Sums over frames and over vertices that all steps share.

v^t is the position of a vertex in frame t, M^t are the stacked transforms, and p̃ = (p, 1) with p
the rest position.  A normal n is a second point p̃ = (n, 0) of its vertex.  The solve of a vertex
reads the frames only through the sums G = Σ_t M^tᵀ M^t and Y = Σ_t v^tᵀ M^t.  The solve of the
bones reads the vertices only through Σ_i w_j w_k p̃p̃ᵀ and Σ_i w_j v^t p̃ᵀ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..common.parallel import chunk_bounds, run_chunks, serial_blas
from ..kernels.bones import bone_moments
from .model import CHUNK, Model
from .trajectories import Array, Trajectories

# most tasks: each needs memory for its own table of sums, but fewer tasks would use fewer cores
_MOMENT_TASKS = 16
# index of monomial p̃_d p̃_e among x², y², z², xy, xz, yz, x, y, z, 1
_PAIR = np.array([[0, 3, 4, 6], [3, 1, 5, 7], [4, 5, 2, 8], [6, 7, 8, 9]])
# index of entry d, e of a symmetric 4×4 matrix in its upper triangle, row by row
_UPPER = np.array([[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]])


def gram_tables(gram: Array, n_bones: int) -> tuple[Array, Array]:
    """Rearrange the Gram matrix G (4B, 4B) of the stacked transforms into the kernels' two layouts.

    G_jk is the 4×4 block of bones j and k.

    Returns
    -------
    table : (B, 10, B) array
        Coefficients of p̃ᵀ G_jk p̃ as a polynomial in the rest position p, for bones j and k.
    blocks : (B, B, 4, 4) array
        The blocks G_jk.
    """
    g = gram.reshape(4, n_bones, 4, n_bones)
    blocks = np.ascontiguousarray(g.transpose(1, 3, 0, 2))
    table = np.empty((n_bones, 10, n_bones))
    for d in range(4):
        for e in range(d, 4):
            both = g[d, :, e] if d == e else g[d, :, e] + g[e, :, d]
            table[:, _PAIR[d, e]] = both
    return table, blocks


def transform_sums(data: Trajectories, transforms: Array) -> tuple[Array, Array, Array, Array]:
    """Sums over frames that depend on the transforms alone, for solving the vertices.

    Returns
    -------
    stacked : (3F, 4B) array
        :meth:`Trajectories.stack` of the transforms.
    table, blocks : arrays
        As :func:`gram_tables` returns them.
    reduced : (r, 4B) array
        Qᵀ times the stacked transforms.  The product of ``data.z`` and this is Y of all vertices.
    """
    stacked = data.stack(transforms)
    table, blocks = gram_tables(stacked.T @ stacked, transforms.shape[1])
    return stacked, table, blocks, data.reduce(stacked)


def bone_sums(data: Trajectories, model: Model, *, length: float = 0.0) -> tuple[Array, Array]:
    """Sums over vertices for solving the bones, weighted by importance.

    Parameters
    ----------
    data : Trajectories
    model : Model
    length : float
        Length of a normal treated as a point; if 0, normals do not count.

    Returns
    -------
    u : (B, B, 4, 4) array
        Σ_i w_j w_k p̃p̃ᵀ.
    c : (F, 3, 4, B) array
        Σ_i w_j v^t p̃ᵀ of each frame.
    """
    n, n_bones = data.n_vertices, model.n_bones
    bounds = chunk_bounds(n, max(CHUNK, -(-n // _MOMENT_TASKS)))
    r = data.z.shape[1]
    places = np.ascontiguousarray(model.points(1.0).transpose(1, 0, 2))
    parts_of = [(places[0], data.importance, data.z)]
    if length > 0 and data.normals is not None:
        parts_of.append((places[1], length**2 * data.importance, data.normals))

    def work(_: int, i: int, k: int) -> tuple[Array, Array]:
        u = np.zeros((n_bones, n_bones, 10))
        az = np.zeros((4, n_bones, r))
        some = slice(i, k)
        for arrays in parts_of:
            points, importance, z = (a[some] for a in arrays)
            bone_moments(model.indices[some], model.weights[some], points, importance, z, u, az)
        return u, az

    parts = run_chunks(work, bounds)
    u, az = parts[0]
    for more_u, more_az in parts[1:]:
        u += more_u
        az += more_az
    lower = np.tril_indices(n_bones, -1)
    u[lower] = u[lower[1], lower[0]]
    with serial_blas():
        c = data.expand(az)
    return np.ascontiguousarray(u[:, :, _UPPER]), c


def stack_blocks(u: Array) -> Array:
    """Matrix (4B, 4B) of blocks (B, B, 4, 4), in the column order of :func:`stack_transforms`."""
    n = len(u)
    return np.ascontiguousarray(u.transpose(2, 0, 3, 1)).reshape(4 * n, 4 * n)


def coupled_bones(u: Array) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """For each bone, those that share vertices or a penalty with it, as compressed sparse rows.

    Returns
    -------
    start : (B + 1,) int32 array
    neighbour : int32 array
        ``neighbour[start[j] : start[j + 1]]`` are the bones coupled with bone j.
    """
    shared = u[:, :, 3, 3] != 0
    np.fill_diagonal(shared, False)
    start = np.concatenate([[0], np.cumsum(shared.sum(axis=1))]).astype(np.int32)
    return start, np.nonzero(shared)[1].astype(np.int32)
