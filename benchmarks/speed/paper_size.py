"""The paper's own size: 12,273 vertices, 40,000 frames, 80 bones, 8 influences, from disk.

The sequence is made once, resumable, as a .npy of 5.9 GB that is mapped, never
read whole: a skirt's rig of 16 columns of 5 bones each, swinging with frequencies
that never repeat, 48 travelling waves along the normals, and noise.  It is of full
rank and no LBS fits it; how far it is from the LBS that it was made with (waves and
noise together) is the floor.

    # all of it, 6 GB of disk; cost over frames; beside a solve in memory; Dem Bones on few frames
    python benchmarks/speed/paper_size.py --data DIR
    python benchmarks/speed/paper_size.py --data DIR --frames 2500 5000 10000
    python benchmarks/speed/paper_size.py --data DIR --frames 5000 --subset 500
    python benchmarks/speed/paper_size.py --data DIR --frames --dem-bones 100 400 1000

A run that was killed goes on from its last checkpoint when started again with
--resume.  Written: benchmarks/results/paper_size.json.
"""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import Delaunay, cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from ssdr.drivers.streamed_state import StreamedState

VERTICES, FRAMES, BONES, INFLUENCES = 12_273, 40_000, 80, 8
COLUMNS, RINGS, REACH, SWING = 16, 5, 0.18, 0.08
WAVES, WAVE, NOISE = 48, 0.01, 0.0005  # waves and noise: RMS in units; the skirt is 2 units high
BLOCK = 250


def _tube(around: np.ndarray, height: np.ndarray) -> np.ndarray:
    around, height = np.broadcast_arrays(around, height)
    radius = 0.65 - 0.15 * height
    return np.stack([radius * np.cos(around), height, radius * np.sin(around)], axis=-1)


class Source:
    """The sequence as a function of the frame: any block can be made by itself."""

    def __init__(
        self, vertices: int = VERTICES, columns: int = COLUMNS, influences: int = INFLUENCES
    ) -> None:
        rng = np.random.default_rng(0)
        self.vertices, self.columns, self.bones = vertices, columns, columns * RINGS
        k = np.arange(vertices)
        height = 2.0 * (k + 0.5) / vertices
        angle = 2.399963229728653 * k  # the golden angle: even everywhere
        turned = np.mod(angle, 2 * np.pi)
        self.rest = _tube(turned, height)
        self.normal = np.stack([np.cos(turned), np.zeros(self.vertices), np.sin(turned)], axis=1)
        # Unrolled; the seam stays open, as in a coat.
        self.faces = Delaunay(np.stack([turned * 0.5, height], axis=1)).simplices.astype(np.int32)
        # A skirt's rig: columns of bones from waist to hem, each turning about its upper end.
        around = 2 * np.pi * (np.arange(self.columns) + 0.5) / self.columns
        level = 2.0 - 2.0 * np.arange(RINGS) / RINGS
        self.around, self.joints_at = around, _tube(around[:, None], level)
        middle = _tube(around[:, None], level - 1.0 / RINGS).reshape(self.bones, 3)
        distance, near = cKDTree(middle).query(self.rest, k=influences)
        weights = np.exp(-((distance / REACH) ** 2)) + 1e-9
        self.weights, self.indices = weights / weights.sum(1, keepdims=True), near.astype(np.int32)
        # Swing out, swing sideways and twist of every joint: a slow field around the skirt, and
        # each bone's own; nine sines of incommensurate rates.
        self.rates = 2 * np.pi * rng.uniform(0.05, 1.6, 9) / 30
        place = np.stack([np.ones(self.columns), np.cos(around), np.sin(around)], axis=1)
        field = np.einsum("rdk,ck->rdc", rng.normal(size=(9, 3, 3)), place)[..., None]
        own = rng.normal(size=(9, 3, self.columns, RINGS))
        self.size = SWING * (0.8 * field + 0.6 * own) * np.array([1, 0.6, 0.6])[:, None, None]
        self.phase = rng.uniform(0, 2 * np.pi, (9, 3, 1, 1)) + rng.uniform(0, 1.5, own.shape)
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

        angle = np.sin(
            frames[:, None, None, None, None] * self.rates[:, None, None, None] + self.phase
        )
        swing, side, twist = np.moveaxis((self.size * angle).sum(axis=1), 1, 0)
        cos, sin, none = np.cos(self.around), np.sin(self.around), np.zeros(self.columns)
        out, tangent = np.stack([cos, none, sin], axis=1), np.stack([-sin, none, cos], axis=1)
        vector = swing[..., None] * tangent[:, None] + side[..., None] * out[:, None]
        vector[..., 1] += twist
        turn = Rotation.from_rotvec(vector.reshape(-1, 3)).as_matrix()
        turn = turn.reshape(len(frames), self.columns, RINGS, 3, 3)
        result = np.empty((len(frames), self.columns, RINGS, 3, 4))
        linear = np.broadcast_to(np.eye(3), (len(frames), self.columns, 3, 3))
        shift = np.zeros((len(frames), self.columns, 3))
        for ring in range(RINGS):
            at = self.joints_at[:, ring]
            moved = np.einsum("tcab,cb->tca", linear, at) + shift
            linear = linear @ turn[:, :, ring]
            shift = moved - np.einsum("tcab,cb->tca", linear, at)
            result[:, :, ring, :, :3], result[:, :, ring, :, 3] = linear, shift
        return result.reshape(len(frames), self.bones, 3, 4)

    def block(self, first: int, count: int) -> tuple[np.ndarray, float]:
        """Frames as float32 ``(F, V, 3)`` and their squared distance to their own LBS."""
        frames = np.arange(first, first + count)
        exact = ssdr.skin(self.rest, self.indices, self.weights, self.transforms(frames))
        out = np.empty((count, self.vertices, 3), np.float32)
        square, turned = 0.0, frames[:, None] * self.speed
        # cos(x - st), taken apart: one product for all frames.
        time = np.concatenate([np.cos(turned), np.sin(turned)], axis=1) * np.tile(self.share, 2)
        waves = time @ self.waves.T
        for k, frame in enumerate(frames):
            rng = np.random.default_rng([1, int(frame)])
            noise = rng.standard_normal((self.vertices, 3), np.float32) * (NOISE / np.sqrt(3))
            out[k] = exact[k] + waves[k][:, None] * self.normal + noise
            square += float(((out[k] - exact[k]) ** 2).sum())
        return out, square


def make(source: Source, path: Path, frames: int, whole: int) -> None:
    """Write what is missing of the first `frames` of `whole`; the file has holes for the others."""
    state = path.with_suffix(".json")
    if not path.is_file():
        shape = (whole, source.vertices, 3)
        np.lib.format.open_memmap(path, "w+", dtype=np.float32, shape=shape).flush()
        state.write_text("[]")
    squares = json.loads(state.read_text())
    target = np.load(path, mmap_mode="r+")
    for first in range(len(squares) * BLOCK, frames, BLOCK):
        block, square = source.block(first, min(BLOCK, whole - first))
        target[first : first + len(block)] = block
        squares.append(square)
        common.write_json(state, squares)
        print(f"\rmade {first + len(block)} of {frames} frames", end="", flush=True)
    target.flush()


def floor_of(path: Path, frames: int, vertices: int) -> float:
    """RMS of waves and noise over the first frames, a multiple of BLOCK."""
    squares = json.loads(path.with_suffix(".json").read_text())
    return float(np.sqrt(sum(squares[: frames // BLOCK]) / (frames * vertices)))


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


def true_error(vertices: Any, model: Any, frames: np.ndarray) -> float:
    """RMSE of a model on the named frames by plain NumPy."""
    square = 0.0
    for t in frames:
        again = common.reskin(model.rest, model.indices, model.weights, model.transforms[t : t + 1])
        square += float(((again[0] - vertices[t]) ** 2).sum())
    return float(np.sqrt(square / (len(frames) * len(model.rest))))


class Follower:
    """A callback that says where the run is and keeps the seconds of each phase."""

    def __init__(self) -> None:
        self.phases: dict[str, list[float]] = {}
        self._told, self._wall, self._cpu = 0.0, time.perf_counter(), time.process_time()

    def __call__(self, p: ssdr.Progress) -> None:
        self.lap(p.phase)
        if time.perf_counter() - self._told > 15:
            self._told = time.perf_counter()
            left = "" if p.time_left == float("inf") else f", {p.time_left:.0f} s left"
            print(f"{p.elapsed:7.0f} s  {p.phase:<12} RMSE {p.rmse:.6g}{left}", flush=True)

    def lap(self, phase: str) -> None:
        wall, cpu = time.perf_counter(), time.process_time()
        spent = self.phases.setdefault(phase, [0.0, 0.0])
        spent[0] += round(wall - self._wall, 3)
        spent[1] += round(cpu - self._cpu, 3)
        self._wall, self._cpu = wall, cpu


def measured(
    make_input: Callable[[], Any],
    *,
    bones: int,
    influences: int,
    effort: str,
    checkpoint: Path,
    resume: bool,
) -> tuple[Any, dict[str, Any]]:
    """From the file to the skinned model: the result, and what it took."""
    rates = common.machine()
    memory = Memory()
    memory.start()
    wall, cpu = time.perf_counter(), time.process_time()
    follow = Follower()
    sequence = make_input()
    follow.lap("check")
    result = ssdr.decompose(
        sequence,
        bones=bones,
        influences=influences,
        effort=effort,
        callback=follow,
        checkpoint=checkpoint,
        resume=checkpoint if resume and checkpoint.is_file() else None,
    )
    follow.lap("error and result")
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    memory.over.set()
    streamed = StreamedState.of(result.state)
    return result, {
        "effort": effort, "wall_s": wall, "cpu_s": cpu, "compile_s": result.compile_seconds,
        "anonymous_MiB": memory.most, "rmse": result.rmse, "stop": result.stop_reason,
        "representative_frames": 0 if streamed is None else len(streamed.scan.chosen),
        "passes": [] if streamed is None else [p[2] for p in streamed.passes],
        "phases_wall_cpu_s": follow.phases,
        "resumed": resume, "threads": ssdr.get_threads(), "machine": rates,
    }  # fmt: skip


def one(path: Path, source: Source, frames: int, effort: str, resume: bool) -> tuple[Any, Any]:
    """Solve the first `frames` frames from disk."""
    vertices = np.load(path, mmap_mode="r")[:frames]
    result, row = measured(
        lambda: ssdr.MeshSequence(vertices, source.faces, 30.0),
        bones=source.bones,
        influences=INFLUENCES,
        effort=effort,
        resume=resume,
        checkpoint=path.with_name(f"checkpoint_{frames}_{effort}.npz"),
    )
    floor = floor_of(path, frames, source.vertices)
    some = np.unique(np.linspace(0, frames - 1, 400).astype(int))
    row = {
        "frames": frames,
        "floor": floor,
        "over_floor": result.rmse / floor,
        "rmse_reskinned_400": true_error(vertices, result.skinning, some),
        **row,
    }
    return result, row


def beside(path: Path, source: Source, streamed: Any, count: int, effort: str) -> dict[str, Any]:
    """A streamed model against one solved in memory, uncompressed, on evenly spread frames."""
    from ssdr.drivers import scan
    from ssdr.solver import trajectories

    frames = len(streamed.skinning.transforms)
    vertices = np.load(path, mmap_mode="r")
    some = np.unique(np.linspace(0, frames - 1, count).astype(int))
    scan._IN_MEMORY = 1 << 40
    trajectories._TAIL = 0.0  # of what compression may lose
    inner, row = measured(
        lambda: ssdr.MeshSequence(vertices[some], source.faces, 30.0),
        bones=source.bones,
        influences=INFLUENCES,
        effort=effort,
        resume=False,
        checkpoint=path.with_name("checkpoint_subset.npz"),
    )
    error = true_error(vertices, streamed.skinning, some)
    return {
        "subset": len(some),
        "of_frames": frames,
        "in_memory": inner.rmse,
        "streamed": error,
        "ratio": error / inner.rmse,
        "wall_s": row["wall_s"],
        "cpu_in_memory_s": row["cpu_s"],
        "machine": row["machine"],
    }


def dem_bones(path: Path, source: Source, frames: int) -> dict[str, Any]:
    """Dem Bones on evenly spread frames: its start, two iterations, and 30 of them by these."""
    from benchmarks.peers import solvers

    vertices = np.load(path, mmap_mode="r")
    some = np.linspace(0, FRAMES - 1, frames).astype(int)
    job = {"solver": "dem bones", "bones": BONES, "influences": INFLUENCES, "iterations": 2}
    pace = solvers.Pace(np.inf)
    pace._left = np.inf  # nobody takes turns with it here
    row = solvers.run_dem_bones(job, vertices[some], source.faces, pace)
    (_, _, begin, _), *_, (_, _, end, e) = row["curve"]
    return {
        "dem_bones_frames": frames,
        "bones_found": row["bones found"],
        "start_cpu_s": begin,
        "iteration_cpu_s": (end - begin) / 2,
        "cpu_30_s": begin + 15 * (end - begin),
        "E": e,
        "machine": common.machine(),
    }


def exponent(points: list[tuple[float, float]]) -> float:
    x, y = np.log(np.array(sorted(points), float)).T
    return float(np.polyfit(x, y, 1)[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder outside the checkout")
    parser.add_argument("--frames", type=int, nargs="*", default=[FRAMES], help="multiples of 250")
    parser.add_argument("--subset", type=int, default=0)
    parser.add_argument("--dem-bones", type=int, nargs="*", default=[])
    parser.add_argument("--effort", default="balanced")
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--make", action="store_true", help="make the file and stop")
    options = parser.parse_args()
    options.data.mkdir(parents=True, exist_ok=True)
    path, source = options.data / "paper_size.npy", Source()
    most = FRAMES if options.dem_bones else max(options.frames, default=BLOCK)
    make(source, path, most, FRAMES)
    if options.make:
        return
    file = common.RESULTS / "paper_size.json"
    kept: list[dict[str, Any]] = json.loads(file.read_text()) if file.is_file() else []

    def keep(row: dict[str, Any], *key: str) -> None:
        print(common.table([row], [k for k, v in row.items() if not isinstance(v, (dict, list))]))
        kept[:] = [r for r in kept if any(r.get(k) != row[k] for k in key)] + [row]
        common.write_json(file, kept)

    for frames in sorted(options.frames):
        result, row = one(path, source, frames, options.effort, options.resume)
        keep(row, "frames", "effort")
        if options.subset and frames == most:
            keep(
                beside(path, source, result, options.subset, options.effort), "subset", "of_frames"
            )
    for frames in options.dem_bones:
        keep(dem_bones(path, source, frames), "dem_bones_frames")
    solved = [
        (r["frames"], r["cpu_s"])
        for r in kept
        if r.get("effort") == options.effort and "frames" in r and not r["resumed"]
    ]
    peer = [(r["dem_bones_frames"], r["cpu_30_s"]) for r in kept if "cpu_30_s" in r]
    if len(solved) > 1:
        print(f"ssdr: CPU time grows as F^{exponent(solved):.2f}")
    if len(peer) > 1:
        # a start and weights that cost the same at any F, and a share of each frame: a line
        slope, constant = np.polyfit(*np.array(sorted(peer), float).T, 1)
        hours = (constant + slope * FRAMES) / 3600
        print(
            f"Dem Bones: {constant:.0f} s + {slope:.3g} s a frame; 30 iterations at {FRAMES} "
            f"frames: {hours:.1f} CPU hours"
        )


if __name__ == "__main__":
    main()
