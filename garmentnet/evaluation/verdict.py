"""What a training was worth: its error on the validation clips beside those of plain methods."""

from __future__ import annotations

from pathlib import Path

from ..data.store import ClipStore
from ..io.files import Progress, silent
from ..networks.checkpoint import load_checkpoint
from ..paper.bones import virtual_bones
from ..paper.train import choose_clips
from .baselines import BodySkinned, MeanShape, Ridge, fit_baselines
from .methods import Network
from .scores import evaluate

_CLIPS = 8  # validation clips that are scored
# What to do where a plain method errs less than the network.
ADVICE = {
    BodySkinned.name: "the garment follows the body: skin it by the body, or give the network "
    "more clips of cloth that swings",
    Ridge.name: "the network has learned less than a linear rule of the pose: more clips or more "
    "epochs (train.epochs)",
    MeanShape.name: "the network has not learned the motion: more clips, and features.joints=[] "
    "if the preset's joints leave out those that move the garment",
}


def verdict(path: Path, store: ClipStore, *, progress: Progress = silent) -> str:
    """Comparison of a trained network with plain methods on validation clips, in one line.

    If the network loses, a second line says what to do.  Without validation clips it is empty.

    Parameters
    ----------
    path : path
        A checkpoint of one network.
    store : ClipStore
        What it was trained on.
    progress : callable, optional
        Called with a method's name and the fraction that is done.
    """
    checkpoint = load_checkpoint(path)
    config = checkpoint.networks[0].config
    names, held = (choose_clips(store, config, split)[0] for split in ("train", "validation"))
    if not held:
        return ""
    bones = virtual_bones(store, config.bones)
    methods = [Network("network", checkpoint), *fit_baselines(bones, names, held)]
    rows = evaluate(bones, methods, held[:_CLIPS], progress=progress)
    errors = {row.name: row.all.overall.rmse for row in rows}
    found = ", ".join(f"{name} {error:.1f} mm" for name, error in errors.items())
    text, best = f"validation, RMSE over all vertices: {found}", min(errors, key=errors.__getitem__)
    if best != "network":
        text += f"\nthe network errs more than {best}: {ADVICE[best]}"
    return text
