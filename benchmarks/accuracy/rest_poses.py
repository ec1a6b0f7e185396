"""What a rest pose costs and looks like: a surface or free, with normals in the objective or not.

    python benchmarks/accuracy/rest_poses.py
    python benchmarks/accuracy/rest_poses.py --only horse_gallop --again

Each sequence is decomposed with the rest pose "surface" or "free", with and without normals, and
with its first frame as the rest pose.  Beside E stand mean angles in degrees, over all frames:
"drawn" from the surface of the input to the stored normals, turned with the bones, as engines draw
them; "own, drawn" to the rest mesh's own normals turned so, which were written before; "bent" from
the stored normals to the rest mesh's own, which is what programs add that bend stored normals with
the surface, as Blender does.  "turned over" counts triangles of the rest pose whose normals point
against those of their vertices, and do so in no frame.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.common import Row

SEQUENCES = [
    ("horse_gallop", 20, 4), ("samba", 20, 4), ("cow_elastic", 24, 4), ("mannequin_rumba", 30, 4),
    ("ea_bone", 10, 4), ("dancer", 24, 4),
]  # fmt: skip
COLUMNS = ("E", "drawn", "drawn, 95 %", "inwards, %", "own, drawn", "bent", "turned over")
VARIANTS: dict[str, dict[str, Any]] = {
    "free, no normals": {"rest_pose": "free", "normals": False},
    "free": {"rest_pose": "free"},
    "surface, no normals": {"normals": False},
    "surface": {},
    "frame 0": {"fixed": True},
}


def corner_normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3) of a mesh: those of the triangles, weighted by their angles."""
    corners = points[faces]
    along, back = np.roll(corners, -1, 1) - corners, np.roll(corners, 1, 1) - corners
    area = np.cross(along[:, 0], back[:, 0])
    lengths = np.linalg.norm(along, axis=2) * np.linalg.norm(back, axis=2)
    cosine = (along * back).sum(axis=2) / np.maximum(lengths, 1e-300)
    each = np.arccos(np.clip(cosine, -1, 1))[..., None] * unit(area)[:, None]
    out = np.zeros_like(points)
    np.add.at(out, faces, each)
    return unit(out)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Degrees between unit vectors, where both are known."""
    known = a.any(axis=-1) & b.any(axis=-1)
    return np.degrees(np.arccos(np.clip((a * b).sum(axis=-1)[known], -1, 1)))


def turned(model: Any, normals: np.ndarray) -> np.ndarray:
    """Unit normals (F, V, 3) as engines turn those of the rest pose with the bones."""
    turns = model.transforms * [1, 1, 1, 0]
    return unit(common.reskin(normals, model.indices, model.weights, turns))


def folded(points: np.ndarray, normals: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Mask (T,) of triangles that point against the normals (V, 3) of their vertices."""
    a, b, c = points[faces].transpose(1, 0, 2)
    return (np.cross(b - a, c - a) * normals[faces].sum(axis=1)).sum(axis=1) < 0


def measure(
    sequence: str,
    bones: int,
    influences: int,
    fixed: bool = False,
    effort: Any = "balanced",
    **options: Any,
) -> Row:
    frames, faces = common.load(sequence)
    frames = np.asarray(frames, dtype=np.float64)
    start = ssdr.Start(rest=frames[0]) if fixed else None
    common.compile_kernels()
    began = time.process_time()
    model = ssdr.decompose(
        frames, faces, bones=bones, influences=influences, effort=effort, start=start, **options
    ).skinning
    seconds = time.process_time() - began
    if wrong := common.defects(model, bones, influences):
        raise SystemExit("; ".join(wrong))
    own, stored = corner_normals(model.rest, faces), np.zeros_like(model.rest)
    stored[faces] = model.surface.normals
    true = np.stack([corner_normals(points, faces) for points in frames])
    drawn = angles(turned(model, stored), true)
    moved = common.skinned(model)
    over = folded(model.rest, own, faces)
    for points, normals in zip(frames, true, strict=True):
        over &= ~folded(points, normals, faces)
    return {
        "E": common.error_e(frames, moved),
        "drawn": float(drawn.mean()),
        "drawn, 95 %": float(np.percentile(drawn, 95)),
        "inwards, %": 100 * float((drawn > 90).mean()),
        "own, drawn": float(angles(turned(model, own), true).mean()),
        "bent": float(angles(stored, own).mean()),
        "surface": float(angles(np.stack([corner_normals(m, faces) for m in moved]), true).mean()),
        "turned over": int(over.sum()),
        "cpu seconds": seconds,
    }


if __name__ == "__main__":
    cases = {
        f"{sequence}-{bones} {variant}": {
            "sequence": sequence, "bones": bones, "influences": influences, **options
        }
        for sequence, bones, influences in SEQUENCES
        for variant, options in VARIANTS.items()
    }  # fmt: skip
    common.run(__file__, __doc__, cases, measure, COLUMNS)
