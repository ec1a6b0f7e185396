"""Limbs through the cloth: the simulation's own, a live garment's, and after each push-out.

From a store of test clips, and of recorded motions if it has some::

    garmentnet simulate dress --motion BVH_FOLDER -o out/dress.clips
    python benchmarks/garment/limbs.py out/dress.clips dress --write

Of the frames of the test dances, and of the recorded clips of every split: the share in which a
triangle of the body crosses one of the cloth that can move, in which one does so by more than
5 mm, the deepest crossing (mm), the error over all vertices (mm), and milliseconds a frame of
one thread, processor time.  *Shortest way* is :class:`PushOut`, *outward* :class:`OutwardPush`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from benchmarks.garment.live import native

RESULTS = Path(__file__).resolve().parents[1] / "results" / "garment-limbs.json"
METHODS = ("simulation", "predicted", "shortest way", "outward")


def measure(store_path: Path, network: str, pattern: str) -> dict[str, Any]:
    """Figures by group of clips and method."""
    from garmentnet.collision.crossings import DEEP, find_crossings
    from garmentnet.collision.outward import push_of
    from garmentnet.collision.push_out import PushOut
    from garmentnet.data.store import ClipStore
    from garmentnet.evaluation.reporting import RECORDED, group_of
    from garmentnet.runtime import load_live

    store, garment = ClipStore.open(store_path), load_live(network)
    s = garment.subject
    pinned = s.carried
    short = PushOut(s.body, s.garment.faces, pinned=pinned)
    outward = push_of(s)
    assert outward is not None
    found: dict[str, dict[str, list[Any]]] = {}
    for clip in store.clips():
        group = group_of(clip)
        if not Path(clip.name).match(pattern) or (clip.split != "test" and group != RECORDED):
            continue
        joints, began = np.asarray(clip.joints, np.float64), time.process_time()
        predicted = native(garment, joints, clip.parameters)
        spent = time.process_time() - began
        truth = np.asarray(clip.sequence.frames(slice(None)))
        pushes: tuple[Callable[[Any, Any], NDArray[Any]], ...] = (
            lambda v, m: short(v[None], m[None]).vertices[0],
            outward.frame,
        )
        moved, seconds = [], [0.0, spent]
        for push in pushes:
            push(predicted[0], joints[0])
            began = time.process_time()
            moved.append(np.stack([push(v, m) for v, m in zip(predicted, joints, strict=True)]))
            seconds.append(time.process_time() - began)
        for method, v, t in zip(METHODS, (truth, predicted, *moved), seconds, strict=True):
            x = find_crossings(s.body, s.garment.faces, v, joints, pinned=pinned)
            square = ((v - truth).astype(np.float64) ** 2).sum(-1).mean(-1)
            row = found.setdefault(group, {}).setdefault(method, [])
            row.append((x.pairs > 0, x.depth, square, t))
        print(clip.name, {k: f"{100 * v[-1][0].mean():.1f} %" for k, v in found[group].items()})
    return {
        group: {method: _figures(parts, DEEP) for method, parts in methods.items()}
        for group, methods in found.items()
    }


def _figures(parts: list[Any], deep: float) -> dict[str, float]:
    crossed, depth, square = (np.concatenate([p[k] for p in parts]) for k in range(3))
    return {
        "frames": len(crossed),
        "crossed_percent": round(100 * float(crossed.mean()), 2),
        "deep_percent": round(100 * float((depth > deep).mean()), 2),
        "deepest_mm": round(1e3 * float(depth.max()), 1),
        "rmse_mm": round(1e3 * float(np.sqrt(square.mean())), 2),
        "ms": round(1e3 * sum(p[3] for p in parts) / len(crossed), 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("network", nargs="?", default="dress")
    parser.add_argument("--clips", default="*", help="pattern of names")
    parser.add_argument("--write", action="store_true", help=f"write {RESULTS.name}")
    chosen = parser.parse_args()
    groups = measure(chosen.store, chosen.network, chosen.clips)
    for group, rows in groups.items():
        print(group)
        table = [{"method": k, **v} for k, v in rows.items()]
        print(common.table(table, list(table[0])))
    if chosen.write:
        command = "python benchmarks/garment/limbs.py out/dress.clips dress --write"
        content = {"command": command, "revision": common.revision(), "groups": groups}
        common.write_json(RESULTS, content)


if __name__ == "__main__":
    main()
