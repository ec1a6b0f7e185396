"""The paper's own size: 12,273 vertices, 40,000 frames, 80 bones, 8 influences, from disk.

The sequence is made once, resumable, as a .npy of 5.9 GB that is mapped, never
read whole: a skinned motion of 80 bones with frequencies that never repeat, 48
travelling waves along the normals, and noise.  It is of full rank and no LBS
fits it; how far it is from the LBS that it was made with (waves and noise
together) is the floor.

    python benchmarks/paper_size.py --data DIR              # the whole: 6 GB, about half an hour
    python benchmarks/paper_size.py --data DIR --frames 2500 5000 10000    # cost
    python benchmarks/paper_size.py --data DIR --subset 1000    # beside one in memory

Written: benchmarks/results/paper_size.json, a line for each F.
"""

from __future__ import annotations

import argparse
import json
import os
import threading
import time
from pathlib import Path
from typing import Any

import common
import numpy as np
from scipy.spatial import Delaunay, cKDTree

import ssdr

VERTICES, BONES, INFLUENCES = 12_273, 80, 8
WAVES, WAVE, NOISE = 48, 0.004, 0.0005  # waves and noise: RMS in units; the tube is 2 units high
BLOCK = 250


class Source:
    """The sequence as a function of the frame: any block can be made by itself."""

    def __init__(self, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        k = np.arange(VERTICES)
        height = 2.0 * (k + 0.5) / VERTICES
        angle = 2.399963229728653 * k  # the golden angle: even everywhere
        turned = np.mod(angle, 2 * np.pi)
        radius = 0.35 + 0.15 * height
        self.rest = np.stack([radius * np.cos(turned), height, radius * np.sin(turned)], axis=1)
        self.normal = np.stack([np.cos(turned), np.zeros(VERTICES), np.sin(turned)], axis=1)
        # Unrolled; the seam stays open, as in a coat.
        self.faces = Delaunay(np.stack([turned * 0.5, height], axis=1)).simplices.astype(np.int32)
        centres = self.rest[:: VERTICES // BONES][:BONES]
        distance, near = cKDTree(centres).query(self.rest, k=INFLUENCES)
        weights = np.exp(-((distance / 0.18) ** 2)) + 1e-9
        self.weights, self.joints = weights / weights.sum(1, keepdims=True), near.astype(np.int32)
        self.centres = centres
        # Each bone turns and moves by nine sines of incommensurate rates; the bones below swing
        # more, and neighbours alike.
        self.rates = 2 * np.pi * rng.uniform(0.05, 1.6, 9) / 30
        field = rng.normal(size=(9, 6, 4))
        place = np.concatenate([np.ones((BONES, 1)), centres], axis=1)
        own = rng.normal(size=(9, 6, BONES)) * 0.35
        self.size = (np.einsum("rcd,bd->rcb", field, place) + own) * (2.2 - centres[:, 1])
        self.size *= np.array([0.15] * 3 + [0.05] * 3)[None, :, None]
        self.phase = rng.uniform(0, 2 * np.pi, (9, 6, BONES))
        across = rng.integers(-6, 7, WAVES)
        along = rng.uniform(2, 25, WAVES)
        where = turned[:, None] * across + height[:, None] * along
        self.waves = np.concatenate([np.cos(where), np.sin(where)], axis=1)
        self.speed = 2 * np.pi * rng.uniform(0.1, 2.0, WAVES) / 30
        self.share = rng.uniform(0.5, 1.0, WAVES)
        self.share *= WAVE * np.sqrt(2 / (self.share**2).sum())

    def transforms(self, frames: np.ndarray) -> np.ndarray:
        """Rigid ``(F, B, 3, 4)``: turns about the bones' centres, then moves."""
        from scipy.spatial.transform import Rotation

        angle = np.sin(frames[:, None, None, None] * self.rates[:, None, None] + self.phase)
        values = (self.size * angle).sum(axis=1)
        turn = Rotation.from_rotvec(values[:, :3].transpose(0, 2, 1).reshape(-1, 3)).as_matrix()
        turn = turn.reshape(len(frames), BONES, 3, 3)
        moved = values[:, 3:].transpose(0, 2, 1) + self.centres
        moved = moved - (turn @ self.centres[None, :, :, None])[..., 0]
        return np.concatenate([turn, moved[..., None]], axis=-1)

    def block(self, first: int, count: int) -> tuple[np.ndarray, float]:
        """Frames as float32 ``(F, V, 3)`` and their squared distance to their own LBS."""
        frames = np.arange(first, first + count)
        exact = ssdr.skin(self.rest, self.joints, self.weights, self.transforms(frames))
        out = np.empty((count, VERTICES, 3), np.float32)
        square, turned = 0.0, frames[:, None] * self.speed
        # cos(x - st), taken apart: one product for all frames.
        time = np.concatenate([np.cos(turned), np.sin(turned)], axis=1) * np.tile(self.share, 2)
        waves = time @ self.waves.T
        for k, frame in enumerate(frames):
            rng = np.random.default_rng([1, int(frame)])
            noise = rng.standard_normal((VERTICES, 3), np.float32) * (NOISE / np.sqrt(3))
            out[k] = exact[k] + waves[k][:, None] * self.normal + noise
            square += float(((out[k] - exact[k]) ** 2).sum())
        return out, square


def make(source: Source, path: Path, frames: int) -> None:
    """Write what is missing of the first `frames` frames."""
    state = path.with_suffix(".json")
    if not path.is_file():
        shape = (frames, VERTICES, 3)
        np.lib.format.open_memmap(path, "w+", dtype=np.float32, shape=shape).flush()
        state.write_text("[]")
    squares = json.loads(state.read_text())
    target = np.load(path, mmap_mode="r+")
    if len(target) < frames:
        raise SystemExit(f"{path} holds {len(target)} frames; delete it to make {frames}")
    for first in range(len(squares) * BLOCK, frames, BLOCK):
        block, square = source.block(first, min(BLOCK, frames - first))
        target[first : first + len(block)] = block
        squares.append(square)
        common.write_json(state, squares)
        print(f"\rmade {first + len(block)} of {frames} frames", end="", flush=True)
    target.flush()
    print()


class Memory(threading.Thread):
    """The most anonymous memory that this process held, MiB; mapped files do not count."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.most, self.over = 0.0, threading.Event()

    def run(self) -> None:
        while not self.over.wait(0.05):
            text = Path("/proc/self/status").read_text()
            line = next(x for x in text.splitlines() if x.startswith("RssAnon"))
            self.most = max(self.most, int(line.split()[1]) / 1024)


def true_error(vertices: Any, model: Any, source_frames: np.ndarray) -> float:
    """RMSE of a model on the named frames by plain NumPy."""
    square = 0.0
    for t in source_frames:
        again = common.reskin(model.rest, model.joints, model.weights, model.transforms[t : t + 1])
        square += float(((again[0] - vertices[t]) ** 2).sum())
    return float(np.sqrt(square / (len(source_frames) * VERTICES)))


def one(path: Path, source: Source, frames: int, effort: str) -> dict[str, Any]:
    """Solve the first `frames` frames from disk."""
    vertices = np.load(path, mmap_mode="r")[:frames]
    rates = common.machine()
    memory = Memory()
    memory.start()
    wall, cpu = time.perf_counter(), time.process_time()
    told = [0.0]

    def follow(p: Any) -> None:
        if time.perf_counter() - told[0] > 15:
            told[0] = time.perf_counter()
            print(f"{p.elapsed:7.0f} s  {p.phase:<12} rmse {p.rmse:.6g}", flush=True)

    result = ssdr.decompose(
        ssdr.MeshSequence(vertices, source.faces, 30.0), bones=BONES, influences=INFLUENCES,
        effort=effort, callback=follow,
    )  # fmt: skip
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    memory.over.set()
    squares = json.loads(path.with_suffix(".json").read_text())
    floor = float(np.sqrt(sum(squares[: frames // BLOCK]) / (frames * VERTICES)))
    some = np.unique(np.linspace(0, frames - 1, 400).astype(int))
    return {
        "frames": frames, "effort": effort, "wall_s": wall, "cpu_s": cpu,
        "compile_s": result.compile_seconds, "anonymous_MiB": memory.most,
        "rmse": result.rmse, "rmse_reskinned_400": true_error(vertices, result.skinning, some),
        "floor": floor, "over_floor": result.rmse / floor, "stop": result.stop_reason,
        "machine": rates,
    }  # fmt: skip


def beside(path: Path, source: Source, count: int, effort: str) -> dict[str, Any]:
    """The streamed solve against one in memory, on `count` evenly spread frames."""
    vertices = np.load(path, mmap_mode="r")
    some = np.unique(np.linspace(0, len(vertices) - 1, count).astype(int))
    frames = np.stack([vertices[t] for t in some]).astype(np.float32)
    inner = ssdr.decompose(
        ssdr.MeshSequence(frames, source.faces, 30.0), bones=BONES, influences=INFLUENCES,
        effort=effort,
    )  # fmt: skip
    whole = ssdr.decompose(
        ssdr.MeshSequence(vertices, source.faces, 30.0), bones=BONES, influences=INFLUENCES,
        effort=effort,
    )  # fmt: skip
    streamed = true_error(vertices, whole.skinning, some)
    return {
        "subset": len(some), "in_memory": inner.rmse, "streamed": streamed,
        "ratio": streamed / inner.rmse,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder outside the checkout")
    parser.add_argument("--frames", type=int, nargs="*", default=[40_000])
    parser.add_argument("--subset", type=int, default=0)
    parser.add_argument("--effort", default="balanced")
    options = parser.parse_args()
    options.data.mkdir(parents=True, exist_ok=True)
    most = max(options.frames)
    path = options.data / f"paper_size_{max(most, 40_000) if most > 10_000 else most}.npy"
    source = Source()
    make(source, path, most)
    file = common.RESULTS / "paper_size.json"
    kept: list[dict[str, Any]] = json.loads(file.read_text()) if file.is_file() else []
    for frames in sorted(options.frames):
        row = one(path, source, frames, options.effort)
        print(common.table([row], [k for k in row if k != "machine"]))
        kept = [r for r in kept if (r.get("frames"), r.get("effort")) != (frames, options.effort)]
        kept.append(row)
        common.write_json(file, kept)
    if options.subset:
        row = beside(path, source, options.subset, options.effort)
        print(row)
        kept = [r for r in kept if "subset" not in r] + [row]
        common.write_json(file, kept)
    solved = sorted((r["frames"], r["cpu_s"]) for r in kept if "cpu_s" in r)
    if len(solved) > 1:
        f, s = np.log(np.array(solved, float)).T
        print(f"CPU time grows as F^{np.polyfit(f, s, 1)[0]:.2f}; process {os.getpid()}")


if __name__ == "__main__":
    main()
