"""A small exact rig for tests of hierarchies: a branched creature and a part of its own."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import ssdr
from ssdr.model.transforms import from_local

# parents do not come first, and there are two roots
PARENTS = (2, 0, -1, 0, 2, -1, 4)
NAMES = ("chest", "arm.L", "hip", "arm.R", "leg", "ball", "foot")
# rods of a branched body, one from each joint to its end: rest, faces, indices, weights
_RODS = np.load(Path(__file__).with_name("creature.npz"))
POSITIONS, ENDS = _RODS["positions"], _RODS["ends"]


def creature(*, frames=10, loose=False, scaled=False, clips=None):
    """Rigid joints; `loose` ones slide too, `scaled` bones grow."""
    parents = np.array(PARENTS)
    phase, b = (np.arange(frames) / max(1, frames - 1))[:, None], np.arange(len(PARENTS))
    local = np.zeros((frames, len(b), 3, 4))
    axes = np.stack([0 * b + 1, 0.4 * b - 1, 0 * b + 0.5], axis=1)
    turns = 0.6 * np.sin(2 * np.pi * phase + b)[..., None] * axes
    local[..., :3] = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(*turns.shape, 3)
    local[..., 3] = POSITIONS - np.where(parents[:, None] >= 0, POSITIONS[parents], 0)
    if loose:
        parts = np.sin(3 * phase + b), np.cos(b), phase
        local[..., 3] += 0.05 * np.stack(np.broadcast_arrays(*parts), axis=-1)
    if scaled:
        local[..., :3] *= (1 + 0.1 * np.sin(4 * phase + b))[..., None, None]
    local[:, 2, :, 3] += np.stack([0.5 * phase, 0.1 * np.sin(6 * phase), 0 * phase], axis=-1)[:, 0]
    local[:, 5, :, 3] += np.stack([0 * phase, 0.3 * phase, 0 * phase + 0.2], axis=-1)[:, 0]
    return ssdr.Skinning(
        _RODS["rest"],
        _RODS["indices"],
        _RODS["weights"],
        from_local(local, parents, POSITIONS),
        faces=_RODS["faces"],
        fps=24.0,
        bone_model="similarity" if scaled else "rigid",
        bone_names=NAMES,
        name="creature",
        clips=clips,
        parents=parents,
        joint_positions=POSITIONS,
    )


def stretched(model, seed=0):
    """A model whose bones stretch along axes that turn slowly."""
    rng = np.random.default_rng(seed)
    axes = Rotation.from_rotvec(rng.normal(size=(model.n_bones, 3)))
    matrices = np.empty((model.n_frames, model.n_bones, 3, 3))
    for t in range(model.n_frames):
        slow = Rotation.from_rotvec(0.02 * t * np.ones((model.n_bones, 3)))
        v = (slow * axes).as_matrix()
        size = 1 + 0.3 * np.sin(0.2 * t + np.arange(3))
        matrices[t] = (v * size) @ v.swapaxes(1, 2)
    moves = model.transforms.copy()
    centers = model.centroids() if model.parents is None else model.joint_positions
    local = np.einsum("fbij,bj->fbi", moves[..., :3], centers) + moves[..., 3]
    moves[..., :3] = moves[..., :3] @ matrices
    moves[..., 3] = local - np.einsum("fbij,bj->fbi", moves[..., :3], centers)
    return dataclasses.replace(model, transforms=moves, bone_model="affine")


def flat(model):
    """The same bones without the hierarchy."""
    return dataclasses.replace(model, parents=None, joint_positions=None)


def tree_of(model):
    """The parent's name of each bone, by name."""
    names = model.names()
    return {
        name: names[above] if above >= 0 else None
        for name, above in zip(names, model.parents.tolist(), strict=True)
    }


def differences(model, other):
    """Largest differences of two models of one tree: joints, transforms, local ones, vertices.

    Lengths are over the diagonal of the rest pose; bones are matched by name.
    """
    order = [other.names().index(name) for name in model.names()]
    diagonal = float(np.linalg.norm(np.ptp(model.rest, axis=0)))

    def apart(a, b):
        turned = np.abs(a[..., :3] - b[..., :3]).max()
        return max(float(turned), float(np.abs(a[..., 3] - b[..., 3]).max()) / diagonal)

    return {
        "joints": float(np.abs(model.joint_positions - other.joint_positions[order]).max())
        / diagonal,
        "transforms": apart(model.transforms, other.transforms[:, order]),
        "local": apart(model.local_transforms(), other.local_transforms()[:, order]),
        "vertices": float(np.abs(model.skin(dtype=float) - other.skin(dtype=float)).max())
        / diagonal,
    }
