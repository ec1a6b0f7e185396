"""Is the model that a tolerance asks for the smallest?

    python benchmarks/accuracy/parsimony.py

Ten small scenes, default options.  The error of each result is measured here by plain NumPy;
then a bone less is tried: ``effort="best"`` from three seeds, and from more of them in turn until
ten times the iterations are spent that the search itself spent on that number of bones.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.accuracy.recovery import chain
from benchmarks.common import (
    IMAGES,
    RESULTS,
    load,
    machine,
    pyplot,
    reskin,
    save_figure,
    table,
    tell,
    write_csv,
    write_json,
)

SEEDS, TIMES = 3, 10


def _turn(vector: np.ndarray) -> np.ndarray:
    angle = float(np.linalg.norm(vector)) or 1e-300
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def static() -> np.ndarray:
    pose = np.asarray(ssdr.samples.load("dancer_small").vertices[0])
    return np.repeat(pose[None], 12, axis=0)


def boxes(count: int, frames: int = 24, seed: int = 1) -> np.ndarray:
    """Separate boxes of points, each tumbling by itself."""
    rng = np.random.default_rng(seed)
    side = np.linspace(-1, 1, 4)
    box = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    axis, way = rng.standard_normal((2, count, 3))
    out = np.empty((frames, count, len(box), 3))
    for t in range(frames):
        for b in range(count):
            out[t, b] = box @ _turn(0.15 * t * axis[b]).T + 0.1 * t * way[b] + [4.0 * b, 0, 0]
    return out.reshape(frames, -1, 3)


def overlapping(bones: int = 6, vertices: int = 300, frames: int = 24, seed: int = 2) -> np.ndarray:
    """Exact skinning: unrelated bones, three random influences a vertex."""
    rng = np.random.default_rng(seed)
    rest = rng.uniform(-1, 1, (vertices, 3))
    indices = np.argsort(rng.random((vertices, bones)), axis=1)[:, :3]
    weights = rng.dirichlet([1.0, 1.0, 1.0], vertices)
    transforms = np.empty((frames, bones, 3, 4))
    for t in range(frames):
        for b in range(bones):
            transforms[t, b, :, :3] = _turn(0.7 * rng.standard_normal(3))
            transforms[t, b, :, 3] = 0.5 * rng.standard_normal(3)
    return reskin(rest, indices, weights, transforms)


def noisy(amount: float = 0.01) -> np.ndarray:
    frames = chain(5, 24, 3)[:, ::4]
    return frames + amount * np.random.default_rng(0).standard_normal(frames.shape)


def sheet(side: int = 18, frames: int = 24) -> np.ndarray:
    """A square sheet with two waves that travel through it."""
    x, y = np.meshgrid(np.linspace(0, 2, side), np.linspace(0, 2, side), indexing="ij")
    t = np.linspace(0, 2 * np.pi, frames, endpoint=False)[:, None, None]
    z = 0.15 * np.sin(3 * x - t) + 0.08 * np.sin(4 * y + x - 2 * t)
    flat = np.broadcast_to(np.stack([x, y], axis=-1), (frames, side, side, 2))
    return np.concatenate([flat, z[..., None]], axis=-1).reshape(frames, -1, 3)


def half(name: str) -> np.ndarray:
    return np.asarray(ssdr.samples.load(name).vertices[:, ::2], dtype=np.float64)


def sampled(name: str, vertices: int, frames: int) -> np.ndarray:
    every = load(name)[0]
    step = max(1, len(every) // frames)
    return np.asarray(every[::step, :: max(1, every.shape[1] // vertices)], dtype=np.float64)


SCENES: dict[str, tuple[Callable[[], np.ndarray], str, int | None]] = {
    "static mesh": (static, "0.5%", 1),
    "two boxes": (lambda: boxes(2), "0.01%", 2),
    "five boxes": (lambda: boxes(5), "0.01%", 5),
    "chain of 5, exact": (lambda: chain(5, 24, 3)[:, ::4], "0.1%", 5),
    "6 overlapping, exact": (overlapping, "0.01%", 6),
    "chain of 5, noise": (noisy, "0.4%", 5),
    "waving sheet": (sheet, "1%", None),
    "dancer": (lambda: half("dancer_small"), "0.5%", None),
    "horse_gallop": (lambda: sampled("horse_gallop", 400, 24), "0.8%", None),
    "cow_elastic": (lambda: sampled("cow_elastic", 400, 25), "1.5%", None),
}


def rmse_of(frames: np.ndarray, model: Any) -> float:
    gone = reskin(model.rest, model.indices, model.weights, model.transforms) - frames
    return float(np.sqrt((gone**2).sum() / (gone.shape[0] * gone.shape[1])))


def one_less(
    frames: np.ndarray, bones: int, spent: int, seeds: int, times: float
) -> tuple[list[float], int, float]:
    """Errors of every seed with `bones` bones, iterations, CPU seconds."""
    errors: list[float] = []
    iterations, began = 0, time.process_time()
    while len(errors) < seeds or iterations < times * spent:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ssdr.SsdrWarning)
            result = ssdr.decompose(frames, bones=bones, effort="best", rng=len(errors))
        errors.append(rmse_of(frames, result.skinning))
        iterations += int(result.state.progress["iteration"])
    return errors, iterations, time.process_time() - began


def scene(name: str, seeds: int, times: float) -> dict[str, Any]:
    make, asked, made = SCENES[name]
    frames = make()
    began = time.process_time()
    result = ssdr.decompose(frames, tolerance=asked)
    seconds = time.process_time() - began
    found = result.parsimony
    assert found is not None
    error = rmse_of(frames, result.skinning)
    bones, cost = found.bones, {p.what: p for p in found.prunings}
    row: dict[str, Any] = {
        "scene": name, "F": frames.shape[0], "V": frames.shape[1], "tolerance": asked,
        "made with": made, "B": bones, "least by rank": found.least_bones,
        "K": found.influences, "error / tolerance": error / found.tolerance,
        "held": bool(error <= found.tolerance or error < 1e-12 * np.abs(frames).max()),
        "tries": len(found.attempts),
        "iterations": sum(a.iterations for a in found.attempts), "CPU s": seconds,
        "bytes": found.size.total, "bytes with all": cost["influences"].bytes_before,
    }  # fmt: skip
    for what in ("influences", "keyframes"):
        row |= {
            f"{what} before": cost[what].before,
            f"{what} after": cost[what].after,
            f"{what} cost": cost[what].cost / found.tolerance,
        }
    row |= {
        "B - 1": None,
        "B - 1 errors": [],
        "B - 1 iterations": 0,
        "times": None,
        "B - 1 CPU s": 0.0,
        "smallest": True,
    }
    if bones > 1:
        spent = sum(a.iterations for a in found.attempts if a.bones == bones - 1)
        errors, iterations, cpu = one_less(frames, bones - 1, spent, seeds, times)
        ratios = [e / found.tolerance for e in errors]
        row |= {
            "B - 1": min(ratios),
            "B - 1 errors": ratios,
            "B - 1 iterations": iterations,
            "times": iterations / spent if spent else None,
            "B - 1 CPU s": cpu,
            "smallest": min(ratios) > 1,
        }
    return row


def chart(rows: list[dict[str, Any]], curves: dict[str, Any], path: Path) -> None:
    plt = pyplot()
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8), width_ratios=[1, 1.15])
    for (name, c), color in zip(curves.items(), ("#0072b2", "#d55e00", "#009e73"), strict=False):
        percent = np.maximum(c.percent, 1e-3)
        left.plot(c.bytes / 1e3, percent, ".-", color=color, label=name)
        left.plot(c.bytes[c.knee] / 1e3, percent[c.knee], "o", ms=10, mfc="none", color=color)
        left.annotate(
            f"{c.bones[c.knee]} bones",
            (c.bytes[c.knee] / 1e3, percent[c.knee]),
            color=color,
            xytext=(-8, -14),
            textcoords="offset points",
            ha="right",
            bbox={"fc": "white", "ec": "none", "pad": 0.5},
        )
    left.set(
        xscale="log",
        yscale="log",
        xlabel="kB, every frame a key",
        ylabel="RMSE, % of diagonal",
        title="error against size, knee marked",
    )
    left.set_xticks([6, 10, 20, 40], ["6", "10", "20", "40"])
    left.set_xticks([], minor=True)
    left.legend(loc="upper right", fontsize=7)
    place = np.arange(len(rows))[::-1]
    for y, row in zip(place, rows, strict=True):
        many = [max(v, 1e-3) for v in row["B - 1 errors"]]
        right.plot(many, [y] * len(many), "|", ms=9, color="#d55e00")
        right.plot(max(row["error / tolerance"], 1e-3), y, "o", color="#0072b2")
    right.plot([], [], "o", color="#0072b2", label="result")
    right.plot([], [], "|", color="#d55e00", label="one bone less, every try")
    right.axvline(1.0, color="k", lw=1)
    right.set_yticks(place, [f"{r['scene']}: {r['B']}" for r in rows])
    right.set(xscale="log", xlabel="RMSE / tolerance", title="ten scenes: bones found")
    right.legend(loc="lower left", fontsize=7)
    save_figure(figure, path)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", choices=SCENES, action="append", help="only these")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--times", type=float, default=TIMES)
    parser.add_argument("--out", type=Path, default=RESULTS / "parsimony.json")
    parser.add_argument("--chart", type=Path, default=IMAGES / "parsimony.png")
    args = parser.parse_args()
    ssdr.decompose(boxes(2, frames=3), bones=2, effort="fast", max_iterations=1)  # kernels ready
    rates = machine()
    rows = []
    for name in args.scene or SCENES:
        rows.append(scene(name, args.seeds, args.times))
        shown = ("scene", "B", "K", "error / tolerance", "B - 1", "times", "CPU s", "B - 1 CPU s")
        print({k: rows[-1][k] for k in shown}, flush=True)
    if args.scene:
        return
    curves = {
        "dancer": ssdr.parsimony.curve(ssdr.samples.load("dancer_small"), bones=40),
        "horse_gallop": ssdr.parsimony.curve(sampled("horse_gallop", 400, 24), bones=40),
        "chain of 5, exact": ssdr.parsimony.curve(chain(5, 24, 3)[:, ::4], bones=40),
    }
    write_json(
        args.out,
        {
            "question": __doc__.splitlines()[0],
            "scenes": rows,
            "curves": {
                name: {
                    "bones": c.bones.tolist(),
                    "bytes": c.bytes.tolist(),
                    "rmse": c.rmse.tolist(),
                    "percent": c.percent.tolist(),
                    "knee": int(c.bones[c.knee]),
                }
                for name, c in curves.items()
            },
            **rates,
        },
    )
    write_csv(
        args.out.with_suffix(".csv"),
        [{k: v for k, v in row.items() if k != "B - 1 errors"} for row in rows],
    )
    chart(rows, curves, args.chart)
    print(table(rows, ["scene", "F", "V", "tolerance", "made with", "B", "least by rank", "K",
                       "error / tolerance", "B - 1", "times", "CPU s"]))  # fmt: skip
    print(tell(rates))
    if not all(row["held"] and row["smallest"] for row in rows):
        raise SystemExit("a tolerance is not held, or a smaller model holds it")


if __name__ == "__main__":
    main()
