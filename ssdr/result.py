"""What a decomposition hands back."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .parsimony.report import Parsimony
from .search.progress import Record
from .search.state import SolverState
from .skinning import Skinning

__all__ = ["Decomposition"]


@dataclasses.dataclass(frozen=True, eq=False)
class Decomposition:
    """What :func:`decompose` found.

    Attributes
    ----------
    skinning : Skinning
        Rest pose, indices, weights and transforms (frames of all shots in order).
    rmse : float
        sqrt(Σ|d|² / (F V)) over all frames, in the mesh's units, measured by
        skinning the result and comparing it with the input.
    converged : bool
        Whether the last stage ended by its stopping test.
    stop_reason : str
        "converged", "plan finished", "iterations", "time limit" or "cancelled";
        with a tolerance "tolerance held" or "tolerance out of reach" for the first two.
    history : tuple of Record
        One record an accepted model; `rmse` never rises (with `smoothness` the
        penalised error never does); the last is the result.  With a tolerance
        one record for each smaller model that held it, then the result: a
        smaller model may have a larger error, so that `rmse` may rise up to
        the tolerance.
    offsets : (S + 1,) int array
        First frame of each shot, and the number of frames.
    state : SolverState
        To resume from.
    compile_seconds : float
        Time that loading or compiling the kernels took in this call.
    warnings : tuple of str
        What was also given as :class:`SsdrWarning`.
    parsimony : Parsimony or None
        With a tolerance: how small a model holds it, and what every pruning cost.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> result = ssdr.decompose(dancer, bones=4, effort="fast", max_iterations=1)
    >>> result.skinning.n_bones, result.reconstruct().shape
    (4, (24, 799, 3))
    >>> np.allclose(result.rmse, result.history[-1].rmse)
    True
    """

    skinning: Skinning
    rmse: float
    converged: bool
    stop_reason: str
    history: tuple[Record, ...]
    offsets: NDArray[np.int64]
    state: SolverState
    compile_seconds: float
    warnings: tuple[str, ...] = ()
    parsimony: Parsimony | None = None

    def reconstruct(self, frames: Any = None) -> NDArray[np.floating]:
        """Positions (f, V, 3) of the named frames, all by default."""
        return self.skinning.skin(frames)

    def __repr__(self) -> str:
        return f"Decomposition({self.skinning!r}, rmse={self.rmse:.6g}, {self.stop_reason})"
