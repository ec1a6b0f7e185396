"""What a streamed run adds to a state: what the walks over all frames have found so far."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..errors import FormatError
from ..search.state import SolverState, model_of, packed, taking_up
from ..solver.model import Model
from .scan import Scan

__all__ = ["StreamedState"]

_KEY = "streaming"  # of the numbers in a state's progress


@dataclasses.dataclass
class StreamedState:
    """Scan, and passes over all frames.

    Attributes
    ----------
    scan : Scan
    settling : bool
        Whether the run is on more frames than the representative ones.
    passes : list of (iteration, elapsed, squared error)
        One a pass over all frames that lowered the error.
    done : bool
        Whether another pass would not pay.
    model : Model or None
        Of all frames, once a pass over them has been made.
    """

    scan: Scan
    settling: bool = False
    passes: list[tuple[int, float, float]] = dataclasses.field(default_factory=list)
    done: bool = False
    model: Model | None = None

    def progress(self) -> dict[str, Any]:
        """What goes to a state's progress."""
        passes = [list(p) for p in self.passes]
        return {_KEY: {"settling": self.settling, "passes": passes, "done": self.done}}

    def arrays(self) -> dict[str, Any]:
        """What goes to a state's arrays."""
        scan = {f"scan_{name}": array for name, array in self.scan.arrays().items()}
        return scan | packed("model_", self.model if self.passes else None)

    @staticmethod
    def of(state: SolverState) -> StreamedState | None:
        """What a state says of streaming; None if it is of a run in memory.

        Raises
        ------
        FormatError
            If an array is missing or damaged.
        InputError
            If its numbers are.
        """
        if "scan_centre" not in state.driver:
            return None
        prefix = "scan_"
        try:
            scan = Scan.of_arrays(
                {k[len(prefix) :]: a for k, a in state.driver.items() if k.startswith(prefix)}
            )
            model = model_of(state.driver, "model_")
        except (KeyError, ValueError, TypeError) as error:
            raise FormatError(
                f"{state.source}: not a saved state of ssdr.decompose ({error})"
            ) from error
        with taking_up():
            numbers = state.progress[_KEY]
            passes = [(int(i), float(t), float(value)) for i, t, value in numbers["passes"]]
            if not np.isfinite(np.array(passes, dtype=np.float64)).all():
                raise ValueError("a pass without an error")
            if any(iteration < 0 or elapsed < 0 for iteration, elapsed, _ in passes):
                raise ValueError("a pass before the first")
            if not all(isinstance(numbers[name], bool) for name in ("settling", "done")):
                raise ValueError("settling and done are neither true nor false")
            streamed = StreamedState(
                scan=scan,
                settling=bool(numbers["settling"]),
                passes=passes,
                done=bool(numbers["done"]),
                model=model,
            )
        streamed._check(state)
        return streamed

    def _check(self, state: SolverState) -> None:
        def refuse(what: str) -> FormatError:
            return FormatError(f"{state.source}: not a saved state of ssdr.decompose ({what})")

        if (self.model is not None) != (len(self.passes) > 0):
            raise refuse("passes and their model do not fit")
        if self.model is None:
            if self.done:
                raise refuse("passes are done, and there is none")
            return
        if min(value for _, _, value in self.passes) < 0:
            raise refuse("a pass of negative error")
        if len(self.model.transforms) != self.scan.alignment.n_frames:
            raise refuse("model_transforms does not fit the scan")
        best = state.best
        if (
            best is None
            or best.transforms.shape[1:] != self.model.transforms.shape[1:]
            or best.indices.shape != self.model.indices.shape
        ):
            raise refuse("model_joints does not fit best_joints")
