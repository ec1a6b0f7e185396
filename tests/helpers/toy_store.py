"""A small store of clips whose cloth is a formula: a skirt that lags behind a turning body.

Every height of the skirt follows the root's heading and place as a damped
oscillator, so that the present pose does not determine the shape but its history
does; turning lifts the hem, and pleats deepen with it.  Symmetric in x.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from garmentnet.data.outfit import Outfit
from garmentnet.data.parameters import SimulationParameters
from garmentnet.data.skeleton import Skeleton
from garmentnet.data.store import ClipStore
from ssdr import Skinning
from ssdr.model.rigid import matrix_from_quaternion

FPS = 30.0
BASE = SimulationParameters(bending=0.5, density=0.2, time_scale=1.0)


def _ring(columns):
    angle = 2 * np.pi * np.arange(columns) / columns
    return np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)


def _quads(columns, rings):
    """Corners (n, 4) of the quads between rings: above, the next above, and both below."""
    r, c = (a.ravel() for a in np.indices((rings - 1, columns)))
    a, b = r * columns + c, r * columns + (c + 1) % columns
    return np.stack([a, b, a + columns, b + columns], axis=1)


def skirt(columns=16, rings=7):
    """Rest pose, faces and mirror permutation of an open cone."""
    t = np.linspace(0, 1, rings)[:, None, None]
    rest = (0.16 + 0.22 * t) * _ring(columns) + (1.0 - 0.5 * t) * np.array([0, 1, 0])
    faces = []
    for a, b, c, d in _quads(columns, rings):
        # Diagonals mirrored on the other half, so that the triangles are symmetric too.
        first = a % columns < columns // 2
        faces += [[a, c, b], [b, c, d]] if first else [[a, c, d], [a, d, b]]
    mirror = (np.arange(rings)[:, None] * columns + (-np.arange(columns)) % columns).ravel()
    return (
        rest.reshape(-1, 3).astype(np.float32),
        np.array(faces, np.int32),
        mirror.astype(np.int32),
    )


def body():
    """A closed barrel with two legs' worth of joints."""
    names = ("root", "leg_l", "leg_r")
    skeleton = Skeleton(names, [-1, 0, 0], [[0, 1.0, 0], [0.08, 0.95, 0], [-0.08, 0.95, 0]])
    barrel = np.load(Path(__file__).with_name("barrel.npz"))
    joints = np.tile(np.arange(3), (len(barrel["rest"]), 1))
    still = np.tile(np.eye(3, 4), (1, 3, 1, 1))
    rig = Skinning(**barrel, indices=joints, transforms=still, fps=FPS, bone_names=names)
    return rig, skeleton


def random_pose(rng, skeleton, frames):
    """Joint transforms of unrelated poses."""
    rotations = matrix_from_quaternion(rng.normal(size=(frames, skeleton.n_joints, 4)))
    return skeleton.transforms(rng.normal(size=(frames, 3)), rotations)


def _wander(rng, frames, scale, low=0.15, high=0.9):
    """A smooth random curve that starts at rest at 0."""
    time = np.arange(frames) / FPS
    curve = sum(
        rng.normal() * np.sin(2 * np.pi * rng.uniform(low, high) * time + rng.uniform(0, 6.28))
        for _ in range(3)
    )
    begin = np.clip(time / 0.6, 0, 1) ** 2 * (3 - 2 * np.clip(time / 0.6, 0, 1))
    return scale * begin * (curve - curve[0])


def motion(rng, frames, skeleton):
    """Joint transforms, heading and place."""
    heading = _wander(rng, frames, 0.7)
    place = np.stack([_wander(rng, frames, 0.12), np.zeros(frames), _wander(rng, frames, 0.12)], 1)
    root = Rotation.from_euler(
        "yxz", np.stack([heading, _wander(rng, frames, 0.06), _wander(rng, frames, 0.06)], 1)
    ).as_matrix()
    rotations = np.tile(np.eye(3), (frames, 3, 1, 1))
    rotations[:, 0] = root
    for j in (1, 2):
        rotations[:, j] = Rotation.from_rotvec(
            np.stack([_wander(rng, frames, 0.25), np.zeros(frames), np.zeros(frames)], 1)
        ).as_matrix()
    place = place + skeleton.rest[0]
    return skeleton.transforms(place, rotations), heading, place


def _follow(target, omega, damping):
    """A damped oscillator that chases a curve."""
    x, v, out = target[0].copy() if np.ndim(target[0]) else target[0], 0.0, []
    for now in target:
        for _ in range(8):
            v = v + (omega**2 * (now - x) - 2 * damping * omega * v) / (8 * FPS)
            x = x + v / (8 * FPS)
        out.append(x)
    return np.array(out)


def drape(rest, joints, heading, place, parameters):
    """The skirt: a function of the whole history."""
    omega = 9.0 * parameters.time_scale * (parameters.bending / 0.5) ** 0.2
    lag = _follow(heading, omega, 0.35) - heading
    swing = _follow(place, omega, 0.35) - place
    speed = np.gradient(heading) * FPS
    lift = _follow(speed**2, omega, 0.6)
    t = np.clip((1.0 - rest[:, 1]) / 0.5, 0, 1).astype(np.float64)
    angle = np.arctan2(rest[:, 0], rest[:, 2])
    out = np.empty((len(joints), *rest.shape))
    for f, m in enumerate(joints):
        turn = lag[f] * t**1.5
        flare = 1 + t * min(0.04 * lift[f], 0.6)
        pleat = 1 + 0.05 * t * np.cos(8 * angle) * (1 + 0.3 * np.tanh(speed[f]) ** 2)
        radius = np.hypot(rest[:, 0], rest[:, 2]) * flare * pleat
        local = np.stack(
            [
                radius * np.sin(angle + turn),
                rest[:, 1] + 0.25 * (flare - 1) * t,
                radius * np.cos(angle + turn),
            ],
            1,
        )
        out[f] = local @ m[0, :, :3].T + m[0, :, 3] + t[:, None] ** 2 * swing[f]
    return out.astype(np.float32)


def make_store(path, *, frames=90, train=8, others=(), seed=0) -> ClipStore:
    """Clips with base parameters, and shorter ones under `others`: (parameters, role)."""
    rest, faces, mirror = skirt()
    rig, skeleton = body()
    outfit = Outfit(rest, faces, rig, skeleton, FPS, mirror_vertices=mirror)
    store = ClipStore.create(path, outfit)
    rng = np.random.default_rng(seed)

    def add(name, split, motion_name, parameters, moved, role="train", **more):
        joints, heading, place = moved
        store.add(
            name,
            vertices=drape(rest, joints[:, :1], heading, place, parameters)
            + more.pop("noise", np.float32(0)),
            joints=joints,
            classes=np.arange(len(joints)) // 20 % 4,
            split=split,
            motion=motion_name,
            parameters=parameters,
            seed=seed,
            quality={"accepted": True},
            provenance={"parameter_split": role} | more.pop("provenance", {}),
            **more,
        )

    plan = [("train", train), ("validation", 2), ("test", 2)]
    moves = {}
    for split, count in plan:
        for k in range(count):
            name = f"{split}-{k}"
            moves[name] = motion(rng, frames, skeleton)
            add(f"base-{name}", split, name, BASE, moves[name])
    for n, (parameters, role) in enumerate(others):
        # Validation clips are of the base only.
        for split in ("train", "test"):
            add(f"set{n}-{split}-0", split, f"{split}-0", parameters, moves[f"{split}-0"], role)
    shake = 1e-3 * rng.normal(size=(frames, len(rest), 3)).astype(np.float32)
    add(
        "base-test-0-again",
        "test",
        "test-0",
        BASE,
        moves["test-0"],
        noise=shake,
        perturbation=1e-3,
        provenance={"repeat_of": "base-test-0"},
    )
    return store
