"""Is the model that a tolerance asks for the smallest?

    python benchmarks/accuracy/parsimony.py                   # half an hour
    python benchmarks/accuracy/parsimony.py --only boxes

Ten small scenes, default options.  The error of each result is measured here by plain NumPy;
then a bone less is tried: ``effort="best"`` from three seeds, and from more of them in turn until
ten times the iterations are spent that the search itself spent on that number of bones.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.scenes import chain
from helpers.motions import rotation

SEEDS, TIMES = 3, 10


def static() -> np.ndarray:
    return np.repeat(common.load("dancer_small")[0][:1], 12, axis=0)


def boxes(count: int, frames: int = 24) -> np.ndarray:
    """Separate boxes of points, each tumbling by itself."""
    rng = np.random.default_rng(1)
    side = np.linspace(-1, 1, 4)
    box = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    axis, way = rng.standard_normal((2, count, 3))
    out = np.empty((frames, count, len(box), 3))
    for t in range(frames):
        for b in range(count):
            turned = box @ rotation(*(0.15 * t * axis[b])).T
            out[t, b] = turned + 0.1 * t * way[b] + [4.0 * b, 0, 0]
    return out.reshape(frames, -1, 3)


def overlapping(bones: int = 6, vertices: int = 300, frames: int = 24) -> np.ndarray:
    """Exact skinning: unrelated bones, three random influences a vertex."""
    rng = np.random.default_rng(2)
    rest = rng.uniform(-1, 1, (vertices, 3))
    indices = np.argsort(rng.random((vertices, bones)), axis=1)[:, :3]
    weights = rng.dirichlet([1.0, 1.0, 1.0], vertices)
    turn, move = np.moveaxis(rng.standard_normal((frames, bones, 2, 3)), 2, 0)
    transforms = np.empty((frames, bones, 3, 4))
    transforms[..., 3] = 0.5 * move
    turned = Rotation.from_rotvec(0.7 * turn.reshape(-1, 3)).as_matrix()
    transforms[..., :3] = turned.reshape(frames, bones, 3, 3)
    return common.reskin(rest, indices, weights, transforms)


def sheet(side: int = 18, frames: int = 24) -> np.ndarray:
    """A square sheet with two waves that travel through it."""
    x, y = np.meshgrid(np.linspace(0, 2, side), np.linspace(0, 2, side), indexing="ij")
    t = np.linspace(0, 2 * np.pi, frames, endpoint=False)[:, None, None]
    z = 0.15 * np.sin(3 * x - t) + 0.08 * np.sin(4 * y + x - 2 * t)
    flat = np.broadcast_to(np.stack([x, y], axis=-1), (frames, side, side, 2))
    return np.concatenate([flat, z[..., None]], axis=-1).reshape(frames, -1, 3)


def links(noise: float = 0.0) -> np.ndarray:
    frames = chain(5, 24, 3)[:, ::4]
    return frames + noise * np.random.default_rng(0).standard_normal(frames.shape)


def sampled(name: str, vertices: int, frames: int) -> np.ndarray:
    every = common.load(name)[0]
    step = max(1, len(every) // frames)
    return np.asarray(every[::step, :: max(1, every.shape[1] // vertices)], dtype=np.float64)


SCENES: dict[str, tuple[Callable[[], np.ndarray], str, int | None]] = {
    "static mesh": (static, "0.5%", 1),
    "two boxes": (lambda: boxes(2), "0.01%", 2),
    "five boxes": (lambda: boxes(5), "0.01%", 5),
    "chain of 5, exact": (links, "0.1%", 5),
    "6 overlapping, exact": (overlapping, "0.01%", 6),
    "chain of 5, noise": (lambda: links(0.01), "0.4%", 5),
    "waving sheet": (sheet, "1%", None),
    "dancer": (lambda: sampled("dancer_small", 399, 24), "0.5%", None),
    "horse_gallop": (lambda: sampled("horse_gallop", 400, 24), "0.8%", None),
    "cow_elastic": (lambda: sampled("cow_elastic", 400, 25), "1.5%", None),
}


def measure(scene: str) -> common.Row:
    """Size of the smallest model for a scene's tolerance, and errors with one bone less."""
    make, asked, made = SCENES[scene]
    frames = make()
    common.compile_kernels()
    began = time.process_time()
    steps: list[tuple[str, int]] = []
    note = lambda p: steps.append((p.phase.partition(" ")[0], p.iteration))  # noqa: E731
    result = ssdr.smallest(frames, tolerance=asked, callback=note)
    seconds = time.process_time() - began
    found = result.parsimony
    bones, tolerance = found.bones, found.tolerance
    error = common.rmse_of(frames, result.skinning)
    influences = next(p for p in found.prunings if p.what == "influences")
    row: common.Row = {
        "tolerance": asked, "made with": made, "bones": bones, "proven": found.least_bones,
        "influences": found.influences, "error / tolerance": error / tolerance,
        "held": bool(error <= tolerance or error < 1e-12 * np.abs(frames).max()),
        "cpu seconds": seconds, "bytes": found.size.total, "bytes before": influences.bytes_before,
        "one less": [], "effort": None,
    }  # fmt: skip
    if bones > 1:
        spent = len({step for step in steps if step[0] == str(bones - 1)})
        errors, iterations = one_less(frames, bones - 1, spent)
        row["one less"] = [e / tolerance for e in errors]
        row["effort"] = iterations / spent if spent else None
    if not row["held"] or min(row["one less"], default=2.0) <= 1:
        print(f"{scene}: not held, or a smaller model holds it", file=sys.stderr)
    return row


def one_less(frames: np.ndarray, bones: int, spent: int) -> tuple[list[float], int]:
    """Error of every seed, and the iterations of all."""
    errors: list[float] = []
    iterations = 0
    while len(errors) < SEEDS or iterations < TIMES * spent:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ssdr.SsdrWarning)
            result = ssdr.decompose(frames, bones=bones, effort="best", rng=len(errors))
        errors.append(common.rmse_of(frames, result.skinning))
        iterations += result.history[-1].iteration
    return errors, iterations


if __name__ == "__main__":
    every = {name: {"scene": name} for name in SCENES}
    columns = ("bones", "influences", "error / tolerance", "effort", "bytes", "cpu seconds")
    common.run(__file__, __doc__, every, measure, columns)
