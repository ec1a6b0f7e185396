"""How much the cloth changes when the motion changes hardly: what no function of it can learn.

    python benchmarks/garment/roughness.py out/medium.clips --out out/study/roughness.json

Validation dances are simulated again with every joint but the root turned by a smooth noise of a
few tenths of a degree to a few degrees (RMS, cut off above 0.6 Hz).  Two such motions look the
same; RMSE / √2 between their cloths is how far a clip lies from the mean over its neighbours, and
a network that has not seen motions as near as that predicts the mean.  Stopped and started
again, it goes on.  A minute a clip and size of noise on one core.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from garmentnet.data.motion import Motion
from garmentnet.data.skeleton import Skeleton
from garmentnet.data.store import ClipStore
from garmentnet.scenes.cloth import Cloth
from garmentnet.scenes.scene_file import load_data_set
from garmentnet.scenes.simulator import simulate
from ssdr.io.atomic import write_bytes

WIDTH = 8.0  # frames; of the Gaussian that smooths the noise


def shaken(motion: Motion, skeleton: Skeleton, degrees: float, rng: np.random.Generator) -> Motion:
    """The motion with smooth noise on the rotations of all joints but the root."""
    root, rotations = skeleton.pose(motion.joints)
    frames, joints = rotations.shape[:2]
    noise = gaussian_filter1d(rng.standard_normal((frames, joints, 3)), WIDTH, axis=0)
    # The angle of a joint is the length of its vector.
    noise *= math.radians(degrees) / math.sqrt(float((noise**2).sum(-1).mean()))
    noise[:, 0] = 0.0
    turn = Rotation.from_rotvec(noise.reshape(-1, 3)).as_matrix().reshape(rotations.shape)
    return dataclasses.replace(motion, joints=skeleton.transforms(root, rotations @ turn))


def measure(store: ClipStore, name: str, degrees: float, preset: str) -> dict[str, Any]:
    """Simulate one clip from a shaken motion and compare."""
    data_set = load_data_set(preset)
    scene = next(s for s in data_set.scenes() if s.name == name)
    body = data_set.make_body()
    motion = scene.motion.make(body, data_set.fps)
    rng = np.random.default_rng([scene.seed, round(1000 * degrees)])
    again = simulate(
        Cloth(body, data_set.make_garment(body), data_set.solver),
        shaken(motion, body.skeleton, degrees, rng),
        scene.parameters.parameters,
        gate=data_set.gate,
    )
    free = ~np.asarray(store.pinned, bool)
    gap = np.asarray(store.clip(name).sequence.frames(slice(None))) - again.vertices
    square = (gap.astype(np.float64) ** 2).sum(-1)
    return {
        "clip": name,
        "degrees": degrees,
        "overall": 1e3 * math.sqrt(square.mean() / 2),
        "overall_free": 1e3 * math.sqrt(square[:, free].mean() / 2),
    }


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("store", type=Path)
    options.add_argument("--out", type=Path, default=Path("out/study/roughness.json"))
    options.add_argument("--preset", default="medium", help="data set of the store")
    options.add_argument("--degrees", type=float, nargs="+", default=[1.0, 0.25, 4.0])
    options.add_argument("--clips", type=int, default=8)
    given = options.parse_args()
    store = ClipStore.open(given.store)
    base = store.parameters()[0]
    dances = [c for c in store.clips("validation") if c.motion.startswith("dance-")]
    names = [c.name for c in dances if c.parameters == base][: given.clips]
    rows = json.loads(given.out.read_text("utf-8")) if given.out.is_file() else []
    done = {(r["clip"], r["degrees"]) for r in rows}
    for degrees in given.degrees:
        for name in names:
            if (name, degrees) not in done:
                rows.append(measure(store, name, degrees, given.preset))
                write_bytes(given.out, json.dumps(rows, indent=1).encode())
                print(rows[-1], file=sys.stderr, flush=True)
    for degrees in given.degrees:
        part = [r for r in rows if r["degrees"] == degrees]
        rms = {
            k: math.sqrt(sum(r[k] ** 2 for r in part) / len(part))
            for k in ("overall", "overall_free")
        }
        print(f"{degrees:g}°: {rms['overall']:.1f} mm, free vertices {rms['overall_free']:.1f} mm")


if __name__ == "__main__":
    main()
