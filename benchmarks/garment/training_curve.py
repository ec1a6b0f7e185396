"""Error of the low frequencies against the epochs of training, of runs that are finished.

    garmentnet train rooted --store out/longer.clips -o out/runs/symmetric --set train.epochs=8
    python benchmarks/garment/training_curve.py out/runs/symmetric out/runs/free

Errors of the validation clips and of some training clips (without dropout), mm, over free vertices,
beside the seconds of the epochs, from ``history.json`` of each folder; a run is known by its
folder's name.  ``--draw`` draws what is recorded.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common

RECORD = common.RESULTS / "garment-training.json"
PICTURE = common.ROOT / "docs" / "images" / "garment_training.png"


def read(folder: Path) -> dict[str, Any]:
    history = json.loads((folder / "history.json").read_text("utf-8"))["low"]
    config = json.loads((folder / "run.json").read_text("utf-8"))["config"]
    measured = [e for e in history if e["rmse"] is not None]
    seconds = list(itertools.accumulate(e["seconds"] for e in history))
    return {
        "epoch": [e["epoch"] for e in measured],
        "seconds": [round(seconds[e["epoch"] - 1], 1) for e in measured],
        "validation, mm": [round(1e3 * e["rmse"], 2) for e in measured],
        "training, mm": [round(1e3 * e["trained"], 2) for e in measured],
        "epochs": len(history),
        "symmetric": config["low"]["symmetric"],
        **{k: config["train"][k] for k in ("learning_rate", "batch", "window")},
    }


def draw(rows: dict[str, dict[str, Any]]) -> None:
    plt = common.pyplot()
    figure, axis = plt.subplots(figsize=(5, 3.2))
    for k, (name, row) in enumerate(rows.items()):
        axis.plot(row["epoch"], row["validation, mm"], f"C{k}-o", label=name)
        axis.plot(row["epoch"], row["training, mm"], f"C{k}--")
    axis.set(xlabel="epochs", ylabel="RMSE, mm")
    axis.legend(frameon=False)
    common.save_figure(figure, PICTURE)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("folders", type=Path, nargs="*")
    options.add_argument("--draw", action="store_true")
    given = options.parse_args()
    rows = common.read_rows(RECORD)
    for folder in given.folders:
        command = f"python benchmarks/garment/training_curve.py out/runs/{folder.name}"
        rows[folder.name] = {**read(folder), "command": command, "revision": common.revision()}
        common.write_rows(RECORD, rows)
    table = [
        {
            "run": name,
            "epochs": row["epochs"],
            "seconds an epoch": row["seconds"][-1] / row["epochs"],
            "validation, mm": row["validation, mm"][-1],
            "training, mm": row["training, mm"][-1],
        }
        for name, row in rows.items()
    ]
    print(common.table(table, list(table[0])))
    if given.draw:
        draw(rows)


if __name__ == "__main__":
    main()
