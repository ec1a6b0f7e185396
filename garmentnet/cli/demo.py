"""The demo: the dress that ships, on a dance; or every step from simulation to a small dress."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ssdr.common.errors import InputError

from ..data.motion import Motion
from ..data.parameters import SimulationParameters
from ..data.subject import Subject
from ..io.files import Progress
from ..scenes.body import default_body
from ..scenes.dance.choreography import dance

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
            "motion",
            "a file, for a body of these joints (dances are made for the one that ships)",
            ", ".join(subject.skeleton.names),
        )
    return dance(
        subject.skeleton,
        seed=seed,
        frames=round(seconds * subject.fps),
        fps=subject.fps,
        classes=classes,
    )


def run_demo(folder: Path, *, progress: Progress) -> list[Path]:
    """Dress a dance with the garment that ships; needs neither simulation nor training.

    Parameters
    ----------
    folder : Path
        Folder for pictures and meshes.
    progress : callable
        Called with the current step and the fraction of it that is done.

    Returns
    -------
    list of Path
        The files: pictures, vertices, film, and the model that plays.
    """
    from ..networks.checkpoint import load_checkpoint
    from ..prediction.output import save_prediction
    from ..prediction.prediction import predict
    from ..prediction.rigged import rigged, save_rigged

    folder.mkdir(parents=True, exist_ok=True)
    progress("predicting", 0.0)
    checkpoint = load_checkpoint("dress")
    joints = made_dance(checkpoint.subject).joints
    result = predict(checkpoint, joints, SimulationParameters(), name="dress")
    model = folder / "dress.glb"
    save_rigged(rigged(result, checkpoint.subject.skeleton), model)
    files = [folder / f"dress.{suffix}" for suffix in ("png", "npz", "mp4")]
    for path in files:
        save_prediction(result, path, size=360, every=2, progress=progress)
    return [*files, model]


def run_pipeline(folder: Path, *, progress: Progress) -> list[Path]:
    """Run every step on the data set ``tiny``; an interrupted run continues.

    Parameters
    ----------
    folder : Path
        Folder for clips, networks and pictures.
    progress : callable
        Called with the current step and the fraction of it that is done.

    Returns
    -------
    list of Path
        The files: the report, its pictures, a film, and the checkpoint.
    """
    from ..configs.config import load_config
    from ..evaluation.reporting import report
    from ..networks.checkpoint import load_checkpoint
    from ..prediction.output import save_prediction
    from ..prediction.prediction import predict
    from ..scenes.dataset import make_data_set
    from ..scenes.scene_file import load_data_set
    from ..training.run import train

    folder.mkdir(parents=True, exist_ok=True)
    store = make_data_set(load_data_set("tiny"), folder / "tiny.clips", progress=progress)
    path = train(store, load_config("tiny"), folder / "run", progress=progress)
    evaluation, film = folder / "evaluation", folder / "prediction.gif"
    report([path], store, evaluation, progress=progress)
    checkpoint = load_checkpoint(path)
    clip = next(store.clips("test", checkpoint.parameters[0]))
    result = predict(checkpoint, clip.joints, name=clip.name)
    save_prediction(result, film, size=360, truth=clip, progress=progress)
    return [evaluation / "report.md", *sorted(evaluation.glob("*.png")), film, path]
