"""Colouring of constraints, and packing into chunks of :data:`LANES` that share no free vertex."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .policy import INDEX, LANES, REAL


class Chunks(NamedTuple):
    """Packed constraints, as the kernels of :mod:`.constraints` read them.

    vertices  flat uint64   3 times the vertices' indices
    numbers   flat float32  inverse masses and further numbers of the constraints
    size      int           number of chunks
    """

    vertices: NDArray[np.uint64]
    numbers: NDArray[np.float32]
    size: int


def colour(constraints: NDArray[np.integer], pinned: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Indices of the constraints of each colour; those of one colour share no free vertex.

    The colouring is greedy.

    Parameters
    ----------
    constraints : (n, k) int array
        Vertices of each constraint.
    pinned : (V,) bool array
        Vertices that no constraint moves.

    Examples
    --------
    >>> chain = np.array([[0, 1], [1, 2], [2, 3]])
    >>> [members.tolist() for members in colour(chain, np.zeros(4, bool))]
    [[0, 2], [1]]
    """
    taken: list[NDArray[np.bool_]] = []
    members: list[list[int]] = []
    for number, vertices in enumerate(constraints):
        free = vertices[~pinned[vertices]]
        place = next((k for k, mask in enumerate(taken) if not mask[free].any()), len(taken))
        if place == len(taken):
            taken.append(np.zeros(len(pinned), bool))
            members.append([])
        taken[place][free] = True
        members[place].append(number)
    return [np.array(m) for m in members]


def pack(
    constraints: NDArray[np.integer],
    weights: NDArray[np.float64],
    numbers: NDArray[np.float64],
    colours: list[NDArray[np.intp]],
) -> Chunks:
    """Pack constraints colour by colour.

    The last chunk of a colour is filled up with copies of the first constraint that have inverse
    masses of 0 and so move nothing.

    Parameters
    ----------
    constraints : (n, k) int array
    weights : (n, k) array
        Inverse masses of the constraints' vertices.
    numbers : (n, m) array
        Further numbers of each constraint.
    colours : list of int arrays
        Result of :func:`colour`.
    """
    vertices, columns = [], []
    for members in colours:
        filled = np.concatenate([members, np.zeros(-len(members) % LANES, np.intp)])
        w = weights[filled]
        w[len(members) :] = 0
        rows = np.concatenate([w, numbers[filled]], axis=1)
        for start in range(0, len(filled), LANES):
            vertices.append(3 * constraints[filled[start : start + LANES]].T.astype(INDEX))
            columns.append(rows[start : start + LANES].T.astype(REAL))
    flat = [np.concatenate([a.ravel() for a in part]) for part in (vertices, columns)]
    return Chunks(flat[0], flat[1], len(vertices))
