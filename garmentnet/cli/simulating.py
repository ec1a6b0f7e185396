"""The command ``garmentnet simulate``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from .learning import output_folder
from .progress import aligned, progress_bar

if TYPE_CHECKING:
    from ..data.clip import Clip
    from ..data.store import ClipStore

_HEAD = (
    *("set", "clips", "rejected", "frames"),
    *("stretch p50", "p99", "max", "inside %", "worst frame %", "depth mm"),
)
# What a clip's quality holds, how it is summed up over clips, and its unit and digits.
_FIGURES: tuple[tuple[str, Any, float, int], ...] = (
    ("stretch_p50", np.median, 1, 3),
    ("stretch_p99", max, 1, 3),
    ("stretch_max", max, 1, 2),
    ("inside_fraction", np.mean, 100, 3),
    ("inside_worst_frame", max, 100, 2),
    ("depth_max", max, 1e3, 1),
)


def simulate(
    name: Annotated[
        str, typer.Argument(help="A scene or data set (TOML), or one that ships: tiny, dress ...")
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Store of clips to write.")
    ] = None,
    motion: Annotated[
        Path | None, typer.Option(help="Folder of BVH files whose motions are added.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Threads; all cores by default.")] = None,
) -> None:
    """Simulate the clips of a scene or a data set; the same command again goes on."""
    from ..scenes.dataset import make_data_set, recorded_motions
    from ..scenes.scene_file import load_data_set

    stem = Path(name).stem + ("-recorded" if motion else "")
    target = output or output_folder() / f"{stem}.clips"
    data_set = load_data_set(name)
    recorded = recorded_motions(motion, data_set) if motion else ()
    scenes = data_set.scenes(recorded)
    frames = sum(s.motion.frames for s in scenes)
    typer.echo(f"{data_set.name}: {len(scenes)} clips, {frames} frames, to {target}", err=True)
    with progress_bar() as show:
        show("simulating", 0.0)
        store = make_data_set(data_set, target, recorded=recorded, workers=workers, progress=show)
    typer.echo(f"{store.path.name}: {store.n_vertices} vertices", err=True)
    typer.echo(aligned(quality_rows(store)), err=True)
    for clip in store.clips(accepted=False, perturbed=None):
        typer.echo(f"rejected {clip.name}: {clip.quality['reason']}", err=True)


def quality_rows(store: ClipStore) -> list[Sequence[str]]:
    """Quality of the clips, one row for each parameter set.

    Medians and means over its clips for ``stretch p50`` and ``inside %``, the worst clip otherwise.
    """
    groups: dict[str, list[Clip]] = {}
    for clip in store.clips(accepted=None, perturbed=None):
        groups.setdefault(str(clip.provenance.get("parameter_set", "?")), []).append(clip)
    rows: list[Sequence[str]] = [_HEAD]
    for name, clips in groups.items():
        good = [c.quality for c in clips if c.accepted]
        counts = len(clips), len(clips) - len(good), sum(c.n_frames for c in clips)
        figures = (
            f"{unit * over([q[key] for q in good]):.{digits}f}" if good else "-"
            for key, over, unit, digits in _FIGURES
        )
        rows.append([name, *map(str, counts), *figures])
    return rows
