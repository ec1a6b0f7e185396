"""What do weights in 8 or 16 bits cost: rounded at the end, and solved for?

    python benchmarks/interchange/storage.py
    python benchmarks/interchange/storage.py ea_bone:10 --models DIR --storage uint16

Prints, for each sequence and number of bones (4 influences): E of the model with float weights, as
rounded by largest remainders, and as `ssdr.round_weights` solves for the storage, with seconds of
CPU time.  With --models the float models are kept in that folder and taken from it.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import compile_kernels, e_of, load
from ssdr.quantisation import quantise, weight_values

CASES = ["ea_bone:10", "horse_gallop:20", "samba:20", "mannequin_rumba:30"]


def row(case: str, folder: Path, effort: str, storage: str) -> str:
    """A row of the table."""
    name, bones = case.split(":")
    frames, faces = load(name)
    path, solving = folder / f"{name}_{bones}_4.npz", 0.0
    if not path.exists():
        began = time.process_time()
        found = ssdr.decompose(frames, faces, bones=int(bones), effort=effort)
        solving = time.process_time() - began
        ssdr.save(found.skinning, path)
    model = ssdr.load_skinning(path)
    order = np.argsort(-model.weights, axis=1, kind="stable")
    indices, weights = (np.take_along_axis(a, order, 1) for a in (model.indices, model.weights))
    indices, stored = quantise(indices, weights.astype(float), storage)
    plain = dataclasses.replace(model, indices=indices, weights=weight_values(stored))
    began = time.process_time()
    solved = ssdr.round_weights(frames, model, storage=storage).skinning
    took = time.process_time() - began
    steps = np.iinfo(storage).max
    assert (np.rint(steps * solved.weights).sum(axis=1) == steps).all()
    e, e_plain, e_solved = (e_of(frames, m) for m in (model, plain, solved))
    cells = [f"{name}, {bones}", f"{e:.3f}", f"{solving:.0f} s" if solving else "–"]
    cells += [f"{e_plain:.3f}, {e_plain / e:.2f}", f"{e_solved:.3f}, {e_solved / e:.3f}"]
    return "| " + " | ".join([*cells, f"{took:.1f} s"]) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("cases", nargs="*", metavar="SEQUENCE:BONES")
    parser.add_argument("--models", type=Path, help="folder of the float models")
    parser.add_argument("--effort", default="best", help="of float models that are not there")
    parser.add_argument("--storage", default="uint8", choices=["uint8", "uint16"])
    options = parser.parse_args()
    compile_kernels()
    print(
        "| sequence, bones | E, float | solving | rounded, ratio | solved for, ratio | it takes |"
    )
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as empty:
        folder = options.models or Path(empty)
        folder.mkdir(parents=True, exist_ok=True)
        for case in options.cases or CASES:
            print(row(case, folder, options.effort, options.storage), flush=True)


if __name__ == "__main__":
    main()
