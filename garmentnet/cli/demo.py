"""The demo: simulate, decompose, train, predict and draw, all small."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..configs.config import load_config
from ..data.virtual_bones import virtual_bones
from ..evaluation.baselines import MeanShape, Ridge
from ..evaluation.methods import Network
from ..evaluation.pictures import draw_clip
from ..evaluation.scores import evaluate
from ..evaluation.tables import score_table
from ..networks.checkpoint import load_checkpoint
from ..prediction.output import save_prediction
from ..prediction.prediction import predict
from ..training.run import choose_clips, train

__all__ = ["run_demo"]


def run_demo(
    folder: Path | str, *, progress: Callable[[str, float, float | None], None] | None = None
) -> dict[str, Any]:
    """Run every step on the data set ``tiny``; an interrupted run continues.

    Parameters
    ----------
    folder : path
        For clips, networks and pictures.
    progress : callable, optional
        Called with the current step, the fraction of it that is done and the seconds left, or
        None if unknown.

    Returns
    -------
    dict
        ``seconds`` of every step, the ``table`` of errors and the ``files``.
    """
    # Imported here: the simulator is another extra, and of these commands only the demo needs it.
    from ..scenes.dataset import make_data_set
    from ..scenes.scene_file import load_data_set

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    seconds: dict[str, float] = {}
    began = time.perf_counter()

    def lap(name: str) -> None:
        seconds[name] = round(time.perf_counter() - began - sum(seconds.values()), 1)

    def show(text: str, done: float, left: float | None = None) -> None:
        if progress:
            progress(text, done, left)

    store = make_data_set(
        load_data_set("tiny"),
        folder / "tiny.clips",
        progress=lambda p: show(
            f"simulating, {p.clips} of {p.clips_total} clips",
            p.frames / max(p.frames_total, 1),
            p.time_left,
        ),
    )
    lap("simulate")
    config = load_config("tiny")
    bones = virtual_bones(store, config.bones, progress=show)
    lap("decompose")
    path = train(
        store,
        config,
        folder / "run",
        progress=show,
        callback=lambda p: show(f"training {p.phase}, epoch {p.epoch}", p.fraction, p.time_left),
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
