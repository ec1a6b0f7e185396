"""A root joint whose motion is the ground track and the heading of a model."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..clips import unique_names
from ..skinning import Skinning
from .transforms import Array

_NO_HEADING = 1e-9  # of the moment of the rest pose: below it, no heading is determined


def with_root(model: Skinning, *, moving: bool = True) -> Skinning:
    """Copy of a model with one more bone: the root of all others, which moves no vertex itself.

    No bone's transform from the rest pose changes, and so no vertex; `local_transforms()` of the
    former roots are relative to the new one. Bones without a hierarchy become its children, with
    joints at their centroids.

    Parameters
    ----------
    model : Skinning
        Its up axis is that of `model.space`, or y where that is not stated.
    moving : bool
        Whether the root moves by :func:`ground_motion`. If not, it stands still.

    Returns
    -------
    Skinning
        The root is the last bone, named "root", or with a number if there is such a bone. In the
        rest pose its joint lies below the centroid of the mesh, as high as the lowest vertex.
        Every frame is a key.
    """
    count, up = model.n_bones, _up(model)
    motion = ground_motion(model) if moving else np.tile(np.eye(3, 4), (model.n_frames, 1, 1))
    at = model.rest.astype(np.float64).mean(axis=0)
    at[up] = model.rest[:, up].min()
    parents = np.full(count, -1) if model.parents is None else model.parents
    positions = model.centroids() if model.parents is None else model.joint_positions
    transforms = np.concatenate([model.transforms, motion[:, None]], axis=1)
    return dataclasses.replace(
        model,
        transforms=transforms.astype(model.transforms.dtype),
        keyframes=None,  # relative to a root that moves, the others' keys are different ones
        bone_names=unique_names([*model.names(), "root"]),
        parents=np.append(np.where(parents < 0, count, parents), -1),
        joint_positions=np.concatenate([positions, at[None]]),
    )


def ground_motion(model: Skinning) -> Array:
    """Ground track and heading of a model in each frame: (F, 3, 4) transforms [R | T].

    R rotates about the up axis and T is horizontal. They map the rest pose to the vertices of the
    frame with the least sum of squared horizontal distances. Sums over vertices are computed once
    for each bone. If no rotation fits better than another, the previous frame's heading is taken.

    References
    ----------
    Horn, "Closed-form solution of absolute orientation using unit quaternions", JOSA A, 1987,
    section 5: the planar case, in which the rotation is the direction of a complex sum.
    """
    up = _up(model)
    ground = [(up + 1) % 3, (up + 2) % 3]  # right-handed about the up axis
    rest = model.rest.astype(np.float64)
    flat = rest[:, ground] - rest[:, ground].mean(axis=0)
    weights = model.sparse_weights().astype(np.float64)
    points = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
    moments = np.stack([weights.T @ (points * flat[:, [k]]) for k in range(2)], axis=-1)
    means = weights.T @ points / len(rest)
    moved = np.asarray(model.transforms, dtype=np.float64)[:, :, ground]
    crossed = np.einsum("fbij,bjk->fik", moved, moments)
    turn = crossed[:, 0, 0] + crossed[:, 1, 1] + 1j * (crossed[:, 1, 0] - crossed[:, 0, 1])
    turn = _headings(turn, _NO_HEADING * float((flat**2).sum()))
    rotation = np.array([[turn.real, -turn.imag], [turn.imag, turn.real]]).transpose(2, 0, 1)
    motion = np.tile(np.eye(3, 4), (model.n_frames, 1, 1))
    motion[:, np.array(ground)[:, None], ground] = rotation
    motion[:, ground, 3] = np.einsum("fbij,bj->fi", moved, means)
    motion[:, ground, 3] -= rotation @ rest[:, ground].mean(axis=0)
    return motion


def _headings(turn: NDArray[np.complex128], least: float) -> NDArray[np.complex128]:
    """Scale complex numbers to modulus 1.

    One of modulus `least` or less becomes the previous result, or 1 if there is none.
    """
    known = np.abs(turn) > least
    last = np.maximum.accumulate(np.where(known, np.arange(len(turn)), -1))
    unit = np.where(known, turn, 1) / np.where(known, np.abs(turn), 1)
    return np.asarray(np.where(last < 0, 1, unit[last]))


def _up(model: Skinning) -> int:
    """Index of the up axis."""
    return 2 if model.space.up == "z" else 1
