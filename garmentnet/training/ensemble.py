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
from ..data.parameters import SimulationParameters
from ..data.store import ClipStore
from ..data.virtual_bones import VirtualBones, parameter_roles, virtual_bones
from ..io.files import write_file
from ..networks.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from ..networks.ensemble import Kernel
from ..networks.network import MotionNetwork
from .loop import Progress
from .pivots import (
    error_of,
    fit_kernel,
    gram,
    inverse_distance,
    left_out_errors,
    nearest,
    select_pivots,
    smallest_good,
)
from .run import train

__all__ = ["Sweep", "compare_networks", "sweep_pivots", "train_ensemble"]

Array = NDArray[np.float64]
# Weights (K,) of pivots (K, P) at parameters (P,), all normalised.
Mixer = Callable[[Array, Any], Array]
# Clips of a parameter set on which networks are compared, at most: predicting is the cost.
_CLIPS = 4


@dataclasses.dataclass(frozen=True, eq=False)
class Sweep:
    """The ensemble of K pivots, one entry of the sweep over K.

    Attributes
    ----------
    pivots : list of int
        Indices of training sets.
    kernel : Kernel
    sigma : float
        Bandwidth with the smallest error on the validation sets.
    validation : float
        That error, mm.
    score : float
        Mean error, mm, over the validation sets and over every training set predicted from the
        other pivots: one validation set alone says little.
    errors : dict
        mm, of ``rbf``, ``inverse distance`` and ``nearest`` on the test sets, for training motions
        (``train``) and test motions (``test``).
    """

    pivots: list[int]
    kernel: Kernel
    sigma: float
    validation: float
    score: float
    errors: dict[str, dict[str, float]]


def train_ensemble(
    store: ClipStore,
    config: Config,
    folder: Path | str,
    *,
    base: Checkpoint | None = None,
    bones_folder: Path | str | None = None,
    callback: Callable[[str, Progress], bool | None] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Path:
    """Train the base network, one for every other training set, and the kernel.

    Called again, it continues.

    Parameters
    ----------
    store : ClipStore
    config : Config
    folder : path
        For one folder a network, ``ensemble.safetensors`` and ``ensemble.json``, which holds the
        sweep over K.
    base : Checkpoint, optional
        The base network, if it is trained already.
    bones_folder, progress
        As in :func:`~garmentnet.training.run.train`.
    callback : callable, optional
        Called with the network's name and its progress; returning True stops.

    Returns
    -------
    Path
        Of the ensemble's checkpoint.

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
    if config.data.condition:
        raise InputError("data.condition", "false: an ensemble's networks read no parameters", True)
    stopped = False
    checkpoints: list[Checkpoint] = []
    if base is not None:
        base.check_fits(store)
        if base.kernel is not None or base.parameters[0] != sets[0]:
            raise InputError("base", f"a network of {sets[0]}", base.parameters)
        checkpoints.append(base)
    o = config.ensemble
    for k, parameters in list(enumerate(sets))[len(checkpoints) :]:
        # Named by its parameters, because numbers would change as the store grows.
        name = "set-" + "-".join(f"{v:g}" for v in dataclasses.astuple(parameters)) if k else "base"
        data = dataclasses.replace(config.data, parameters=_text(parameters))
        set_config = dataclasses.replace(config, data=data)
        start = None
        if k and o.start_from_base:
            start = checkpoints[0]
            set_config = dataclasses.replace(
                set_config,
                train=dataclasses.replace(
                    config.train,
                    epochs=o.epochs,
                    high_epochs=o.high_epochs,
                    learning_rate=o.learning_rate,
                    high_learning_rate=o.learning_rate,
                ),
            )

        def after_epoch(p: Progress, name: str = name) -> bool:
            nonlocal stopped
            stopped = bool(callback(name, p)) if callback else False
            return stopped

        path = train(
            store,
            set_config,
            folder / name,
            start=start,
            bones_folder=bones_folder,
            callback=after_epoch,
            progress=progress,
        )
        if stopped:
            raise InputError("callback", "an ensemble to be finished", f"stopped in {name}")
        checkpoints.append(load_checkpoint(path))

    bones = virtual_bones(store, config.bones, folder=bones_folder)
    networks = tuple(c.networks[0] for c in checkpoints)
    sweep = sweep_pivots(store, bones, networks, sets, config, progress=progress)
    count = o.pivots or smallest_good([s.score for s in sweep])
    chosen = sweep[min(count, len(sweep)) - 1]
    text = json.dumps(_report(sets, sweep, chosen), indent=1)
    write_file(folder / "ensemble.json", text.encode())
    return save_checkpoint(
        Checkpoint(
            tuple(networks[i] for i in chosen.pivots),
            tuple(sets[i] for i in chosen.pivots),
            chosen.kernel,
        ),
        folder / "ensemble.safetensors",
    )


def sweep_pivots(
    store: ClipStore,
    bones: VirtualBones,
    networks: Sequence[MotionNetwork],
    sets: Sequence[SimulationParameters],
    config: Config,
    *,
    progress: Callable[[str, float], None] | None = None,
) -> list[Sweep]:
    """Pivots and kernel for K from 1 to all training sets, and their errors.

    Bandwidth and training step are chosen on the validation sets, never on the test sets.

    Returns
    -------
    list of Sweep
        For K = 1 to the number of training sets.
    """
    roles = parameter_roles(store)
    by_role = {r: [p for p in store.parameters() if roles[p] == r] for r in ("validation", "test")}
    o = config.ensemble

    def grams(of: Sequence[SimulationParameters], split: str) -> list[Array]:
        out = []
        for k, p in enumerate(of):
            out.append(compare_networks(store, bones, networks, p, split, o.frames))
            if progress:
                progress(f"comparing networks, {split} motions", (k + 1) / len(of))
        return out

    theta = np.stack([p.normalised() for p in sets])
    train_grams = grams(sets, "train")
    held = [p.normalised() for p in by_role["validation"]]
    held_out = list(zip(grams(by_role["validation"], "train"), held, strict=True))
    tests = {split: grams(by_role["test"], split) for split in ("train", "test")}
    places = [p.normalised() for p in by_role["test"]]

    def error_at(q: Array, at: Array, mix: Mixer, pivots: list[int]) -> float:
        return error_of(q[np.ix_(pivots, pivots)], mix(theta[pivots], at))

    def test_error(split: str, mix: Mixer, pivots: list[int]) -> float:
        pairs = zip(tests[split], places, strict=True)
        return 1e3 * float(np.mean([error_at(q, at, mix, pivots) for q, at in pairs]))

    def fit(pivots: list[int], sigma: float) -> tuple[Kernel, float]:
        seed = config.train.seed
        return fit_kernel(
            train_grams, theta, pivots, validation=held_out, sigma=sigma, steps=o.steps, seed=seed
        )

    sweep = []
    for count in range(1, len(sets) + 1):
        pivots = select_pivots(train_grams, theta, count)
        fits = [(*fit(pivots, sigma), sigma) for sigma in o.sigmas]
        # With one pivot the weights are 1, and all errors are the same or NaN.
        kernel, validation, sigma = min(fits, key=lambda f: (math.isnan(f[1]), f[1]))
        mixers: dict[str, Mixer] = {
            "rbf": kernel.weights,
            "inverse distance": inverse_distance,
            "nearest": nearest,
        }
        seen = left_out_errors(kernel, train_grams, theta, pivots)
        seen += [error_at(q, at, kernel.weights, pivots) for q, at in held_out]
        errors = {
            name: {split: test_error(split, mix, pivots) for split in tests if tests[split]}
            for name, mix in mixers.items()
        }
        score = 1e3 * float(np.mean(seen))
        sweep.append(Sweep(pivots, kernel, sigma, 1e3 * validation, score, errors))
    return sweep


def compare_networks(
    store: ClipStore,
    bones: VirtualBones,
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
    names = [c.name for c in store.clips(split) if c.parameters == parameters]
    if not names:
        raise InputError("store", f"{split} motions of {parameters}", str(store.path))
    some = np.unique(np.linspace(0, len(names) - 1, _CLIPS).astype(int))
    names = [names[k] for k in some]
    lengths = [store.clip(n).n_frames for n in names]
    total, used, first = np.zeros((len(networks), len(networks))), 0, 0
    chosen = np.unique(np.linspace(0, sum(lengths) - 1, min(frames, sum(lengths))).astype(int))
    for name, length in zip(names, lengths, strict=True):
        here = chosen[(chosen >= first) & (chosen < first + length)] - first
        first += length
        if not len(here):
            continue
        clip = store.clip(name)
        truth = clip.sequence.frames(here)
        upto = clip.joints[: here[-1] + 1]
        answers = [n.predict(upto, frames=here) for n in networks]
        total += gram(answers, truth) * len(here)
        used += len(here)
    return total / used


def _text(p: SimulationParameters) -> str:
    return f"{p.bending!r},{p.density!r},{p.time_scale!r}"


def _report(
    sets: Sequence[SimulationParameters], sweep: Sequence[Sweep], chosen: Sweep
) -> dict[str, Any]:
    within = {}
    for split in ("train", "test"):
        curve = [s.errors["rbf"].get(split) for s in sweep]
        if all(e is not None for e in curve):
            within[split] = smallest_good([float(e) for e in curve if e is not None])
    return {
        "sets": [dataclasses.asdict(p) for p in sets],
        "pivots": chosen.pivots,
        "sigma": chosen.sigma,
        "smallest_within_2_percent": within,
        "sweep": [
            {
                "count": len(s.pivots),
                "pivots": s.pivots,
                "sigma": s.sigma,
                "validation_mm": None if math.isnan(s.validation) else s.validation,
                "score_mm": s.score,
                "test_mm": s.errors,
            }
            for s in sweep
        ],
    }
