"""Where the skin of bones that hang on each other meets, and joints that are drawn there.

Motion often hardly tells where a joint is: a leg that swings in a plane leaves its hip anywhere on
a line, and a wrong place costs next to nothing.  What is left open is decided by the skin.
"""

from __future__ import annotations

import numpy as np

from .model import Fixed, Model
from .trajectories import Array, Trajectories

__all__ = ["PULL", "judged", "meeting_points", "spread", "stray", "strays"]

# What joints cost that are away from where the skin of their bones meets, of the objective: mean of
# d² + d⁴ over them, of distances d in the mesh's size (root mean square distance from its
# centroid), so that a place far outside, which turns into a shift what should be a turn, is never
# worth it.  A part of the objective, so that exact data keeps its exact joints.  On horse_gallop
# with 20 bones E is 1.71, 1.94 and 2.21 with d² alone and 0, 1 and 10 times that, and 5, 2 and no
# joints lie outside the body.
PULL = 1.0
_SHARED = 1e-2  # overlap of weights at which half of a place is where they overlap


def meeting_points(model: Model) -> tuple[Array, Array]:
    """Where the skin of each bone and of its parent meets (B, 3), and how far it is apart (B,).

    By the weights that both share; the fewer, the more it is the middle between what they move.
    Of roots, and beside bones that move nothing, joints are where they should be.
    """
    tree = model.tree
    assert tree is not None
    n_bones, weights, indices = model.n_bones, model.weights, model.indices
    # of each influence, the weight of its parent at the same vertex
    parents = tree.parents[indices]
    both = np.where(parents[:, :, None] == indices[:, None, :], weights[:, None, :], 0.0)
    share = weights * both.sum(axis=2)

    def sums(each: Array) -> Array:
        out = np.bincount(indices.ravel(), each.ravel(), minlength=n_bones)
        return np.asarray(out, dtype=np.float64)

    overlap, mass = sums(share), sums(weights**2)
    places = np.stack([sums(share * model.rest[:, None, d]) for d in range(3)], axis=1)
    centres = np.stack([sums(weights**2 * model.rest[:, None, d]) for d in range(3)], axis=1)
    centres /= np.maximum(mass, 1e-300)[:, None]
    up = np.maximum(tree.parents, 0)
    relative = overlap / np.maximum(np.sqrt(mass * mass[up]), 1e-300)
    near = relative / (relative + _SHARED)
    middle = 0.5 * (centres + centres[up])
    shared = places / np.maximum(overlap, 1e-300)[:, None]
    point = np.where((overlap > 0)[:, None], shared, middle)
    point = near[:, None] * point + (1.0 - near)[:, None] * middle
    apart = (1.0 - near) * 0.5 * np.linalg.norm(centres - centres[up], axis=1)
    open_ = (tree.parents < 0) | ~(mass > 0) | ~(mass[up] > 0)
    point[open_], apart[open_] = tree.points[open_], 0.0
    return point, apart


def strays(model: Model) -> tuple[Array, Array]:
    """Joints from where the skin of their bones meets (B, 3), and their squared distances (B,).

    A distance holds how far the skin is apart, too, and is 0 of roots.
    """
    tree = model.tree
    assert tree is not None
    point, apart = meeting_points(model)
    off = tree.points - point
    squared = np.where(tree.parents >= 0, (off**2).sum(axis=1) + apart**2, 0.0)
    return off, squared


def spread(squared: Array) -> float:
    """Mean of d² + d⁴ over joints, from their d²; 0 of none."""
    return float((squared * (1.0 + squared)).mean()) if len(squared) else 0.0


def stray(model: Model) -> float:
    """:func:`spread` of the joints of a model."""
    tree = model.tree
    assert tree is not None
    return spread(strays(model)[1][tree.hung])


def judged(data: Trajectories, model: Model, fixed: Fixed) -> float:
    """The objective, times 1 + :data:`PULL` · :func:`stray` where joints are drawn to the skin."""
    value = model.objective(data)
    if not fixed.near_skin or model.tree is None:
        return value
    return value * (1.0 + PULL * stray(model))
