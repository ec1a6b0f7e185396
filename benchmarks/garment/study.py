"""Everything that the page on garmentnet reports, trained and scored by one command.

    python benchmarks/garment/study.py out/medium.clips --out out/study

It may be stopped at any time; the same command goes on.  A store that is still being simulated
may be given with ``--parts`` that need no more than it has.  Two parts side by side with
``--set train.threads=1`` take less than one after the other: the networks are narrow.  Parts:

    trials      the same settings tried for `rooted` and for Santesteban et al. 2019, on validation
    base        `rooted` with three seeds, `faithful`
    collision   weights of the collision loss, on validation, from the first network on
    curve       the low-frequency module of `rooted` on 1,000 frames, twice as many, ...; the last
                point is the first network
    baselines   Santesteban et al. 2019 and the others, within the report
    large       the network that reads the parameters
    ensembles   the paper's (independent pivots) and ours (from the network that reads them)
    recorded    each motion capture left out in turn, fine-tuned from the first network
    report      the tables of all that is there; of the first network once more, pushed out

Results are written to ``study.json`` in the folder, times beside the machine's GEMM rate.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from garmentnet.configs.config import Config, load_config, override
from garmentnet.data.store import ClipStore
from garmentnet.data.virtual_bones import virtual_bones
from garmentnet.evaluation.reporting import report
from garmentnet.evaluation.santesteban import train_santesteban
from garmentnet.networks.checkpoint import load_checkpoint
from garmentnet.training.ensemble import train_ensemble
from garmentnet.training.run import choose_clips, train, with_mirrored
from ssdr.io.atomic import write_bytes

PARTS = (
    "trials",
    "base",
    "collision",
    "curve",
    "baselines",
    "large",
    "ensembles",
    "recorded",
    "report",
)
SEEDS = (0, 1, 2)
SIZES = (1000, 2000, 4000, 8000, 16000, 32000, 64000)
# Generated dances alone, so that motion capture can be left out; bones from the base's alone, so
# that they are the same while sets are simulated.
DANCES = ("data.motions=dance-*", "bones.motions=dance-20[01]*")
# An epoch of eight times the frames has eight times the steps.
EPOCHS = ("train.epochs=16", "train.high_epochs=4")
FINE_TUNING = ("train.learning_rate=3e-4", "train.high_learning_rate=3e-4")
# Three short clips: epochs of a dozen steps.
RECORDED = (*FINE_TUNING, "train.epochs=80")
# Tried for both recurrent methods, a quarter of the training each.
TRIALS = tuple(
    (f"low.hidden={hidden}", f"low.dropout={dropout}")
    for hidden in (600, 1000)
    for dropout in (0.0, 0.3)
)
COLLISION = (0.0, 0.1, 0.3, 1.0)


class Study:
    """The store, the folder and what has been measured."""

    def __init__(self, store: ClipStore, folder: Path, settings: list[str]) -> None:
        self.store, self.folder, self.settings = store, folder, settings
        folder.mkdir(parents=True, exist_ok=True)
        self.file = folder / "study.json"

    def config(self, preset: str, *changes: str) -> Config:
        return override(load_config(preset), [*DANCES, *EPOCHS, *changes, *self.settings])

    def read(self) -> dict[str, Any]:
        return dict(json.loads(self.file.read_text("utf-8"))) if self.file.is_file() else {}

    def note(self, key: str, value: Any) -> None:
        # Parts may run side by side, one thread each: what another has noted stays.
        record = self.read() | {key: value, "machine": common.machine()}
        write_bytes(self.file, json.dumps(record, indent=1).encode())

    def run(self, name: str, work: Callable[[Path], Path]) -> Path:
        """A training in a folder of its own; its time is kept."""
        began = time.process_time()
        path = work(self.folder / name)
        took = time.process_time() - began
        spent = self.read().get("cpu_seconds", {})
        spent[name] = spent.get(name, 0.0) + took
        self.note("cpu_seconds", spent)
        print(f"{name}: {path}", file=sys.stderr, flush=True)
        return path

    def network(self, name: str, config: Config, start: Path | None = None) -> Path:
        begun = load_checkpoint(start) if start else None
        return self.run(name, lambda at: train(self.store, config, at, start=begun))

    def history(self, name: str) -> Path:
        return self.folder / name / "history.json"

    def checkpoint(self, name: str) -> Path:
        path = self.folder / name / "checkpoint.safetensors"
        if not path.is_file():
            raise SystemExit(f"{path} is missing: run the part that trains it first")
        return path


def best_rmse(history: Path) -> float:
    """Lowest validation error of the first module, mm."""
    found = json.loads(history.read_text("utf-8"))["low"]
    return 1e3 * min(float(e["rmse"]) for e in found if e["rmse"] is not None)


def trials(study: Study) -> None:
    rows = []
    for changes in TRIALS:
        config = study.config("rooted", *changes, "train.epochs=4", "train.high_epochs=1")
        name = "-".join(c.split("=")[1] for c in changes)
        study.network(f"trial-rooted-{name}", config)
        row = {"settings": changes, "rooted": best_rmse(study.history(f"trial-rooted-{name}"))}
        study.run(f"trial-santesteban-{name}", partial(train_baseline, study, config))
        row["santesteban"] = best_rmse(study.history(f"trial-santesteban-{name}"))
        rows.append(row)
        study.note("trials", rows)


def train_baseline(study: Study, config: Config, folder: Path) -> Path:
    names, _ = choose_clips(study.store, config)
    held, _ = choose_clips(study.store, config, "validation")
    bones = virtual_bones(study.store, config.bones)
    bones.prepare([*names, *held])
    learned = with_mirrored(study.store, config, names)
    train_santesteban(bones, config, learned, held, folder)
    return folder / "history.json"


def tuned_baseline(study: Study) -> Config | None:
    """Settings of the recurrent baseline with the lowest validation error of its trials."""
    rows = study.read().get("trials", [])
    if not rows:
        return None
    return study.config("rooted", *min(rows, key=lambda r: float(r["santesteban"]))["settings"])


def collision(study: Study) -> None:
    """Three epochs on from the first network with each weight: error, and what lies inside."""
    start, rows = study.checkpoint("rooted-0"), []
    for weight in COLLISION:
        changes = (f"low.collision={weight}", *FINE_TUNING, "train.epochs=3", "train.high_epochs=1")
        name = f"collision-{weight}"
        path = study.network(name, study.config("rooted", *changes), start)
        folder = study.folder / f"report-{name}"
        dances = study.store.clips("validation", parameters=study.store.parameters()[0])
        names = [c.name for c in dances if c.motion.startswith("dance-")]
        report([path], study.store, folder, baselines=False, pictures=0, clips=names)
        found = json.loads((folder / "report.json").read_text("utf-8"))["unseen_motions"]
        row = next(r for r in found if r["name"] != "bones themselves")
        rows.append({"weight": weight, "overall": row["all"]["overall"], "inside": row["inside"]})
        study.note("collision", rows)


def base(study: Study) -> None:
    for seed in SEEDS:
        study.network(f"rooted-{seed}", study.config("rooted", f"train.seed={seed}"))
    study.network("faithful", study.config("faithful"))


def curve(study: Study) -> None:
    """Steps grow with the square root of the frames; validation error of the low module."""
    full = study.config("rooted")
    names, _ = choose_clips(study.store, full)
    total = sum(study.store.clip(n).n_frames for n in names)
    points = []
    for size in (s for s in SIZES if s < 0.9 * total):
        epochs = max(1, round(full.train.epochs * math.sqrt(total / size)))
        config = study.config("rooted", f"data.frames={size}", f"train.epochs={epochs}")
        config = dataclasses.replace(
            config, train=dataclasses.replace(config.train, high_epochs=1, patience=10**6)
        )
        used, _ = choose_clips(study.store, config)
        frames = sum(study.store.clip(n).n_frames for n in used)
        study.network(f"curve-{size}", config)
        best = best_rmse(study.history(f"curve-{size}"))
        points.append({"frames": frames, "epochs": epochs, "rmse_mm": best})
    # The first network is the last point.
    study.checkpoint("rooted-0")
    best = best_rmse(study.history("rooted-0"))
    points.append({"frames": total, "epochs": full.train.epochs, "rmse_mm": best})
    if len(points) > 2:
        # error = coefficient · frames^−exponent, least squares on the logarithms
        x, y = (np.log([p[k] for p in points]) for k in ("frames", "rmse_mm"))
        slope, height = np.polyfit(x, y, 1)
        law = {"exponent": -float(slope), "coefficient": float(np.exp(height))}
        study.note("curve", {"points": points, "law": law})
    else:
        study.note("curve", {"points": points})


def large(study: Study) -> None:
    study.network("large", study.config("rooted", "data.condition=true"))


def ensembles(study: Study) -> None:
    # A pivot of its own sees 2,400 frames: more epochs, not fewer steps than it can use.
    longer = ("train.epochs=80", "train.high_epochs=20")
    independent = study.config("rooted", "ensemble.start_from_base=false", *longer)
    first = load_checkpoint(study.checkpoint("rooted-0"))
    study.run(
        "ensemble-paper",
        lambda at: train_ensemble(study.store, independent, at, base=first),
    )
    reading = load_checkpoint(study.checkpoint("large"))
    # As many frames for the pivot at the base parameters as for the others.
    ours = study.config("rooted", "data.condition=true", "data.frames=2400")
    study.run("ensemble-ours", lambda at: train_ensemble(study.store, ours, at, base=reading))
    for name in ("ensemble-paper", "ensemble-ours"):
        found = json.loads((study.folder / name / "ensemble.json").read_text("utf-8"))
        study.note(name, found)


def recorded(study: Study) -> None:
    clips = [c for c in study.store.clips() if c.provenance["motion"]["file"]]
    files = sorted({str(c.motion).rsplit("_", 1)[0] for c in clips})
    if not files:
        raise SystemExit("no motion capture in the store: make it with --motion FOLDER")
    start = study.checkpoint("rooted-0")
    rows = {}
    for stem in files:
        left = f"{stem}_*"
        changes = ("data.motions=*", f"data.leave_out={left}", *RECORDED)
        config = study.config("rooted", *changes)
        only = dataclasses.replace(config.data, motions=_common(files))
        path = study.network(f"recorded-{stem}", dataclasses.replace(config, data=only), start)
        text = report(
            [path, start],
            study.store,
            study.folder / f"report-{stem}",
            baselines=False,
            pictures=1,
            clips=(f"base-{left}",),
            push_out=True,
        )
        print(text)
        document = study.folder / f"report-{stem}" / "report.json"
        rows[stem] = json.loads(document.read_text("utf-8"))["unseen_motions"]
    study.note("recorded", rows)


def _common(names: list[str]) -> str:
    """A pattern of all the names: what they begin with."""
    first, last = min(names), max(names)
    same = next(
        (k for k, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), len(first)
    )
    return first[:same] + "*"


def tables(study: Study, *, baselines: bool) -> None:
    names = [*(f"rooted-{s}" for s in SEEDS), "faithful", "large"]
    paths = [study.folder / n / "checkpoint.safetensors" for n in names]
    paths += [study.folder / f"ensemble-{n}" / "ensemble.safetensors" for n in ("paper", "ours")]
    there = [p for p in paths if p.is_file()]

    def progress(name: str, done: float) -> None:
        print(f"{name} {100 * done:.0f} %", file=sys.stderr)

    text = report(
        there,
        study.store,
        study.folder / "report",
        baselines=baselines,
        recurrent=tuned_baseline(study),
        progress=progress,
    )
    print(text)
    pushed = study.folder / "report-pushed"
    text = report(
        there[:1],
        study.store,
        pushed,
        baselines=False,
        push_out=True,
        progress=progress,
    )
    print(text)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("store", type=Path)
    options.add_argument("--out", type=Path, default=Path("out/study"))
    options.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    options.add_argument("--set", nargs="*", default=[], metavar="SECTION.NAME=VALUE")
    given = options.parse_args()
    study = Study(ClipStore.open(given.store), given.out, given.set)
    steps: dict[str, Callable[[Study], None]] = {
        "trials": trials,
        "base": base,
        "collision": collision,
        "curve": curve,
        "large": large,
        "ensembles": ensembles,
        "recorded": recorded,
    }
    for name, step in steps.items():
        if name in given.parts:
            step(study)
    if {"report", "baselines"} & set(given.parts):
        tables(study, baselines="baselines" in given.parts)


if __name__ == "__main__":
    main()
