"""No more model than a scene needs: its size in bytes, what pruning costs, error against size.

``ssdr.decompose(sequence, tolerance="0.5%")`` finds the smallest model; this
module holds what it says about it, and :func:`curve`.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..checks import as_sequences, check_bones, check_influences, check_rng
from ..errors import Cancelled, InputError
from ..parallel import serial_blas
from ..search.moves import grow_bone
from ..search.problem import Given
from ..search.progress import Progress
from ..search.run import Run
from ..search.schedule import Op
from ..sequence import MeshSequence
from ..solver.model import Fixed, Model
from ..solver.trajectories import gather
from ..streaming.error import squared_error
from ..streaming.scan import needs_streaming, scan, subset
from .report import Attempt, bytes_of

__all__ = [
    "Attempt",
    "Curve",
    "curve",
]

_FLOOR = 1e-5  # of the diagonal: errors below are as good as none, on a logarithmic axis
_STEPS = {"fast": (4, 6), "balanced": (8, 16), "best": (24, 40)}  # re-seeds, polish steps


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """Error against size.

    Attributes
    ----------
    bones : (N,) int64
        Ascending.
    bytes : (N,) int64
        By :func:`size`, every frame a key.
    rmse : (N,) float64
        In the mesh's units; never rises.  Where frames are streamed it is that
        of the telling ones alone, among which rare poses count for more.
    diagonal : float
    knee : int
        Index of the point that lies farthest below the straight line between
        the ends of the curve, on logarithmic axes, each scaled to unit length;
        errors under 1e-5 of the diagonal count as that (Satopää et al. 2011,
        "Finding a kneedle in a haystack").
    """

    bones: NDArray[np.int64]
    bytes: NDArray[np.int64]
    rmse: NDArray[np.float64]
    diagonal: float
    knee: int

    @property
    def percent(self) -> NDArray[np.float64]:
        """RMSE in percent of the diagonal."""
        return 100 * self.rmse / (self.diagonal or 1.0)


def curve(
    sequence: MeshSequence | Any,
    faces: Any = None,
    *,
    bones: int | None = None,
    influences: int = 4,
    effort: Literal["fast", "balanced", "best"] = "fast",
    rng: int | np.random.Generator = 0,
    callback: Callable[[Progress], bool | None] | None = None,
) -> Curve:
    """Error against size, from one bone to many.

    One model of the most bones is merged down step by step, polished at each;
    on the way back up, whatever a model with a bone more does worse is replaced
    by one that grew out of the smaller.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
        Where it does not fit into memory, frames that differ most stand for it
        in `rmse`; `bytes` and `diagonal` are of all frames.
    faces : (T, 3) int array, optional
    bones : int, optional
        The most; by default 64, or the number of vertices.
    influences : int
        Most bones a vertex.
    effort : {"fast", "balanced", "best"}
    rng : int or numpy.random.Generator
    callback : callable, optional
        Called with a :class:`~ssdr.search.progress.Progress`; returning True stops.

    Returns
    -------
    Curve

    Raises
    ------
    InputError
        If an argument is not usable.
    Cancelled
        If the callback stopped the work.
    """
    sequences = as_sequences(sequence, faces)
    n = sequences[0].n_vertices
    most = check_bones(min(n, 64) if bones is None else bones, n)
    k = check_influences(influences)
    if effort not in _STEPS:
        raise InputError("effort", f"one of {tuple(_STEPS)}", repr(effort))
    if callback is not None and not callable(callback):
        raise InputError("callback", "a function of one Progress, or None", repr(callback))
    generator = check_rng(rng)
    frames = sum(len(s) for s in sequences)
    solved = sequences
    if needs_streaming(sequences):
        solved = [subset(sequences, scan(sequences, None).chosen)]
    data = gather(solved, bones=most)
    ladder = _ladder(most)
    reseeds, polish = _STEPS[effort]
    improve = [
        Op("reseed", count=reseeds, amount=4, patience=4, cost=6),
        Op("polish", count=polish, tolerance=0.01, cost=6),
    ]
    models: dict[int, Model] = {}
    unit = data.scale / math.sqrt(data.n_frames * n)
    steps = 0

    def walk(count: int, plan: list[Op], start: Model | None, share: float) -> Model:
        nonlocal steps
        run = Run(
            data, plan, bones=count, influences=k, rng=generator, fixed=Fixed(), given=Given(),
            smooth=None,
        )  # fmt: skip
        if start is not None:
            run.model = start
            if start.n_bones == count:
                run.best, run.best_value = start.copy(), start.objective(data)
        with serial_blas():
            while not run.finished:
                phase = run.phase
                run.advance()
                steps += 1
                if callback is not None and callback(
                    Progress(
                        phase=f"{count} bones: {phase}", iteration=steps, elapsed=run.elapsed,
                        rmse=unit * math.sqrt(run.best_value), fraction=share, time_left=math.inf,
                    )
                ):  # fmt: skip
                    raise Cancelled("stopped by the callback before the curve was done")
        assert run.best is not None
        return run.best

    for place, count in enumerate(reversed(ladder)):
        share = 0.9 * place / len(ladder)
        if place == 0:
            plan = [Op("start", amount=1.3, cost=8), Op("alternate", count=10)]
            start = None
        else:
            plan = []
            start = models[ladder[-place]].widened()
        merge = [Op("merge", count=1000, amount=4, cost=20), Op("alternate", count=4)]
        models[count] = walk(count, [*plan, *merge, *improve], start, share)
    for smaller, larger in itertools.pairwise(ladder):
        if models[larger].objective(data) > models[smaller].objective(data):
            grown = models[smaller]
            while grown.n_bones < larger:
                grown = grow_bone(data, grown, alternations=2, fixed=Fixed())
            models[larger] = walk(larger, improve, grown, 0.95)

    rmse, stored = np.empty(len(ladder)), np.empty(len(ladder), dtype=np.int64)
    for i, count in enumerate(ladder):
        model = models[count]
        rest, transforms = data.to_world(model.rest, model.transforms)
        squared = squared_error(solved, rest, model.joints, model.weights, transforms)
        rmse[i] = math.sqrt(float(squared.sum()) / (data.n_frames * n))
        used = int(np.count_nonzero(model.weights))
        stored[i] = bytes_of(n, used, frames, np.full(count, frames), "rigid").total
    # where the objective is exact to its last bits only, so is the order
    rmse = np.minimum.accumulate(rmse)
    diagonal = max(s.diagonal() for s in sequences)
    return Curve(
        bones=np.array(ladder, dtype=np.int64), bytes=stored, rmse=rmse, diagonal=diagonal,
        knee=knee(stored, rmse, _FLOOR * diagonal),
    )  # fmt: skip


def knee(stored: NDArray[Any], error: NDArray[Any], floor: float) -> int:
    """Index of the point farthest below the chord of the curve, logarithmic axes."""
    x = np.log(np.asarray(stored, dtype=np.float64))
    y = np.log(np.maximum(np.asarray(error, dtype=np.float64), max(floor, 1e-300)))
    if len(x) < 3 or not x[-1] > x[0] or not y[0] > y[-1]:
        return 0
    x, y = (x - x[0]) / (x[-1] - x[0]), (y - y[-1]) / (y[0] - y[-1])
    below = 1 - x - y
    return int(below.argmax())


def _ladder(most: int) -> list[int]:
    """1, 2, 3, ... and then about a fifth more each, to the most."""
    out = [1]
    while out[-1] < most:
        out.append(min(most, max(out[-1] + 1, round(1.2 * out[-1]))))
    return out
