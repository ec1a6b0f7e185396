"""Training of an ensemble: one network for every training set, pivots, kernel, comparison."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.errors import InputError

from ..configs.config import Config
from ..data.clip import spread
from ..data.parameters import SimulationParameters
from ..data.store import ClipStore
from ..data.virtual_bones import parameter_roles
from ..io.files import write_file
from ..networks.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from ..networks.ensemble import Kernel
from ..networks.network import MotionNetwork
from .loop import Progress
from .pivots import (
    Mixed,
    fit_kernel,
    gram,
    inverse_distance,
    left_out,
    nearest,
    select_pivots,
    smallest_good,
)
from .run import train

__all__ = ["compare_networks", "sweep_pivots", "train_ensemble"]

Array = NDArray[np.float64]
# Gram matrix of the networks' residuals on a parameter set, and its normalised parameters (P,).
Compared = tuple[Array, Array]
# Most clips of a parameter set on which networks are compared, since prediction takes long.
_CLIPS = 4


def train_ensemble(
    store: ClipStore,
    config: Config,
    folder: Path | str,
    *,
    base: Checkpoint | None = None,
    callback: Callable[[str, Progress], bool | None] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Path:
    """Train a network for every training set, and the kernel that mixes them.

    The first is the base network, from which the others start if the configuration says so.
    If training was interrupted, another call continues it.

    Parameters
    ----------
    store : ClipStore
    config : Config
    folder : path
        Folder with a subfolder for each network, ``ensemble.safetensors``, and ``ensemble.json``,
        which holds the results for each K.
    base : Checkpoint, optional
        The network from which the others start, if it is trained already.
    progress
        As in :func:`~garmentnet.training.run.train`.
    callback : callable, optional
        Called with the network's name and its progress; returning True stops.

    Returns
    -------
    Path
        Path of the ensemble's checkpoint.

    Raises
    ------
    InputError
        If there is only one training set, or training was stopped.
    """
    folder = Path(folder)
    roles = parameter_roles(store)
    sets = [p for p in store.parameters() if roles[p] == "train"]
    if len(sets) < 2:
        raise InputError("store", "two or more training sets of parameters", len(sets))
    stopped = False

    def run(
        name: str, settings: Config, start: Checkpoint | None, *, validated: bool = True
    ) -> Checkpoint:
        def after_epoch(p: Progress) -> bool:
            nonlocal stopped
            stopped = bool(callback(name, p)) if callback else False
            return stopped

        path = train(
            store,
            settings,
            folder / name,
            start=start,
            validated=validated,
            callback=after_epoch,
            progress=progress,
        )
        if stopped:
            raise InputError("callback", "an ensemble to be finished", f"stopped in {name}")
        return load_checkpoint(path)

    o = config.ensemble
    if config.data.condition:
        raise InputError(
            "data.condition", "false for pivots, which have parameters of their own", True
        )
    if base is not None:
        base.check_fits(store)
        if base.kernel is not None or base.parameters[0] != sets[0]:
            raise InputError("base", f"a network of {sets[0]}", base.parameters)
    checkpoints = [base] if base is not None else []
    shorter = dataclasses.replace(
        config.train,
        epochs=o.epochs,
        high_epochs=o.high_epochs,
        learning_rate=o.learning_rate,
        high_learning_rate=o.learning_rate,
    )
    for parameters in sets[len(checkpoints) :]:
        first, values = not checkpoints, dataclasses.astuple(parameters)
        # Named by its parameters, because numbers would change as the store grows.
        name = "set-" + "-".join(f"{v:g}" for v in values)
        if first:
            name = "base"
        start = checkpoints[0] if o.start_from_base and not first else None
        own = dataclasses.replace(config.data, parameters=",".join(map(repr, values)))
        settings = dataclasses.replace(config, data=own)
        if start is not None:
            settings = dataclasses.replace(settings, train=shorter)
        # Sets other than the base have few clips, all of which are needed for training.
        checkpoints.append(run(name, settings, start, validated=first))

    networks = tuple(c.networks[0] for c in checkpoints)
    sweep = sweep_pivots(store, networks, sets, config, progress=progress)
    count = o.pivots or smallest_good([record["score_mm"] for _, record in sweep])
    kernel, chosen = sweep[min(count, len(sweep)) - 1]
    report = {
        "sets": [dataclasses.asdict(p) for p in sets],
        "pivots": chosen["pivots"],
        "sigma": kernel.sigma,
        "sweep": [record for _, record in sweep],
    }
    write_file(folder / "ensemble.json", json.dumps(report, indent=1).encode())
    pivots = tuple(networks[i] for i in chosen["pivots"])
    trained_on = tuple(sets[i] for i in chosen["pivots"])
    whole = Checkpoint(pivots, trained_on, kernel)
    return save_checkpoint(whole, folder / "ensemble.safetensors")


def sweep_pivots(
    store: ClipStore,
    networks: Sequence[MotionNetwork],
    sets: Sequence[SimulationParameters],
    config: Config,
    *,
    progress: Callable[[str, float], None] | None = None,
) -> list[tuple[Kernel, dict[str, Any]]]:
    """Pivots, kernel and errors for every K, from 1 to the number of training sets.

    Bandwidth and training step are chosen on the validation sets, never on the test sets.

    Returns
    -------
    list of (Kernel, dict)
        For K = 1 to the number of training sets the kernel with the bandwidth that has the
        smallest error on the validation sets, and its entry in ``ensemble.json``: `pivots`, the
        indices of training sets; `validation_mm`, that error, None where nothing can be left out;
        `score_mm`, the mean error over the validation sets and over every training set predicted
        from the other pivots, as one validation set alone says little; `test_mm`, errors of
        ``rbf``, ``inverse distance`` and ``nearest`` on the test sets, for training motions
        (``train``) and test motions (``test``).
    """
    roles, o = parameter_roles(store), config.ensemble
    held, tested = (
        [p for p in store.parameters() if roles[p] == role] for role in ("validation", "test")
    )

    def compared(of: Sequence[SimulationParameters], split: str) -> list[Compared]:
        out = []
        for k, p in enumerate(of):
            out.append((compare_networks(store, networks, p, split, o.frames), p.normalised()))
            if progress:
                progress(f"comparing networks, {split} motions", (k + 1) / len(of))
        return out

    theta = np.stack([p.normalised() for p in sets])
    grams = [q for q, _ in compared(sets, "train")]
    held_out = compared(held, "train")
    tests = {split: compared(tested, split) for split in ("train", "test")}

    def mixed(of: Sequence[Compared], pivots: list[int]) -> list[Mixed]:
        return [Mixed.of(pivots, theta, at, q) for q, at in of]

    sweep = []
    for count in range(1, len(sets) + 1):
        pivots = select_pivots(grams, theta, count)
        learned, validation = left_out(grams, theta, pivots), mixed(held_out, pivots)
        fits = [
            fit_kernel(
                learned,
                validation,
                sigma=sigma,
                shape=o.kernel,
                steps=o.steps,
                seed=config.train.seed,
            )
            for sigma in o.sigmas
        ]
        # With one pivot the weights are 1, and all errors are the same or NaN.
        kernel, error = min(fits, key=lambda f: (math.isnan(f[1]), f[1]))
        mixers = {
            "rbf": kernel.weights,
            "inverse distance": inverse_distance,
            "nearest": nearest,
        }
        seen = [m.error(kernel.weights) for m in (*learned, *validation)]
        record = {
            "count": count,
            "sigma": kernel.sigma,
            "pivots": pivots,
            "validation_mm": None if math.isnan(error) else 1e3 * error,
            "score_mm": 1e3 * float(np.mean(seen)),
            "test_mm": {
                name: {
                    k: 1e3 * float(np.mean([m.error(mix) for m in mixed(q, pivots)]))
                    for k, q in tests.items()
                    if q
                }
                for name, mix in mixers.items()
            },
        }
        sweep.append((kernel, record))
    return sweep


def compare_networks(
    store: ClipStore,
    networks: Sequence[MotionNetwork],
    parameters: SimulationParameters,
    split: str,
    frames: int,
) -> Array:
    """Gram matrix ``(S, S)`` of all networks' residuals on one set's clips of a split.

    Networks predict at most four clips from their first frame; `frames` evenly spread frames are
    compared.

    Raises
    ------
    InputError
        If the set has no clip of the split.
    """
    names = store.names(split, parameters)
    if not names:
        raise InputError("store", f"{split} motions of {parameters}", str(store.path))
    (some,) = spread([len(names)], _CLIPS)
    names = tuple(names[k] for k in some)
    total, used = np.zeros((len(networks), len(networks))), 0
    chosen = spread([store.clip(n).n_frames for n in names], frames)
    for name, here in zip(names, chosen, strict=True):
        if not len(here):
            continue
        clip = store.clip(name)
        upto = clip.joints[: here[-1] + 1]
        answers = [n.predict(upto, frames=here) for n in networks]
        total += gram(answers, clip.sequence.frames(here)) * len(here)
        used += len(here)
    return total / used
