"""The choice among rest poses that give the same animation, for bones that stretch."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .model import Locked, Model
from .trajectories import Array, Trajectories

__all__ = ["free_gauge", "normalise_gauge"]


def free_gauge(data: Trajectories, model: Model, locked: Locked) -> None:
    """As :func:`normalise_gauge`, unless a surface decides about the rest pose."""
    if data.surface is None:
        normalise_gauge(model, data.importance, locked)


def normalise_gauge(model: Model, importance: Array, locked: Locked) -> None:
    """Give bones a mean stretch of 1 (in place); no vertex moves in any frame.

    A part of the mesh is a set of bones and their vertices that no other bone moves.  Replacing the
    rest positions p of a part by A p and the 3×3 blocks L of its bones by L A⁻¹ leaves the
    animation as it is.  Here A is the square root of the mean of LᵀL over the bones and frames of
    the part, so that its rest pose has the mean size and proportions of the motion; for similarity
    bones A is only a factor.  A acts about the centroid of the part.
    """
    if locked.bone_model == "rigid" or locked.rest or len(locked.bones):
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
        if locked.bone_model == "similarity":
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
