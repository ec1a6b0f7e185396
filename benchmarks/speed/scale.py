"""Many vertices, and many clips: two sizes that the solver streams, each from disk by one command.

    # 200,000 vertices × 1,000 frames × 60 bones, K = 4; 1,000 clips of 20 to 60 frames, one mesh
    python benchmarks/speed/scale.py --data DIR --vertices
    python benchmarks/speed/scale.py --data DIR --clips

The motion is that of paper_size.py; its files are made once, resumable: 2.4 GB as one .npy,
1.4 GB as 1,000 of them.  --resume goes on from the last checkpoint of a run that was killed.
Written: benchmarks/results/scale.json.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.speed.paper_size import BLOCK, Source, floor_of, make, measured, true_error

MANY, MANY_FRAMES, MANY_COLUMNS = 200_000, 1_000, 12
CLIPS, CLIP_VERTICES, CLIP_COLUMNS = 1_000, 3_000, 8


def many_vertices(folder: Path, effort: str, resume: bool, count: int) -> dict[str, Any]:
    path, source = folder / f"vertices_{count}.npy", Source(count, MANY_COLUMNS, 4)
    make(source, path, MANY_FRAMES, MANY_FRAMES)
    vertices = np.load(path, mmap_mode="r")
    result, row = measured(
        lambda: ssdr.MeshSequence(vertices, source.faces, 30.0),
        bones=source.bones,
        influences=4,
        effort=effort,
        resume=resume,
        checkpoint=folder / f"vertices_{count}.npz",
    )
    floor = floor_of(path, MANY_FRAMES, count)
    some = np.arange(0, MANY_FRAMES, 25)
    return {
        "case": "vertices",
        "vertices": count,
        "frames": MANY_FRAMES,
        "bones": source.bones,
        "influences": 4,
        "floor": floor,
        "over_floor": result.rmse / floor,
        "rmse_reskinned_40": true_error(vertices, result.skinning, some),
        **row,
    }


def clip_spans() -> np.ndarray:
    """First and last frame of each clip, far apart in one endless motion."""
    rng = np.random.default_rng(2)
    first = 200 * np.arange(CLIPS)
    return np.stack([first, first + rng.integers(20, 61, CLIPS)], axis=1)


def many_clips(folder: Path, effort: str, resume: bool) -> dict[str, Any]:
    source, spans = Source(CLIP_VERTICES, CLIP_COLUMNS, 4), clip_spans()
    clips = folder / "clips"
    clips.mkdir(exist_ok=True)
    squares: dict[str, float] = {}
    noted = clips / "squares.json"
    if noted.is_file():
        squares = json.loads(noted.read_text())
    for k, (first, last) in enumerate(spans):
        if str(k) not in squares:
            block, squares[str(k)] = source.block(int(first), int(last - first))
            np.save(clips / f"{k:04d}.npy", block)
        if k % BLOCK == BLOCK - 1:
            common.write_json(noted, squares)

    def shots() -> list[ssdr.MeshSequence]:
        return [
            ssdr.MeshSequence(np.load(path, mmap_mode="r"), source.faces, 30.0, name=path.stem)
            for path in sorted(clips.glob("*.npy"))
        ]

    result, row = measured(
        shots,
        bones=source.bones,
        influences=4,
        effort=effort,
        resume=resume,
        checkpoint=folder / "clips.npz",
    )
    frames = int((spans[:, 1] - spans[:, 0]).sum())
    floor = float(np.sqrt(sum(squares.values()) / (frames * CLIP_VERTICES)))
    assert result.offsets[-1] == frames == len(result.skinning.transforms)
    model, squared = result.skinning, 0.0
    for k in range(0, CLIPS, 25):  # every 25th clip, by plain NumPy
        span = slice(result.offsets[k], result.offsets[k + 1])
        again = common.reskin(model.rest, model.indices, model.weights, model.transforms[span])
        squared += float(((again - np.load(clips / f"{k:04d}.npy")) ** 2).sum())
    count = sum(int(b - a) for a, b in spans[::25]) * CLIP_VERTICES
    return {
        "case": "clips",
        "clips": CLIPS,
        "vertices": CLIP_VERTICES,
        "frames": frames,
        "bones": source.bones,
        "influences": 4,
        "floor": floor,
        "over_floor": result.rmse / floor,
        "rmse_reskinned_40_clips": float(np.sqrt(squared / count)),
        **row,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder outside the checkout")
    parser.add_argument("--vertices", type=int, nargs="?", const=MANY, default=0)
    parser.add_argument("--clips", action="store_true")
    parser.add_argument("--effort", default="balanced")
    parser.add_argument("--resume", action="store_true")
    options = parser.parse_args()
    options.data.mkdir(parents=True, exist_ok=True)
    rows = []
    if options.vertices:
        rows.append(many_vertices(options.data, options.effort, options.resume, options.vertices))
    if options.clips:
        rows.append(many_clips(options.data, options.effort, options.resume))
    file = common.RESULTS / "scale.json"
    kept = json.loads(file.read_text()) if file.is_file() else []
    for row in rows:
        print(common.table([row], [k for k, v in row.items() if not isinstance(v, (dict, list))]))
        key = ("case", "effort", "vertices")
        kept = [r for r in kept if any(r[k] != row[k] for k in key)] + [row]
    common.write_json(file, kept)


if __name__ == "__main__":
    main()
