"""Makes a data set for the command line: progress, a table of quality, rejected clips."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from ..data.store import ClipStore
from ..scenes import dataset
from ..scenes.scene_file import load_data_set
from .progress import progress_bar

__all__ = ["quality_table", "run"]


def run(
    source: str | Path,
    output: Path,
    *,
    motion: str | os.PathLike[str] | None = None,
    workers: int | None = None,
) -> ClipStore:
    """Make a data set; what happens is shown on stderr."""
    # A log has no width; 120 columns hold the whole table.
    console = Console(stderr=True, width=None if sys.stderr.isatty() else 120)
    data_set = load_data_set(source)
    if motion is not None:
        data_set = data_set.with_motions(dataset.recorded_motions(motion, data_set))
    scenes = data_set.scenes()
    frames = sum(s.motion.frames for s in scenes)
    console.print(f"{data_set.name}: {len(scenes)} clips, {frames} frames, to {output}")
    with progress_bar() as show:
        show("simulating", 0.0)
        store = dataset.make_data_set(data_set, output, workers=workers, progress=show)
    console.print(quality_table(store))
    for clip in store.clips(accepted=False, perturbed=None):
        console.print(f"rejected {clip.name}: {clip.quality['reason']}")
    return store


def quality_table(store: ClipStore) -> Table:
    """Quality of the clips, one row for each parameter set.

    Medians and means over its clips for ``stretch p50`` and ``inside %``, the worst clip otherwise.
    """
    table = Table(title=f"{store.path.name}: {store.n_vertices} vertices")
    for name in (
        "set",
        "clips",
        "rejected",
        "frames",
        "stretch p50",
        "p99",
        "max",
        "inside %",
        "worst frame %",
        "depth mm",
    ):
        table.add_column(name, justify="left" if name == "set" else "right")
    groups: dict[str, list[dict[str, float]]] = {}
    frames: dict[str, int] = {}
    for clip in store.clips(accepted=None, perturbed=None):
        name = str(clip.provenance.get("parameter_set", "?"))
        groups.setdefault(name, []).append(clip.quality)
        frames[name] = frames.get(name, 0) + clip.n_frames
    for name, rows in groups.items():
        good = [r for r in rows if r["accepted"]]
        if not good:
            table.add_row(name, str(len(rows)), str(len(rows)), str(frames[name]), *["-"] * 6)
            continue
        table.add_row(
            name,
            str(len(rows)),
            str(len(rows) - len(good)),
            str(frames[name]),
            f"{np.median([r['stretch_p50'] for r in good]):.3f}",
            f"{max(r['stretch_p99'] for r in good):.3f}",
            f"{max(r['stretch_max'] for r in good):.2f}",
            f"{100 * np.mean([r['inside_fraction'] for r in good]):.3f}",
            f"{100 * max(r['inside_worst_frame'] for r in good):.2f}",
            f"{1e3 * max(r['depth_max'] for r in good):.1f}",
        )
    return table
