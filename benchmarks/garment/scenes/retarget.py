"""Retargeting of motion capture to a body with other proportions."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from garmentnet.data.clip import CLASSES
from garmentnet.data.skeleton import Skeleton
from ssdr.common.errors import InputError

from .bvh import Bvh
from .motion import Motion, interpolate

Float = NDArray[np.float64]

# Names of the body's joints in other skeletons, in lower case (Daz, CMU, Mixamo and others);
# right joints follow from the left ones.
_NAMES = {
    "pelvis": ("hip", "hips", "pelvis", "root"),
    "abdomen": ("abdomen", "lowerback", "spine"),
    "spine": ("spine1", "waist"),
    "chest": ("chest", "spine2", "spine1", "torso"),
    "neck": ("neck", "neck1"),
    "head": ("head",),
    "collar_l": ("lcollar", "leftshoulder", "leftcollar"),
    "arm_l": ("lshldr", "leftarm", "lshoulder", "leftuparm"),
    "forearm_l": ("lforearm", "leftforearm", "lelbow", "leftlowarm"),
    "hand_l": ("lhand", "lefthand", "lwrist"),
    "thigh_l": ("lthigh", "leftupleg", "lhip", "lefthip"),
    "shin_l": ("lshin", "leftleg", "lknee", "leftlowleg"),
    "foot_l": ("lfoot", "leftfoot", "lankle"),
}


_NEEDED = ("pelvis", "thigh_l", "shin_l", "foot_l", "arm_l", "forearm_l", "hand_l")
# Bones whose rest directions differ between A-pose and T-pose, with the joint at their end.
_LIMBS = {"arm": "forearm", "forearm": "hand", "thigh": "shin", "shin": "foot"}


def retarget(bvh: Bvh, skeleton: Skeleton, *, fps: float = 30.0) -> Motion:
    """Retarget a motion to another skeleton.

    Joints are matched by name.  Every joint takes the world rotation of the matching joint,
    relative to the file's zero pose.  Arms and legs of the body's rest pose may have other
    directions (A-pose and T-pose), so the shortest rotation from one direction to the other is
    applied first.  The root's path is scaled by the length of the legs, starts above the origin and
    is raised so that the feet stand on y = 0.

    Parameters
    ----------
    bvh : Bvh
    skeleton : Skeleton
        Skeleton of :mod:`benchmarks.garment.scenes.body`, or one with the same names.
    fps : float
        Frame rate of the result.

    Returns
    -------
    Motion
        Motion whose frames are of the class ``recorded``.

    Raises
    ------
    InputError
        If the file has no match for a joint that is needed; the message says which.
    """
    source = _match(bvh, skeleton)
    zero = np.zeros((len(bvh.names), 3))
    for j, parent in enumerate(bvh.parents):
        zero[j] = bvh.offsets[j] + (zero[parent] if parent >= 0 else 0)
    # By numbers, since a file may give two joints the same name.
    figure = Skeleton(tuple(map(str, range(len(zero)))), bvh.parents, zero)
    world = figure.transforms(np.zeros((len(bvh.root), 3)), bvh.rotations)
    # Files differ in which axis is up and in which direction the figure faces.
    across = zero[source["thigh_l"]] - zero[source["thigh_r"]]
    down = (zero[source["foot_l"]] + zero[source["foot_r"]]) / 2 - zero[source["pelvis"]]
    up = -down / max(float(np.linalg.norm(down)), 1e-12)
    left = across - (across @ up) * up
    if np.linalg.norm(left) < 1e-9 or np.linalg.norm(down) < 1e-9:
        raise InputError("bvh", "hips with a left, a right and legs", "a skeleton without")
    # Rounded to the nearest axes of the file, since the figure in a zero pose may lean a little.
    up, left = _axis(up), _axis(left)
    ours = np.stack([left, up, np.cross(left, up)])
    rest = dict(zip(skeleton.names, skeleton.rest, strict=True))
    legs = _leg_length({name: zero[j] for name, j in source.items()})
    first = _first_frame(figure.positions(world))
    turned = ours @ world[first:, :, :, :3] @ ours.T
    count = len(turned)
    rotations = np.empty((count, skeleton.n_joints, 3, 3))
    for j, joint in enumerate(skeleton.names):
        base, _, side = joint.partition("_")
        if joint not in source:
            rotations[:, j] = rotations[:, skeleton.parents[j]]
            continue
        align = np.eye(3)
        bone = "forearm" if base == "hand" else base
        if bone in _LIMBS:
            a, b = f"{bone}_{side}", f"{_LIMBS[bone]}_{side}"
            theirs = ours @ (zero[source[b]] - zero[source[a]])
            align = _arc(rest[b] - rest[a], theirs)
        rotations[:, j] = turned[:, source[joint]] @ align
    _, local = skeleton.pose(np.pad(rotations, [(0, 0), (0, 0), (0, 0), (0, 1)]))
    path: Float = bvh.root[first:] @ ours.T * (_leg_length(rest) / legs)
    path -= [path[0, 0], 0.0, path[0, 2]]
    joints = skeleton.transforms(path, local)
    soles = skeleton.positions(joints)[
        :, [skeleton.names.index(n) for n in ("foot_l", "foot_r")], 1
    ]
    # The second percentile, not the minimum: a few frames of noise may lie below the floor.
    joints[..., 1, 3] -= np.percentile(soles.min(axis=1), 2) - rest["foot_l"][1]
    # 1e-3 of a frame is added, so that a frame time written as 0.0333333 s keeps the last frame.
    frames = max(1, math.floor((count - 1) * fps / bvh.fps + 1e-3) + 1)
    at = np.arange(frames, dtype=np.float64) * (bvh.fps / fps)
    joints = interpolate(skeleton, joints, at)
    recorded = np.full(frames, CLASSES.index("recorded"), dtype=np.int8)
    return Motion(joints, recorded, fps)


def _match(bvh: Bvh, skeleton: Skeleton) -> dict[str, int]:
    """Index of the file's joint that matches each joint of the skeleton, by name."""
    theirs = {n.split(":")[-1].replace("_", "").lower(): j for j, n in enumerate(bvh.names)}
    matched: dict[str, int] = {}
    taken: set[int] = set()
    for joint in skeleton.names:
        right = joint.endswith("_r")
        for name in _NAMES.get(joint[:-1] + "l" if right else joint, ()):
            if right:
                name = "right" + name[4:] if name.startswith("left") else "r" + name[1:]
            j = theirs.get(name, -1)
            if j >= 0 and j not in taken:
                matched[joint] = j
                taken.add(j)
                break
    needed = {*_NEEDED, *(n[:-1] + "r" for n in _NEEDED if n.endswith("_l"))}
    missing = sorted(n for n in needed if n not in matched)
    if missing:
        expected = f"joints for {', '.join(missing)}, which the body needs, too"
        raise InputError("bvh", expected, ", ".join(bvh.names[:40]))
    return matched


def _first_frame(heads: Float) -> int:
    """Index of the first frame of the motion itself, given joints ``(F, J, 3)`` about the root.

    Some converters put a calibration pose before the motion and jump from it within a few
    frames.  Frames at the start that move much faster than the rest are left out.
    """
    # Most frames that may be left out: 12 (0.1 s at 120 frames per second), but at most a quarter.
    lead = min(12, len(heads) // 4)
    if lead == 0:
        return 0
    speed = np.linalg.norm(np.diff(heads, axis=0), axis=2).max(axis=1)
    # 1.5 times the 99th percentile of speed: faster than the motion ever is, apart from noise.
    fast = speed[:lead] > 1.5 * np.percentile(speed[lead:], 99)
    return int(fast.argmin()) if not fast.all() else lead


def _leg_length(joints: Mapping[str, Float]) -> float:
    hip, knee, ankle = (joints[n] for n in ("thigh_l", "shin_l", "foot_l"))
    return float(np.linalg.norm(knee - hip)) + float(np.linalg.norm(ankle - knee))


def _axis(v: Float) -> Float:
    out = np.zeros(3)
    k = int(np.abs(v).argmax())
    out[k] = np.sign(v[k])
    return out


def _arc(a: Float, b: Float) -> Float:
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    return np.asarray(Rotation.align_vectors(b[None], a[None])[0].as_matrix())
