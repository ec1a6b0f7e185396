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

from garmentnet.data.skeleton import Skeleton

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
_DOWN, _FRONT = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
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
        Skeleton with the joints of :mod:`benchmarks.garment.scenes.body`.
    controls : dict of (n,) arrays
        Samples of each channel in :data:`CHANNELS`, by name.
    heading : float
        Direction that the dancer faces at first, in radians from z towards x.

    Examples
    --------
    >>> from benchmarks.garment.scenes.body import default_body
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
    feet = _walk(c, path, velocity, yaw, scale)
    pelvis = Rotation.from_euler("YXZ", np.stack([yaw + c["twist"], c["pitch"], c["roll"]], axis=1))
    root = np.empty((len(yaw), 3))
    root[:, [0, 2]] = path + _turn(yaw, c["shift_x"], c["shift_z"]) * scale
    ankle = rest["foot_l"][1]
    root[:, 1] = rest["pelvis"][1] + (c["lift"] - _CROUCH) * scale
    hips = [pelvis.apply(rest[f"thigh_{foot.side}"] - rest["pelvis"]) for foot in feet]
    longest = _STRETCHED * (upper + lower)
    too_high = np.zeros(len(yaw))
    for foot, hip in zip(feet, hips, strict=True):
        flat = np.linalg.norm(foot.place - (root + hip)[:, [0, 2]], axis=1)
        reach = np.sqrt(np.maximum(longest**2 - flat**2, _LOWEST**2)) + _TIPTOE * scale
        over = (root + hip)[:, 1] - (foot.height + ankle + reach)
        too_high = np.maximum(too_high, np.where(c[f"free_{foot.side}"] > _RAISED[0], 0.0, over))
    # 0.2 s ahead and smoothly: the hips sink before the step that needs it.
    window = RATE // 5
    root[:, 1] -= gaussian_filter1d(maximum_filter1d(too_high, window), window / 4)
    root[:, 1] += c["air"] * scale
    local = _upper_body(rest, c, pelvis)
    for foot, hip in zip(feet, hips, strict=True):
        local |= _leg(rest, foot, c, pelvis, root + hip, yaw)
    rotations = np.stack([local[n].as_matrix() for n in skeleton.names], axis=1)
    return skeleton.transforms(root, rotations)


@dataclasses.dataclass(eq=False)
class _Foot:
    """A foot: where it should be and is at every sample, and what it does now."""

    side: str
    goal: Float  # (n, 2) place beside the hips, ahead of a body that moves
    facing: Float
    place: Float  # (n, 2)
    yaw: Float
    height: Float
    now: Float  # place and direction at the present sample
    turned: float
    # A step: sample, place and direction at which it began, and its seconds; None: it stands.
    step: tuple[int, Float, float, float] | None = None

    def far(self, k: int, scale: float) -> float:
        """Distance from place and direction at sample `k`, relative to that at which it steps."""
        off = self.goal[k] - self.now
        askew = abs(math.remainder(self.facing[k] - self.turned, math.tau))
        return math.hypot(*off) / (_STRIDE * scale) + askew / _ASKEW


def _walk(
    c: dict[str, Float], path: Float, velocity: Float, yaw: Float, scale: float
) -> tuple[_Foot, _Foot]:
    """Left and right foot: they stand still, and step when the body is too far from them."""
    count = len(yaw)
    speed = np.linalg.norm(velocity, axis=1)
    duration = np.clip(_STEP[1] - _HURRY * speed, *_STEP)
    airborne = c["air"] > 1e-3  # metres
    # Half a stride ahead of the body, so that the foot is under it in mid-stance.
    ahead = velocity * (0.5 * duration + _AHEAD)[:, None]

    def foot_of(side: str, sign: float) -> _Foot:
        home = sign * (0.5 * _STANCE + 0.5 * c["width"]) * scale
        goal = path + _turn(yaw, home, np.zeros(count)) + ahead
        facing, place = yaw + sign * c["turnout"], np.empty((count, 2))
        return _Foot(
            side, goal, facing, place, np.empty(count), np.zeros(count), goal[0], facing[0]
        )

    left, right = foot_of("l", 1.0), foot_of("r", -1.0)
    for k in range(count):
        for foot, other in ((left, right), (right, left)):
            step_yaw = yaw[k] - yaw[k - 1] if k else 0.0
            follow = 1.0 if airborne[k] else float(c["pivot"][k])
            if foot.step is None:
                if follow > 0 and k:
                    arm = foot.now - path[k - 1]
                    turn = _turn(np.array([step_yaw * follow]), arm[:1], arm[1:])[0]
                    foot.now = path[k - 1] + turn
                    foot.now = foot.now + follow * (path[k] - path[k - 1])
                    foot.turned += step_yaw * follow
                if c[f"free_{foot.side}"][k] > _RAISED[1]:
                    # A raised leg comes down at its place beside the hips.
                    foot.now, foot.turned = foot.goal[k], foot.facing[k]
                far = foot.far(k, scale)
                free = other.step is None and c[f"free_{other.side}"][k] < _RAISED[0]
                if far > 1 and far >= other.far(k, scale) and free and not airborne[k]:
                    foot.step = (k, foot.now, foot.turned, duration[k])
            if foot.step is not None:
                begun, start, start_yaw, length = foot.step
                t = min(1.0, (k - begun) / (length * RATE))
                s = t * t * (3 - 2 * t)
                foot.now = (1 - s) * start + s * foot.goal[k]
                turn_by = math.remainder(foot.facing[k] - start_yaw, math.tau)
                foot.turned = start_yaw + s * turn_by
                stride = math.hypot(*(foot.goal[k] - start))
                rise = _LIFT[0] + _LIFT[1] * min(stride, _STRIDES)
                foot.height[k] = rise * math.sin(math.pi * t) ** 2
                if t >= 1:
                    foot.step = None
            foot.place[k], foot.yaw[k] = foot.now, foot.turned
    for foot in (left, right):
        foot.height = foot.height * scale + c["air"] * scale
    return left, right


def _leg(
    rest: dict[str, Float],
    foot: _Foot,
    c: dict[str, Float],
    pelvis: Rotation,
    hip: Float,
    yaw: Float,
) -> dict[str, Rotation]:
    """Rotations of a leg's joints that bring its foot from the hip to its place."""
    side = foot.side
    sign = 1.0 if side == "l" else -1.0
    ankle = rest[f"foot_{side}"]
    bone = [rest[f"shin_{side}"] - rest[f"thigh_{side}"], ankle - rest[f"shin_{side}"]]
    upper, lower = (float(np.linalg.norm(b)) for b in bone)
    target = np.stack([foot.place[:, 0], ankle[1] + foot.height, foot.place[:, 1]], axis=1)
    way = target - hip
    distance = np.linalg.norm(way, axis=1)
    longest = _STRETCHED * (upper + lower)
    raised = np.maximum(distance - longest, 0.0)
    reach = np.clip(distance, abs(upper - lower) + 0.05, longest)
    along = way / distance[:, None]
    # The knee points in the direction of the foot, and outward when it bends (radians).
    bent = np.clip(1 - reach / longest, 0, 0.5)
    turn = (foot.yaw - yaw + np.pi) % (2 * np.pi) - np.pi
    pole_yaw = yaw + turn * 0.7 + sign * (0.1 + 0.9 * bent)
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
    thigh = _blend(thigh, swing * _aim(bone[0], _DOWN, _FRONT), free)
    free_shin = swing * Rotation.from_euler("x", c[f"knee_{side}"][:, None])
    free_shin = free_shin * _aim(bone[1], _DOWN, _FRONT)
    shin = _blend(shin, free_shin, free)
    pointed = free_shin * Rotation.from_euler("x", np.full((len(yaw), 1), 0.5))
    foot_world = _blend(flat, pointed, free)
    return {
        f"thigh_{side}": pelvis.inv() * thigh,
        f"shin_{side}": thigh.inv() * shin,
        f"foot_{side}": shin.inv() * foot_world,
    }


def _upper_body(
    rest: dict[str, Float], c: dict[str, Float], pelvis: Rotation
) -> dict[str, Rotation]:
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
        upper = _unit(rest[f"forearm_{side}"] - rest[f"arm_{side}"])
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


def _unit(v: Float) -> Float:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def _frame(along: Float, pole: Float) -> Float:
    x = _unit(along)
    y = _unit(pole - (pole * x).sum(axis=-1, keepdims=True) * x)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _aim(rest: Float, along: Float, pole: Float) -> Rotation:
    """World rotations of a bone's rest direction to `along` and of its front towards `pole`."""
    base = _frame(rest, _FRONT)
    return Rotation.from_matrix(_frame(along, pole) @ base.T)


def _arc(a: Float, b: Float) -> Rotation:
    axis = np.cross(a, b)
    size = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(size[:, 0], (a * b).sum(axis=1))
    return Rotation.from_rotvec(axis / np.maximum(size, 1e-12) * angle[:, None])


def _blend(a: Rotation, b: Rotation, follow: Float) -> Rotation:
    return a * Rotation.from_rotvec((a.inv() * b).as_rotvec() * follow[:, None])
