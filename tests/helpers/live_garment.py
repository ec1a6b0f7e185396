"""Networks with random weights and a made garment, and motions at any frame rate."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from garmentnet.configs.config import load_config
from garmentnet.data.parameters import SimulationParameters
from garmentnet.data.skeleton import Skeleton
from garmentnet.data.skin_weights import BodyBound
from garmentnet.data.subject import Subject
from garmentnet.networks.checkpoint import Checkpoint, save_checkpoint
from garmentnet.networks.features import Normaliser, PoseFeatures
from garmentnet.networks.network import MotionNetwork
from helpers.cloth_scenes import rigid
from ssdr import Skinning

FPS = 30.0
# What networks can differ in, for all that run them without torch.
CHANGES = (
    {},
    {"bound": False, "condition": True},
    {"detail": False, "features": {"frame": "world", "translation": True}},
    {"high": {"source": "body"}, "condition": True, "features": {"joints": ("shin_l",)}},
    {"features": {"joint_motion": False}},  # as of the dress that ships
    {"features": {"heading_free": False, "frame": "root", "root_motion": False}},
    {"features": {"frame": "world", "joints": ("shin_l", "spine"), "clamp": 0.0}},
    {"features": {"rotation": "vector", "translation": True, "velocities": False}},
    {"low": {"relative_to": "joints"}},
)


def skeleton():
    names = ("pelvis", "spine", "thigh_l", "shin_l", "thigh_r", "shin_r")
    heads = [[0, 1, 0], [0, 1.2, 0], [0.1, 1, 0], [0.1, 0.5, 0], [-0.1, 1, 0], [-0.1, 0.5, 0]]
    return Skeleton(names, [-1, 0, 0, 2, 0, 4], heads)


def _curves(rng, time, count, size):
    phase, rate = rng.uniform(0, 6, (3, count)), rng.uniform(0.6, 5, (3, count))
    height = rng.normal(size=(3, count))
    return size * (height * np.sin(rate * time[:, None, None] + phase)).sum(axis=1)


def motion(seconds, seed=0, fps=FPS):
    """Joints (F, J, 3, 4); the same motion at every frame rate."""
    rng, body = np.random.default_rng(seed), skeleton()
    time = np.arange(round(seconds * fps)) / fps
    turns = _curves(rng, time, 3 * body.n_joints, 0.2).reshape(len(time), -1, 3)
    turns[:, 0] += _curves(rng, time, 1, 1.5) * [0, 1, 0]
    rotations = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix()
    root = body.rest[0] + _curves(rng, time, 3, 0.3)
    return body.transforms(root, rotations.reshape(*turns.shape[:2], 3, 3))


def figure(body):
    """A body of a vertex at every joint."""
    rig = rigid(body.rest, [[0, 1, 2]], range(body.n_joints), body.n_joints)
    return dataclasses.replace(rig, bone_names=body.names)


def network(*, vertices=150, bones=9, bound=True, condition=False, detail=True, seed=0, **change):
    """A network of the rooted configuration; `change` names sections and what differs there."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(7)  # pivots have one garment
    body, angle, t = skeleton(), rng.uniform(0, 6.28, vertices), rng.random(vertices)
    near = np.lexsort((angle, (20 * t).astype(int)))  # triangles of neighbours
    angle, t = angle[near], t[near]
    radius = 0.15 + 0.3 * t
    p = np.stack([radius * np.sin(angle), 1.05 - 0.9 * t, radius * np.cos(angle)], axis=1)
    gap = ((p[:, None] - p[rng.choice(vertices, bones, False)]) ** 2).sum(-1)
    nearest = np.argsort(gap, axis=1)[:, :8]
    w = np.exp(-np.take_along_axis(gap, nearest, 1) / 0.01) + 1e-6
    faces = np.arange(3 * (vertices // 3)).reshape(-1, 3)
    still = np.tile(np.eye(3, 4), (1, bones, 1, 1))
    garment = Skinning(p, nearest, w / w.sum(1, keepdims=True), still, faces=faces)
    rig = figure(body)
    top = np.sort(np.argsort(-p[:, 1])[: vertices // 8]).astype(np.int32)
    each = (len(top), 1)
    held = BodyBound(
        top, p[top], 1.01 * p[top], np.tile([[0, 1]], each), np.tile([[0.7, 0.3]], each)
    )
    config = load_config("rooted")
    changes = {
        "features": {"joints": ()},
        "low": {"hidden": 24, "relative_to": "frame"},
        "high": {"hidden": 16, "rank": 5},
        "data": {"condition": condition},
    }
    for section, items in changes.items():
        own = dataclasses.replace(getattr(config, section), **(items | change.get(section, {})))
        config = dataclasses.replace(config, **{section: own})
    subject = Subject(garment, rig, body, FPS, "made", held if bound else None)
    numbers = PoseFeatures(body, config.features, FPS)(motion(20.0, seed=1))[0]
    made = MotionNetwork(config, subject, Normaliser.fit([numbers], floor=0.01, clamp=5.0))
    code = made.low.code
    code.mean[:, [0, 4]] = 1.0
    code.mean[:, -3:] = code.centres - torch.tensor([0, 1.0, 0])
    if code.followed is not None:
        code.followed.copy_(torch.arange(bones) % (body.n_joints + 1) - 1)
        code.mean[code.followed >= 0, -3:] = code.centres[code.followed >= 0]
    code.deviation[:, :-3], code.deviation[:, -3:] = 0.2, 0.05
    with torch.no_grad():
        made.low.out.weight.mul_(4)
        if detail:
            high = made.add_high()
            high.mean.normal_(0, 0.003)
            high.basis.normal_(0, high.basis.shape[1] ** -0.5)
            high.deviation.uniform_(0.02, 0.2)
    return made.eval()


def saved(path, **change):
    """Path to which a :func:`network` was saved."""
    return save_checkpoint(one(network(**change)), path)


def ready(model, folder):
    """The runtime of a network that is exported to a folder."""
    from garmentnet.runtime import LiveGarment
    from garmentnet.runtime.onnx_file import export_onnx

    return LiveGarment(export_onnx(one(model), folder / "one.onnx"))


def one(model):
    """A checkpoint of one network."""
    return Checkpoint((model,), (None if model.condition else SimulationParameters(),), None)


def live(folder, **change):
    """The runtime of a :func:`network` that was exported to a folder."""
    return ready(network(**change), folder)


def play(garment, joints, parameters=None):
    """Vertices (F, V, 3), a frame after the other."""
    state, frames = None, []
    for pose in joints:
        state, vertices = garment.step(state, pose, parameters)
        frames.append(vertices)
    return np.stack(frames)
