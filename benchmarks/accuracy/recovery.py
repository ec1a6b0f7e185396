"""Is data that is exact linear blend skinning recovered, and does the error never rise on the way?

    python benchmarks/accuracy/recovery.py --effort balanced best

fox: a game character's own skinning, baked (24 joints, 4 influences, float32).  chain: a tube that
this file bends by smooth, overlapping weights (up to 4 a vertex, float64).  The way is walked by
stopping and resuming: at each stop the model is re-skinned here, so that what rises is seen even
where the solver's own account of it would not show it.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import (
    IMAGES,
    RESULTS,
    defects,
    load,
    machine,
    pyplot,
    reskin,
    save_figure,
    table,
    tell,
    write_json,
)

EFFORTS = ("fast", "balanced", "best")
INFLUENCES = 4
GOAL = 1e-4


def chain(bones: int = 6, frames: int = 60, seed: int = 7) -> np.ndarray:
    """A tube of 80 rings of 16 vertices on a chain of joints that swing and twist."""
    rng = np.random.default_rng(seed)
    along = np.linspace(0.0, bones, 80)
    angle = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    x, a = (m.ravel() for m in np.meshgrid(along, angle, indexing="ij"))
    rest = np.stack([x, 0.35 * np.cos(a), 0.25 * np.sin(a)], axis=1)
    dense = np.exp(-(((x[:, None] - np.arange(bones) - 0.5) / 0.8) ** 2))
    indices = np.argsort(-dense, axis=1, kind="stable")[:, :INFLUENCES]
    weights = np.take_along_axis(dense, indices, axis=1)
    weights[weights < 0.01] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    time = np.arange(frames) / 24.0
    phase, speed = rng.uniform(0, 2 * np.pi, (bones, 3)), rng.uniform(1.0, 4.0, (bones, 3))
    swing = np.sin(time[:, None, None] * speed + phase) * np.array([0.3, 0.4, 0.5])
    transforms = np.empty((frames, bones, 3, 4))
    for t in range(frames):
        world = np.eye(4)
        for j in range(bones):
            local = np.eye(4)
            local[:3, :3] = _euler(swing[t, j])
            pivot = np.array([j, 0.0, 0.0])
            local[:3, 3] = pivot - local[:3, :3] @ pivot
            world = world @ local
            transforms[t, j] = world[:3]
    return reskin(rest, indices, weights, transforms)


def _euler(angles: np.ndarray) -> np.ndarray:
    out = np.eye(3)
    for axis, angle in enumerate(angles):
        c, s = np.cos(angle), np.sin(angle)
        i, k = [(1, 2), (2, 0), (0, 1)][axis]
        turn = np.eye(3)
        turn[i, i] = turn[k, k] = c
        turn[i, k], turn[k, i] = -s, s
        out = out @ turn
    return out


def distances(frames: np.ndarray, model: Any) -> np.ndarray:
    again = reskin(model.rest, model.indices, model.weights, model.transforms)
    return np.linalg.norm(np.asarray(frames, dtype=np.float64) - again, axis=-1)


def recover(name: str, frames: np.ndarray, bones: int, effort: Any, seed: int) -> dict[str, Any]:
    diagonal = ssdr.MeshSequence(frames).diagonal()
    result = ssdr.decompose(frames, bones=bones, influences=INFLUENCES, effort=effort, rng=seed)
    wrong = defects(result.skinning, bones, INFLUENCES)
    if wrong:
        raise SystemExit(f"{name}, {effort}: {'; '.join(wrong)}")
    d = distances(frames, result.skinning)
    rmse = float(np.sqrt((d * d).mean()))
    return {
        "data": name,
        "B": bones,
        "effort": effort,
        "seed": seed,
        "rmse / diagonal": rmse / diagonal,
        "max / diagonal": float(d.max()) / diagonal,
        "E": 1000 * rmse / np.sqrt(3),
        "seconds": result.state.progress["elapsed"],
        "reached": rmse <= GOAL * diagonal,
        "stopped": result.stop_reason,
        "history": [(r.elapsed, r.rmse / diagonal) for r in result.history],
    }


def walk(
    name: str, frames: np.ndarray, bones: int, effort: Any, seed: int, stride: int
) -> dict[str, Any]:
    """RMSE of the handed-out model after every few iterations, each by resuming the last."""
    diagonal = ssdr.MeshSequence(frames).diagonal()
    state, errors, iterations = None, [], []
    for stop in range(1, 100_000, stride):
        result = ssdr.decompose(
            frames,
            bones=bones,
            influences=INFLUENCES,
            effort=effort,
            rng=seed,
            max_iterations=stop,
            resume=state,
        )
        state = result.state
        d = distances(frames, result.skinning)
        errors.append(float(np.sqrt((d * d).mean())) / diagonal)
        iterations.append(result.history[-1].iteration)
        if result.stop_reason != "iterations":
            break
    steps = np.array(errors)
    rises = np.diff(steps) / steps[:-1]
    return {
        "data": name,
        "effort": effort,
        "stops": len(errors),
        "first": errors[0],
        "last": errors[-1],
        "largest rise, relative": float(max(0.0, rises.max(initial=0.0))),
        "iteration": iterations,
        "rmse / diagonal": errors,
    }


def chart(rows: list[dict[str, Any]], path: Path) -> None:
    plt = pyplot()
    names = list(dict.fromkeys(row["data"] for row in rows))
    figure, axes = plt.subplots(1, len(names), figsize=(9, 3.4), squeeze=False)
    colours = dict(zip(EFFORTS, ("#e69f00", "#0072b2", "#009e73"), strict=True))
    for axis, name in zip(axes.flat, names, strict=True):
        drawn: set[str] = set()
        for row in rows:
            if row["data"] == name:
                label = None if row["effort"] in drawn else row["effort"]
                drawn.add(row["effort"])
                axis.step(
                    *np.array(row["history"]).T,
                    where="post",
                    label=label,
                    color=colours[row["effort"]],
                )
        axis.axhline(GOAL, color="0.4", linestyle="--", linewidth=0.8)
        axis.set(
            xscale="log",
            yscale="log",
            title=name,
            xlabel="seconds since the call",
            ylabel="RMSE / diagonal",
        )
        axis.legend(fontsize=7)
    save_figure(figure, path)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--effort", nargs="+", choices=EFFORTS, default=["balanced"])
    parser.add_argument("--data", nargs="+", choices=["fox", "chain"], default=["fox", "chain"])
    parser.add_argument("--rng", nargs="+", type=int, default=[0], help="seeds")
    parser.add_argument("--stride", type=int, default=4, help="iterations between two stops")
    parser.add_argument("--out", type=Path, default=RESULTS / "recovery.json")
    parser.add_argument("--chart", type=Path, default=IMAGES / "recovery.png")
    args = parser.parse_args()
    old = json.loads(args.out.read_text()) if args.out.exists() else {"recovered": [], "walks": []}
    found = {(r["data"], r["effort"], r["seed"]): r for r in old["recovered"]}
    walks = {(r["data"], r["effort"]): r for r in old["walks"]}
    data = {"fox": (load("fox")[0], 24), "chain": (chain(), 6)}
    rates = machine()
    for name in args.data:
        frames, bones = data[name]
        for effort in args.effort:
            for seed in args.rng:
                found[name, effort, seed] = recover(name, frames, bones, effort, seed) | rates
            if effort != "best":
                walks[name, effort] = walk(name, frames, bones, effort, args.rng[0], args.stride)
            rows = [found[k] for k in sorted(found)]
            ways = [walks[k] for k in sorted(walks)]
            write_json(
                args.out, {"question": __doc__.splitlines()[0], "recovered": rows, "walks": ways}
            )
    chart(rows, args.chart)
    print(table(rows, (
        "data", "B", "effort", "seed", "rmse / diagonal", "max / diagonal", "E", "seconds",
        "reached", "stopped", "load",
    )))  # fmt: skip
    print()
    print(table(ways, ("data", "effort", "stops", "first", "last", "largest rise, relative")))
    print(tell(rates))


if __name__ == "__main__":
    main()
