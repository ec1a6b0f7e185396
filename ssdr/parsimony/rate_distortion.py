"""Error against size: one model for every number of bones."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import as_sequences, check_bones, check_influences, check_rng
from ..drivers.scan import needs_streaming, scan, subset
from ..drivers.schedule import Effort, Schedule
from ..errors import Cancelled, InputError, check_choice
from ..frames.error import squared_error
from ..search.moves import grow_bone
from ..search.prescribed import Prescribed
from ..search.progress import Callback, Clock, Reporter
from ..search.run import Run
from ..search.stages import Alternate, Merge, Polish, Reseed
from ..search.starts import Start
from ..sequence import MeshSequence
from ..solver.model import Fixed, Model
from ..solver.trajectories import Trajectories, gather
from .report import bytes_of

__all__ = ["Curve", "curve", "knee"]

_MOST_BONES = 64  # by default
_FLOOR = 1e-5  # of the diagonal: errors below are as good as none, on a logarithmic axis
_STEPS = {"fast": (4, 6), "balanced": (8, 16), "best": (24, 40)}  # re-seeds, polish steps
_DOWN, _UP = 0.9, 0.95  # fraction of the work that is done after the way down, and on the way up


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
        of the representative ones alone, among which rare poses count for more.
    diagonal : float
    knee : int
        Index of the point that lies farthest below the straight line between
        the ends of the curve, on logarithmic axes, each scaled to unit length;
        errors under 1e-5 of the diagonal count as that (Satopää et al. 2011,
        "Finding a kneedle in a haystack").

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> curve = ssdr.parsimony.curve(dancer.frames(slice(0, 4)), bones=3)
    >>> bool(np.all(np.diff(curve.rmse) <= 0)), 0 <= curve.knee < len(curve.bones)
    (True, True)
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
    effort: Effort = "fast",
    rng: int | np.random.Generator = 0,
    callback: Callback | None = None,
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

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> curve = ssdr.parsimony.curve(dancer.frames(slice(0, 4)), bones=3)
    >>> curve.bones.tolist()
    [1, 2, 3]
    """
    sequences = as_sequences(sequence, faces)
    n = sequences[0].n_vertices
    most = check_bones(min(n, _MOST_BONES) if bones is None else bones, n)
    influences = check_influences(influences)
    check_choice(effort, "effort", Effort)
    if callback is not None and not callable(callback):
        raise InputError("callback", "a function of one Progress, or None", repr(callback))
    generator = check_rng(rng)
    solved = sequences
    if needs_streaming(sequences):
        solved = [subset(sequences, scan(sequences, None).chosen)]
    data = gather(solved, bones=most)
    ladder = _ladder(most)
    report = Reporter(callback, Clock())
    models = _models(data, ladder, influences, effort, generator, report)

    frames = sum(len(s) for s in sequences)
    rmse, stored = np.empty(len(ladder)), np.empty(len(ladder), dtype=np.int64)
    for i, count in enumerate(ladder):
        model = models[count]
        rest, transforms = data.to_world(model.rest, model.transforms)
        squared = squared_error(solved, rest, model.indices, model.weights, transforms)
        rmse[i] = math.sqrt(float(squared.sum()) / (data.n_frames * n))
        used = int(np.count_nonzero(model.weights))
        stored[i] = bytes_of(n, used, frames, np.full(count, frames), "rigid").total
    # where the objective is exact to its last bits only, so is the order
    rmse = np.minimum.accumulate(rmse)
    diagonal = max(s.diagonal() for s in sequences)
    return Curve(
        bones=np.array(ladder, dtype=np.int64),
        bytes=stored,
        rmse=rmse,
        diagonal=diagonal,
        knee=knee(stored, rmse, _FLOOR * diagonal),
    )


def _models(
    data: Trajectories,
    ladder: list[int],
    influences: int,
    effort: Effort,
    rng: np.random.Generator,
    report: Reporter,
) -> dict[int, Model]:
    """A model for every number of bones: merged down from the most, then mended on the way up."""
    reseeds, polish = _STEPS[effort]
    improve: Schedule = (Reseed(steps=reseeds), Polish(steps=polish, gain=0.01))
    merge: Schedule = (Merge(), Alternate(steps=4))
    first: Schedule = (Start(factor=1.3), Alternate(steps=10))
    unit = data.scale / math.sqrt(data.n_frames * data.n_vertices)
    steps = 0

    def solved(bones: int, schedule: Schedule, start: Model | None, fraction: float) -> Model:
        run = Run(
            data,
            schedule,
            bones=bones,
            influences=influences,
            rng=rng,
            fixed=Fixed(),
            prescribed=Prescribed(),
        )
        if start is not None:
            run.begin_with(start)

        def after_step(phase: str) -> None:
            nonlocal steps
            steps += 1
            rmse = unit * math.sqrt(run.best_value)
            if report(f"{bones} bones: {phase}", iteration=steps, rmse=rmse, fraction=fraction):
                raise Cancelled("stopped by the callback before the curve was done")

        run.drive(after_step)
        return run.best_model

    models: dict[int, Model] = {}
    down = ladder[::-1]
    models[down[0]] = solved(down[0], (*first, *merge, *improve), None, 0.0)
    for place, (larger, bones) in enumerate(itertools.pairwise(down), start=1):
        start = models[larger].with_restarted_support()
        models[bones] = solved(bones, (*merge, *improve), start, _DOWN * place / len(down))
    for smaller, larger in itertools.pairwise(ladder):
        if models[larger].weighted_error(data) > models[smaller].weighted_error(data):
            grown = models[smaller]
            while grown.n_bones < larger:
                grown = grow_bone(data, grown, alternations=2, fixed=Fixed())
            models[larger] = solved(larger, improve, grown, _UP)
    return models


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
