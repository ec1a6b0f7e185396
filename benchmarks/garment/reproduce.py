"""The paper's tables (Pan et al. 2022, section 5) on simulated data sets.

Data sets that are missing are simulated, networks and baselines trained, and the tables printed::

    python benchmarks/garment/reproduce.py --only table2

Every training has a folder of its own and every table a file.  Clips, trainings and tables that
exist are not made again, so that a run that was stopped continues.  ``--only shipped`` lets the
dress that ships learn on.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


from benchmarks.garment.intervals import interval_cell
from benchmarks.garment.published import BASELINES, SANTESTEBAN, train_chen
from benchmarks.garment.reproduction import Reproduction, base_parameters, dances_for_testing
from benchmarks.garment.rules import Rule, Ruled, inverse_distance, nearest
from benchmarks.garment.scenes.dataset import make_data_set, recorded_motions
from benchmarks.garment.scenes.scene_file import load_data_set
from garmentnet.cli.progress import progress_bar
from garmentnet.configs.config import override
from garmentnet.evaluation.baselines import BodySkinned
from garmentnet.evaluation.methods import Chaos, Method, Network
from garmentnet.evaluation.reporting import RECORDED, group_of
from garmentnet.evaluation.scores import PARTS
from garmentnet.evaluation.tables import markdown
from garmentnet.networks.checkpoint import load_checkpoint, save_checkpoint
from garmentnet.paper.bones import parameter_roles
from garmentnet.paper.train import choose_clips, train_ensemble
from garmentnet.training.batches import load_tracks
from ssdr.common.errors import InputError
from ssdr.io.atomic import write_bytes

_DRESSES = ("dress", "gown", "a_line")
_TIGHT = ("t_shirt", "skirt", "trousers")
# Sleeves follow the arms, which `rooted` does not read.
_SLEEVES = {"gown": ("features.joints=[]",), "t_shirt": ("features.joints=[]",)}
_BONES, _MANY = (20, 40, 80, 150, 250, 500), 200
# Equal data for all methods of a table: the paper's 40,000 frames.
_EQUAL = "data.frames=40000"
_PART = "_[0-9][0-9]"  # end of the names of a recording's parts
# Few recordings: a short training from the weights of a network that has seen none of them.
_TUNED = ("train.learning_rate=3e-4", "train.epochs=40", "train.high_epochs=4")
# What the dress that ships differs in, and how it goes on from the one that shipped before.
_SHIPPED = (
    "data.condition=true", "bones.motions=base-dance-20[01]*", "low.dropout=0.1",
    "features.joint_motion=false",
    "high.hidden=128", "high.rank=16", "train.batch=32", "train.window=60",
    "train.learning_rate=5e-4", "train.high_learning_rate=5e-4",
    "train.epochs=8", "train.high_epochs=2",
)  # fmt: skip


def _text(record: dict[str, Any], part: str) -> str:
    """Table of RMSE, Hausdorff distance and STED of a part, and RMSE relative to the first row."""
    lines = []
    for row in record["rows"]:
        s = row["all"][part]
        known = record["ratios"].get(row["name"])
        ratio = interval_cell(known[part]) if known else ""
        cells = [f"{s['rmse']:.2f}", f"{s['hausdorff']:.1f}", f"{s['sted']:.4f}"]
        detail = row["all"]["detail"] or math.nan
        left = [f"{100 * s['rmse'] / detail:.0f} %"] * (part == "high")
        lines.append([row["name"], *cells, *left, ratio])
    head = ["RMSE, mm", "Hausdorff", "STED", *["left"] * (part == "high"), "RMSE ratio"]
    return markdown([part, *head], lines)


def _dress(run: Reproduction, store: str) -> str:
    """Low and high frequencies of a dress (of the paper's table 2)."""
    rooted = run.config("rooted", _EQUAL, *_SLEEVES.get(store, ()))
    paper = run.config("faithful", _EQUAL)
    learned, held, _ = run.clips(store, rooted)

    def chen() -> Method:
        ours, bones = run.network(store, "rooted", rooted), run.bones(store, rooted)
        tracks, others = (load_tracks(ours.networks[0], bones, n) for n in (learned, held))
        folder = run.folder / store / "chen"
        done = run.epoch("Chen 2021")
        return run.timed(
            f"{store}/chen", lambda: train_chen(ours, tracks, others, folder, progress=done)
        )

    methods = [
        run.method(store, "rooted", rooted),
        *run.baselines(store, rooted),
        chen,
        run.method(store, "faithful", paper),
        run.method(
            store, "no split", override(rooted, ["bones.length=0.0", "high.target=residual"])
        ),
        run.method(store, "body motion", override(rooted, ["high.source=body"])),
        run.method(store, "no local stream", override(paper, ["high.local=false"])),
    ]
    record = run.scores(store, "table2", rooted, methods)
    return "\n\n".join([f"## {store}", *(_text(record, p) for p in ("low", "high", "overall"))])


def _tight(run: Reproduction, store: str) -> str:
    """A tight garment (of the paper's table 3)."""
    config = run.config("rooted", _EQUAL, "low.relative_to=joints", *_SLEEVES.get(store, ()))
    tailor, whole = BASELINES[0], SANTESTEBAN
    methods = [
        run.method(store, "rooted", config),
        run.method(store, "moving frame", override(config, ["low.relative_to=frame"])),
        *run.baselines(store, config, (tailor, whole)),
        lambda: BodySkinned(run.store(store)),
    ]
    return f"## {store}\n\n" + _text(run.scores(store, "table3", config, methods), "overall")


def _table4(run: Reproduction) -> str:
    """Unseen simulation parameters (the paper's table 4), with equal data for all pivots."""
    store, folder = run.store("parameters"), run.folder / "parameters" / "ensemble"
    config = run.config("rooted")

    def pivots(name: str, rule: Rule | None = None) -> Callable[[], Method]:
        def made() -> Method:
            if not (folder / "ensemble.safetensors").is_file():
                run.timed(
                    "parameters/ensemble",
                    lambda: train_ensemble(store, config, folder, progress=run.progress),
                )
            found = load_checkpoint(folder / "ensemble.safetensors")
            kernel = Ruled(rule) if rule else found.kernel
            return Network(name, dataclasses.replace(found, kernel=kernel))

        return made

    roles = parameter_roles(store)
    large = override(config, ["data.condition=true"])
    # Of each set a part, so that all together have the frames, and the steps, of one pivot.
    frames = sum(store.clip(n).n_frames for n in choose_clips(store, config)[0])
    sets = sum(role == "train" for role in roles.values())
    short = override(large, [f"data.frames={frames // sets}"])

    methods = [
        pivots("pivots, RBF"),
        pivots("pivots, inverse distance", inverse_distance),
        pivots("pivots, nearest", nearest),
        run.method("parameters", "large network", large),
        run.method("parameters", "large network, frames of a pivot", short),
    ]
    unseen = [c.name for c in dances_for_testing(store) if roles[c.parameters] == "test"]
    record = run.scores("parameters", "table4", config, methods, unseen)
    parts = (_text(record, part) for part in ("low", "high", "overall"))
    return "## unseen parameters\n\n" + "\n\n".join(parts) + "\n"


def _bones(run: Reproduction) -> str:
    """Error by number of virtual bones, on the first dress."""
    store, usual, rows = _DRESSES[0], run.config("rooted", _EQUAL), []
    for count in _BONES:
        # The search for hundreds of bones takes hours otherwise.
        quick = ("bones.effort=fast", "bones.frames=300") if count > _MANY else ()
        config = run.config("rooted", _EQUAL, f"bones.count={count}", *quick)
        # With the usual number it is the network of table 2.
        name = "rooted" if config == usual else f"bones-{count}"
        record = run.scores(store, f"bones-{count}", config, [run.method(store, name, config)])
        network, _, bound, *_ = record["rows"]
        errors = *(network["all"][part] for part in PARTS), bound["all"]["low"]
        rows.append([str(count), *(f"{e['rmse']:.2f}" for e in errors)])
    rows += [
        [r["name"], *(f"{r['all'][p]['rmse']:.2f}" for p in PARTS), ""]
        for r in record["rows"][1::2]
    ]
    return markdown(["bones", *(f"{p} RMSE" for p in PARTS), "bones themselves"], rows) + "\n"


def _capture(run: Reproduction) -> str:
    """Motion capture: each recording in turn is left out of training and used for the test."""
    clips = [c for c in run.store("dress").clips() if group_of(c) == RECORDED]
    recordings = sorted({c.motion[:-3] for c in clips})
    if len(recordings) < 2:
        raise InputError("motion", "a folder with two or more BVH files", recordings)
    # What their names have in common selects them all.
    recorded = os.path.commonprefix(recordings) + "*" + _PART  # noqa: RUF071
    found: dict[str, list[float]] = {}
    for name in recordings:
        test = [c.name for c in clips if c.motion[:-3] == name]
        for row in _left_out(run, name, recorded, test)["rows"]:
            if row["name"] != Chaos.name:  # not every recording is repeated
                found.setdefault(row["name"], []).append(row["all"]["overall"]["rmse"])
    rows = [[m, *(f"{e:.1f}" for e in [*r, sum(r) / len(r)])] for m, r in found.items()]
    return markdown(["left out, RMSE in mm", *recordings, "mean"], rows) + "\n"


def _left_out(run: Reproduction, name: str, recorded: str, test: list[str]) -> dict[str, Any]:
    """Scores on one recording of methods that learned from the dances and the other recordings."""
    store = "dress"
    config = run.config("rooted", f"data.leave_out={name}{_PART}")

    def shipped() -> Method:
        start = load_checkpoint("dress")
        few = (f"data.motions={recorded}", f"data.leave_out={name}{_PART}", *_TUNED)
        tuned = override(start.networks[0].config, [*run.settings, *few])
        trained = run.network(store, f"tuned-{name}", tuned, start)
        return Network("the dress that ships, fine-tuned", trained)

    methods = [
        shipped,
        lambda: Network("rooted", run.network(store, f"rooted-{name}", config)),
        *run.baselines(store, config, (BASELINES[2],), f"-{name}"),
    ]
    return run.scores(store, f"capture-{name}", config, methods, test)


def _shipped(run: Reproduction) -> str:
    """The dress that ships learns on; in half precision the result lies beside its training."""
    store, start = run.store("live"), load_checkpoint("dress")
    config = run.config("rooted", *_SHIPPED)
    file = run.folder / "live" / "dress.safetensors"
    test = [c.name for c in dances_for_testing(store, base_parameters(store))]

    def dress() -> Method:
        trained = run.network("live", "dress", config, start)
        save_checkpoint(trained, file, half=True)
        return Network("the dress", load_checkpoint(file))

    record = run.scores("live", "scores", config, [dress], test, start.subject)
    return _text(record, "overall") + "\n"


TABLES: dict[str, Callable[[Reproduction], str]] = {
    "table2": lambda run: "\n\n".join(_dress(run, name) for name in _DRESSES) + "\n",
    "table3": lambda run: "\n\n".join(_tight(run, name) for name in _TIGHT) + "\n",
    "table4": _table4,
    "bones": _bones,
    "capture": _capture,
    "shipped": _shipped,
}


def table(run: Reproduction, name: str) -> str:
    """A table as Markdown, after the trainings and evaluations that are still missing.

    Raises
    ------
    InputError
        If there is no such table.
    """
    if name not in TABLES:
        raise InputError("only", f"of {', '.join(TABLES)}", repr(name))
    file = run.folder / f"{name}.md"
    if not file.is_file():
        write_bytes(file, TABLES[name](run).encode())
    return file.read_text("utf-8")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--output", "-o", type=Path, default=Path("out/reproduction"))
    options.add_argument("--data", type=Path, default=Path("out"), help="folder of the data sets")
    options.add_argument("--share", type=float, default=1.0, help="of the motions of a data set")
    options.add_argument("--only", action="append", choices=TABLES, help="repeatable")
    options.add_argument("--motion", type=Path, help="BVH files, which the dress dances, too")
    options.add_argument("--set", action="append", default=[], help="a setting of every network")
    given = options.parse_args()

    def simulate(name: str, path: Path) -> None:
        data_set = load_data_set(name)
        if data_set.motions:
            fewer = data_set.motions.share(given.share)
            data_set = dataclasses.replace(data_set, motions=fewer)
        some = given.motion if name == "dress" else None
        recorded = recorded_motions(some, data_set) if some else ()
        make_data_set(data_set, path, recorded=recorded, progress=show)

    with progress_bar() as show:
        run = Reproduction(
            given.data, given.output, simulate=simulate, settings=given.set, progress=show
        )
        left = {"shipped"} if given.motion else {"shipped", "capture"}
        wanted = given.only or [name for name in TABLES if name not in left]
        found = [f"# {name}\n\n{table(run, name)}" for name in wanted]
    print("\n\n".join(found))


if __name__ == "__main__":
    main()
