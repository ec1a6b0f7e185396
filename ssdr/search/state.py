"""What a stopped decomposition needs to go on, exactly where it was."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import LARGEST, check_squarable
from ..errors import FormatError, InputError, SsdrWarning, is_real, is_whole
from ..hierarchy.transforms import check_parents
from ..hierarchy.tree import Tree
from ..solver.conjugate_gradients import Recycled
from ..solver.model import ARRAYS, Model

__all__ = [
    "Checkpoint",
    "SolverState",
    "check_settings",
    "check_size",
    "model_of",
    "number",
    "numbers",
    "packed",
    "taking_up",
    "whole",
]

_VERSION = 6
_CHECKPOINT_SECONDS = 60.0  # between two checkpoints: what a killed process loses at most
_DIRECTIONS, _IMAGES = "recycled_directions", "recycled_images"
_DRIVER = "driver_"  # prefix, in a file, of the arrays that a driver adds


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
        Place in the schedule, random generator, damping, elapsed time.
    history : (n, 3) float64
        Iteration, elapsed seconds, objective of each accepted model.
    phases : tuple of str
        Phase of each accepted model.
    current, best : Model or None
        Of the frames that are solved in memory.
    aside : Model or None
        The lowest of several starts, while others are made.
    recycled : Recycled or None
        What the last step of a polish under way hands on to the next.
    driver : dict of str to array
        What the driver of the run adds: where frames are streamed, what the walks over all of
        them found.
    source : str
        The file that it was read from, for messages.

    Examples
    --------
    >>> import tempfile
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> options = dict(bones=3, effort="fast", max_iterations=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = ssdr.decompose(dancer, **options).state.save(f"{folder}/state.npz")
    ...     result = ssdr.decompose(dancer, **options, resume=path)
    >>> result.skinning.n_bones
    3
    """

    settings: dict[str, Any]
    progress: dict[str, Any]
    history: NDArray[np.float64]
    phases: tuple[str, ...]
    current: Model | None
    best: Model | None
    aside: Model | None = None
    recycled: Recycled | None = None
    driver: dict[str, NDArray[Any]] = dataclasses.field(default_factory=dict)
    source: str = "a state"

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
        arrays |= packed("current_", self.current) | packed("best_", self.best)
        arrays |= packed("aside_", self.aside)
        if self.recycled is not None:
            arrays[_DIRECTIONS] = self.recycled.directions
            arrays[_IMAGES] = self.recycled.images
        arrays |= {_DRIVER + name: array for name, array in self.driver.items()}
        write_arrays(path, arrays, compress=False)
        return path

    @staticmethod
    def load(path: str | Path) -> SolverState:
        """Read a state.

        Raises
        ------
        FormatError
            If the file is not a state, is one of another version, or its arrays are damaged
            (what a driver has added, and what its progress holds, is checked where it is taken
            up, by ``ssdr.decompose``).
        """
        from ..io.arrays.archive import read_arrays

        path = Path(path)
        arrays = read_arrays(
            path,
            required=("ssdr_state", "history"),
            optional=("current_*", "best_*", "aside_*", "recycled_*", _DRIVER + "*"),
        )
        try:
            header = json.loads(bytes(arrays["ssdr_state"]).decode())
            if header["version"] != _VERSION:
                raise FormatError(
                    f"{path}: state of version {header['version']}, not {_VERSION}, which this "
                    "version of ssdr writes; begin anew, or go on with the ssdr that wrote it"
                )
            phases = header["phases"]
            if not isinstance(phases, list) or not all(isinstance(p, str) for p in phases):
                raise ValueError("phases are not names")
            return SolverState(
                settings=dict(header["settings"]),
                progress=dict(header["progress"]),
                history=np.asarray(arrays["history"], dtype=np.float64).reshape(-1, 3),
                phases=tuple(phases),
                current=model_of(arrays, "current_"),
                best=model_of(arrays, "best_"),
                aside=model_of(arrays, "aside_"),
                recycled=_recycled_of(arrays),
                driver={
                    name[len(_DRIVER) :]: array
                    for name, array in arrays.items()
                    if name.startswith(_DRIVER)
                },
                source=str(path),
            )
        except (KeyError, ValueError, TypeError, OverflowError, RecursionError) as error:
            if isinstance(error, FormatError):
                raise
            raise FormatError(f"{path}: not a saved state of ssdr.decompose ({error})") from error


def check_settings(state: SolverState, settings: dict[str, Any]) -> None:
    """Whether a run asked for by these settings may go on from the state."""
    for key, value in settings.items():
        there = state.settings.get(key)
        if there == value or (key == "clips" and key not in state.settings):
            continue  # states saved before this setting was know nothing of clips
        expected, got = f"a state of a run with {key} = {value!r}", repr(there)
        if key == "input":
            expected = "a state of a run on these very frames, faces, importances and fixed parts"
            got = "one on others"
        elif key == "schedule":
            expected, got = "a state of this version of ssdr", "one of other steps"
        elif key == "clips":
            expected, got = f"a state of a run on clips of {value} frames", f"one on {there}"
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
    except (LookupError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise InputError("resume", "a state as it was saved", f"a damaged one ({error})") from error


def number(progress: Mapping[str, Any], name: str, *, least: float = 0.0) -> float:
    """A finite number of a state's progress.

    Raises
    ------
    KeyError, ValueError
        If there is none, or it is below `least`.
    """
    value = progress[name]
    if not is_real(value) or value < least:
        raise ValueError(f"{name} is {value!r}")
    return float(value)


def whole(progress: Mapping[str, Any], name: str) -> int:
    """An integer >= 0 of a state's progress.

    Raises
    ------
    KeyError, ValueError
        If there is none.
    """
    value = progress[name]
    if not is_whole(value) or value < 0:
        raise ValueError(f"{name} is {value!r}")
    return int(value)


def numbers(progress: Mapping[str, Any], name: str, *, least: float = 0.0) -> list[float]:
    """A list of finite numbers of a state's progress.

    Raises
    ------
    KeyError, ValueError
        If there is none, or one is below `least`.
    """
    values = progress[name]
    if not isinstance(values, list) or not all(is_real(v) and v >= least for v in values):
        raise ValueError(f"{name} is no list of numbers")
    return values


class Checkpoint:
    """A file that holds the latest state worth keeping."""

    def __init__(self, path: str | Path) -> None:
        if not isinstance(path, (str, Path)):
            raise InputError("checkpoint", "the path of an .npz, or None", type(path).__name__)
        self.path = Path(path)
        if self.path.suffix != ".npz" or not self.path.parent.is_dir():
            raise InputError("checkpoint", "a name ending in .npz in a folder that exists", path)
        if self.path.is_dir():
            raise InputError("checkpoint", "the path of an .npz", f"a folder, {path}")
        self._last = time.monotonic()

    def offer(self, state: Callable[[], SolverState]) -> None:
        """Save a state if the last one is a while ago."""
        if time.monotonic() - self._last >= _CHECKPOINT_SECONDS:
            self.save(state())

    def save(self, state: SolverState) -> None:
        """Save a state; a full disk or a folder that has gone does not end a run of hours."""
        try:
            state.save(self.path)
        except (OSError, InputError) as error:
            warnings.warn(f"no checkpoint at {self.path}: {error}", SsdrWarning, stacklevel=4)
        self._last = time.monotonic()


# --- models as arrays --------------------------------------------------------------------------

# name: kind of numbers, shape in terms of the sizes below, where an integer lies
_ARRAYS: dict[str, tuple[str, str]] = {
    "transforms": ("f", "FB34"),
    "rest": ("f", "V3"),
    "support": ("i", "VS"),
    "support_weights": ("f", "VS"),
    "count": ("i", "V"),
    "indices": ("i", "VK"),
    "weights": ("f", "VK"),
    "error": ("f", "V"),
}


def packed(prefix: str, model: Model | None) -> dict[str, Any]:
    """The arrays of a model by name."""
    if model is None:
        return {}
    arrays = {prefix + name: getattr(model, name) for name in ARRAYS}
    if model.tree is not None:
        arrays[prefix + "parents"] = model.tree.parents
        arrays[prefix + "points"] = model.tree.points
        arrays[prefix + "rigid"] = np.array([model.tree.rigid])
    return arrays


def _recycled_of(arrays: dict[str, Any]) -> Recycled | None:
    if _DIRECTIONS not in arrays:
        return None
    directions, images = arrays[_DIRECTIONS], arrays[_IMAGES]
    if directions.ndim != 2 or directions.shape != images.shape:
        raise ValueError(f"recycled directions have shape {directions.shape}")
    for array in (directions, images):
        if array.dtype != np.float64 or not np.isfinite(array).all():
            raise ValueError("recycled directions are no finite float64 numbers")
    if not np.allclose(np.einsum("mn,mn->m", directions, images), 1.0):
        raise ValueError("recycled directions do not curve upwards")
    return Recycled(directions, images)


def model_of(arrays: dict[str, Any], prefix: str) -> Model | None:
    """The model whose arrays have this prefix; None where there is none.

    Raises
    ------
    KeyError, ValueError
        If an array is missing or damaged.
    """
    if f"{prefix}rest" not in arrays:
        return None
    parts = {name: np.ascontiguousarray(arrays[prefix + name]) for name in ARRAYS}
    for name, (_, shape) in _ARRAYS.items():
        if parts[name].ndim != len(shape):
            raise ValueError(f"{prefix}{name} has shape {parts[name].shape}")
    n, k = parts["indices"].shape
    frames, bones = parts["transforms"].shape[:2]
    sizes = {"F": frames, "B": bones, "V": n, "K": k, "3": 3, "4": 4}
    sizes["S"] = max(k, parts["support"].shape[1])
    least_and_most = {
        "indices": (0, bones - 1),
        "support": (0, bones - 1),
        "count": (1, sizes["S"]),
    }
    for name, (kind, shape) in _ARRAYS.items():
        array = parts[name]
        if array.shape != tuple(sizes[axis] for axis in shape) or array.dtype.kind != kind:
            raise ValueError(f"{prefix}{name} has shape {array.shape}, dtype {array.dtype}")
        if kind == "f":
            if not np.isfinite(array).all():
                raise ValueError(f"{prefix}{name} holds NaN or Inf")
            array = parts[name] = array.astype(np.float64, copy=False)
            check_squarable(array, f"{prefix}{name}", f"numbers of less than {LARGEST:g}")
            if name in ("error", "weights", "support_weights") and (array < 0).any():
                raise ValueError(f"{prefix}{name} holds negative numbers")
        if kind == "i":
            least, most = least_and_most[name]
            if array.size and not (least <= array.min() and array.max() <= most):
                raise ValueError(f"{prefix}{name} is out of range")
            parts[name] = array.astype(np.int32)
    return Model(**parts, tree=_tree_of(arrays, prefix, bones))


def _tree_of(arrays: dict[str, Any], prefix: str, bones: int) -> Tree | None:
    if f"{prefix}parents" not in arrays:
        return None
    parents = check_parents(arrays[f"{prefix}parents"], bones)
    points, rigid = arrays[f"{prefix}points"], arrays[f"{prefix}rigid"]
    if points.shape != (bones, 3) or points.dtype.kind != "f" or not np.isfinite(points).all():
        raise ValueError(f"{prefix}points has shape {points.shape}, or holds NaN or Inf")
    if rigid.shape != (1,) or rigid.dtype != bool:
        raise ValueError(f"{prefix}rigid is {rigid!r}")
    return Tree(parents.astype(np.int64), points.astype(np.float64), bool(rigid[0]))
