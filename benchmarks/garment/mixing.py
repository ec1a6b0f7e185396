"""What mixing pivots can reach at unseen parameters: simulations and one network as the pivots.

From a store with the parameter sets of the preset ``parameters``, a beginning of it at least, and a
checkpoint that reads the parameters::

    python benchmarks/garment/mixing.py out/parameters.clips dress

*Perfect pivots* are the simulations of the training sets themselves, *network as pivots* is the
checkpoint asked at the training sets.  Both are mixed for the test sets by the rules of the paper's
table 4; the best convex weights are chosen for each set with knowledge of the truth.  *Asked
directly* is the checkpoint at the test sets.  RMSE over free vertices, mm, mean over the test sets;
seen motions are those of training clips.  The kernels learn on seen motions of the training sets,
each left out in turn.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


from benchmarks import common
from benchmarks.garment.rules import inverse_distance, nearest
from garmentnet.data.parameters import SimulationParameters
from garmentnet.data.store import ClipStore
from garmentnet.data.virtual_bones import parameter_roles
from garmentnet.networks.checkpoint import Checkpoint, load_checkpoint
from garmentnet.training.pivots import (
    Mixed,
    convex_fit,
    fit_kernel,
    gram,
    left_out,
    select_pivots,
)

COUNTS = (4, 6, 8)  # pivots that the paper's procedure chooses
SPLITS = {"seen": "train", "unseen": "test"}
Array = np.ndarray
# Prediction of the garment (f, V, 3) for a motion at some parameters.
Answer = Callable[[str, SimulationParameters], Array]


class Clips:
    """Simulated motions at every parameter set, and a network's predictions of them."""

    def __init__(self, store: ClipStore, model: Checkpoint, every: int) -> None:
        self.store, self.model, self.every = store, model, every
        self.free = ~np.asarray(store.pinned, bool)
        roles = parameter_roles(store)
        self.train, self.test = (
            [p for p in store.parameters() if roles[p] == role] for role in ("train", "test")
        )
        self.clips = {(c.motion, c.parameters): c for c in store.clips()}
        # A beginning of the data set may lack one of them.
        self.splits = {name: s for name, s in SPLITS.items() if self.motions(s)}

    def motions(self, split: str) -> list[str]:
        """Motions of a split that were simulated at every parameter set."""
        there = {c.motion for c in self.clips.values() if c.split == split}
        sets = [*self.train, *self.test]
        return sorted(m for m in there if all((m, p) in self.clips for p in sets))

    def simulated(self, motion: str, parameters: SimulationParameters) -> Array:
        frames = self.clips[motion, parameters].sequence.frames(slice(None, None, self.every))
        return np.asarray(frames, np.float32)[:, self.free]

    def predicted(self, motion: str, parameters: SimulationParameters) -> Array:
        joints = self.clips[motion, self.train[0]].joints
        frames = np.arange(0, len(joints), self.every)
        return self.model.predict(joints, parameters, frames=frames)[:, self.free]

    def grams(self, answers: dict[Any, Array], split: str, sets: Any) -> list[Array]:
        """Gram matrix of the residuals of the training sets' answers, for every one of `sets`."""
        motions = self.motions(split)
        return [
            np.mean(
                [gram([answers[m, q] for q in self.train], self.simulated(m, p)) for m in motions],
                axis=0,
            )
            for p in sets
        ]


def rules(grams: list[Array], theta: Array, pivots: list[int]) -> dict[str, Any]:
    """Rules that give pivots their weights; those of kernels are learned."""
    known = left_out(grams, theta, pivots)
    return {
        "nearest": nearest,
        "inverse distance": inverse_distance,
        "kernel exp(−d), the published code": fit_kernel(known, power=1).weights,
        "kernel exp(−d²), equation 4": fit_kernel(known).weights,
    }


def mixed(run: Clips, answer: Answer) -> dict[str, dict[str, float]]:
    """Errors of every rule with some pivots, by seen and unseen motions and number of pivots."""
    answers = {
        (m, p): answer(m, p)
        for split in run.splits.values()
        for m in run.motions(split)
        for p in run.train
    }
    theta = np.stack([p.normalised() for p in run.train])
    learned = run.grams(answers, "train", run.train)
    tests = {name: run.grams(answers, split, run.test) for name, split in run.splits.items()}
    rows: dict[str, dict[str, float]] = {}
    for count in COUNTS:
        pivots = select_pivots(learned, theta, count)
        found = rules(learned, theta, pivots)
        for motions, grams in tests.items():
            sets = [
                Mixed.of(pivots, theta, p.normalised(), q)
                for p, q in zip(run.test, grams, strict=True)
            ]
            errors = {name: [s.error(rule) for s in sets] for name, rule in found.items()}
            errors["best convex weights"] = [convex_fit(s.q)[1] for s in sets]
            for name, each in errors.items():
                rows.setdefault(name, {})[f"{motions}, {count}"] = 1e3 * float(np.mean(each))
    return rows


def apart(run: Clips) -> dict[str, float]:
    """What separates simulations: mm for each parameter's difference, by least squares.

    Squared distances of all pairs of sets are fitted by Σ (c_k Δθ_k)², θ in normalised units: c_k
    is the distance of two sets half of the range apart in one parameter.
    """
    sets = [*run.train, *run.test]
    motions = [m for split in run.splits.values() for m in run.motions(split)]
    theta = np.stack([p.normalised() for p in sets])
    cloth = [np.concatenate([run.simulated(m, p) for m in motions]) for p in sets]
    pairs = [(i, j) for i in range(len(sets)) for j in range(i)]
    squares = [np.square(cloth[i] - cloth[j]).sum(-1).mean() for i, j in pairs]
    apart = np.array([np.square(theta[i] - theta[j]) for i, j in pairs])
    (found, *_) = np.linalg.lstsq(apart, np.array(squares), rcond=None)
    names = ("bending", "density", "time scale")
    return {n: 1e3 * float(np.sqrt(max(c, 0))) for n, c in zip(names, found, strict=True)}


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("store", type=Path)
    options.add_argument("model", type=Path)
    options.add_argument("--every", type=int, default=3, help="frames between those compared")
    options.add_argument("--out", type=Path, default=common.RESULTS / "garment-mixing.json")
    given = options.parse_args()
    run = Clips(ClipStore.open(given.store), load_checkpoint(given.model), given.every)
    table: dict[str, dict[str, float]] = {}
    for pivots, answer in (
        ("perfect pivots", run.simulated),
        ("network as pivots", run.predicted),
    ):
        found = mixed(run, answer)
        table |= {f"{pivots}, {name}": row for name, row in found.items()}
    direct = {}
    for motions, split in run.splits.items():
        each = [
            np.mean([gram([run.predicted(m, p)], run.simulated(m, p)) for m in run.motions(split)])
            for p in run.test
        ]
        direct[f"{motions}, 8"] = 1e3 * float(np.mean(np.sqrt(each)))
    table["network asked directly"] = direct
    record = {
        "rows": table,
        "simulations apart, mm": apart(run),
        "motions": {name: run.motions(split) for name, split in run.splits.items()},
        "frames": given.every,
        "command": f"python benchmarks/garment/mixing.py parameters.clips {given.model}",
        "revision": common.revision(),
    }
    common.write_json(given.out, record)
    columns = [f"{m}, {k}" for m in run.splits for k in COUNTS]
    print(common.table([{"pivots": n} | r for n, r in table.items()], ["pivots", *columns]))
    print(record["simulations apart, mm"])


if __name__ == "__main__":
    main()
