"""The end of a streamed run, alternations over all frames while they pay, and its checkpoints."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import Cancelled
from ..kernels.polish import polish_vertices
from ..parallel import chunk_bounds, run_chunks, serial_blas
from ..search.progress import Callback, Progress
from ..search.run import Run
from ..search.state import SolverState
from ..sequence import MeshSequence
from ..solver.alternation import bone_step
from ..solver.model import CHUNK, Fixed, Model
from ..solver.moments import gram_tables
from ..solver.trajectories import Alignment, Array, Trajectories
from .executor import Executor, Frames, Local, Walk, spans_of
from .scan import Scan, Told

__all__ = ["PASSES", "Passes", "scan_progress", "share_of"]

# share of the work that is done after the scan, the run on telling frames, the one on more
_SCANNED, _FOUND, _SOLVED = 0.05, 0.3, 0.5
PASSES = {"fast": 1, "balanced": 4, "best": 8}  # over all frames, at most
_GAIN = 2e-3  # of the objective, below which another pass is not made


_SWEEPS = 6  # after a leap of the bones
_LEAPS, _FIRST_LEAPS = 2, 4  # of a pass; of the first, where bones start from another frame's


def share_of(settling: bool, settles: bool) -> tuple[float, float]:
    """Share of all the work that is done before and after a run on some frames."""
    if settling:
        return _FOUND, _SOLVED
    return _SCANNED, _FOUND if settles else _SOLVED


def scan_progress(callback: Callback | None, began: float) -> Told | None:
    """Tells a callback how far the scan is; where it asks to stop there is nothing to keep."""
    if callback is None:
        return None

    def told(share: float) -> None:
        elapsed, fraction = time.perf_counter() - began, _SCANNED * share
        stop = callback(
            Progress(
                phase="scan", iteration=0, elapsed=elapsed, rmse=math.inf, fraction=fraction,
                time_left=elapsed * (1 - fraction) / fraction,
            )
        )  # fmt: skip
        if stop:
            raise Cancelled("stopped by the callback before there was any model")

    return told


class Passes:
    """Passes over all frames, and the best model that they found.

    Parameters
    ----------
    frames : AllFrames
    earlier : SolverState, optional
        Of a run that had made some of them already.

    Attributes
    ----------
    best : Model
    records : list of (iteration, elapsed, squared error, phase)
    over : bool
        Whether another pass would not pay.
    """

    def __init__(self, frames: AllFrames, earlier: SolverState | None = None) -> None:
        self.frames, self.over = frames, False
        self.records: list[tuple[int, float, float, str]] = []
        self.best: Model = frames.model
        if earlier is not None and earlier.whole is not None:
            self.records = [(int(r[0]), r[1], r[2], "all frames") for r in earlier.passes]
            self.over = bool(earlier.progress.get("passes_over"))
            self.best = earlier.whole.copy()
            frames.restore(earlier.whole.copy(), len(self.records))

    def progress(self) -> dict[str, Any]:
        return {"passes": [list(r[:3]) for r in self.records], "passes_over": self.over}

    def finish(
        self,
        run: Run,
        effort: str,
        time_limit: float | None,
        callback: Callback | None,
        keep: Callable[[], None] | None,
        *,
        hurried: bool,
    ) -> bool:
        """Passes until they do not pay, one if `hurried`; whether the caller stopped them."""
        count, frames = PASSES[effort], self.frames
        n = len(frames.model.rest)
        scale = frames.alignment.scale / math.sqrt(len(frames.frame_scale) * n)
        stopped = False
        while not (self.over or stopped):
            done = len(self.records)

            def told(share: float, done: int = done) -> None:
                nonlocal stopped
                if callback is None:
                    return
                value = self.records[-1][2] if self.records else math.inf
                fraction = _SOLVED + (1 - _SOLVED) * (done + share) / count
                stopped |= bool(
                    callback(
                        Progress(
                            phase="all frames", iteration=run.iteration + done,
                            elapsed=run.elapsed, rmse=scale * math.sqrt(value),
                            fraction=fraction, time_left=run.here * (1 - fraction) / fraction,
                        )
                    )
                )  # fmt: skip

            value = frames.pass_over(entering=0 if run.smooth else 3, told=told)
            last = self.records[-1][2] if self.records else math.inf
            if value >= last:
                self.over = True
                frames.restore(self.best, done)
                break
            self.records.append((run.iteration + done + 1, run.elapsed, value, "all frames"))
            self.over = value > (1 - _GAIN) * last or done + 1 >= count
            if not self.over:
                self.best = frames.model.copy()
                if keep is not None:
                    keep()
            else:
                self.best = frames.model
            if hurried or (time_limit is not None and run.here >= time_limit):
                break
        return stopped


def carried(
    model: Model, nearest: NDArray[np.int64], ratio: float, given: Array | None, fixed: Fixed
) -> Model:
    """A copy with the bones that each frame starts with: those of the frame it is most like.

    Parameters
    ----------
    model : Model
    nearest : (F,) int
        That frame's place among the model's.
    ratio : float
        Of the scale of the model's space to the scale of the new one.
    given : (F, B0, 3, 4) array or None
        Transforms handed over, in the new space, of which locked bones keep theirs.
    fixed : Fixed
    """
    transforms = model.transforms[nearest]
    transforms[..., 3] *= ratio
    if given is not None:
        locked = np.flatnonzero(fixed.locked(given.shape[1]))
        transforms[:, locked] = given[:, locked]
    moved = dataclasses.replace(model.copy(), transforms=transforms)
    moved.rest *= ratio
    return moved


class AllFrames:
    """Exact alternations over all frames of a model that was found on some of them.

    Parameters
    ----------
    sequences : list of MeshSequence
    found : Scan
    data : Trajectories
        Of the chosen frames.
    model : Model
        Found on them; copied.
    fixed : Fixed
    given : (F, B0, 3, 4) array or None
        Transforms handed over, in the solver's space of all frames.
    importance : (F,) array or None
        Of the frames.
    executor : Executor, optional
        Who walks over the frames; this process by default.
    """

    def __init__(
        self,
        sequences: Sequence[MeshSequence],
        found: Scan,
        data: Trajectories,
        model: Model,
        *,
        fixed: Fixed,
        given: Array | None,
        importance: Array | None,
        executor: Executor | None = None,
    ) -> None:
        self.sequences, self.found, self.fixed = sequences, found, fixed
        self.executor = executor or Local()
        self.alignment = found.alignment
        self.passes = 0
        ratio = data.scale / self.alignment.scale
        self.model = carried(model, found.nearest, ratio, given, fixed)
        self.vertex_importance = data.importance
        mean = 1.0 if importance is None else float(importance.mean())
        self.frame_scale = (
            np.ones(len(found.nearest)) if importance is None else np.sqrt(importance / mean)
        )

    def restore(self, model: Model, passes: int) -> None:
        """Go on with a model of all frames after so many passes."""
        self.model, self.passes = model, passes

    def pass_over(self, *, entering: int, told: Told | None = None) -> float:
        """One exact alternation; returns the objective in the solver's space.

        `told` hears the share of the frames that are done.
        """
        model, n_frames = self.model, len(self.frame_scale)
        n, n_bones = len(model.rest), model.n_bones
        y, g, x2 = np.zeros((n, 4 * n_bones)), np.zeros((4 * n_bones, 4 * n_bones)), np.zeros(n)
        spans = spans_of(n_frames)
        known = _Known(
            rest=model.rest, joints=model.joints, weights=model.weights,
            importance=self.vertex_importance, scale=self.alignment.scale, fixed=self.fixed,
            leaps=_LEAPS if self.passes else _FIRST_LEAPS,
        )  # fmt: skip

        def own(k: int) -> tuple[Array, ...]:
            span = slice(*spans[k])
            return (
                self.alignment.centre[span], self.alignment.turn[span], self.frame_scale[span],
                model.transforms[span],
            )  # fmt: skip

        walk = self.executor.map(Walk(_pass_span, self.sequences, spans, own, (known,)))
        for (start, stop), part in zip(spans, walk, strict=True):
            model.transforms[start:stop] = part[0]
            y += part[1]
            g += part[2]
            x2 += part[3]
            if told is not None:
                told(stop / n_frames)
        self._vertices(y, g, x2, entering)
        self.passes += 1
        return float(self.vertex_importance @ model.error)

    @serial_blas()
    def _vertices(self, y: Array, g: Array, x2: Array, entering: int) -> None:
        model, fixed = self.model, self.fixed
        n, n_bones, size = len(model.rest), model.n_bones, model.n_influences + 2
        gram, gram4 = gram_tables(g, n_bones)
        keep = fixed.keep_weights(n)

        def work(_: int, i: int, k: int) -> None:
            polish_vertices(
                y[i:k].reshape(k - i, 4, n_bones), x2[i:k], gram, gram4, model.rest[i:k],
                model.joints[i:k], model.weights[i:k], model.error[i:k], keep[i:k],
                not fixed.rest, entering, 3, np.empty((k - i, size, size)),
                np.empty((k - i, size)), 0, k - i,
            )  # fmt: skip

        run_chunks(work, chunk_bounds(n, CHUNK))


@dataclasses.dataclass(frozen=True, eq=False)
class _Known:
    """What the bones of every frame are fitted under."""

    rest: Array
    joints: NDArray[np.int32]
    weights: Array
    importance: Array
    scale: float
    fixed: Fixed
    leaps: int


@serial_blas()
def _pass_span(
    frames: Frames, centre: Array, turn: Array, frame_scale: Array, transforms: Array, known: _Known
) -> tuple[Array, Array, Array, Array]:
    """Bones of a span, and its share of Y, G and Σ|x|²."""
    n, n_bones = len(known.rest), transforms.shape[1]
    transforms = transforms.copy()
    y, g, x2 = np.zeros((n, 4 * n_bones)), np.zeros((4 * n_bones, 4 * n_bones)), np.zeros(n)
    alignment = Alignment(centre=centre, turn=turn, scale=known.scale)
    for start, block in frames.blocks():
        stop = start + len(block)
        x = alignment.inward(block, start)
        x *= frame_scale[start:stop, None]
        flat = x.reshape(n, -1)
        x2 += np.einsum("ij,ij->i", flat, flat)
        part = Trajectories(
            z=flat, q=None, x2=x2, importance=known.importance,
            frame_scale=frame_scale[start:stop], centre=centre[start:stop],
            turn=turn[start:stop], scale=known.scale, lost=0.0,
        )  # fmt: skip
        piece = Model(
            transforms=transforms[start:stop], rest=known.rest, joints=known.joints,
            weights=known.weights, support=known.joints, share=known.weights,
            count=known.joints[:, 0], error=x2,
        )  # fmt: skip
        bone_step(part, piece, sweeps=_SWEEPS, fixed=known.fixed, leaps=known.leaps)
        hat = part.hat(piece.transforms)
        g += hat.T @ hat

        def add(_: int, i: int, k: int, flat: Array = flat, hat: Array = hat) -> None:
            y[i:k] += flat[i:k] @ hat

        run_chunks(add, chunk_bounds(n, 2 * CHUNK))
    return transforms, y, g, x2
