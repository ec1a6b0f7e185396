"""Training of an ensemble: one network for every training set, pivots, kernel."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ssdr.common.errors import InputError

from ..configs.config import Config
from ..data.clip import spread
from ..data.parameters import SimulationParameters
from ..data.store import ClipStore
from ..data.virtual_bones import parameter_roles
from ..io.files import Progress, silent, write_file
from ..networks.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from ..networks.network import MotionNetwork
from .pivots import fit_kernel, gram, left_out, select_pivots
from .run import train

Array = NDArray[np.float64]
# Most clips of a parameter set on which networks are compared, since prediction takes long.
_CLIPS = 4


def train_ensemble(
    store: ClipStore,
    config: Config,
    folder: Path | str,
    *,
    start: Checkpoint | None = None,
    progress: Progress = silent,
) -> Path:
    """Train one network for each training parameter set, and the kernel that mixes the pivots.

    If training was interrupted, another call continues it.

    Parameters
    ----------
    store : ClipStore
    config : Config
    folder : path
        Folder with a subfolder for each network, ``ensemble.safetensors``, and ``ensemble.json``:
        `sets`, the training parameter sets, and `pivots`, their indices.
    start : Checkpoint, optional
        Network from whose weights every network starts; by default these are random.
    progress
        As in :func:`~garmentnet.training.run.train`.

    Returns
    -------
    Path
        Path of the ensemble's checkpoint.

    Raises
    ------
    InputError
        If there is only one training set.
    """
    folder, o = Path(folder), config.ensemble
    roles = parameter_roles(store)
    sets = [p for p in store.parameters() if roles[p] == "train"]
    if len(sets) < 2:
        raise InputError("store", "two or more training sets of parameters", len(sets))
    if config.data.condition:
        raise InputError(
            "data.condition", "false for pivots, which have parameters of their own", True
        )
    networks = []
    for parameters in sets:
        values = dataclasses.astuple(parameters)
        # Named by its parameters, because numbers would change as the store grows.
        name = "set-" + "-".join(f"{v:g}" for v in values)

        def show(text: str, fraction: float, name: str = name) -> None:
            progress(f"{name}, {text}", fraction)

        own = dataclasses.replace(config.data, parameters=",".join(map(repr, values)))
        path = train(
            store,
            dataclasses.replace(config, data=own),
            folder / name,
            start=start,
            progress=show,
        )
        networks.append(load_checkpoint(path).networks[0])

    theta = np.stack([p.normalised() for p in sets])
    grams = []
    for k, p in enumerate(sets):
        grams.append(compare_networks(store, networks, p, "train", o.frames))
        progress("comparing networks", (k + 1) / len(sets))
    pivots = select_pivots(grams, theta, o.pivots or len(sets))
    kernel = fit_kernel(left_out(grams, theta, pivots), steps=o.steps, seed=config.train.seed)
    report = {"sets": [dataclasses.asdict(p) for p in sets], "pivots": pivots}
    write_file(folder / "ensemble.json", json.dumps(report, indent=1).encode())
    chosen = tuple(networks[k] for k in pivots)
    whole = Checkpoint(chosen, tuple(sets[k] for k in pivots), kernel)
    return save_checkpoint(whole, folder / "ensemble.safetensors")


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
    total, used = np.zeros((len(networks), len(networks))), 0
    for clip, here in store.sample([names[k] for k in some], frames):
        upto = clip.joints[: here[-1] + 1]
        answers = [n.predict(upto, frames=here) for n in networks]
        total += gram(answers, clip.sequence.frames(here)) * len(here)
        used += len(here)
    return total / used
