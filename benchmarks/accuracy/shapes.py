"""What bones driven by expressions bring, and cost.

    python benchmarks/accuracy/shapes.py [--data FOLDER]

The ICT face by decompose_expressions goes to benchmarks/results/shapes.json; seconds are CPU
seconds.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

import ssdr
from ssdr.expressions import displaced

RESULTS = Path(__file__).parents[1] / "results" / "shapes.json"
DATA = Path(__file__).parents[3] / "shared" / "data"


def timed(call: Any) -> tuple[Any, float]:
    start = time.process_time()
    return call(), time.process_time() - start


def sizes(model: ssdr.Skinning) -> dict[str, int]:
    """Bytes of .glb files: with a clip for each expression, and with all in one clip."""
    one = dataclasses.replace(model, clips=None, fps=24.0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.glb"
        return {
            "clips": ssdr.save(model, path).bytes,
            "one_clip": ssdr.save(one, path).bytes,
        }


def face(data: Path) -> list[dict[str, Any]]:
    """The ICT face, in millimetres, with 40 bones; and as blend shapes alone."""
    arrays = np.load(data / "ict_face_expressions.npz")
    frames, faces = 10 * arrays["vertices"].astype(np.float64), arrays["faces"]
    rest, moved = frames[0], frames[1:] - frames[0]
    names = [str(name) for name in arrays["names"][1:]]
    truth = ssdr.MeshSequence(frames, faces)
    amounts = np.zeros((2 * len(moved), len(moved)))
    amounts[1::2] = np.eye(len(moved))
    index = np.where(np.arange(len(amounts)) % 2 == 1, 1 + np.arange(len(amounts)) // 2, 0)
    clips = tuple(ssdr.Clip(name, 2 * k, 2 * k + 2, 24) for k, name in enumerate(names))
    rows = []
    for limit in (1.0, 0.5):
        options: dict[str, Any] = {"faces": faces, "names": names, "bones": 40, "tolerance": limit}
        made, cpu = timed(lambda o=options: ssdr.decompose_expressions(rest, moved + rest, **o))
        model = dataclasses.replace(made.skinning, space=ssdr.Space(0.001, "y"))
        still = np.eye(3, 4)
        off = np.abs(model.skin()[1::2] - frames[1:])
        still_face = ssdr.Skinning.from_dense(
            rest, np.ones((len(rest), 1)), np.tile(np.eye(3, 4), (len(index), 1, 1, 1)),
            faces=faces, clips=clips, space=model.space,
        )  # fmt: skip
        blend = displaced(still_face, frames[index], amounts, limit, names)
        pairs = np.array([
            [k in pair for k in range(len(moved))]
            for pair in itertools.combinations(range(len(moved)), 2)
        ], dtype=float)  # fmt: skip
        worst, squares = 0.0, 0.0
        for some in np.array_split(pairs, 64):
            gap = ssdr.drive(model, some).skin() - rest - np.tensordot(some, moved, 1)
            distance = np.linalg.norm(gap, axis=2)
            worst, squares = max(worst, float(distance.max())), squares + float((distance**2).sum())
        turned = [
            ssdr.metrics.normals(dataclasses.replace(truth, vertices=frames[index]), x).mean
            for x in (dataclasses.replace(model, shapes=None), model)
        ]
        rows.append({
            "tolerance_mm": limit, "bones": 40, "influences": 8, "cpu_s": cpu,
            "deltas": made.displaced, "blend_shape_deltas": int(blend.shapes.moved.sum()),
            "rmse_mm": made.rmse, "max_mm": made.max_error,
            "coordinate_mean_mm": float(off.mean()), "coordinate_max_mm": float(off.max()),
            "bone_numbers_not_0": 6 * int((model.transforms[1::2] != still).any((2, 3)).sum()),
            "pairs_rmse_mm": float(np.sqrt(squares / pairs.shape[0] / len(rest))),
            "pairs_max_mm": worst, "normals_without": turned[0], "normals_with": turned[1],
            "bytes": sizes(model), "blend_bytes": sizes(blend),
        })  # fmt: skip
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    record = {"command": "python benchmarks/accuracy/shapes.py"}
    record["face"] = face(parser.parse_args().data)
    RESULTS.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
