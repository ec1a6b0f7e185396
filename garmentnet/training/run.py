"""Training: the loop, the tasks that it can be given, and the run from a store to a checkpoint.

The low-frequency module is trained first, then the high-frequency module on its
output.  A run's folder holds all that it takes to go on where it was stopped,
bit for bit on the same machine and number of threads.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from ssdr.errors import InputError
from ssdr.io.atomic import write_bytes

from ..configs.config import Config, TrainOptions
from ..data.store import MIRRORED, ClipStore, SimulationParameters
from ..data.virtual_bones import VirtualBones, parameter_roles, virtual_bones
from ..networks.checkpoint import (
    Checkpoint,
    load_tensors,
    load_weights,
    save_checkpoint,
    save_tensors,
)
from ..networks.features import Normaliser, PoseFeatures
from ..networks.network import MotionNetwork
from .batches import Batch, Track, batches, load_tracks
from .objectives import HighTask, LowTask

__all__ = [
    "Epoch",
    "Progress",
    "Task",
    "build_network",
    "choose_clips",
    "fit",
    "train",
]

_logger = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Progress:
    """What the loop tells its caller after every epoch; True as an answer stops it."""

    phase: str
    epoch: int
    elapsed: float
    loss: float
    rmse: float
    fraction: float
    time_left: float


@dataclasses.dataclass(frozen=True)
class Epoch:
    """A line of the history: training loss and, where it was validated, RMSE in metres."""

    epoch: int
    loss: float
    rmse: float | None
    learning_rate: float
    seconds: float


class Task(Protocol):
    """What the loop trains."""

    @property
    def module(self) -> nn.Module:
        """Whose weights are trained."""

    @property
    def tracks(self) -> list[Track]:
        """What it is trained on."""

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        """Loss of a window and the new state."""

    def validate(self) -> float:
        """Error on the validation clips, metres; NaN where there are none."""


def fit(
    task: Task,
    options: TrainOptions,
    *,
    name: str,
    epochs: int,
    learning_rate: float,
    folder: Path,
    callback: Callable[[Progress], bool | None] | None = None,
) -> list[Epoch]:
    """Train a task until validation no longer improves; it ends with its best weights.

    Without validation clips it runs through all epochs and ends with the last weights.

    Parameters
    ----------
    task : Task
    options : TrainOptions
    name : str
        Of the phase; ``<name>.state.safetensors`` in `folder` is where it goes on.
    epochs : int
        At most.
    learning_rate : float
        To start with; it falls along half a cosine to nothing at the last epoch.
    folder : Path
    callback : callable, optional

    Returns
    -------
    list of Epoch
    """
    module, state_file = task.module, folder / f"{name}.state.safetensors"
    optimiser = torch.optim.Adam(
        module.parameters(), lr=learning_rate, weight_decay=options.weight_decay, fused=True
    )
    rng = np.random.default_rng([options.seed, *name.encode()])
    history: list[Epoch] = []
    best, waited, done, spent = math.inf, 0, False, 0.0
    kept = _copy(module)
    if state_file.is_file():
        kept, saved = _restore(state_file, module, optimiser, rng)
        history = [Epoch(**e) for e in saved["history"]]
        best, waited, done = saved["best"], saved["waited"], saved["done"]
        spent = saved["spent"]
    began = time.perf_counter() - spent

    with _writer(folder / "tensorboard" / name, options.tensorboard) as writer:
        while not done and len(history) < epochs:
            lap, losses, state = time.perf_counter(), [], None
            rate = learning_rate * _falling(len(history) / epochs)
            optimiser.param_groups[0]["lr"] = rate
            module.train()
            for batch in batches(task.tracks, options.batch, options.window, rng):
                loss, state = task.loss(batch, batch.forget(state), rng)
                optimiser.zero_grad(set_to_none=True)
                torch.autograd.backward(loss)
                nn.utils.clip_grad_norm_(module.parameters(), options.gradient_norm)
                optimiser.step()
                state = state.detach()
                losses.append(float(loss.detach()))
            value = float(np.mean(losses))
            if not math.isfinite(value):
                raise InputError("learning_rate", "a rate at which training stays finite", rate)

            number, rmse = len(history) + 1, None
            if number % options.validate_every == 0 or number == epochs:
                module.eval()
                with torch.no_grad():
                    rmse = task.validate()
                if math.isnan(rmse):
                    kept, rmse = _copy(module), None
                elif rmse < best:
                    best, waited, kept = rmse, 0, _copy(module)
                else:
                    waited += 1
            history.append(Epoch(number, value, rmse, rate, time.perf_counter() - lap))
            elapsed = time.perf_counter() - began
            limit = 60 * options.time_limit
            done = waited >= options.patience or 0 < limit <= elapsed
            saved = {
                "history": [dataclasses.asdict(e) for e in history],
                "best": best, "waited": waited, "done": done, "spent": elapsed,
            }  # fmt: skip
            _save(state_file, module, optimiser, rng, kept, saved)
            writer(number, {"loss": value, "rate": rate, "rmse": rmse})
            _logger.info("%s %d: loss %.5g, rmse %s", name, number, value, rmse)
            if callback and callback(_progress(name, number, epochs, elapsed, limit, value, best)):
                break
    module.load_state_dict(kept)
    module.eval()
    return history


def choose_clips(
    store: ClipStore, config: Config, split: str = "train", *, needed: bool = True
) -> tuple[list[str], SimulationParameters | None]:
    """Names of the clips that a configuration learns from, without mirrored ones.

    Raises
    ------
    InputError
        If the store has no such clips, and they are needed.
    """
    roles = parameter_roles(store)
    stated, chosen = config.data.parameters, None
    if stated and not config.data.condition:
        try:
            bending, density, time_scale = (float(x) for x in stated.split(","))
            chosen = SimulationParameters(bending, density, time_scale)
        except (TypeError, ValueError) as error:
            wanted = "'bending,density,time_scale'"
            raise InputError("data.parameters", wanted, repr(stated)) from error
    elif not config.data.condition:
        chosen = store.parameters()[0] if store.parameters() else None
    names = [
        c.name
        for c in store.clips(split)
        if (c.parameters == chosen if chosen else roles[c.parameters] == "train")
    ]
    if needed and not names:
        raise InputError("store", f"{split} clips of {chosen or 'training sets'}", str(store.path))
    return names, chosen


def build_network(config: Config, bones: VirtualBones, names: Sequence[str]) -> MotionNetwork:
    """A network with the statistics of the named clips, freshly initialised."""
    subject = bones.subject
    features = PoseFeatures(subject.skeleton, config.features, subject.fps)
    inputs, transforms = [], []
    for name in names:
        x, frame, _ = features(bones.store.clip(name).joints)
        inputs.append(x)
        if not name.endswith(MIRRORED):
            m = np.asarray(bones.clip(name).transforms, np.float64)
            r, t = frame[:, None, :, :3].swapaxes(-1, -2), frame[:, None, :, 3:]
            m = np.concatenate([m[..., :3], m[..., 3:] - t], axis=-1)
            transforms.append(r @ m)
    o = config.features
    normaliser = Normaliser.fit(inputs, floor=o.floor, clamp=o.clamp)
    network = MotionNetwork(config, subject, normaliser)
    network.low.code.fit(np.concatenate(transforms))
    return network


def train(
    store: ClipStore,
    config: Config,
    folder: Path | str,
    *,
    start: Checkpoint | None = None,
    bones_folder: Path | str | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Path:
    """From a store to a checkpoint; call again to go on.

    Parameters
    ----------
    store : ClipStore
    config : Config
    folder : path
        Of the run: ``checkpoint.safetensors`` when it is done, states, curves
        and ``history.json`` on the way.
    start : Checkpoint, optional
        Start from its weights instead of random ones, as a pivot may from the
        base network.
    bones_folder : path, optional
        As in :func:`~garmentnet.data.virtual_bones.virtual_bones`.
    callback : callable, optional
        Told after every epoch; returning True stops, to go on later.
    progress : callable, optional
        Told about the preparation.

    Returns
    -------
    Path
        Of the checkpoint; what a callback stopped is written as it is.

    Raises
    ------
    InputError
        If the store lacks the clips, the folder holds a run of another
        configuration or `start` does not fit.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    names, parameters = choose_clips(store, config)
    # What starts from a trained network and has few clips of its own may have none to spare.
    held = choose_clips(store, config, "validation", needed=start is None)[0]
    mirror = config.data.mirror and store.mirror_vertices is not None
    learned = names + ([n + MIRRORED for n in names] if mirror else [])
    _claim(folder, config, learned)
    o = config.train
    if o.threads:
        torch.set_num_threads(o.threads)
    device = o.device if o.device != "auto" else "cuda" if torch.cuda.is_available() else "cpu"
    bones = virtual_bones(store, config.bones, folder=bones_folder, progress=progress)
    bones.prepare([*names, *held], progress)
    # The initial weights depend on the seed alone, whatever ran before.
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(o.seed)
        network = build_network(config, bones, learned).to(device)
    if start is not None:
        load_weights(network, start, "low")
    tracks = load_tracks(network, bones, learned)
    validation = load_tracks(network, bones, held)

    stopped = False

    def told(p: Progress) -> bool:
        nonlocal stopped
        stopped = bool(callback(p)) if callback else False
        return stopped

    history = {"low": fit(
        LowTask(network, tracks, validation), o, name="low", epochs=o.epochs,
        learning_rate=o.learning_rate, folder=folder, callback=told,
    )}  # fmt: skip
    if not stopped:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(o.seed + 1)
            network.add_high()
        task = HighTask(network, tracks, validation)
        task.fit_statistics()
        if start is not None and start.networks[0].high is not None:
            load_weights(network, start, "high")
        history["high"] = fit(
            task, o, name="high", epochs=o.high_epochs,
            learning_rate=o.high_learning_rate, folder=folder, callback=told,
        )  # fmt: skip
    lines = {k: [dataclasses.asdict(e) for e in v] for k, v in history.items()}
    write_bytes(folder / "history.json", json.dumps(lines, indent=1).encode())
    return save_checkpoint(
        Checkpoint((network,), (parameters,), None), folder / "checkpoint.safetensors"
    )


def _claim(folder: Path, config: Config, clips: Sequence[str]) -> None:
    # What has no part in the answer may change from one call to the next.
    free = ("patience", "time_limit", "tensorboard", "device", "threads")
    stated = json.loads(json.dumps({"config": config.as_dict(), "clips": list(clips)}))
    stated["config"]["data"].pop("store")
    for key in free:
        stated["config"]["train"].pop(key)
    file = folder / "run.json"
    if not file.is_file():
        write_bytes(file, json.dumps(stated, indent=1).encode())
        return
    try:
        there = json.loads(file.read_text("utf-8"))
    except ValueError as error:
        raise InputError("folder", "a run of this package", f"{file}: {error}") from error
    if there != stated:
        raise InputError("folder", "a new one, or a run of this configuration and clips", folder)


def _falling(share: float) -> float:
    # Measured against a constant rate that is halved on plateaus: 34 mm in 16 epochs
    # where that stays at 38 mm.
    return 0.5 + 0.5 * math.cos(math.pi * min(1.0, share))


def _copy(module: nn.Module) -> dict[str, Tensor]:
    return {k: v.detach().cpu().clone() for k, v in module.state_dict().items()}


def _save(
    file: Path,
    module: nn.Module,
    optimiser: torch.optim.Optimizer,
    rng: np.random.Generator,
    kept: dict[str, Tensor],
    stated: dict[str, Any],
) -> None:
    tensors = {f"now.{k}": v for k, v in _copy(module).items()}
    tensors |= {f"best.{k}": v for k, v in kept.items()}
    for k, slot in optimiser.state_dict()["state"].items():
        tensors |= {f"adam.{k}.{name}": v.detach().cpu() for name, v in slot.items()}
    best = stated["best"] if math.isfinite(stated["best"]) else None
    document = stated | {"rng": rng.bit_generator.state, "best": best}
    save_tensors(file, tensors, {"training": document})


def _restore(
    file: Path, module: nn.Module, optimiser: torch.optim.Optimizer, rng: np.random.Generator
) -> tuple[dict[str, Tensor], dict[str, Any]]:
    tensors, documents = load_tensors(file, ("training",))
    stated = documents["training"]

    def part(prefix: str) -> dict[str, Tensor]:
        return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}

    try:
        module.load_state_dict(part("now."))
        kept = part("best.")
        slots: dict[int, dict[str, Tensor]] = {}
        for key, value in part("adam.").items():
            number, name = key.split(".")
            slots.setdefault(int(number), {})[name] = value
        groups = optimiser.state_dict()["param_groups"]
        optimiser.load_state_dict({"state": slots, "param_groups": groups})
        rng.bit_generator.state = stated["rng"]
        stated["best"] = math.inf if stated["best"] is None else float(stated["best"])
        if kept.keys() != module.state_dict().keys():
            raise KeyError("best weights")
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise InputError("folder", "states of this run", f"{file}: {error}") from error
    return kept, stated


def _progress(
    name: str, number: int, epochs: int, elapsed: float, limit: float, loss: float, best: float
) -> Progress:
    share = max(number / epochs, elapsed / limit if limit else 0.0)
    share = min(1.0, share)
    return Progress(
        phase=name, epoch=number, elapsed=elapsed, loss=loss, rmse=best, fraction=share,
        time_left=elapsed * (1 - share) / share,
    )  # fmt: skip


@contextlib.contextmanager
def _writer(folder: Path, wanted: bool) -> Iterator[Callable[[int, dict[str, Any]], None]]:
    if not wanted:
        yield lambda number, values: None
        return
    from ssdr.io.registry import require

    module = require("torch.utils.tensorboard", "garmentnet", "tensorboard curves")
    writer = module.SummaryWriter(str(folder))

    def write(number: int, values: dict[str, Any]) -> None:
        for key, value in values.items():
            if value is not None:
                writer.add_scalar(key, value, number)
        writer.flush()

    try:
        yield write
    finally:
        writer.close()
