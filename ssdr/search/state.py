"""What a stopped decomposition needs to go on, exactly where it was."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, InputError, SsdrWarning
from ..solver.model import Model
from ..streaming.scan import Scan, _scan

__all__ = ["SolverState", "check_settings", "check_size", "taking_up"]

_VERSION = 2
_MODEL = tuple(f.name for f in dataclasses.fields(Model))


_EVERY = 60.0  # seconds between two checkpoints


@dataclasses.dataclass(frozen=True, eq=False)
class SolverState:
    """A decomposition between two steps.

    Saved as ``.npz`` without pickles; ``ssdr.decompose(..., resume=state)`` goes
    on to the same result, bit for bit, as a run that was never stopped.

    Attributes
    ----------
    settings : dict
        What the run was asked for; resuming with anything else is an error.
    progress : dict
        Place in the plan, random generator, damping, elapsed time.
    history : (n, 3) float64
        Iteration, elapsed seconds, objective of each accepted model.
    phases : tuple of str
        Phase of each accepted model.
    current, best : Model or None
        Of the frames that are solved in memory.
    scan : Scan or None
        Where frames are streamed: what the first walk over them found.
    whole : Model or None
        Of all streamed frames, once a pass over them has been made.
    """

    settings: dict[str, Any]
    progress: dict[str, Any]
    history: NDArray[np.float64]
    phases: tuple[str, ...]
    current: Model | None
    best: Model | None
    scan: Scan | None = None
    whole: Model | None = None

    @property
    def passes(self) -> list[list[float]]:
        """Iteration, elapsed seconds and objective of each pass over streamed frames."""
        return list(self.progress.get("passes", []))

    @property
    def settling(self) -> bool:
        """Whether the models are of more frames than the telling ones."""
        return bool(self.progress.get("settling"))

    def __repr__(self) -> str:
        s, model = self.settings, "none yet" if self.best is None else "one"
        return (
            f"SolverState(bones={s.get('bones')}, effort={s.get('effort')!r}, "
            f"iteration={self.progress.get('iteration')}, best model: {model})"
        )

    def save(self, path: str | Path) -> Path:
        """Write the state to ``.npz``, to a temporary name first."""
        from ..io.arrays.archive import write_arrays

        path = Path(path)
        if path.suffix != ".npz":
            raise InputError("path", "a name that ends in .npz", str(path))
        header = {
            "version": _VERSION,
            "settings": self.settings,
            "progress": self.progress,
            "phases": list(self.phases),
        }
        arrays: dict[str, Any] = {
            "ssdr_state": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
            "history": self.history,
        }
        if self.scan is not None:
            a = self.scan.alignment
            arrays |= {
                "scan_centre": a.centre, "scan_turn": a.turn, "scan_scale": np.array(a.scale),
                "scan_chosen": self.scan.chosen, "scan_nearest": self.scan.nearest,
            }  # fmt: skip
        models = (("current", self.current), ("best", self.best), ("whole", self.whole))
        for prefix, model in models:
            if model is not None:
                arrays |= {f"{prefix}_{name}": getattr(model, name) for name in _MODEL}
        write_arrays(path, arrays, compress=False)
        return path

    @staticmethod
    def load(path: str | Path) -> SolverState:
        """Read a state.

        Raises
        ------
        FormatError
            If the file is not a state, or its arrays are damaged (what its progress
            holds is checked where it is taken up, by ``ssdr.decompose``).
        """
        from ..io.arrays.archive import read_arrays

        path = Path(path)
        arrays = read_arrays(
            path,
            required=("ssdr_state", "history"),
            optional=("current_*", "best_*", "whole_*", "scan_*"),
        )
        try:
            header = json.loads(bytes(arrays["ssdr_state"]).decode())
            if header["version"] != _VERSION:
                raise FormatError(f"{path}: state of version {header['version']}, not {_VERSION}")
            models = [_model(arrays, prefix) for prefix in ("current", "best", "whole")]
            found = _scan(arrays)
            state = SolverState(
                settings=dict(header["settings"]), progress=dict(header["progress"]),
                history=np.asarray(arrays["history"], dtype=np.float64).reshape(-1, 3),
                phases=tuple(header["phases"]), current=models[0], best=models[1],
                scan=found, whole=models[2],
            )  # fmt: skip
            passes = np.asarray(state.passes, dtype=np.float64).reshape(-1, 3)
            if not np.isfinite(passes).all() or (models[2] is not None) != (len(passes) > 0):
                raise ValueError("passes and their model do not fit")
            if models[2] is not None and (
                found is None or len(models[2].transforms) != found.alignment.n_frames
            ):
                raise ValueError("whole_transforms does not fit the scan")
            if models[2] is not None and (
                models[1] is None
                or models[1].transforms.shape[1:] != models[2].transforms.shape[1:]
                or models[1].joints.shape != models[2].joints.shape
            ):
                raise ValueError("whole_joints does not fit best_joints")
            return state
        except (KeyError, ValueError, TypeError, UnicodeDecodeError) as error:
            if isinstance(error, FormatError):
                raise
            raise FormatError(f"{path}: not a saved state of ssdr.decompose ({error})") from error


def check_settings(state: SolverState, settings: dict[str, Any]) -> None:
    """Whether a run asked for by these settings may go on from the state."""
    for key, value in settings.items():
        found = state.settings.get(key)
        if key == "max_iterations" or found == value:
            continue
        expected, got = f"a state of a run with {key} = {value!r}", repr(found)
        if key == "input":
            expected = "a state of a run on these very frames, importances and fixed parts"
            got = "one on others"
        elif key == "plan":
            expected, got = "a state of this version of ssdr", "one of other steps"
        raise InputError("resume", expected, got)


def check_size(model: Model | None, n_vertices: int, n_frames: int) -> None:
    """Whether a state's model is of the frames that are solved."""
    if model is not None and (len(model.rest), len(model.transforms)) != (n_vertices, n_frames):
        raise InputError("resume", "a state of a run on this very input", "other sizes")


@contextlib.contextmanager
def taking_up() -> Iterator[None]:
    """Around what reads a state's progress: damage in it is blamed on `resume`."""
    try:
        yield
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError("resume", "a state as it was saved", f"a damaged one ({error})") from error


def _model(arrays: dict[str, Any], prefix: str) -> Model | None:
    if f"{prefix}_rest" not in arrays:
        return None
    parts = {name: np.ascontiguousarray(arrays[f"{prefix}_{name}"]) for name in _MODEL}
    n, k = parts["joints"].shape
    frames, bones = parts["transforms"].shape[:2]
    wanted = {
        "transforms": (frames, bones, 3, 4), "rest": (n, 3), "weights": (n, k), "error": (n,),
        "count": (n,), "share": parts["support"].shape, "joints": (n, k),
    }  # fmt: skip
    for name, shape in wanted.items():
        kind = "i" if name in ("joints", "support", "count") else "f"
        if parts[name].shape != shape or parts[name].dtype.kind != kind:
            raise ValueError(f"{prefix}_{name} has shape {parts[name].shape}")
    if parts["support"].shape[0] != n or parts["support"].shape[1] < k:
        raise ValueError(f"{prefix}_support has shape {parts['support'].shape}")
    for name in ("joints", "support"):
        parts[name] = parts[name].astype(np.int32)
        if parts[name].min() < 0 or parts[name].max() >= bones:
            raise ValueError(f"{prefix}_{name} names a bone that is not there")
    parts["count"] = parts["count"].astype(np.int32)
    if parts["count"].min() < 1 or parts["count"].max() > parts["support"].shape[1]:
        raise ValueError(f"{prefix}_count is out of range")
    for name in ("transforms", "rest", "weights", "share", "error"):
        if not np.isfinite(parts[name]).all():
            raise ValueError(f"{prefix}_{name} holds NaN or Inf")
    return Model(**parts)


class Checkpoint:
    """A file that holds the latest state worth keeping."""

    def __init__(self, path: str | Path) -> None:
        if not isinstance(path, (str, Path)):
            raise InputError("checkpoint", "the path of an .npz, or None", type(path).__name__)
        self.path = Path(path)
        if self.path.suffix != ".npz" or not self.path.parent.is_dir():
            raise InputError("checkpoint", "a name ending in .npz in a folder that exists", path)
        self._last = time.monotonic()

    def offer(self, state: Callable[[], SolverState]) -> None:
        """Save a state if the last one is a while ago."""
        if time.monotonic() - self._last >= _EVERY:
            self.save(state())

    def save(self, state: SolverState) -> None:
        """Save a state; a full disk does not end a run that may have taken hours."""
        try:
            state.save(self.path)
        except OSError as error:
            warnings.warn(f"no checkpoint at {self.path}: {error}", SsdrWarning, stacklevel=4)
        self._last = time.monotonic()
