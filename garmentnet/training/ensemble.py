"""Training of an ensemble: one network for every training set, pivots, kernel, comparison.

It has two forms.  The paper's: pivots that know their own parameters' clips alone.  With
``data.condition`` a network that reads the parameters learns from all training sets first; pivots
start from it and are fine-tuned, and it is mixed with them by a share that validation sets choose.
"""

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
# Shares of the common network that are tried.
_SHARES = tuple(k / 10 for k in range(11))


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
        (``train``) and test motions (``test``); with a common network of ``mixed`` and ``common``.
    share : float
        Of the common network in ``mixed``.
    """

    pivots: list[int]
    kernel: Kernel
    sigma: float
    validation: float
    score: float
    errors: dict[str, dict[str, float]]
    share: float = 0.0


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
    """Train a network for every training set, and the kernel.

    Without ``data.condition`` the first is the base network, from which the others start if the
    configuration says so; with it all start from the network that reads the parameters.  Called
    again, it continues.

    Parameters
    ----------
    store : ClipStore
    config : Config
    folder : path
        For one folder a network, ``ensemble.safetensors`` and ``ensemble.json``, which holds the
        sweep over K.
    base : Checkpoint, optional
        The network from which the others start, if it is trained already.
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
            bones_folder=bones_folder,
            callback=after_epoch,
            progress=progress,
        )
        if stopped:
            raise InputError("callback", "an ensemble to be finished", f"stopped in {name}")
        return load_checkpoint(path)

    common: Checkpoint | None = None
    checkpoints: list[Checkpoint] = []
    if base is not None:
        base.check_fits(store)
        fits = (
            base.networks[0].condition if config.data.condition else base.parameters[0] == sets[0]
        )
        if base.kernel is not None or not fits:
            of = "all training sets" if config.data.condition else str(sets[0])
            raise InputError("base", f"a network of {of}", base.parameters)
    if config.data.condition:
        everything = dataclasses.replace(config.data, parameters="")
        common = base or run("common", dataclasses.replace(config, data=everything), None)
    elif base is not None:
        checkpoints.append(base)
    o = config.ensemble
    for k, parameters in list(enumerate(sets))[len(checkpoints) :]:
        # Named by its parameters, because numbers would change as the store grows.
        name = "set-" + "-".join(f"{v:g}" for v in dataclasses.astuple(parameters))
        data = dataclasses.replace(config.data, parameters=_text(parameters))
        settings = dataclasses.replace(config, data=data)
        start = common
        if common is None:
            name = name if k else "base"
            start = checkpoints[0] if k and o.start_from_base else None
        if start is not None:
            shorter = dataclasses.replace(
                config.train,
                epochs=o.epochs,
                high_epochs=o.high_epochs,
                learning_rate=o.learning_rate,
                high_learning_rate=o.learning_rate,
            )
            settings = dataclasses.replace(settings, train=shorter)
        # Sets beside the base have few clips, all to learn from.
        checkpoints.append(run(name, settings, start, validated=k == 0))

    bones = virtual_bones(store, config.bones, folder=bones_folder)
    networks = tuple(c.networks[0] for c in checkpoints)
    shared = None if common is None else common.networks[0]
    sweep = sweep_pivots(store, bones, networks, sets, config, common=shared, progress=progress)
    count = o.pivots or smallest_good([s.score for s in sweep])
    chosen = sweep[min(count, len(sweep)) - 1]
    text = json.dumps(_report(sets, sweep, chosen), indent=1)
    write_file(folder / "ensemble.json", text.encode())
    return save_checkpoint(
        Checkpoint(
            tuple(networks[i] for i in chosen.pivots),
            tuple(sets[i] for i in chosen.pivots),
            chosen.kernel,
            shared,
            chosen.share,
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
    common: MotionNetwork | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> list[Sweep]:
    """Pivots and kernel for K from 1 to all training sets, and their errors.

    Bandwidth, training step and the common network's share are chosen on the validation sets,
    never on the test sets.

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
            every = [*networks] if common is None else [*networks, common]
            own = [*sets] if common is None else [*sets, p]
            out.append(compare_networks(store, bones, every, own, p, split, o.frames))
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
        w = mix(theta[pivots], at)
        mixed = [*pivots, len(sets)][: len(w)]  # the common network comes last
        return error_of(q[np.ix_(mixed, mixed)], w)

    def test_error(split: str, mix: Mixer, pivots: list[int]) -> float:
        pairs = zip(tests[split], places, strict=True)
        return 1e3 * float(np.mean([error_at(q, at, mix, pivots) for q, at in pairs]))

    def fit(pivots: list[int], sigma: float) -> tuple[Kernel, float]:
        seed = config.train.seed
        return fit_kernel(
            train_grams,
            theta,
            pivots,
            validation=held_out,
            sigma=sigma,
            shape=o.kernel,
            steps=o.steps,
            seed=seed,
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
        share = 0.0
        if common is not None:
            mixtures = [(_with_share(kernel.weights, x), x) for x in _SHARES]
            if held_out:
                share = min(
                    mixtures,
                    key=lambda m: sum(error_at(q, at, m[0], pivots) for q, at in held_out),
                )[1]
            mixers["mixed"] = _with_share(kernel.weights, share)
            mixers["common"] = _with_share(kernel.weights, 1.0)
        errors = {
            name: {split: test_error(split, mix, pivots) for split in tests if tests[split]}
            for name, mix in mixers.items()
        }
        score = 1e3 * float(np.mean(seen))
        sweep.append(Sweep(pivots, kernel, sigma, 1e3 * validation, score, errors, share))
    return sweep


def _with_share(mix: Mixer, share: float) -> Mixer:
    """The mixture of pivots, and the common network with a share of it."""
    return lambda pivots, at: np.append((1 - share) * mix(pivots, at), share)


def compare_networks(
    store: ClipStore,
    bones: VirtualBones,
    networks: Sequence[MotionNetwork],
    own: Sequence[SimulationParameters],
    parameters: SimulationParameters,
    split: str,
    frames: int,
) -> Array:
    """Gram matrix ``(S, S)`` of all networks' residuals on one set's clips of a split.

    Networks predict at most four clips from their first frame; `frames` evenly spread frames are
    compared.  A network that reads parameters reads its `own`.

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
        answers = [
            n.predict(upto, frames=here, parameters=p.normalised() if n.condition else None)
            for n, p in zip(networks, own, strict=True)
        ]
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
                "share": s.share,
                "test_mm": s.errors,
            }
            for s in sweep
        ],
    }
