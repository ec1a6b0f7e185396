"""The slot for another solver or model: a function, or a file of a model.

A solver is ``module:function``, ``file.py:function``, or ``file.py`` with a function ``solve``.
It is called as

    solve(frames, faces, *, bones, influences, bone_model, rest)

with frames (F, V, 3) float32, faces (T, 3) int32, the number of bones, the most influences of a
vertex, "rigid" or "affine", and the rest pose (V, 3) that is to be kept, or None where the solver
may choose it.  It returns rest pose (V, 3), weights (V, B) and transforms (F, B, 3, 4), which skin
a vertex as Σ_b w_b (R_b p + t_b), or an `ssdr.Skinning`.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.peers.model_size import dense


class Parts(NamedTuple):
    """A model: rest pose (V, 3), weights (V, B), transforms (F, B, 3, 4), kind of its bones."""

    rest: np.ndarray
    weights: np.ndarray
    transforms: np.ndarray
    bone_model: str = "rigid"


def is_own(solver: str) -> bool:
    """Whether a name means a solver of one's own, and none of this folder."""
    return solver.endswith(".py") or ":" in solver


def solver_of(name: str) -> Callable[..., Parts]:
    """A solver of one's own; ends with a word where there is none."""
    path, _, function = (name, "", "solve") if name.endswith(".py") else name.rpartition(":")
    if path.endswith(".py") and not Path(path).is_file():
        raise SystemExit(f"no solver: {path} is not a file")
    try:
        if path.endswith(".py"):
            spec = importlib.util.spec_from_file_location("solver", path)
            assert spec is not None
            assert spec.loader is not None
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
        else:
            sys.path.insert(0, os.getcwd())
            module = importlib.import_module(path)
    except ImportError as error:
        raise SystemExit(f"no solver: {path} needs what is not installed: {error}") from error
    except Exception as error:
        raise SystemExit(f"no solver: {path}: {type(error).__name__}: {error}") from error
    solve = getattr(module, function, None)
    if not callable(solve):
        raise SystemExit(f"no solver: {path} has no function {function}")

    @functools.wraps(solve)
    def checked(frames: np.ndarray, faces: np.ndarray, **options: Any) -> Parts:
        with prints_aside():
            found = solve(frames, faces, **options)
        return parts_of(found, name, frames.shape, options["bone_model"])

    return checked


@contextlib.contextmanager
def prints_aside() -> Iterator[None]:
    """Send what a solver prints, from C++ too, to the standard error: the output is the row's."""
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def parts_of(
    found: Any, source: str | Path, shape: tuple[int, ...] | None = None, bone_model: str = "rigid"
) -> Parts:
    """A model of what a solver returned or a file holds, in float64.

    Ends with a word where numbers are not finite, or the shapes do not fit each other, or the
    frames' if `shape` is theirs.
    """
    if hasattr(found, "indices"):  # an ssdr.Skinning
        weights = dense(found.indices, found.weights, found.n_bones)
        found, bone_model = (found.rest, weights, found.transforms), found.bone_model
    try:
        rest, weights, transforms = (np.asarray(part, dtype=np.float64) for part in found)
    except (TypeError, ValueError) as error:
        raise SystemExit(f"{source}: expected rest, weights, transforms: {error}") from error
    n_frames, n = shape[:2] if shape else (len(transforms), len(rest))
    bones = weights.shape[-1]
    for name, part, expected in (
        ("rest", rest, (n, 3)),
        ("weights", weights, (n, bones)),
        ("transforms", transforms, (n_frames, bones, 3, 4)),
    ):
        if part.shape != expected:
            remedy = "; of 4×4 matrices pass m[..., :3, :]" if part.shape[-2:] == (4, 4) else ""
            got = f"got {part.shape}{remedy}"
            raise SystemExit(f"{source}: {name}: expected shape {expected}, {got}")
        if not np.isfinite(part).all():
            raise SystemExit(f"{source}: {name}: expected finite numbers, got NaN or Inf")
    return Parts(rest, weights, transforms, bone_model)


def read(path: str | Path, shape: tuple[int, ...] | None = None) -> Parts:
    """Model of a file that `ssdr.load_skinning` reads, or of an npz with the three arrays.

    The arrays are called rest, weights (V, B) and transforms.
    """
    import ssdr

    if not Path(path).is_file():
        raise SystemExit(f"no model: {path} is not a file")
    found: Any = None
    try:
        if Path(path).suffix == ".npz":
            with np.load(path) as archive:
                if "format_version" not in archive:
                    found = [archive[name] for name in ("rest", "weights", "transforms")]
        if found is None:
            found = ssdr.load_skinning(path)
    except (KeyError, ValueError, ssdr.SsdrError) as error:
        names = "what ssdr.load_skinning reads, or an npz with rest, weights and transforms"
        raise SystemExit(f"no model: {path}: expected {names}: {error.args[0]}") from error
    parts = parts_of(found, path, shape)
    r = parts.transforms[..., :3]
    rigid = np.abs(r.swapaxes(-1, -2) @ r - np.eye(3)).max() < 1e-6
    return parts if rigid else parts._replace(bone_model="affine")
