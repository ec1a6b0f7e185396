"""How far a network comes with so many frames of a garment, beside plain methods.

From a store of more clips than are learned, with ``tiny`` and two epochs of its detail::

    python benchmarks/garment/data_curve.py out/sleeve.clips --frames 120 240 480 720

Bones are those of all clips of the store.  Errors are of the whole garment on validation clips, mm;
what is finished in ``--work`` is not trained again.  ``--set low.relative_to=frame`` gives the same
without joints.  ``--draw`` draws what is recorded.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from garmentnet.configs.config import load_config, override
from garmentnet.data.store import ClipStore
from garmentnet.evaluation.verdict import validation_errors
from garmentnet.networks.checkpoint import load_checkpoint
from garmentnet.training.run import train

RECORD = common.RESULTS / "garment-data.json"
PICTURE = common.ROOT / "docs" / "images" / "garment_data.png"
FIXED = ("train.high_epochs=2", "train.tensorboard=false")


def learn(path: Path, frames: int, work: Path, changes: list[str]) -> dict[str, float]:
    store = ClipStore.open(path)
    config = override(load_config("tiny"), [f"data.frames={frames}", *FIXED, *changes])
    name = "-".join([path.stem, str(frames), *(c.rpartition("=")[2] for c in changes)])
    file = train(store, config, work / name)
    (network,) = load_checkpoint(file).networks
    return {
        **{k: round(v, 2) for k, v in validation_errors(file, store).items()},
        "follows joints": network.config.low.relative_to == "joints",
    }


def draw(rows: dict[str, dict[str, float]]) -> None:
    plt = common.pyplot()
    stores = sorted({row["store"] for row in rows.values()})
    figure, axes = plt.subplots(1, len(stores), figsize=(4.2 * len(stores), 3.2), squeeze=False)
    for axis, store in zip(axes[0], stores, strict=True):
        own = [row for row in rows.values() if row["store"] == store and not row["changes"]]
        own.sort(key=lambda row: row["frames"])
        for name in ("network", "body-skinned", "ridge", "mean shape"):
            style = "-o" if name == "network" else "--"
            axis.plot([r["frames"] for r in own], [r[name] for r in own], style, label=name)
        axis.set(
            xscale="log",
            title=Path(store).stem.rpartition("_")[2],
            xlabel="training frames",
        )
        common.number_ticks(axis, [row["frames"] for row in own])
        axis.set_ylim(bottom=0)
    axes[0, 0].set_ylabel("RMSE on validation, mm")
    axes[0, 0].legend(frameon=False, loc="lower left")
    common.save_figure(figure, PICTURE)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("store", type=Path, nargs="?")
    options.add_argument("--frames", type=int, nargs="+", default=[])
    options.add_argument("--work", type=Path, default=Path("out/data_curve"))
    options.add_argument("--set", action="append", default=[], help="settings")
    options.add_argument("--draw", action="store_true")
    given = options.parse_args()
    rows = common.read_rows(RECORD)
    for frames in given.frames:
        words = [f"out/{given.store.name}", f"--frames {frames}"]
        words += [f"--set {text}" for text in given.set]
        rows[" ".join([given.store.stem, str(frames), *given.set])] = {
            "store": given.store.name,
            "frames": frames,
            "changes": given.set,
            **learn(given.store, frames, given.work, given.set),
            "command": " ".join(["python benchmarks/garment/data_curve.py", *words]),
            "revision": common.revision(),
        }
        common.write_rows(RECORD, rows)
    columns = ("network", "body-skinned", "ridge", "mean shape", "follows joints")
    print(common.table([{"case": k} | r for k, r in rows.items()], ["case", *columns]))
    if given.draw:
        draw(rows)


if __name__ == "__main__":
    main()
