"""Charts and films of a study: what `study.py` wrote, as the page on garmentnet shows it.

    python benchmarks/garment/figures.py out/study --out docs/images
    python benchmarks/garment/figures.py out/study --out docs/images --store out/medium.clips

The charts need the study's JSON files alone; with the store come films of the first network.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from garmentnet.data.store import ClipStore
from garmentnet.networks.checkpoint import load_checkpoint
from garmentnet.prediction.output import save_prediction
from garmentnet.prediction.prediction import predict

BOUND = "bones themselves"


def _read(path: Path) -> Any:
    return json.loads(path.read_text("utf-8"))


def curves(study: Path, out: Path) -> None:
    """Validation RMSE over epochs, a panel for each module."""
    plt = common.pyplot()
    names = ("rooted-0", "rooted-1", "rooted-2", "faithful", "large")
    files = {n: study / n / "history.json" for n in names}
    histories = {n: _read(p) for n, p in files.items() if p.is_file()}
    figure, axes = plt.subplots(1, 2, figsize=(11, 3.8))
    titles = {"low": "low-frequency module (low part)", "high": "high-frequency module (detail)"}
    for axis, (phase, title) in zip(axes, titles.items(), strict=True):
        for name, history in histories.items():
            points = [(e["epoch"], 1e3 * e["rmse"]) for e in history.get(phase, []) if e["rmse"]]
            if points:
                axis.plot(*zip(*points, strict=True), label=name, linewidth=1.6)
        axis.set_title(title)
        axis.set_xlabel("epoch")
        axis.set_ylabel("validation RMSE of free vertices, mm")
        axis.set_ylim(bottom=0)
        axis.locator_params(axis="x", integer=True)
    axes[0].legend(fontsize=8)
    common.save_figure(figure, out / "garment_curves.png")


def learning(study: Any, out: Path) -> None:
    """Validation error over the training frames, and the power law through it."""
    plt = common.pyplot()
    points = study["curve"]["points"]
    frames, errors = (np.array([p[k] for p in points]) for k in ("frames", "rmse_mm"))
    figure, axis = plt.subplots(figsize=(6, 3.8))
    axis.loglog(frames, errors, "o-", label="validation, low-frequency module")
    law = study["curve"].get("law")
    if law:
        at = np.geomspace(frames.min(), 2 * frames.max(), 50)
        fall = law["coefficient"] * at ** -law["exponent"]
        axis.loglog(at, fall, ":", label=f"frames^−{law['exponent']:.2f}")
    axis.set_yticks([25, 30, 40, 50], ["25", "30", "40", "50"])
    axis.minorticks_off()
    axis.set_xlabel("training frames")
    axis.set_ylabel("RMSE of free vertices, mm")
    axis.legend(fontsize=8)
    common.save_figure(figure, out / "garment_learning.png")


def _shown(name: str) -> str:
    """A method's name in a report, as a reader would say it."""
    name = name.removesuffix("-checkpoint").removesuffix("-ensemble")
    said = {
        "large": "one network that reads the parameters",
        "ensemble-paper": "ensemble, the paper's form",
        "ensemble-ours": "ensemble, our form",
    }
    return said.get(name, name.replace("rooted-", "rooted, seed "))


def errors(report: Any, out: Path) -> None:
    """Overall RMSE of every method on the test dances, and by class of motion."""
    plt = common.pyplot()
    figure, (left, right) = plt.subplots(1, 2, figsize=(14, 4.4))
    rows = report["groups"]["dance"]["rows"]
    left.barh(
        [_shown(r["name"]) for r in rows],
        [r["free"]["overall"]["rmse"] for r in rows],
        color="#5b8db8",
    )
    for k, row in enumerate(rows):
        value = row["free"]["overall"]["rmse"]
        left.text(value, k, f" {value:.1f}", va="center", fontsize=8)
    left.invert_yaxis()
    left.margins(x=0.12)
    left.set_xlabel("overall RMSE of free vertices on 24 unseen dances, mm")
    kinds = sorted(rows[0]["per_class"], key=lambda k: -rows[1]["per_class"][k]["free"])
    for r in rows:
        if r["name"] in (BOUND, "body-skinned", "mean shape"):
            continue
        values = [r["per_class"][k]["free"] for k in kinds]
        right.plot(kinds, values, "o", alpha=0.7, label=_shown(r["name"]))
    floors = [report["chaos_floor"].get(k, {}).get("overall_free", np.nan) for k in kinds]
    right.plot(kinds, floors, "k_", markersize=14, label="chaos floor")
    right.set_ylabel("RMSE of free vertices, mm")
    right.set_ylim(bottom=0)
    right.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1, 1))
    common.save_figure(figure, out / "garment_errors.png")


def pivots(study: Path, out: Path) -> None:
    """Error on the unseen parameter sets over the number of pivots, both forms of ensemble."""
    plt = common.pyplot()
    found = {n: study / f"ensemble-{n}" / "ensemble.json" for n in ("paper", "ours")}
    sweeps = {n: _read(p)["sweep"] for n, p in found.items() if p.is_file()}
    splits = ("train", "test")
    figure, axes = plt.subplots(1, 2, figsize=(11, 3.8), sharey=True)
    for axis, split in zip(axes, splits, strict=True):
        for name, sweep in sweeps.items():
            ways = {
                "rbf": ("o-", "kernel"),
                "inverse distance": ("s:", "inverse distance"),
                "nearest": ("^:", "nearest pivot"),
                "mixed": ("D-", "mixed with the network that reads the parameters"),
                "common": ("k--", "that network alone"),
            }
            for way, (style, said) in ways.items():
                if way in sweep[0]["test_mm"]:
                    counts = [s["count"] for s in sweep]
                    at = [s["test_mm"][way][split] for s in sweep]
                    axis.plot(counts, at, style, label=f"{name}: {said}")
        axis.set_title(f"unseen parameters, {'training' if split == 'train' else 'unseen'} motions")
        axis.set_xlabel("pivots")
    axes[0].set_ylabel("overall RMSE, mm")
    axes[0].set_ylim(bottom=0)
    axes[1].legend(fontsize=7, loc="upper left", bbox_to_anchor=(1, 1))
    common.save_figure(figure, out / "garment_pivots.png")


def films(study: Path, store: Path, out: Path) -> None:
    """Truth, prediction and error of a test dance and of a motion capture that was left out."""
    clips = ClipStore.open(store)
    jobs = {"dance": ("base-dance-22006", study / "rooted-0" / "checkpoint.safetensors")}
    for path in sorted(study.glob("recorded-*/checkpoint.safetensors"))[-1:]:
        stem = path.parent.name.removeprefix("recorded-")
        name = next(c.name for c in clips.clips() if c.motion.startswith(stem))
        jobs["recorded"] = (name, path)
    for kind, (name, checkpoint) in jobs.items():
        file = out / f"garment_{kind}.webp"
        model, clip = load_checkpoint(checkpoint), clips.clip(name)
        prediction = predict(model, clip.joints, push_out=True, name=name)
        save_prediction(prediction, file, size=320, truth=clip, error=True, every=2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", type=Path)
    parser.add_argument("--store", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    curves(options.study, options.out)
    study = options.study / "study.json"
    if study.is_file() and "curve" in _read(study):
        learning(_read(study), options.out)
    report = options.study / "report" / "report.json"
    if report.is_file():
        errors(_read(report), options.out)
    pictures = {"garment_moments.png": "report-pushed/rooted-0-checkpoint-moments.png"}
    for path in sorted(options.study.glob("report-*/recorded-*.png"))[-1:]:
        pictures["garment_recorded.png"] = str(path.relative_to(options.study))
    for name, source in pictures.items():
        if (options.study / source).is_file():
            with Image.open(options.study / source) as picture:
                picture.convert("RGB").save(options.out / name, optimize=True)
    if list(options.study.glob("ensemble-*/ensemble.json")):
        pivots(options.study, options.out)
    if options.store:
        films(options.study, options.store, options.out)


if __name__ == "__main__":
    main()
