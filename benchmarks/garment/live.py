"""A live garment at other frame rates, after a teleport or a pause, and in an hour of random poses.

    python benchmarks/garment/live.py                # dress, which ships
    python benchmarks/garment/live.py MODEL --hour   # 108,000 unrelated poses, some minutes

Rates: the player's vertices beside those of the network at its own rate whose frames lie at the
same moments, from a second on.  The motions are made dances, whose poses are those of one curve.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from garmentnet.data.parameters import SimulationParameters
from garmentnet.runtime import LiveGarment, Player, load_live
from garmentnet.scenes.dance.choreography import dance

FINE, SECONDS = 120, 10
MOTIONS = {
    "calm": ("stand", "walk", "sway"),
    "violent": ("spin", "kick", "jump"),
}


def rms(gap: np.ndarray) -> float:
    return 1e3 * float(np.sqrt((gap.astype(np.float64) ** 2).sum(-1).mean()))


def native(garment: LiveGarment, joints: np.ndarray, theta: SimulationParameters) -> np.ndarray:
    """Vertices (F, V, 3) that a garment predicts, frame by frame at its own rate."""
    state, frames = None, []
    for pose in joints:
        state, vertices = garment.step(state, pose, theta)
        frames.append(vertices)
    return np.stack(frames)


def poses(garment: LiveGarment, kind: str, seed: int) -> np.ndarray:
    body, options = garment.subject.skeleton, {"classes": MOTIONS[kind]}
    return dance(body, seed=seed, frames=FINE * SECONDS, fps=FINE, **options).joints


def rates(garment: LiveGarment, theta: SimulationParameters, seeds: int) -> None:
    every = round(FINE / garment.subject.fps)
    for kind in MOTIONS:
        errors: dict[int, list[np.ndarray]] = {fps: [] for fps in (24, 30, 60, 120)}
        moved = []
        for seed in range(seeds):
            fine = poses(garment, kind, seed)
            truth = np.empty((len(fine), garment.subject.garment.n_vertices, 3), np.float32)
            for first in range(every):
                truth[first::every] = native(garment, fine[first::every], theta)
            moved.append(truth[FINE + every :] - truth[FINE:-every])
            for fps, found in errors.items():
                player, step = Player(garment, dt=1 / fps), FINE // fps
                got = np.stack([player(pose, theta) for pose in fine[::step]])
                found.append((got - truth[::step])[fps:])
        figures = ", ".join(f"{k} fps {rms(np.concatenate(v)):.1f}" for k, v in errors.items())
        print(f"{kind}: {figures} mm; moved in a frame {rms(np.concatenate(moved)):.1f} mm")


def starts(garment: LiveGarment, theta: SimulationParameters, seeds: int) -> None:
    """After a teleport of 5 m, and after a pause of a minute, beside no interruption."""
    fps, at = round(garment.subject.fps), 4 * round(garment.subject.fps)
    gaps: dict[str, list[np.ndarray]] = {"teleport": [], "pause": []}
    for seed in range(seeds):
        joints = poses(garment, "violent", seed)[:: FINE // fps]
        for kind, found in gaps.items():
            player, there, got = Player(garment, dt=1 / fps), joints.copy(), []
            if kind == "teleport":
                there[at:, :, 0, 3] += 5.0
            for f, pose in enumerate(there):
                long = kind == "pause" and f == at
                got.append(player(pose, theta, dt=60.0 if long else 1 / fps))
            moved = np.stack(got)[at:]
            moved[..., 0] -= there[at, 0, 0, 3] - joints[at, 0, 0, 3]
            found.append(moved - native(garment, joints, theta)[at:])
    for kind, found in gaps.items():
        times = ", ".join(
            f"{t:g} s {rms(np.stack(found)[:, round(t * fps)]):.1f}" for t in (0, 0.5, 1, 2, 4)
        )
        print(f"after a {kind}: {times} mm")
    pose, player = poses(garment, "calm", 0)[0], Player(garment, dt=1 / fps)
    still = [player(pose, theta) for _ in range(60 * fps)]
    print(f"a minute of standing: the last 10 s move by {rms(still[-1] - still[-10 * fps]):.4f} mm")


def hour(garment: LiveGarment, theta: SimulationParameters) -> None:
    """Unrelated poses in every frame, none of which starts anew."""
    rng, body = np.random.default_rng(0), garment.subject.skeleton
    state, farthest = None, np.zeros(6)
    count = round(3600 * garment.subject.fps)
    for f in range(count):
        turns = Rotation.from_quat(rng.normal(size=(body.n_joints, 4))).as_matrix()
        pose = body.transforms(rng.normal(size=(1, 3)), turns[None])[0]
        state, vertices = garment.step(state, pose, theta)
        heads = body.positions(pose[None])[0].astype(np.float32)
        squares = ((vertices[:, None] - heads) ** 2).sum(-1).min(axis=1)
        slot = 6 * f // count
        farthest[slot] = max(farthest[slot], float(squares.max()) ** 0.5)
    text = ", ".join(f"{x:.3f}" for x in farthest)
    print(f"{count} random poses: farthest from the nearest joint, by ten minutes: {text} m")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", nargs="?", default="dress")
    parser.add_argument("--hour", action="store_true")
    parser.add_argument("--seeds", type=int, default=4)
    options = parser.parse_args()
    garment, theta = load_live(options.model), SimulationParameters()
    if options.hour:
        hour(garment, theta)
    else:
        rates(garment, theta, options.seeds)
        starts(garment, theta, options.seeds)


if __name__ == "__main__":
    main()
