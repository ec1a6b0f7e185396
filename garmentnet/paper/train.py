"""A training, from a store of clips to a checkpoint (Pan et al. 2022, section 5).

The low-frequency module is trained first, then the high-frequency module on its output; an ensemble
is one such network for every training set of parameters, its pivots and its kernel.  A run that was
stopped continues from its folder, bit for bit on the same machine and with the same number of
threads.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import logging
from collections import Counter
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from ssdr.common.errors import InputError
from ssdr.io.atomic import write_bytes
from ssdr.io.file_errors import reading

from ..configs.config import Config
from ..data.clip import MIRRORED, Clip, spread
from ..data.parameters import SimulationParameters
from ..data.store import ClipStore
from ..io.files import Progress, silent
from ..io.tensors import digest
from ..networks.checkpoint import Checkpoint, load_checkpoint, load_weights, save_checkpoint
from ..networks.features import Normaliser, PoseFeatures, PoseReader, transforms_in_frame
from ..networks.network import MotionNetwork
from ..training.batches import load_tracks
from ..training.detail import DetailObjective
from ..training.loop import fit
from ..training.targets import LowTargets
from .bones import VirtualBones, parameter_roles, virtual_bones
from .ensemble import extremes, fit_kernel, gram, left_out, select_pivots
from .high import HighFrequencyObjective
from .low import LowFrequencyObjective

_logger = logging.getLogger(__name__)
# Number of frames from which the statistics of the bones' motion are found.
_STATISTICS = 400
# With more frames than this, mirrored ones included, the high-frequency module is trained on only
# some of the clips.
_DETAIL_FRAMES = 130_000


def choose_clips(
    store: ClipStore,
    config: Config,
    split: str = "train",
    parameters: SimulationParameters | None = None,
) -> tuple[list[str], SimulationParameters | None]:
    """Names of the clips of a split that a configuration uses, without mirrored ones.

    Parameters
    ----------
    store : ClipStore
    config : Config
    split : {"train", "validation", "test"}
    parameters : SimulationParameters, optional
        In place of those of the configuration.

    Returns
    -------
    names : list of str
    parameters : SimulationParameters or None
        Parameters that all the clips share; None for a network that reads the parameters, whose
        clips are those of all training sets.

    Raises
    ------
    InputError
        If there are none for training, or ``data.parameters`` cannot be read.
    """
    roles = parameter_roles(store)
    text, chosen = config.data.parameters, parameters
    if text and chosen is None:
        try:
            bending, density, time_scale = (float(x) for x in text.split(","))
            chosen = SimulationParameters(bending, density, time_scale)
        except (TypeError, ValueError) as error:
            expected = "'bending,density,time_scale'"
            raise InputError("data.parameters", expected, repr(text)) from error
    elif chosen is None and not config.data.condition:
        chosen = store.parameters()[0] if store.parameters() else None
    o = config.data

    def used(clip: Clip) -> bool:
        if not (clip.parameters == chosen if chosen else roles[clip.parameters] == "train"):
            return False
        if not o.leave_out:
            return clip.split == split and fnmatchcase(clip.motion, o.motions or "*")
        # Each motion in turn is left out and used for the test, whatever the splits say.
        left = fnmatchcase(clip.motion, o.leave_out)
        if split == "train":
            return not left and fnmatchcase(clip.motion, o.motions or "*")
        return left and split == "test"

    names: list[str] = []
    frames: Counter[SimulationParameters] = Counter()
    for clip in store.clips():
        enough = split == "train" and 0 < o.frames <= frames[clip.parameters]
        if used(clip) and not enough:
            names.append(clip.name)
            frames[clip.parameters] += clip.n_frames
    if split == "train" and not names:
        wanted = f" of motions {o.motions}" if o.motions else ""
        expected = f"training clips{wanted} of {chosen or 'training sets'}"
        raise InputError("store", expected, str(store.path))
    return names, chosen


def with_mirrored(store: ClipStore, config: Config, names: Sequence[str]) -> list[str]:
    """Names of the clips and, if asked for and the garment is symmetric, of their mirror images."""
    mirror = config.data.mirror and store.mirror_vertices is not None
    return [*names, *(n + MIRRORED for n in names if mirror)]


def pose_reader(config: Config, bones: VirtualBones, names: Sequence[str]) -> PoseReader:
    """Reader of a network's input, with the statistics of the named clips."""
    subject, o = bones.subject, config.features
    features = PoseFeatures(subject.skeleton, o, subject.fps)
    inputs = (features(bones.store.clip(name).joints)[0] for name in names)
    normaliser = Normaliser.fit(inputs, floor=o.floor, clamp=o.clamp)
    return PoseReader(features, normaliser, 3 if config.data.condition else 0)


def build_network(config: Config, bones: VirtualBones, names: Sequence[str]) -> MotionNetwork:
    """A network with random weights and the statistics of the named clips."""
    reader = pose_reader(config, bones, names)
    network = MotionNetwork(config, bones.subject, reader.normaliser)
    # Evenly spread frames are enough for the mean and deviation of the bones' motion.
    plain = [n for n in names if not n.endswith(MIRRORED)]
    low, frames, joints = [], [], []
    for clip, some in bones.store.sample(plain, _STATISTICS):
        low.append(bones.split(clip.name, some)[0])
        frames.append(reader.features(clip.joints)[1][some])
        joints.append(clip.joints[some])
    transforms, frame = bones.fit(np.concatenate(low), tolerance=1e-3), np.concatenate(frames)
    network.low.code.fit(
        transforms_in_frame(transforms, frame), transforms_in_frame(np.concatenate(joints), frame)
    )
    return network


def train(
    store: ClipStore,
    config: Config,
    folder: Path | str,
    *,
    start: Checkpoint | None = None,
    progress: Progress = silent,
) -> Path:
    """Train both modules of a network, or only the low-frequency one if `high_epochs` is 0.

    If training was interrupted, another call continues it.  Without validation clips (with
    ``data.leave_out`` there are none) all epochs are run and the last weights kept.

    Parameters
    ----------
    store : ClipStore
    config : Config
    folder : path
        Folder of the run.  It holds ``checkpoint.safetensors`` and ``history.json`` once the run is
        finished, states and curves before.
    start : Checkpoint, optional
        Checkpoint with whose weights and bones to start; by default weights are random, and bones
        are computed.
    progress : callable, optional
        Called during the preparation and after every epoch with a text and the fraction that is
        done.  What it raises ends the run, which can be continued later.

    Returns
    -------
    Path
        Path of the checkpoint.

    Raises
    ------
    InputError
        If the store lacks the clips, the folder holds a run of another
        configuration or `start` does not fit.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    names, parameters = choose_clips(store, config)
    left = config.data.leave_out
    if left and not any(fnmatchcase(c.motion, left) for c in store.clips()):
        raise InputError("data.leave_out", "a pattern of motions of the store", left)
    held = choose_clips(store, config, "validation")[0]
    if not held:
        _logger.warning("no clips for validation: all epochs, and the weights of the last")
    learned = with_mirrored(store, config, names)
    _claim(folder, config, learned, start)
    o = config.train
    if o.threads:
        torch.set_num_threads(o.threads)
    device = o.device if o.device != "auto" else "cuda" if torch.cuda.is_available() else "cpu"
    subject = None if start is None else start.subject
    bones = virtual_bones(store, config.bones, subject=subject, progress=progress)
    # The initial weights depend on the seed alone, not on what ran before.
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(o.seed)
        network = build_network(config, bones, learned).to(device)
    if start is not None:
        load_weights(network, start, "low")
    tracks = load_tracks(network, bones, learned)
    validation = load_tracks(network, bones, held)

    begun = start is not None and start.networks[0].high is not None
    if o.high_epochs:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(o.seed + 1)
            network.add_high()
        network.to(device)
        if start is not None and begun:
            load_weights(network, start, "high")
    targets = LowTargets(bones, network.features, learned)
    low_loss = LowFrequencyObjective(network, targets, tracks, validation)
    learn = functools.partial(fit, options=o, folder=folder, progress=progress)
    history = {"low": learn(low_loss, name="low", epochs=o.epochs, learning_rate=o.learning_rate)}
    if o.high_epochs:
        every = max(1, sum(t.n_frames for t in tracks) // _DETAIL_FRAMES)
        kind = DetailObjective if config.high.kind == "basis" else HighFrequencyObjective
        high_loss = kind(network, tracks[::every], validation, start=begun)
        epochs, rate = o.high_epochs, o.high_learning_rate
        history["high"] = learn(high_loss, name="high", epochs=epochs, learning_rate=rate)
    found = {k: [e["rmse"] for e in h if e["rmse"] is not None] for k, h in history.items()}
    errors = {f"{k}, validation": min(v) for k, v in found.items() if v}
    path = save_checkpoint(
        Checkpoint((network,), (parameters,), None, errors), folder / "checkpoint.safetensors"
    )
    # Last, because it says that the run is finished.
    write_bytes(folder / "history.json", json.dumps(history, indent=1).encode())
    return path


def _claim(folder: Path, config: Config, clips: Sequence[str], start: Checkpoint | None) -> None:
    # Settings that do not change the weights may differ from call to call.
    free = ("patience", "device", "threads")
    state = {} if start is None else start.networks[0].state_dict()
    begun = digest({k: v.cpu().numpy() for k, v in state.items()}, {})
    record = {"config": dataclasses.asdict(config), "clips": list(clips), "start": begun}
    record = json.loads(json.dumps(record))
    for key in free:
        record["config"]["train"].pop(key)
    file = folder / "run.json"
    if not file.is_file():
        write_bytes(file, json.dumps(record, indent=1).encode())
        return
    with reading(file):
        there = json.loads(file.read_text("utf-8"))
    if there != record:
        raise InputError("folder", "a new one, or one of this configuration, clips, start", folder)


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
        Folder with a subfolder for each network and ``ensemble.safetensors``.
    start : Checkpoint, optional
        Network from whose weights every network starts; by default these are random.
    progress
        As in :func:`~garmentnet.paper.train.train`.

    Returns
    -------
    Path
        Path of the ensemble's checkpoint.

    Raises
    ------
    InputError
        If there is only one training set, or ``ensemble.pivots`` is too small or too large.
    """
    folder, o = Path(folder), config.ensemble
    roles = parameter_roles(store)
    sets = [p for p in store.parameters() if roles[p] == "train" and store.names("train", p)]
    if len(sets) < 2:
        raise InputError("store", "two or more training sets of parameters", len(sets))
    if config.data.condition or config.data.parameters:
        expected = "neither for pivots, which have parameters of their own"
        raise InputError("data.condition, data.parameters", expected, "one of them")
    theta, count = np.stack([p.normalised() for p in sets]), o.pivots or len(sets)
    # Errors come before hours of training.
    extremes(theta, count)
    learned = [choose_clips(store, config, "train", p)[0] for p in sets]
    networks = []
    for parameters in sets:
        values = dataclasses.astuple(parameters)
        # Named by its parameters, because numbers would change as the store grows.
        name = "set-" + "-".join(f"{v:g}" for v in values)

        def show(text: str, fraction: float, name: str = name) -> None:
            progress(f"{name}, {text}", fraction)

        data = dataclasses.replace(config.data, parameters=",".join(map(repr, values)))
        own = dataclasses.replace(config, data=data)
        path = train(store, own, folder / name, start=start, progress=show)
        networks.append(load_checkpoint(path).networks[0])

    grams = []
    for names in learned:
        grams.append(compare_networks(store, networks, names, o.frames))
        progress("comparing networks", len(grams) / len(sets))
    pivots = select_pivots(grams, theta, count)
    kernel = fit_kernel(left_out(grams, theta, pivots), steps=o.steps, seed=config.train.seed)
    chosen = tuple(networks[k] for k in pivots)
    whole = Checkpoint(chosen, tuple(sets[k] for k in pivots), kernel)
    return save_checkpoint(whole, folder / "ensemble.safetensors")


def compare_networks(
    store: ClipStore, networks: Sequence[MotionNetwork], names: Sequence[str], frames: int
) -> Array:
    """Gram matrix ``(S, S)`` of the residuals of S networks on some clips.

    Networks predict at most four clips from their first frame; `frames` evenly spread frames are
    compared.
    """
    (some,) = spread([len(names)], _CLIPS)
    total, used = np.zeros((len(networks), len(networks))), 0
    for clip, here in store.sample([names[k] for k in some], frames):
        upto = clip.joints[: here[-1] + 1]
        answers = [n.predict(upto)[here] for n in networks]
        total += gram(answers, clip.sequence.frames(here)) * len(here)
        used += len(here)
    return total / used
