"""A walking rig of three joints, and a skirt that its hips carry."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from helpers.cloth_scenes import tube
from ssdr import MeshSequence, Skinning

FRAMES, FPS = 60, 30.0
NAMES, PARENTS = ("hips", "leg_l", "leg_r"), [-1, 0, 0]
JOINTS = np.array([[0, 1.0, 0], [0.1, 0.9, 0], [-0.1, 0.9, 0]])
CORNERS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
SIDES = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]


def motion(frames=FRAMES, fps=FPS, seed=0):
    """Transforms (F, 3, 3, 4) of hips that turn and walk and legs that swing; first at rest."""
    t = np.arange(frames)[:, None] / fps
    phase = np.random.default_rng(seed).uniform(0, 3, 3)
    angle = 0.8 * (np.sin(3 * t + phase) - np.sin(phase)) * [1, 0.15, 0.15]
    turn = Rotation.from_euler("y", angle[:, [0]]).as_matrix()
    hips = np.concatenate([turn, (JOINTS[0] - turn @ JOINTS[0])[..., None]], axis=-1)
    hips[:, :, 3] += np.sin(2 * t) * [0.5, 0, 0.3]
    out = [hips]
    for k in (1, 2):
        swing = turn @ Rotation.from_euler("x", angle[:, [k]]).as_matrix()
        at = turn @ JOINTS[k] + hips[..., 3]
        out.append(np.concatenate([swing, (at - swing @ JOINTS[k])[..., None]], axis=-1))
    return np.stack(out, axis=1)


def rig(moved=None, **changes):
    """An octahedron around every joint."""
    rest = np.concatenate([j + [0, -0.2, 0] + CORNERS * [0.08, 0.25, 0.08] for j in JOINTS])
    faces = np.concatenate([np.array(SIDES) + 6 * k for k in range(3)])
    fields = {
        "faces": faces,
        "fps": FPS,
        "bone_names": NAMES,
        "parents": PARENTS,
        "joint_positions": JOINTS,
        "name": "body",
    }
    index = np.repeat(np.arange(3), 6)[:, None]
    moved = motion() if moved is None else moved
    return Skinning(rest, index, np.ones((18, 1)), moved, **(fields | changes))


def cloth(moved=None, seed=0):
    """A tube whose upper ring the hips carry and whose lower rings wave."""
    down = np.repeat(np.arange(5), 10)[:, None]
    rest, faces = tube(1 - 0.12 * np.arange(5), 0.15 + 0.03 * np.arange(5))
    m = motion() if moved is None else moved
    t = np.arange(len(m))[:, None, None] / FPS
    turn = np.arctan2(rest[:, 2:], rest[:, :1])
    wave = 0.01 * down * np.sin(5 * t + seed + turn) * [1, 0, 1]
    wave -= wave[:1]
    v = (rest + wave) @ m[:, 0, :, :3].swapaxes(1, 2) + m[:, None, 0, :, 3]
    return MeshSequence(v.astype(np.float32), faces, FPS, name="skirt")
