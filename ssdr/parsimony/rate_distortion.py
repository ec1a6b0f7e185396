"""Curve of error against size: a model for each of many numbers of bones."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..problem.check import check_problem
from ..problem.problem import Effort
from ..progress import Callback
from ..representation import short_repr
from ..search.descent import Descent
from ..search.moves import add_bone
from ..search.steps import polish
from ..sequence import MeshSequence
from .models_by_bones import ModelsByBones, merge_down, move_some, start_merged
from .solved_frames import SolvedFrames

__all__ = ["Curve", "curve", "knee"]

_MOST_BONES = 64  # by default
_FLOOR = 1e-5  # least error on the logarithmic axis of the knee, relative to the diagonal
# Number of moves of bones, and of polish steps, for each number of bones.
_STEPS: dict[Effort, tuple[int, int]] = {"fast": (4, 6), "balanced": (8, 16), "best": (24, 40)}


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """Curve of error against size.

    Attributes
    ----------
    bones : (N,) int64
        Bone count of each model, ascending.
    bytes : (N,) int64
        Size of each model by :func:`size`, if every frame is a key of every bone.
    rmse : (N,) float64
        Error of each model in the mesh's units; it never rises along the curve.  If frames are
        streamed, it is measured on representative frames, each of which counts as often as there
        are frames like it.
    diagonal : float
        Diagonal of the bounding box in the frame where it is largest.
    knee : int
        Index of the point farthest below the straight line between the ends of the curve, on
        logarithmic axes scaled to unit length.  Errors below 1e-5 of the diagonal are raised to it
        (Satopää et al. 2011, "Finding a kneedle in a haystack").

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

    __repr__ = short_repr


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
    """Compute the curve of error against size, from one bone to many.

    A model with the most bones is merged down step by step and polished at each number of bones.
    If a larger model ends with more error than a smaller one, it is replaced by a copy of the
    smaller one to which bones are added.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
        If it does not fit into memory, `rmse` is measured on the frames that differ most; `bytes`
        and `diagonal` are those of all frames.
    faces : (T, 3) int array, optional
        Triangles, if `sequence` is a plain array.
    bones : int, optional
        Largest number of bones; by default 64, or the number of vertices if that is less.
    influences : int
        Most influences per vertex.
    effort : {"fast", "balanced", "best"}
        Work spent on each number of bones.
    rng : int or numpy.random.Generator
    callback : callable, optional
        Called with a :class:`~ssdr.progress.Progress` after every step; if it returns True,
        the call ends with Cancelled.

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
    problem = check_problem(
        sequence,
        faces,
        bones=bones,
        most_bones=_MOST_BONES,
        influences=influences,
        effort=effort,
        rng=rng,
        callback=callback,
    )
    problem.monitor.all_or_nothing = True
    frames = SolvedFrames(problem, "rmse")

    def report(phase: str, _: bool) -> None:
        problem.monitor.report(
            phase,
            iteration=models.iteration,
            rmse=min((m.value for m in models.best.values()), default=math.inf),
            fraction=models.fraction,
        )

    counts = _numbers_of_bones(problem.bones)
    models = ModelsByBones(frames, report, expected=len(counts))
    _fill(models, counts, effort)
    # among errors near zero, one may be larger than the previous one by a rounding error
    rmse = np.minimum.accumulate([models.best[bones].value for bones in counts])
    stored = np.array([frames.bytes(models.best[bones].model) for bones in counts], dtype=np.int64)
    diagonal = max(s.diagonal() for s in problem.sequences)
    return Curve(
        bones=np.array(counts, dtype=np.int64),
        bytes=stored,
        rmse=rmse,
        diagonal=diagonal,
        knee=knee(stored, rmse, _FLOOR * diagonal),
    )


def _fill(models: ModelsByBones, counts: list[int], effort: Effort) -> None:
    """Find a model for every number of bones in `counts`.

    Bones are merged from the largest number down.  Then, from the smallest number up, if a model
    has more error than the next smaller one, a copy of the smaller one with bones added is tried.
    """
    moves, steps = _STEPS[effort]

    def improve(d: Descent) -> None:
        move_some(d, moves)
        polish(d, steps=steps, gain=0.01)

    def begin(d: Descent) -> None:
        start_merged(d, 1.3)
        improve(d)

    def merged(d: Descent) -> None:
        merge_down(d)
        improve(d)

    models.attempt(counts[-1], begin, "start")
    for larger, bones in itertools.pairwise(counts[::-1]):
        start = models.best[larger].model.with_restarted_support()
        models.attempt(bones, merged, "merged", start=start)
    data, constraints = models.frames.data, models.frames.problem.constraints
    for smaller, larger in itertools.pairwise(counts):
        if models.best[larger].value > models.best[smaller].value:
            grown = models.best[smaller].model
            while grown.n_bones < larger:
                grown = add_bone(data, grown, alternations=2, constraints=constraints)
            models.attempt(larger, improve, "grown", start=grown)


def knee(stored: NDArray[Any], error: NDArray[Any], floor: float) -> int:
    """Index of the point farthest below the straight line between the ends of the curve.

    Both axes are logarithmic and scaled to unit length; errors below `floor` are raised to it.
    """
    x = np.log(np.asarray(stored, dtype=np.float64))
    y = np.log(np.maximum(np.asarray(error, dtype=np.float64), max(floor, 1e-300)))
    if len(x) < 3 or not x[-1] > x[0] or not y[0] > y[-1]:
        return 0
    x, y = (x - x[0]) / (x[-1] - x[0]), (y - y[-1]) / (y[0] - y[-1])
    return int((1 - x - y).argmax())


def _numbers_of_bones(most: int) -> list[int]:
    """Numbers of bones from 1 to `most`: first 1, 2, 3, ..., then each about a fifth larger."""
    out = [1]
    while out[-1] < most:
        out.append(min(most, max(out[-1] + 1, round(1.2 * out[-1]))))
    return out
