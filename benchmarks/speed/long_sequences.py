"""What is larger than memory, from disk to the skinned model: time, memory, error.

    python benchmarks/speed/long_sequences.py                    # 11 GB of disk, hours
    python benchmarks/speed/long_sequences.py --only "40000 frames" --threads 2
    python benchmarks/speed/long_sequences.py --only vertices clips

The paper's own size, 12,273 vertices, 40,000 frames, 80 bones and 8 influences, and fewer of its
frames; 200,000 vertices; 1,000 clips of 20 to 60 frames.  The data, a swinging skirt (skirt.py), is
made once in the folder that SSDR_LONG_DATA names (default: out/long).
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.common import Row
from benchmarks.speed.skirt import Skirt

FOLDER = Path(os.environ.get("SSDR_LONG_DATA", common.ROOT / "out" / "long"))
FRAMES = 40_000
CASES: dict[str, Row] = {
    f"{frames} frames": {"kind": "frames", "size": frames}
    for frames in (2500, 5000, 10_000, FRAMES)
}
CASES[f"{FRAMES} frames, positions alone"] = {
    "kind": "frames", "size": FRAMES, "options": {"rest_pose": "free", "normals": False},
}  # fmt: skip
CASES |= {
    "200000 vertices": {"kind": "vertices", "size": 200_000},
    "1000 clips": {"kind": "clips", "size": 1000},
}


def paper() -> Skirt:
    return Skirt(vertices=12_273, columns=16, influences=8)


def solved(
    make_input: Callable[[], Any], bones: int, influences: int, **options: Any
) -> tuple[Any, Row]:
    """Solve from the file on; returns the result, times and memory."""
    over, most = threading.Event(), [0.0]

    def watch() -> None:
        while not over.wait(0.05):  # mapped files are not anonymous memory
            most[0] = max(most[0], common.peak_memory("RssAnon"))

    phases: dict[str, float] = {}
    last = [time.perf_counter()]

    def lap(progress: ssdr.Progress) -> None:
        now = time.perf_counter()
        phases[progress.phase] = phases.get(progress.phase, 0.0) + now - last[0]
        last[0] = now

    threading.Thread(target=watch, daemon=True).start()
    wall, cpu = time.perf_counter(), time.process_time()
    result = ssdr.decompose(
        make_input(), bones=bones, influences=influences, callback=lap,
        checkpoint=FOLDER / "checkpoint.npz", **options,
    )  # fmt: skip
    over.set()
    return result, {
        "wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu,
        "compile": result.compile_seconds, "anonymous MiB": most[0], "rmse": result.rmse,
        "phases": phases,
        "passes": [r.rmse for r in result.history if r.phase == "all frames"],
    }  # fmt: skip


def true_error(vertices: Any, model: Any, frames: Iterable[int]) -> float:
    """RMSE of a model on some frames by plain NumPy."""
    squares = []
    for t in frames:
        again = common.reskin(model.rest, model.indices, model.weights, model.transforms[t : t + 1])
        squares.append(((again[0] - vertices[t]) ** 2).sum(axis=-1).mean())
    return float(np.sqrt(np.mean(squares)))


def spread(count: int, frames: int) -> np.ndarray:
    return np.unique(np.linspace(0, frames - 1, count).astype(int))


def frames(size: int, options: Row | None = None) -> Row:
    """Solve the first frames; of two sizes also 500 evenly spread frames in memory."""
    skirt, path = paper(), FOLDER / "paper.npy"
    result, row = streamed(skirt, path, size, FRAMES, 8, options or {})
    if size in (5000, FRAMES):
        some, mapped = spread(500, size), np.load(path, mmap_mode="r")
        inner, _ = solved(
            lambda: ssdr.MeshSequence(mapped[some], skirt.faces, 30.0), skirt.bones, 8,
            **(options or {}),
        )  # fmt: skip
        row["rmse of 500 frames"] = true_error(mapped, result.skinning, some)
        row["rmse of these in memory"] = inner.rmse
        row["ratio"] = row["rmse of 500 frames"] / inner.rmse
    return row


def vertices(size: int) -> Row:
    skirt = Skirt(vertices=size, columns=12, influences=4)
    return streamed(skirt, FOLDER / f"vertices_{size}.npy", 1000, 1000, 4, {})[1]


def streamed(
    skirt: Skirt, path: Path, count: int, whole: int, influences: int, options: Row
) -> tuple[Any, Row]:
    """Solve the first frames of a file."""
    floor = skirt.write(path, count, whole)
    mapped = np.load(path, mmap_mode="r")[:count]
    result, row = solved(
        lambda: ssdr.MeshSequence(mapped, skirt.faces, 30.0), skirt.bones, influences, **options
    )
    error = true_error(mapped, result.skinning, spread(400, count))
    return result, row | {"floor": floor, "rmse of 400 frames": error}


def clips(size: int) -> Row:
    """Solve clips of 20 to 60 frames, far apart in one endless motion."""
    skirt, folder = Skirt(vertices=3000, columns=8, influences=4), FOLDER / "clips"
    folder.mkdir(exist_ok=True)
    lengths = np.random.default_rng(2).integers(20, 61, size).tolist()
    paths = [folder / f"{k:04d}.npy" for k in range(size)]
    for k, (path, length) in enumerate(zip(paths, lengths, strict=True)):
        if not path.is_file():
            np.save(path, skirt.block(200 * k, length)[0])

    def shots() -> list[ssdr.MeshSequence]:
        return [
            ssdr.MeshSequence(np.load(path, mmap_mode="r"), skirt.faces, 30.0) for path in paths
        ]

    result, row = solved(shots, skirt.bones, 4)
    model, squares, floors, count = result.skinning, 0.0, 0.0, 0
    for k in range(0, size, 25):
        span = slice(*result.offsets[k : k + 2])
        again = common.reskin(model.rest, model.indices, model.weights, model.transforms[span])
        squares += float(((again - np.load(paths[k])) ** 2).sum())
        floors += skirt.block(200 * k, lengths[k])[1]
        count += lengths[k] * skirt.vertices
    return row | {
        "frames": sum(lengths),
        "floor": float(np.sqrt(floors / count)),
        "rmse of 40 clips": float(np.sqrt(squares / count)),
    }


KINDS = {f.__name__: f for f in (frames, vertices, clips)}


def measure(kind: str, size: int, **options: Any) -> Row:
    FOLDER.mkdir(parents=True, exist_ok=True)
    return KINDS[kind](size, **options)


if __name__ == "__main__":
    columns = ("wall", "cpu", "anonymous MiB", "rmse", "floor", "ratio")
    common.run(__file__, __doc__, CASES, measure, columns)
