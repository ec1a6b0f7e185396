"""A small exact rig for tests of hierarchies: a branched creature and a part of its own."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

import ssdr
from ssdr.hierarchy.transforms import from_local

# parents do not come first, and there are two roots
PARENTS = (2, 0, -1, 0, 2, -1, 4)
NAMES = ("chest", "arm.L", "hip", "arm.R", "leg", "ball", "foot")
POSITIONS = np.array(
    [
        [0, 1.0, 0],
        [0.3, 1.5, 0.1],
        [0, 0, 0],
        [-0.3, 1.5, 0.1],
        [0.1, -0.2, 0],
        [2, 0, 0],
        [0.1, -1, 0.1],
    ]
)
ENDS = np.array(
    [
        [0, 1.6, 0],
        [1, 1.4, 0.3],
        [0, 0.9, 0],
        [-1, 1.4, 0.3],
        [0.1, -0.9, 0.1],
        [2, 0.6, 0],
        [0.1, -1.1, 0.6],
    ]
)


def _rods(sides=6, rings=5):
    """A closed rod from each joint to its end; vertices, triangles, bone of each vertex."""
    rest, faces, bone = [], [], []
    angle = np.arange(sides) * 2 * np.pi / sides
    for b, (a, z) in enumerate(zip(POSITIONS, ENDS, strict=True)):
        along = (z - a) / np.linalg.norm(z - a)
        one = np.cross(along, [0.3, 0.2, 0.9])
        one /= np.linalg.norm(one)
        two = np.cross(along, one)
        start = sum(map(len, rest))
        ring = 0.12 * (np.cos(angle)[:, None] * one + np.sin(angle)[:, None] * two)
        for u in np.linspace(0, 1, rings):
            rest.append(a + u * (z - a) + ring)
        rest.append(np.array([a, z]))
        for i in range(rings - 1):
            for j in range(sides):
                p, q = start + i * sides + j, start + i * sides + (j + 1) % sides
                faces += [[p, p + sides, q], [q, p + sides, q + sides]]
        for j in range(sides):
            p, q, top = start + j, start + (j + 1) % sides, start + (rings - 1) * sides
            low = start + rings * sides
            faces += [[low, p, q], [low + 1, top + (j + 1) % sides, top + j]]
        bone += [b] * (rings * sides + 2)
    return np.concatenate(rest), np.array(faces), np.array(bone)


def creature(*, frames=10, loose=False, scaled=False, clips=None):
    """Rigid joints; `loose` ones slide too, `scaled` bones grow."""
    rest, faces, bone = _rods()
    parents = np.array(PARENTS)
    above = np.where(parents[bone] >= 0, parents[bone], 0)
    near = np.exp(-2 * np.linalg.norm(rest - POSITIONS[bone], axis=1)) * (parents[bone] >= 0)
    weights = np.stack([1 - 0.5 * near, 0.5 * near], axis=1)
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
        rest,
        np.stack([bone, above], axis=1),
        weights,
        from_local(local, parents, POSITIONS),
        faces=faces,
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
