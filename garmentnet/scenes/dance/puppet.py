"""Joint transforms from control channels (path, hips, arms, kicks): steps and inverse kinematics.

The feet have no channels: a foot stands still and steps when the body has moved away from it, so
that every blend of moves has plausible footsteps.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.spatial.transform import Rotation

from ...data.skeleton import Skeleton

__all__ = ["CHANNELS", "RATE", "pose_joints"]

Float = NDArray[np.float64]
# Samples of the channels per second; steps and jumps need more than the frame rate.
RATE = 120
# The channels; all are 0 at rest.  Angles in radians, lengths in metres for a leg of 0.807 m,
# times in seconds.  "l" and "r" are the dancer's left and right.
CHANNELS = (
    "forward", "side", "turn",  # velocity in the heading's frame, rate of turn
    "shift_x", "shift_z", "lift", "air",  # hips relative to the feet; height of a jump
    "pitch", "roll", "twist",  # of the pelvis
    "bend", "lean", "wring",  # of the spine, over three joints
    "nod", "look",  # of the head
    "pivot", "width", "turnout",  # how far the feet turn with the body; stance
    "reach_l", "sweep_l", "elbow_l", "reach_r", "sweep_r", "elbow_r",  # arms
    "free_l", "flex_l", "open_l", "knee_l", "free_r", "flex_r", "open_r", "knee_r",  # legs
)  # fmt: skip
_LEG = 0.807  # metres, hip to ankle of the body for which the moves were designed
_FOOT = 0.13  # metres, ankle to ball of the foot
_STRIDE = 0.11  # distance of a foot from its place at which it steps, metres, for that leg
_ASKEW = 0.6  # angle of a foot to its direction at which it steps, radians
_STANCE = 0.17  # metres between the feet at rest
_CROUCH = 0.022  # metres by which standing lowers the hips: knees are slightly bent
_TIPTOE = 0.07  # metres that a leg gains by standing on the toes
_LOWEST = 0.3  # least height of the hips above the ankle, metres
_STEP = (0.2, 0.34)  # seconds of a step, shortest and longest ...
_HURRY = 0.1  # ... and by how much shorter it becomes per m/s
_AHEAD = 0.12  # seconds of motion by which a step aims farther ahead of the body
# Values of the channel "free" of a leg above which the other leg may not step, and above which the
# leg has left the floor.
_RAISED = (0.3, 0.5)
_LIFT = (0.03, 0.2)  # metres that a stepping foot rises, and further rise per metre of stride ...
_STRIDES = 0.35  # ... up to this stride, metres
_STRETCHED = 0.998  # most of its length to which a leg is stretched, so that the knee can point


def pose_joints(skeleton: Skeleton, controls: dict[str, Float], heading: float) -> Float:
    """Joint transforms ``(n, J, 3, 4)`` for every sample of the channels.

    Parameters
    ----------
    skeleton : Skeleton
        Skeleton with the joints of :mod:`garmentnet.scenes.body`.
    controls : dict of (n,) arrays
        Samples of each channel in :data:`CHANNELS`, by name.
    heading : float
        Direction that the dancer faces at first, in radians from z towards x.

    Examples
    --------
    >>> from garmentnet.scenes.body import default_body
    >>> still = {name: np.zeros(12) for name in CHANNELS}
    >>> pose_joints(default_body().skeleton, still, heading=0.0).shape
    (12, 20, 3, 4)
    """
    c = controls
    rest = {n: skeleton.rest[j] for j, n in enumerate(skeleton.names)}
    upper = float(np.linalg.norm(rest["shin_l"] - rest["thigh_l"]))
    lower = float(np.linalg.norm(rest["foot_l"] - rest["shin_l"]))
    scale = (upper + lower) / _LEG
    yaw = heading + np.cumsum(c["turn"]) / RATE
    velocity = _turn(yaw, c["side"], c["forward"]) * scale
    path = np.cumsum(velocity, axis=0) / RATE
    feet = {
        side: _Foot(sign * (0.5 * _STANCE + 0.5 * c["width"]) * scale, sign * c["turnout"])
        for side, sign in (("l", 1.0), ("r", -1.0))
    }
    _walk(feet, c, path, velocity, yaw, scale)
    pelvis = Rotation.from_euler("YXZ", np.stack([yaw + c["twist"], c["pitch"], c["roll"]], axis=1))
    root = np.empty((len(yaw), 3))
    root[:, [0, 2]] = path + _turn(yaw, c["shift_x"], c["shift_z"]) * scale
    ankle = rest["foot_l"][1]
    root[:, 1] = rest["pelvis"][1] + (c["lift"] - _CROUCH) * scale
    hips = {s: pelvis.apply(rest[f"thigh_{s}"] - rest["pelvis"]) for s in "lr"}
    longest = _STRETCHED * (upper + lower)
    too_high = np.zeros(len(yaw))
    for side, foot in feet.items():
        flat = np.linalg.norm(foot.place - (root + hips[side])[:, [0, 2]], axis=1)
        reach = np.sqrt(np.maximum(longest**2 - flat**2, _LOWEST**2)) + _TIPTOE * scale
        over = (root + hips[side])[:, 1] - (foot.height + ankle + reach)
        too_high = np.maximum(too_high, np.where(c[f"free_{side}"] > _RAISED[0], 0.0, over))
    # 0.2 s ahead and smoothly: the hips sink before the step that needs it.
    window = RATE // 5
    root[:, 1] -= gaussian_filter1d(maximum_filter1d(too_high, window), window / 4)
    root[:, 1] += c["air"] * scale
    local = _upper_body(skeleton, c, pelvis)
    for side, foot in feet.items():
        _leg(local, skeleton, side, foot, c, pelvis, root, hips[side], yaw, ankle)
    rotations = np.stack([local[n].as_matrix() for n in skeleton.names], axis=1)
    return skeleton.transforms(root, rotations)


@dataclasses.dataclass(eq=False)
class _Foot:
    """A foot: its place beside the hips, and its position, direction and height at every sample."""

    home: Float
    turnout: Float
    place: Float = dataclasses.field(init=False)
    yaw: Float = dataclasses.field(init=False)
    height: Float = dataclasses.field(init=False)


def _walk(
    feet: dict[str, _Foot],
    c: dict[str, Float],
    path: Float,
    velocity: Float,
    yaw: Float,
    scale: float,
) -> None:
    """Move both feet (in place): they stand still, and step when the body is too far from them."""
    count = len(yaw)
    speed = np.linalg.norm(velocity, axis=1)
    duration = np.clip(_STEP[1] - _HURRY * speed, *_STEP)
    airborne = c["air"] > 1e-3  # metres
    goal, facing, placed, turned, swing = {}, {}, {}, {}, {}
    for side, foot in feet.items():
        # Half a stride ahead of the body, so that the foot is under it in mid-stance.
        ahead = velocity * (0.5 * duration + _AHEAD)[:, None]
        goal[side] = path + _turn(yaw, foot.home, np.zeros(count)) + ahead
        facing[side] = yaw + foot.turnout
        placed[side], turned[side] = goal[side][0].copy(), float(facing[side][0])
        swing[side] = (-1.0, placed[side], turned[side], 0.0)
        foot.place, foot.height = np.empty((count, 2)), np.zeros(count)
        foot.yaw = np.empty(count)
    for k in range(count):
        for side, other in (("l", "r"), ("r", "l")):
            foot = feet[side]
            step_yaw = yaw[k] - yaw[k - 1] if k else 0.0
            follow = 1.0 if airborne[k] else float(c["pivot"][k])
            begun, start, start_yaw, length = swing[side]
            if begun < 0:
                if follow > 0 and k:
                    arm = placed[side] - path[k - 1]
                    turn = _turn(np.array([step_yaw * follow]), arm[:1], arm[1:])[0]
                    placed[side] = path[k - 1] + turn
                    placed[side] = placed[side] + follow * (path[k] - path[k - 1])
                    turned[side] += step_yaw * follow
                if c[f"free_{side}"][k] > _RAISED[1]:
                    # A raised leg comes down at its place beside the hips.
                    placed[side], turned[side] = goal[side][k].copy(), float(facing[side][k])
                far = _far(side, goal, facing, placed, turned, k, scale)
                partner = _far(other, goal, facing, placed, turned, k, scale)
                free = swing[other][0] < 0 and c[f"free_{other}"][k] < _RAISED[0]
                if far > 1 and far >= partner and free and not airborne[k]:
                    swing[side] = (k, placed[side].copy(), turned[side], duration[k])
            if swing[side][0] >= 0:
                begun, start, start_yaw, length = swing[side]
                t = min(1.0, (k - begun) / (length * RATE))
                s = t * t * (3 - 2 * t)
                placed[side] = (1 - s) * start + s * goal[side][k]
                turn_by = math.remainder(facing[side][k] - start_yaw, math.tau)
                turned[side] = start_yaw + s * turn_by
                stride = math.hypot(*(goal[side][k] - start))
                rise = _LIFT[0] + _LIFT[1] * min(stride, _STRIDES)
                foot.height[k] = rise * math.sin(math.pi * t) ** 2
                if t >= 1:
                    swing[side] = (-1.0, placed[side], turned[side], 0.0)
            foot.place[k], foot.yaw[k] = placed[side], turned[side]
    for foot in feet.values():
        foot.height = foot.height * scale + c["air"] * scale


def _far(
    side: str,
    goal: dict[str, Float],
    facing: dict[str, Float],
    placed: dict[str, Float],
    turned: dict[str, float],
    k: int,
    scale: float,
) -> float:
    """Distance of a foot from its place and direction, relative to that at which it steps."""
    off = goal[side][k] - placed[side]
    askew = abs(math.remainder(facing[side][k] - turned[side], math.tau))
    return math.hypot(*off) / (_STRIDE * scale) + askew / _ASKEW


def _leg(
    local: dict[str, Rotation],
    skeleton: Skeleton,
    side: str,
    foot: _Foot,
    c: dict[str, Float],
    pelvis: Rotation,
    root: Float,
    hip: Float,
    yaw: Float,
    ankle: float,
) -> None:
    rest = {n: skeleton.rest[skeleton.index(f"{n}_{side}")] for n in ("thigh", "shin", "foot")}
    sign = 1.0 if side == "l" else -1.0
    bone = [rest["shin"] - rest["thigh"], rest["foot"] - rest["shin"]]
    upper, lower = (float(np.linalg.norm(b)) for b in bone)
    target = np.stack([foot.place[:, 0], ankle + foot.height, foot.place[:, 1]], axis=1)
    way = target - (root + hip)
    distance = np.linalg.norm(way, axis=1)
    longest = _STRETCHED * (upper + lower)
    raised = np.maximum(distance - longest, 0.0)
    reach = np.clip(distance, abs(upper - lower) + 0.05, longest)
    along = way / distance[:, None]
    # The knee points in the direction of the foot, and outward when it bends (radians).
    bent = np.clip(1 - reach / longest, 0, 0.5)
    pole_yaw = yaw + _wrap(foot.yaw - yaw) * 0.7 + sign * (0.1 + 0.9 * bent)
    pole = np.stack([np.sin(pole_yaw), np.zeros_like(yaw), np.cos(pole_yaw)], axis=1)
    pole = _unit(pole - (pole * along).sum(axis=1, keepdims=True) * along)
    cosine = np.clip((upper**2 + reach**2 - lower**2) / (2 * upper * reach), -1, 1)
    knee = upper * (cosine[:, None] * along + np.sqrt(1 - cosine**2)[:, None] * pole)
    thigh = _aim(bone[0], knee, pole)
    shin = _aim(bone[1], reach[:, None] * along - knee, pole)
    # Radians: the heel rises where the leg is too short, and while the foot is in the air.
    toes = np.arcsin(np.clip(raised / _FOOT, 0, 0.85)) + np.clip(
        4 * foot.height - 4 * c["air"], 0, 0.5
    )
    flat = Rotation.from_euler("YX", np.stack([foot.yaw, toes], axis=1))
    free = c[f"free_{side}"]
    swing = pelvis * Rotation.from_euler(
        "ZX", np.stack([sign * c[f"open_{side}"], -c[f"flex_{side}"]], axis=1)
    )
    thigh = _blend(thigh, swing * _straight(bone[0]), free)
    free_shin = swing * Rotation.from_euler("x", c[f"knee_{side}"][:, None]) * _straight(bone[1])
    shin = _blend(shin, free_shin, free)
    pointed = free_shin * Rotation.from_euler("x", np.full((len(yaw), 1), 0.5))
    foot_world = _blend(flat, pointed, free)
    local[f"thigh_{side}"] = pelvis.inv() * thigh
    local[f"shin_{side}"] = thigh.inv() * shin
    local[f"foot_{side}"] = shin.inv() * foot_world


def _upper_body(skeleton: Skeleton, c: dict[str, Float], pelvis: Rotation) -> dict[str, Rotation]:
    third = np.stack([c["wring"], c["bend"], c["lean"]], axis=1) / 3
    spine = Rotation.from_euler("YXZ", third)
    half = Rotation.from_euler("YX", np.stack([c["look"], c["nod"]], axis=1) / 2)
    local = {
        "pelvis": pelvis,
        "abdomen": spine,
        "spine": spine,
        "chest": spine,
        "neck": half,
        "head": half,
    }
    for side, sign in (("l", 1.0), ("r", -1.0)):
        rest = {n: skeleton.rest[skeleton.index(f"{n}_{side}")] for n in ("arm", "forearm", "hand")}
        upper = _unit(rest["forearm"] - rest["arm"])
        reach, sweep = c[f"reach_{side}"] + 0.75, c[f"sweep_{side}"]
        # From straight down, outward or forward, to straight up.
        toward = np.stack(
            [
                sign * np.sin(reach) * np.cos(sweep),
                -np.cos(reach),
                np.sin(reach) * np.sin(sweep),
            ],
            axis=1,
        )
        lifted = np.clip(reach - 1.3, 0, 1.4) * 0.3
        collar = Rotation.from_euler("z", (sign * lifted)[:, None])
        arm = collar.inv() * _arc(np.broadcast_to(upper, toward.shape), toward)
        hinge = _unit(np.cross(upper, [0.0, 0.0, 1.0]))
        elbow = Rotation.from_rotvec(c[f"elbow_{side}"][:, None] * hinge)
        local[f"collar_{side}"] = collar
        local[f"arm_{side}"] = arm
        local[f"forearm_{side}"] = elbow
        local[f"hand_{side}"] = Rotation.identity(len(toward))
    return local


def _turn(yaw: Float, x: Float, z: Float) -> Float:
    """Vectors ``(n, 2)``, x and z, rotated from the heading's frame to the world."""
    sine, cosine = np.sin(yaw), np.cos(yaw)
    return np.stack([cosine * x + sine * z, cosine * z - sine * x], axis=1)


def _wrap(angle: Float) -> Float:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def _unit(v: Float) -> Float:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def _frame(along: Float, pole: Float) -> Float:
    x = _unit(along)
    y = _unit(pole - (pole * x).sum(axis=-1, keepdims=True) * x)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _aim(rest: Float, along: Float, pole: Float) -> Rotation:
    """World rotations of a bone's rest direction to `along` and of its front towards `pole`."""
    base = _frame(rest, np.array([0.0, 0.0, 1.0]))
    return Rotation.from_matrix(_frame(along, pole) @ base.T)


def _straight(bone: Float) -> Rotation:
    """Rotation of a bone's rest direction to straight down."""
    return Rotation.from_matrix(
        _frame(np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
        @ _frame(bone, np.array([0.0, 0.0, 1.0])).T
    )


def _arc(a: Float, b: Float) -> Rotation:
    axis = np.cross(a, b)
    size = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(size[:, 0], (a * b).sum(axis=1))
    return Rotation.from_rotvec(axis / np.maximum(size, 1e-12) * angle[:, None])


def _blend(a: Rotation, b: Rotation, follow: Float) -> Rotation:
    return a * Rotation.from_rotvec((a.inv() * b).as_rotvec() * follow[:, None])
