"""Stores of clips that are simulated here: a data set of ours by its name, or a scene file.

``python benchmarks/garment/simulate.py tiny`` writes ``out/tiny.clips``;
``docs/garment-scenes.md`` has the others.  The same command again goes on where it was stopped.
``garmentnet`` needs clips alone; those of other programs are read by ``garmentnet import``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.garment.scenes.dataset import make_data_set, recorded_motions
from benchmarks.garment.scenes.scene_file import load_data_set
from garmentnet.cli.learning import output_folder
from garmentnet.cli.progress import progress_bar


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
    print(f"{len(store.names(perturbed=None))} clips accepted. {store.refused()}".rstrip())


if __name__ == "__main__":
    main()
