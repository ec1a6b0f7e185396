"""Do other programs see the same vertices in what is written?  A table and a picture.

    python benchmarks/interchange/roundtrip.py --out out/roundtrip

Each format is written, imported by this package, by usd-core (its own skin baking) and by Blender
(its own importers, in a process of its own), and compared frame by frame with the model.  The
picture shows one frame of what Blender imported, behind the truth as a plain mesh.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import logging
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import write_csv
from helpers.rig_model import tube
from helpers.rig_tree import creature
from ssdr.io.axes import turn_up
from ssdr.io.blender import bridge, command
from ssdr.io.corners import corner_normals

CASES: list[tuple[str, dict[str, Any]]] = [
    (".glb", {}),
    (".glb", {"weights": "uint16"}),
    (".glb", {"weights": "uint8"}),
    (".gltf", {}),
    (".usda", {}),
    (".usdc", {}),
    (".fbx", {}),
]


def by_ssdr(path: Path) -> np.ndarray:
    return np.asarray(ssdr.load(path).vertices)


def by_usd(path: Path) -> np.ndarray:
    from pxr import Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.Open(str(path))
    UsdSkel.BakeSkinning(stage.Traverse())
    mesh = next(UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
    times = range(int(stage.GetEndTimeCode()) + 1)
    return np.stack([np.array(mesh.GetPointsAttr().Get(float(t))) for t in times])


def by_blender(path: Path, fps: float) -> tuple[np.ndarray, np.ndarray | None]:
    job = {"action": "read", "path": str(path), "fps": fps, "resample": False}
    arrays = bridge.run({**job, "max_bytes": 16 << 30})
    return turn_up(arrays["vertices"], "z", "y"), arrays.get("vertex")


def nearest(vertices: np.ndarray, truth: np.ndarray) -> float:
    """Largest distance where the importer gives no numbers: each to its twin at rest."""
    from scipy.spatial import cKDTree

    # The first, middle and last frame together tell twins apart.
    pick = [0, len(truth) // 2, len(truth) - 1]
    key = np.concatenate([truth[t] for t in pick], axis=1)
    order = cKDTree(key).query(np.concatenate([vertices[t] for t in pick], axis=1))[1]
    return gap(vertices, truth[:, order])


def gap(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(((a.astype(np.float64) - b) ** 2).sum(axis=2)).max())


def measure(name: str, model: ssdr.Skinning, folder: Path) -> list[dict[str, Any]]:
    truth = model.skin(dtype=np.float64)
    diagonal = ssdr.MeshSequence(truth, validate=False).diagonal()
    rows = []
    for suffix, options in CASES:
        path = folder / f"{name}{suffix}"
        report = ssdr.save(model, path, **options)
        found: dict[str, float] = {}
        if suffix != ".fbx":
            found["ssdr"] = gap(by_ssdr(path), truth)
            vertices, numbers = by_blender(path, model.fps)
            if numbers is not None:
                found["blender"] = gap(vertices, truth[:, numbers])
            elif vertices.shape == truth.shape:
                found["blender"] = gap(vertices, truth)
        else:
            found["blender"] = nearest(by_ssdr(path), truth)
        if suffix.startswith(".usd"):
            found["usd-core"] = gap(by_usd(path), truth)
        assert report.max_error is not None
        for importer, value in found.items():
            rows.append(
                {
                    "model": name,
                    "format": suffix[1:],
                    "weights": options.get("weights", "float32"),
                    "importer": importer,
                    "bytes": report.bytes,
                    "max_error": value,
                    "max_error_over_diagonal": value / diagonal,
                    "stated_max_error": report.max_error,
                    "between_frames_over_diagonal": (report.between_frames or 0.0) / diagonal,
                }
            )
    return rows


def picture(model: ssdr.Skinning, name: str, folder: Path, out: Path, frame: int) -> None:
    """The truth, then the glTF, USD and FBX that Blender imported."""
    posed = model.skin([frame])
    surface = dataclasses.replace(
        model.surface or ssdr.Surface(),
        normals=corner_normals(posed[0], model.faces, model.surface),
    )
    truth = ssdr.MeshSequence(posed, model.faces, surface=surface, validate=False)
    ssdr.save(truth, folder / f"{name}_truth_%01d.obj")
    files = [folder / f"{name}_truth_0.obj"]
    files += [folder / f"{name}{suffix}" for suffix in (".glb", ".usdc", ".fbx")]
    script = Path(__file__).with_name("blender_picture.py")
    # glTF and UsdSkel start at frame 0 in Blender, as they are written.
    words = command(script, str(out.resolve()), str(frame), *map(str, files))
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)
    if done.returncode:
        raise SystemExit(done.stderr[-2000:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/roundtrip"))
    parser.add_argument("--no-picture", action="store_true")
    args = parser.parse_args()
    logging.basicConfig(level=logging.WARNING)
    args.out.mkdir(parents=True, exist_ok=True)
    models = {"tube": tube(), "tube_similarity": tube(scaled=True), "tree": creature(frames=20)}
    from ssdr.samples import path as sample_path

    sample = ssdr.load(sample_path("dancer"))
    models["dancer"] = ssdr.decompose(sample, bones=24, effort="fast").skinning
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, model in models.items():
            rows += measure(name, model, Path(folder))
        if not args.no_picture:
            picture(models["tube"], "tube", Path(folder), args.out / "tube.png", 13)
            frame = models["dancer"].n_frames // 2
            picture(models["dancer"], "dancer", Path(folder), args.out / "dancer.png", frame)
    (args.out / "roundtrip.json").write_text(json.dumps(rows, indent=1) + "\n")
    write_csv(args.out / "roundtrip.csv", rows)
    print(
        f"{'model':16} {'format':6} {'weights':8} {'importer':9} {'max/diagonal':>12} {'stated':>9}"
    )
    for row in rows:
        print(
            f"{row['model']:16} {row['format']:6} {row['weights']:8} {row['importer']:9} "
            f"{row['max_error_over_diagonal']:12.2e} {row['stated_max_error']:9.1e}"
        )


if __name__ == "__main__":
    main()
