"""Charts of a garment evaluation: validation curves, errors, looseness, the ensemble over K.

    python benchmarks/garment/figures.py RUNS EVALUATION --out docs/images

RUNS is the folder with the runs of ``garmentnet train``, EVALUATION the one that
``garmentnet evaluate`` wrote.  Needs only their JSON files.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common


def _read(path: Path) -> Any:
    return json.loads(path.read_text("utf-8"))


def curves(runs: Path, out: Path) -> None:
    """Validation RMSE over epochs, a panel for each module."""
    plt = common.pyplot()
    histories = {p.parent.name: _read(p) for p in sorted(runs.glob("*/history.json"))}
    figure, axes = plt.subplots(1, 2, figsize=(11, 3.8))
    titles = {"low": "low-frequency module (low part)", "high": "high-frequency module (overall)"}
    for axis, (phase, title) in zip(axes, titles.items(), strict=True):
        for name, history in histories.items():
            points = [(e["epoch"], 1e3 * e["rmse"]) for e in history.get(phase, []) if e["rmse"]]
            if points:
                axis.plot(*zip(*points, strict=True), label=name, linewidth=1.6)
        axis.set_title(title)
        axis.set_xlabel("epoch")
        axis.set_ylabel("validation RMSE, mm")
        axis.set_ylim(bottom=0)
    axes[0].legend(fontsize=8)
    common.save_figure(figure, out / "garment_curves.png")


def errors(report: Any, out: Path) -> None:
    """Overall RMSE of every method, and error over the distance to the body."""
    plt = common.pyplot()
    figure, (left, right) = plt.subplots(1, 2, figsize=(14, 4))
    rows = report["unseen_motions"]
    names = [r["name"] for r in rows]
    left.barh(names, [r["overall"]["rmse"] for r in rows], color="#5b8db8")
    for k, r in enumerate(rows):
        left.text(r["overall"]["rmse"], k, f" {r['overall']['rmse']:.1f}", va="center", fontsize=8)
    floor = report["chaos_floor"].get("all")
    if floor:
        left.axvline(floor["overall"], color="#b04040", linewidth=1, label="chaos floor")
        left.legend(fontsize=8)
    left.invert_yaxis()
    left.set_xlabel("overall RMSE on unseen motions, mm")
    mean = np.array(report["looseness"]["mean_mm"])
    parts = np.array_split(np.argsort(mean), 12)
    for r in rows:
        error = np.array(r["per_vertex"])
        at = [mean[p].mean() for p in parts]
        style = ":" if r["name"] == "bones themselves" else "-"
        right.plot(at, [error[p].mean() for p in parts], style, label=r["name"], linewidth=1.6)
    right.set_xlabel("mean distance to the body, mm")
    right.set_ylabel("mean error, mm")
    right.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1, 1))
    common.save_figure(figure, out / "garment_errors.png")


def pivots(path: Path, out: Path) -> None:
    """Error on the unseen parameter sets over the number of pivots."""
    plt = common.pyplot()
    sweep = _read(path)["sweep"]
    splits = [s for s in ("train", "test") if s in sweep[0]["test_mm"]["rbf"]]
    figure, axes = plt.subplots(1, len(splits), figsize=(5.5 * len(splits), 3.8), squeeze=False)
    for axis, split in zip(axes[0], splits, strict=True):
        for way in sweep[0]["test_mm"]:
            axis.plot(
                [s["count"] for s in sweep],
                [s["test_mm"][way][split] for s in sweep],
                marker="o",
                label=way,
            )
        axis.set_title(f"unseen parameters, {'training' if split == 'train' else 'unseen'} motions")
        axis.set_xlabel("pivots")
        axis.set_ylabel("overall RMSE, mm")
        axis.set_ylim(bottom=0)
    axes[0][0].legend(fontsize=8)
    common.save_figure(figure, out / "garment_pivots.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path)
    parser.add_argument("evaluation", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    curves(options.runs, options.out)
    errors(_read(options.evaluation / "report.json"), options.out)
    for path in sorted(options.runs.glob("*/ensemble.json")):
        pivots(path, options.out)


if __name__ == "__main__":
    main()
