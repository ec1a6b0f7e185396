"""How many bytes does an animation take in an engine, and how many does gltfpack need?

    python benchmarks/interchange/engine_files.py samba horse_gallop dancer --bones 20
    python benchmarks/interchange/engine_files.py samba --bones 20 --gltfpack PATH

The first prints the table of the docs: a cache of float32 vertices and a texture of 16-bit
positions are counted, bones are written.  The second compresses the plain ``.glb`` of a model with
``gltfpack -cc -af 0`` over its settings, and then with ssdr at the largest error of each.
"""

from __future__ import annotations

import argparse
import itertools
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import load

BITS = tuple(itertools.product((10, 12, 14, 16), (12, 16, 20), (8, 10, 12, 16)))  # -vp, -at, -ar
FINER = ("uint8", "uint16")


def sequence_of(name: str) -> ssdr.MeshSequence:
    """Sequence of a file or, if there is none, of a name in the data folder."""
    if Path(name).exists():
        return ssdr.load(name)
    vertices, faces = load(name)
    return ssdr.MeshSequence(vertices, faces)


def packed(model: ssdr.Skinning, path: Path, tolerance: float) -> ssdr.io.SaveReport | None:
    """Smallest file of a model within a largest error; None if no weights are fine enough."""
    reports = []
    for weights in FINER:
        try:
            made = ssdr.save(
                model, path, compression="meshopt", weights=weights, tolerance=tolerance
            )
            reports.append(made)
        except ssdr.InputError:
            continue
    return min(reports, key=lambda report: report.bytes, default=None)


def table(names: list[str], bones: int, folder: Path) -> None:
    """Print the bytes of each sequence by storage."""
    print("| | cache, float32 | texture, 16 bits | bones | bones within 0.5 % |")
    print("|---|---:|---:|---:|---:|")
    for name in names:
        sequence = sequence_of(name)
        frames, vertices = len(sequence), sequence.n_vertices
        model = ssdr.decompose(sequence, bones=bones, effort="fast").skinning
        report = packed(model, folder / "a.glb", 0.002 * sequence.diagonal())
        if report is None:
            report = ssdr.save(model, folder / "a.glb", compression="meshopt")
        found = ssdr.smallest(sequence, tolerance="0.5%", effort="fast")
        small = packed(found.skinning, folder / "a.glb", 0.005 * sequence.diagonal())
        size = f"{small.bytes:,} ({found.skinning.n_bones})" if small else "-"
        row = (12 * frames * vertices, 6 * frames * vertices, f"{report.bytes:,} ({bones})", size)
        cells = [cell if isinstance(cell, str) else f"{cell:,}" for cell in row]
        print(f"| {Path(name).stem}, F {frames}, V {vertices} | " + " | ".join(cells) + " |")


def largest_error(path: Path, model: ssdr.Skinning) -> float:
    """Largest distance of a file's vertices, in any order, from those of the model."""
    here = ssdr.load_skinning(path, fps=model.fps).skin(dtype=np.float64)
    there = model.skin(dtype=np.float64)
    frames = np.linspace(0, len(there) - 1, min(len(there), 12)).round().astype(int)

    def rows(points: np.ndarray) -> np.ndarray:
        chosen: np.ndarray = points[frames].transpose(1, 0, 2)
        return chosen.reshape(points.shape[1], -1)

    _, near = cKDTree(rows(there)).query(rows(here))
    return float(np.linalg.norm(here - there[:, near], axis=2).max())


def compare(name: str, bones: int, program: str, folder: Path) -> None:
    """Print the sizes of gltfpack's files on their Pareto front, and of ours at their errors."""
    model = ssdr.decompose(sequence_of(name), bones=bones, effort="fast").skinning
    plain, theirs = folder / "plain.glb", folder / "theirs.glb"
    ssdr.save(model, plain)
    found = []
    for vp, at, ar in BITS:
        settings = ["-cc", "-af", "0", "-vp", str(vp), "-at", str(at), "-ar", str(ar)]
        subprocess.run([program, "-i", plain, "-o", theirs, *settings], check=True)
        found.append((theirs.stat().st_size, largest_error(theirs, model), settings[3:]))
    front = [a for a in found if not any(b[0] <= a[0] and b[1] < a[1] for b in found)]
    for size, error, settings in sorted(front):
        ours = packed(model, folder / "ours.glb", error)
        told = "out of reach" if ours is None else f"{ours.bytes} ({ours.bytes / size:.3f})"
        print(f"{name} {' '.join(settings)}: {size} at {error:.4g}, ours {told}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="+")
    parser.add_argument("--bones", type=int, default=20)
    parser.add_argument("--gltfpack", help="path of gltfpack")
    given = parser.parse_args()
    warnings.simplefilter("ignore", ssdr.SsdrWarning)
    with tempfile.TemporaryDirectory() as folder:
        if given.gltfpack is None:
            table(given.names, given.bones, Path(folder))
        else:
            for name in given.names:
                compare(name, given.bones, given.gltfpack, Path(folder))


if __name__ == "__main__":
    main()
