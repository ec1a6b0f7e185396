"""Motion capture: BVH files read, and their motion carried over to a body of its own build."""

from __future__ import annotations

import dataclasses
import gzip
import math
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ssdr.errors import FormatError, InputError
from ssdr.io.registry import reading

from .motion import Motion, interpolate
from .skeleton import Skeleton
from .store import CLASSES

__all__ = ["Bvh", "find_bvh", "read_bvh", "retarget"]

Float = NDArray[np.float64]
_MAX_BYTES = 1 << 28
_MAX_JOINTS = 1000
_MAX_DEPTH = 200
# What others call the body's joints; left ones, right ones alike.
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


@dataclasses.dataclass(frozen=True, eq=False)
class Bvh:
    """A skeleton and its motion as a BVH file states them.

    Attributes
    ----------
    names : tuple of str
    parents : (J,) int array
        -1 for the root.
    offsets : (J, 3) float array
        From the parent, in the file's units.
    root : (F, 3) float array
        Translation of the root.
    rotations : (F, J, 3, 3) float array
        Relative to the parent.
    fps : float
    """

    names: tuple[str, ...]
    parents: NDArray[np.int32]
    offsets: Float
    root: Float
    rotations: Float
    fps: float

    @property
    def n_frames(self) -> int:
        return len(self.root)


def find_bvh(folder: str | os.PathLike[str]) -> tuple[Path, ...]:
    """The BVH files (``.bvh``, ``.bvh.gz``) of a folder, sorted by name.

    Raises
    ------
    InputError
        If there are none.
    """
    path = Path(folder)
    found = [p for p in path.glob("*") if p.name.lower().endswith((".bvh", ".bvh.gz"))]
    if not found:
        raise InputError("motion", "a folder with BVH files (.bvh, .bvh.gz)", str(path))
    return tuple(sorted(found))


def read_bvh(path: str | os.PathLike[str]) -> Bvh:
    """Read a BVH file, packed (``.gz``) or not.

    Raises
    ------
    FormatError
        If it is damaged or is not one.
    """
    source = Path(path)
    with reading(source):
        opener = gzip.open if source.suffix.lower() == ".gz" else open
        with opener(source, "rb") as file:
            data = file.read(_MAX_BYTES + 1)
        if len(data) > _MAX_BYTES:
            raise FormatError(f"more than {_MAX_BYTES} bytes")
        text = data.decode("utf-8-sig")
        head, found, tail = text.partition("MOTION")
        if not found:
            raise FormatError("no section MOTION")
        names, parents, offsets, channels = _hierarchy(iter(head.split()))
        lines = tail.split("\n")
        words = " ".join(lines[:4]).split()
        if len(words) < 5 or words[0] != "Frames:" or words[2:4] != ["Frame", "Time:"]:
            raise FormatError("no 'Frames:' and 'Frame Time:' after MOTION")
        frames, step = int(words[1]), float(words[4])
        if not (frames >= 1 and math.isfinite(step) and 1e-4 <= step <= 10):
            raise FormatError(f"{frames} frames of {step} s")
        width = sum(len(c) for c in channels)
        start = tail.index(words[4], tail.index("Time:")) + len(words[4])
        values = np.array(tail[start:].split(), dtype=np.float64)
        if len(values) != frames * width:
            raise FormatError(
                f"expected {frames} frames of {width} numbers, got {len(values)} numbers"
            )
        if not np.isfinite(values).all():
            raise FormatError("NaN or Inf among the channels")
        values = values.reshape(frames, width)
        root = np.zeros((frames, 3))
        rotations = np.broadcast_to(np.eye(3), (frames, len(names), 3, 3)).copy()
        column = 0
        for j, own in enumerate(channels):
            order, angles = "", []
            for name in own:
                if name.endswith("position"):
                    if j == 0:
                        root[:, "XYZ".index(name[0])] = values[:, column]
                else:
                    order += name[0]
                    angles.append(values[:, column])
                column += 1
            if order:
                turned = Rotation.from_euler(order, np.stack(angles, axis=1), degrees=True)
                rotations[:, j] = turned.as_matrix()
        return Bvh(names, np.array(parents, np.int32), offsets, root, rotations, 1 / step)


def _hierarchy(
    words: Iterator[str],
) -> tuple[tuple[str, ...], list[int], Float, list[list[str]]]:
    try:
        if next(words) != "HIERARCHY":
            raise FormatError("does not begin with HIERARCHY")
        names: list[str] = []
        parents: list[int] = []
        offsets: list[list[float]] = []
        channels: list[list[str]] = []
        stack: list[int] = []
        end = False  # inside an End Site, whose offset no joint has
        for word in words:
            if word in ("ROOT", "JOINT"):
                if (word == "ROOT") != (not names):
                    raise FormatError("more than one ROOT, or none before a JOINT")
                names.append(next(words))
                parents.append(stack[-1] if stack else -1)
                offsets.append([0.0, 0.0, 0.0])
                channels.append([])
                if len(names) > _MAX_JOINTS:
                    raise FormatError(f"more than {_MAX_JOINTS} joints")
            elif word == "End":
                next(words)
                end = True
            elif word == "{":
                stack.append(-2 if end else len(names) - 1)
                if len(stack) > _MAX_DEPTH:
                    raise FormatError(f"joints nested deeper than {_MAX_DEPTH}")
            elif word == "}":
                end = False
                stack.pop()
            elif word == "OFFSET":
                values = [float(next(words)) for _ in range(3)]
                if not np.isfinite(values).all():
                    raise FormatError("an OFFSET that is not finite")
                if stack[-1] >= 0:
                    offsets[stack[-1]] = values
            elif word == "CHANNELS":
                own = [next(words) for _ in range(int(next(words)))]
                kinds = {f"{a}{k}" for a in "XYZ" for k in ("position", "rotation")}
                if not set(own) <= kinds or len(set(own)) != len(own):
                    raise FormatError(f"channels {own}")
                if sum(c.endswith("rotation") for c in own) not in (0, 3):
                    raise FormatError(f"channels {own}: expected three rotations or none")
                channels[stack[-1]] = own
            else:
                raise FormatError(f"{word!r} in the hierarchy")
        if stack or not names:
            raise FormatError("a hierarchy without end")
    except (StopIteration, IndexError) as error:
        raise FormatError("a hierarchy that is cut off") from error
    return tuple(names), parents, np.array(offsets), channels


def retarget(bvh: Bvh, skeleton: Skeleton, *, fps: float = 30.0, name: str = "") -> Motion:
    """Carry a motion over to another skeleton.

    Joints are matched by name.  Every joint takes the world rotation that its namesake has
    since the file's zero pose; the bones of arms and legs are first turned, by the shortest
    arc, from the body's rest pose to that zero pose.  The root's path is scaled by the length
    of the legs, begins over the origin and is lifted so that the feet stand on y = 0.

    Parameters
    ----------
    bvh : Bvh
    skeleton : Skeleton
        Of :mod:`garmentnet.scenes.body`, or with the same names.
    fps : float
        Of the result.
    name : str

    Returns
    -------
    Motion
        Of the class ``recorded``.

    Raises
    ------
    InputError
        If a joint that is needed has no namesake; the message says which.
    """
    if not (math.isfinite(fps) and 1 <= fps <= 1000):
        raise InputError("fps", "1 to 1000", fps)
    source = _match(bvh, skeleton)
    zero = np.zeros((len(bvh.names), 3))
    world = np.empty_like(bvh.rotations)
    for j, parent in enumerate(bvh.parents):
        zero[j] = bvh.offsets[j] + (zero[parent] if parent >= 0 else 0)
        own = bvh.rotations[:, j]
        world[:, j] = own if parent < 0 else world[:, parent] @ own
    # Their up and left to ours: files differ in which axis is up and where the figure looks.
    across = zero[source["thigh_l"]] - zero[source["thigh_r"]]
    down = (zero[source["foot_l"]] + zero[source["foot_r"]]) / 2 - zero[source["pelvis"]]
    up = -down / max(float(np.linalg.norm(down)), 1e-12)
    left = across - (across @ up) * up
    if np.linalg.norm(left) < 1e-9 or np.linalg.norm(down) < 1e-9:
        raise InputError("bvh", "hips with a left, a right and legs", "a skeleton without")
    # To the nearest axes: a zero pose may lean a little, the world does not.
    up, left = _axis(up), _axis(left)
    ours = np.stack([left, up, np.cross(left, up)])
    legs = sum(
        float(np.linalg.norm(zero[source[f"{b}_l"]] - zero[source[f"{a}_l"]]))
        for a, b in (("thigh", "shin"), ("shin", "foot"))
    )
    own_legs = sum(
        float(np.linalg.norm(_rest(skeleton, f"{b}_l") - _rest(skeleton, f"{a}_l")))
        for a, b in (("thigh", "shin"), ("shin", "foot"))
    )
    first = _first_frame(bvh, world)
    turned = ours @ world[first:] @ ours.T
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
            align = _arc(_rest(skeleton, b) - _rest(skeleton, a), theirs)
        rotations[:, j] = turned[:, source[joint]] @ align
    local = rotations.copy()
    for j, parent in enumerate(skeleton.parents):
        if parent >= 0:
            local[:, j] = rotations[:, parent].swapaxes(-1, -2) @ rotations[:, j]
    path: Float = bvh.root[first:] @ ours.T * (own_legs / legs)
    path -= [path[0, 0], 0.0, path[0, 2]]
    joints = skeleton.transforms(path, local)
    soles = skeleton.positions(joints)[:, [skeleton.index(n) for n in ("foot_l", "foot_r")], 1]
    # The lowest feet but for a few frames of noise stand on the floor.
    joints[..., 1, 3] -= np.percentile(soles.min(axis=1), 2) - _rest(skeleton, "foot_l")[1]
    frames = max(1, math.floor((count - 1) * fps / bvh.fps + 1e-3) + 1)
    at = np.arange(frames, dtype=np.float64) * (bvh.fps / fps)
    joints = interpolate(skeleton, joints, at)
    recorded = np.full(frames, CLASSES.index("recorded"), dtype=np.int8)
    return Motion(joints, recorded, fps, name)


def _match(bvh: Bvh, skeleton: Skeleton) -> dict[str, int]:
    """The file's joint of each of the skeleton's."""
    theirs = {n.split(":")[-1].replace("_", "").lower(): j for j, n in enumerate(bvh.names)}
    found: dict[str, int] = {}
    taken: set[int] = set()
    for joint in skeleton.names:
        right = joint.endswith("_r")
        for name in _NAMES.get(joint[:-1] + "l" if right else joint, ()):
            if right:
                name = "right" + name[4:] if name.startswith("left") else "r" + name[1:]
            j = theirs.get(name, -1)
            if j >= 0 and j not in taken:
                found[joint] = j
                taken.add(j)
                break
    needed = {*_NEEDED, *(n[:-1] + "r" for n in _NEEDED if n.endswith("_l"))}
    absent = sorted(needed - set(skeleton.names))
    if absent:
        raise InputError(
            "skeleton",
            f"joints {', '.join(absent)}, to which a BVH's motion can be carried over",
            f"joints {', '.join(skeleton.names)}",
        )
    missing = sorted(n for n in needed if n not in found)
    if missing:
        raise InputError(
            "bvh", f"joints for {', '.join(missing)}", f"joints {', '.join(bvh.names[:40])}"
        )
    return found


def _first_frame(bvh: Bvh, world: Float) -> int:
    """First frame of the motion itself.

    Converters put a pose of their own before it and leap from there within a few frames: left
    out are leading frames much faster than the fastest of the motion.
    """
    lead = min(12, bvh.n_frames // 4)
    if lead == 0:
        return 0
    heads = np.zeros((bvh.n_frames, len(bvh.names), 3))
    for j, parent in enumerate(bvh.parents):
        if parent >= 0:
            heads[:, j] = heads[:, parent] + world[:, parent] @ bvh.offsets[j]
    speed = np.linalg.norm(np.diff(heads, axis=0), axis=2).max(axis=1)
    fast = speed[:lead] > 1.5 * np.percentile(speed[lead:], 99)
    return int(fast.argmin()) if not fast.all() else lead


def _rest(skeleton: Skeleton, name: str) -> Float:
    return np.asarray(skeleton.rest[skeleton.index(name)])


def _axis(v: Float) -> Float:
    out = np.zeros(3)
    k = int(np.abs(v).argmax())
    out[k] = np.sign(v[k])
    return out


def _arc(a: Float, b: Float) -> Float:
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    return np.asarray(Rotation.align_vectors(b[None], a[None])[0].as_matrix())
