"""The demo: the dress that ships, on a dance; or every step from simulation to a small dress."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ssdr.errors import InputError

from ..data.motion import Motion
from ..data.parameters import SimulationParameters
from ..data.subject import Subject
from ..scenes.body import default_body
from ..scenes.dance.choreography import dance
from .progress import Show

__all__ = ["made_dance", "run_demo", "run_pipeline"]

_DANCE = ("sway", "spin", "kick", "walk")
_SEED, _SECONDS = 7, 4.0


def made_dance(
    subject: Subject,
    *,
    seed: int = _SEED,
    seconds: float = _SECONDS,
    classes: Sequence[str] | None = _DANCE,
) -> Motion:
    """Generated dance for a body with the same joints as the one that ships.

    Raises
    ------
    InputError
        If the body has other joints.
    """
    names = default_body().skeleton.names
    if subject.skeleton.names != names:
        raise InputError(
            "motion", "a file, for a body of these joints", list(subject.skeleton.names)
        )
    return dance(
        subject.skeleton,
        seed=seed,
        frames=round(seconds * subject.fps),
        fps=subject.fps,
        classes=classes,
        repertoire="wide",
    )


def run_demo(folder: Path | str, *, progress: Show | None = None) -> dict[str, Any]:
    """Dress a dance with the garment that ships; needs neither simulation nor training.

    Parameters
    ----------
    folder : path
        Folder for pictures and meshes.
    progress : callable, optional
        Called with the current step and the fraction of it that is done.

    Returns
    -------
    dict
        ``seconds`` of every step and the ``files``.
    """
    from ..networks.checkpoint import load_checkpoint
    from ..prediction.output import save_prediction
    from ..prediction.prediction import predict
    from ..prediction.rigged import rigged, save_rigged

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    show = progress or (lambda text, done: None)
    times = [time.perf_counter()]
    show("predicting", 0.0)
    checkpoint = load_checkpoint("dress")
    joints = made_dance(checkpoint.subject).joints
    result = predict(checkpoint, joints, SimulationParameters(), name="dress")
    save_rigged(rigged(result, checkpoint.subject.skeleton), folder / "dress.glb")
    times.append(time.perf_counter())
    files = [folder / f"dress.{suffix}" for suffix in ("png", "npz", "mp4")]
    for path in files:
        save_prediction(
            result, path, size=360, every=2, progress=lambda done: show("drawing", done)
        )
    times.append(time.perf_counter())
    return {
        "seconds": {
            "predict": round(times[1] - times[0], 1),
            "draw": round(times[2] - times[1], 1),
        },
        "files": [str(path) for path in (*files, folder / "dress.glb")],
    }


def run_pipeline(folder: Path | str, *, progress: Show | None = None) -> dict[str, Any]:
    """Run every step on the data set ``tiny``; an interrupted run continues.

    Parameters
    ----------
    folder : path
        Folder for clips, networks and pictures.
    progress : callable, optional
        Called with the current step and the fraction of it that is done.

    Returns
    -------
    dict
        ``seconds`` of every step, the ``table`` of errors and the ``files``.
    """
    from ..configs.config import load_config
    from ..data.virtual_bones import virtual_bones
    from ..drawing.dressed import draw_clip
    from ..evaluation.baselines import MeanShape, Ridge
    from ..evaluation.methods import Network
    from ..evaluation.scores import evaluate
    from ..evaluation.tables import score_table
    from ..networks.checkpoint import load_checkpoint
    from ..prediction.output import save_prediction
    from ..prediction.prediction import predict
    from ..scenes.dataset import make_data_set
    from ..scenes.scene_file import load_data_set
    from ..training.run import choose_clips, train

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    seconds: dict[str, float] = {}
    began = time.perf_counter()

    def lap(name: str) -> None:
        seconds[name] = round(time.perf_counter() - began - sum(seconds.values()), 1)

    show = progress or (lambda text, done: None)
    store = make_data_set(load_data_set("tiny"), folder / "tiny.clips", progress=show)
    lap("simulate")
    config = load_config("tiny")
    bones = virtual_bones(store, config.bones, progress=show)
    lap("decompose")
    path = train(
        store,
        config,
        folder / "run",
        progress=show,
        callback=lambda p: show(f"training {p.phase}, epoch {p.epoch}", p.fraction),
    )
    lap("train")
    names, base = choose_clips(store, config)
    held, _ = choose_clips(store, config, "validation")
    seen = [c.name for c in store.clips("test") if c.parameters == base]
    checkpoint = load_checkpoint(path)
    network = Network("network", checkpoint)
    methods = [network, Ridge(bones, names, held), MeanShape(bones, names)]
    rows = evaluate(bones, methods, seen, progress=show)
    lap("evaluate")
    clip = store.clip(seen[0])
    sheet = draw_clip(clip, network.predict(clip), folder / "truth-prediction-error.png")
    film = folder / "prediction.gif"
    result = predict(checkpoint, clip.joints, name=clip.name)
    save_prediction(result, film, size=360, truth=clip, progress=lambda done: show("drawing", done))
    lap("draw")
    return {
        "seconds": seconds | {"all": round(time.perf_counter() - began, 1)},
        "table": score_table(rows).splitlines(),
        "files": [str(sheet), str(film), str(path)],
    }
