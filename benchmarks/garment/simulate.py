"""Stores of clips that are simulated here: a data set of ours by its name, or a scene file.

``python benchmarks/garment/simulate.py tiny`` writes ``out/tiny.clips``;
``docs/garment-scenes.md`` has the others.  The same command again goes on where it was stopped.
``garmentnet`` needs clips alone; those of other programs are read by ``garmentnet import``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.garment.scenes.dataset import make_data_set, recorded_motions
from benchmarks.garment.scenes.scene_file import load_data_set
from garmentnet.cli.learning import output_folder
from garmentnet.cli.progress import aligned, progress_bar
from garmentnet.data.clip import Clip
from garmentnet.data.store import ClipStore

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


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("name", help="a scene or data set (TOML), or one of ours: tiny, dress ...")
    options.add_argument("--output", "-o", type=Path, help="store of clips; else out/NAME.clips")
    options.add_argument("--motion", type=Path, help="folder of BVH files whose motions are added")
    options.add_argument("--workers", type=int, help="threads; all cores by default")
    given = options.parse_args()
    stem = Path(given.name).stem + ("-recorded" if given.motion else "")
    target = given.output or output_folder() / f"{stem}.clips"
    data_set = load_data_set(given.name)
    recorded = recorded_motions(given.motion, data_set) if given.motion else ()
    scenes = data_set.scenes(recorded)
    frames = sum(s.motion.frames for s in scenes)
    print(f"{data_set.name}: {len(scenes)} clips, {frames} frames, to {target}")
    with progress_bar() as show:
        store = make_data_set(
            data_set, target, recorded=recorded, workers=given.workers, progress=show
        )
    print(aligned(quality_rows(store)))
    for clip in store.clips(accepted=False, perturbed=None):
        print(f"rejected {clip.name}: {clip.quality['reason']}")


if __name__ == "__main__":
    main()
