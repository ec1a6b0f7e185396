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
    n = len(PARENTS)
    local = np.zeros((frames, n, 3, 4))
    for t in range(frames):
        phase = t / max(1, frames - 1)
        for b in range(n):
            turn = 0.6 * np.sin(2 * np.pi * phase + b) * np.array([1, 0.4 * b - 1, 0.5])
            local[t, b, :, :3] = Rotation.from_rotvec(turn).as_matrix()
            up = parents[b]
            local[t, b, :, 3] = POSITIONS[b] - (POSITIONS[up] if up >= 0 else 0)
            if loose:
                local[t, b, :, 3] += 0.05 * np.array([np.sin(3 * phase + b), np.cos(b), phase])
            if scaled:
                local[t, b, :, :3] *= 1 + 0.1 * np.sin(4 * phase + b)
        local[t, 2, :, 3] += [0.5 * phase, 0.1 * np.sin(6 * phase), 0]
        local[t, 5, :, 3] += [0, 0.3 * phase, 0.2]
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
