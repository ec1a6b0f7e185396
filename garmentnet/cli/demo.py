"""The demo: the dress that ships, on the motion that ships."""

from __future__ import annotations

from pathlib import Path

from ..data.parameters import SimulationParameters
from ..io.files import Progress
from ..io.tensors import SHIPPED

# Four seconds of a generated dance: sway, spin, kick, walk.
DANCE = SHIPPED / "dance.npz"


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
    from ..prediction.motion_file import read_motion
    from ..prediction.output import save_prediction
    from ..prediction.prediction import predict
    from ..prediction.rigged import rigged, save_rigged

    folder.mkdir(parents=True, exist_ok=True)
    progress("predicting", 0.0)
    checkpoint = load_checkpoint("dress")
    joints, _ = read_motion(DANCE, checkpoint.subject)
    result = predict(checkpoint, joints, SimulationParameters(), name="dress")
    model = folder / "dress.glb"
    save_rigged(rigged(result, checkpoint.subject.skeleton), model)
    files = [folder / f"dress.{suffix}" for suffix in ("png", "npz", "webp")]
    for path in files:
        save_prediction(result, path, size=360, every=2, progress=progress)
    return [*files, model]
