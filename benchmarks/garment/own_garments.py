"""A sleeve, a cape and a skirt as another program would write them: cloth and rig, clip by clip.

``python benchmarks/garment/own_garments.py FOLDER`` writes ``FOLDER/sleeve_0.abc`` and ``.glb``
and so on for four clips of each (``--clips``), and ``sleeve.obj``, the garment as it was cut, to
be read by ``garmentnet import``; ``docs/garmentnet.md`` has the commands.  What is there is not
made again.

A sleeve lies close to the left arm, which moves half as far as in other dances, clips of 60 frames;
its triangles face the arm, as they do in some files.  A cape is in centimetres with z up and hangs
from the shoulders.  A skirt hangs from the waist.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.garment.scenes.body import default_body
from benchmarks.garment.scenes.cloth import Cloth, Solver
from benchmarks.garment.scenes.cut import Cut, cut_garment
from benchmarks.garment.scenes.dance.choreography import dance
from benchmarks.garment.scenes.garments import Garment, follow
from benchmarks.garment.scenes.motion import Motion
from benchmarks.garment.scenes.simulator import simulate
from garmentnet.data.parameters import SimulationParameters
from ssdr import MeshSequence

BODY = default_body()
SEED = 40_000
FRAMES = {"sleeve": 60, "cape": 150, "skirt": 150}
FINE = 0.018  # metres from vertex to vertex
Array = np.ndarray


def grid(points: Array, *, closed: bool) -> Array:
    """Triangles of rows of points (R, N, 3), whose rows are closed or not."""
    rows, count = points.shape[:2]
    at = np.arange(rows * count).reshape(rows, count)
    a, c = at[:-1], at[1:]
    b, d = np.roll(a, -1, axis=1), np.roll(c, -1, axis=1)
    if not closed:
        a, b, c, d = (x[:, :-1] for x in (a, b, c, d))
    return np.concatenate([np.stack(x, -1).reshape(-1, 3) for x in ((a, c, d), (a, d, b))])


def hung(points: Array, faces: Array, pinned: Array) -> Garment:
    indices, weights = follow(BODY, points.reshape(-1, 3), None, shoulders=True)
    rest, weights = (x.astype(np.float32) for x in (points.reshape(-1, 3), weights))
    return Garment(rest, faces.astype(np.int32), pinned.ravel(), indices, weights, None)


def sleeve() -> Garment:
    """A tube around the left arm, from below the shoulder to the wrist, held at its upper end."""
    corners = BODY.skeleton.rest[
        [BODY.skeleton.names.index(n) for n in ("arm_l", "forearm_l", "hand_l")]
    ]
    ways = np.cumsum([0, *np.linalg.norm(np.diff(corners, axis=0), axis=1)])
    along = np.arange(0.25 * ways[1], 0.97 * ways[2], FINE)
    middle = np.stack([np.interp(along, ways, corners[:, k]) for k in range(3)], axis=1)
    axis = corners[2] - corners[0]
    axis /= np.linalg.norm(axis)
    side = np.cross(axis, [0, 0, 1])
    side /= np.linalg.norm(side)
    across = np.cross(side, axis)
    # As wide as the arm there, and 12 mm.
    arm = BODY.skinning.dense_weights()[
        :, [BODY.skeleton.names.index(n) for n in ("arm_l", "forearm_l")]
    ]
    skin = np.asarray(BODY.skinning.rest, float)[arm.sum(axis=1) > 0.7]
    off = np.abs((skin[:, None] - middle) @ axis) < 0.03
    gap = np.linalg.norm(skin[:, None] - middle, axis=2)
    radius = 0.012 + np.where(off, gap, 0).max(axis=0)
    count = round(2 * np.pi * radius.mean() / FINE)
    turn = 2 * np.pi * np.arange(count) / count
    ring = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * side
    points = middle[:, None] + radius[:, None, None] * ring
    pinned = np.zeros(points.shape[:2], bool)
    pinned[:2] = True
    return hung(points, grid(points, closed=True), pinned)


def calm(motion: Motion) -> Motion:
    """The motion with half the turn of the left arm and elbow, whose skin else crosses itself."""
    body = BODY.skeleton
    root, local = body.pose(motion.joints)
    for joint in ("arm_l", "forearm_l"):
        turn = local[:, body.names.index(joint)]
        turn[:] = (Rotation.from_matrix(turn) ** 0.5).as_matrix()
    return dataclasses.replace(motion, joints=body.transforms(root, local))


def cape() -> Garment:
    """A sheet behind the back that two corners hold at the shoulders."""
    neck = BODY.skeleton.rest[[BODY.skeleton.names.index(n) for n in ("arm_l", "arm_r")]]
    top, wide = neck[0, 1] + 0.05, 0.85 * neck[0, 0]
    skin = np.asarray(BODY.skinning.rest, float)
    trunk = skin[(np.abs(skin[:, 0]) < wide) & (skin[:, 1] > 0.4)]
    back = trunk[:, 2].min() - 0.03
    down = np.arange(0, 0.85, FINE)
    points = []
    for d in down:
        half = wide * (1 + 0.5 * d)
        x = np.linspace(half, -half, 1 + round(2 * wide / FINE))
        points.append(np.stack([x, np.full(len(x), top - d), np.full(len(x), back)], axis=1))
    points = np.array(points)
    pinned = np.zeros(points.shape[:2], bool)
    pinned[0] = np.abs(points[0, :, 0]) > 0.5 * wide
    return hung(points, grid(points, closed=False), pinned)


def made(name: str) -> Garment:
    if name == "skirt":
        shape = Cut(vertices=900, top=0.625, pinned=0.605, hem=0.3, flare=0.35, pleats=0)
        return cut_garment(BODY, shape)
    return {"sleeve": sleeve, "cape": cape}[name]()


def cloth(name: str, vertices: Array, faces: Array, fps: float) -> MeshSequence:
    if name == "cape":
        vertices = 100 * vertices[..., [0, 2, 1]] * [1, -1, 1]
    return MeshSequence(vertices.astype(np.float32), faces, fps, name=name)


def rig(motion: Motion) -> ssdr.Skinning:
    tree = {"parents": BODY.skeleton.parents, "joint_positions": BODY.skeleton.rest}
    moved = {"transforms": motion.joints, "fps": motion.fps, "name": "body"}
    return dataclasses.replace(BODY.skinning, **tree, **moved)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("folder", type=Path)
    options.add_argument("--only", choices=FRAMES, help="one of the garments")
    options.add_argument("--clips", type=int, default=4)
    given = options.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for name in [given.only] if given.only else FRAMES:
        garment = made(name)
        cut = cloth(name, garment.rest[None], garment.faces, 30.0)
        ssdr.save(cut, given.folder / f"{name}.obj")
        simulator = Cloth(BODY, garment, Solver(substeps=30))
        for number in range(given.clips):
            files = [given.folder / f"{name}_{number}{end}" for end in (".abc", ".glb")]
            if all(file.exists() for file in files):
                continue
            motion = dance(BODY.skeleton, seed=SEED + number, frames=FRAMES[name])
            motion = calm(motion) if name == "sleeve" else motion
            result = simulate(simulator, motion, SimulationParameters())
            ssdr.save(cloth(name, result.vertices, garment.faces, motion.fps), files[0])
            ssdr.save(rig(motion), files[1])
            print(f"  clip {number}: {result.quality}", flush=True)


if __name__ == "__main__":
    main()
