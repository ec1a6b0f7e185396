"""Models that several scripts look at, each fitted once for a revision and kept in out/fitted."""

from __future__ import annotations

import functools
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import ssdr
from benchmarks import common
from benchmarks.peers import dem_bones
from benchmarks.peers.model_size import sparse

SEQUENCES = {  # bones, influences
    "horse_gallop": (20, 4),
    "samba": (20, 4),
    "cow_elastic": (24, 4),
    "ea_bone": (10, 8),
    "ea_bone, 4 influences": (10, 4),
    "mannequin_rumba": (30, 4),
    "flag": (12, 4),
}
FREE: dict[str, Any] = {"rest_pose": "free", "normals": False}
_ITERATIONS = 60


@functools.cache
def load(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Frames (F, V, 3) in float64 and faces; the flag is made by shared/cases/gen.py."""
    if name != "flag":
        frames, faces = common.load(name.split(",")[0])
        return np.asarray(frames, dtype=np.float64), faces
    script = common.data_folder().parent / "cases" / "gen.py"
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, script, folder], check=True, stdout=subprocess.DEVNULL)
        with np.load(Path(folder, "flag.npz")) as archive:
            return archive["vertices"], archive["faces"].astype(np.int32)


def ours(name: str, *, step: int = 1, effort: Any = "balanced", **options: Any) -> ssdr.Skinning:
    """Model of `ssdr.decompose` for every `step`-th frame."""
    bones, influences = SEQUENCES[name]

    def fit() -> ssdr.Skinning:
        frames, faces = load(name)
        sizes = {"bones": bones, "influences": influences, "effort": effort}
        return ssdr.decompose(frames[::step], faces, **sizes, **options).skinning

    return _kept("_".join([name, effort, str(step), *options]), fit)


def theirs(name: str, *, step: int = 1) -> ssdr.Skinning:
    """Model of Dem Bones for every `step`-th frame: the better of its two settings.

    Frame 0 is the rest pose; of 60 iterations the best is taken, with and without its regularisers.
    """

    def fit() -> ssdr.Skinning:
        frames, faces = load(name)
        frames = np.ascontiguousarray(frames[::step])
        least, found = np.inf, None
        for regularised in (True, False):
            solver = dem_bones.prepared(frames, faces, *SEQUENCES[name], regularised=regularised)
            models = dem_bones.iterates(solver, len(frames), _ITERATIONS)
            errors, best = dem_bones.lowest(frames, frames[0], models)
            if best is not None and np.nanmin(errors) < least:
                least, found = np.nanmin(errors), best
        assert found is not None
        weights, transforms = found
        return ssdr.Skinning(frames[0], *sparse(weights), transforms, faces=faces)

    return _kept(f"{name}_dembones_{step}", fit)


def _kept(name: str, fit: Callable[[], ssdr.Skinning]) -> ssdr.Skinning:
    words = ["git", "log", "-1", "--format=%h", "--", "ssdr"]
    shown = subprocess.run(words, cwd=common.ROOT, capture_output=True, text=True, check=True)
    path = common.ROOT / "out" / "fitted" / shown.stdout.strip() / f"{name}.npz"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        ssdr.save(fit(), path)
    return ssdr.load_skinning(path)
