"""Sequences that do not fit into memory: solve on telling frames, finish on all of them.

    scan (one pass) -> frames that differ most -> the usual run on those
         -> the polish, on as many as may be held: what few frames leave open
         -> passes over all frames, each an exact alternation: bones of every
            frame, then weights and rest pose from the sums that the pass gathers

Each walk over the frames is a function of a span of them, called here or by the
workers of a cluster (`chunked`), and a sum in the order of the spans.  A pass
keeps a block of frames, the transforms and two (V, 4B) matrices; what it states is
the error over all frames, not an estimate from a part of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .chunked import Executor, Frames, Local, Walk, spans_of
from .initialization import farthest_points
from .kernels.lbs import squared_error_range
from .kernels.polish import polish_vertices
from .model import CHUNK, Fixed, Model, bone_step, gram_tables
from .parallel import chunk_bounds, run_chunks, serial_blas
from .sequence import MeshSequence
from .trajectories import Alignment, Array, Trajectories, centred, scale_of, turn_onto

__all__ = ["AllFrames", "Scan", "carried", "needs_streaming", "scan", "squared_error", "subset"]

_IN_MEMORY = 1 << 30  # bytes of float64 trajectories up to which everything is held at once
_SUBSET = 128 << 20  # bytes of those of the telling frames
_FEWEST, _MOST = 120, 1000  # telling frames
_SETTLED = 512 << 20  # bytes of the trajectories of the frames on which their model settles
_MOST_SETTLED = 4000
_PROBES = 64  # vertices by which frames are compared
_SWEEPS = 6  # after a leap of the bones
_LEAPS, _FIRST_LEAPS = 2, 4  # of a pass; of the first, where bones start from another frame's

Told = Callable[[float], Any]


def needs_streaming(sequences: Sequence[MeshSequence]) -> bool:
    """Whether the trajectories are too large to be held at once."""
    frames = sum(len(s) for s in sequences)
    return sequences[0].n_vertices * frames * 24 > _IN_MEMORY and frames > _FEWEST


@dataclasses.dataclass(frozen=True, eq=False)
class Scan:
    """What the first pass found.

    Attributes
    ----------
    alignment : Alignment
        Of all frames.
    chosen : (S,) int64
        Telling frames, ascending; the first frame is one of them.  After
        :meth:`widened` others as well.
    nearest : (F,) int64
        For each frame, the position in `chosen` of the one that it is most like.
    """

    alignment: Alignment
    chosen: NDArray[np.int64]
    nearest: NDArray[np.int64]

    def importance(self, frames: Array | None) -> Array:
        """(S,) importance of the telling frames: that of the frames they stand for."""
        whole = np.ones(len(self.nearest)) if frames is None else frames
        counts = np.bincount(self.nearest, weights=whole, minlength=len(self.chosen))
        return counts.astype(np.float64)

    def widened(self, n_vertices: int) -> Scan | None:
        """As many frames, evenly spread, as may be held, and the telling ones.

        None where that would not be many more.
        """
        n_frames = len(self.nearest)
        count = min(_SETTLED // (24 * n_vertices), _MOST_SETTLED, n_frames)
        if count < 2 * len(self.chosen):
            return None
        spread = np.linspace(0, n_frames - 1, count).round().astype(np.int64)
        chosen = np.union1d(self.chosen, spread)
        nearest = np.searchsorted(chosen, self.chosen)[self.nearest]
        nearest[chosen] = np.arange(len(chosen))
        return dataclasses.replace(self, chosen=chosen, nearest=nearest)


@serial_blas()
def scan(
    sequences: Sequence[MeshSequence],
    importance: Array | None,
    keep: Sequence[int] = (),
    *,
    executor: Executor | None = None,
    told: Told | None = None,
) -> Scan:
    """Walk over all frames once: alignment, size, and which frames tell most.

    Frames are compared by a few vertices after alignment and chosen by
    farthest-point sampling, so that rare poses are among them; `keep` are chosen
    in any case.  `told` hears the share of the frames that are done.
    """
    n, n_frames = sequences[0].n_vertices, sum(len(s) for s in sequences)
    share = None if importance is None else importance / importance.sum()
    probes = np.linspace(0, n - 1, min(n, _PROBES)).astype(np.int64)
    first, _ = centred(sequences[0].frames(0), share)
    spans = spans_of(n_frames)
    parts = []
    walk = (executor or Local()).map(
        Walk(_scan_span, sequences, spans, shared=(first, share, probes))
    )
    for (_, stop), part in zip(spans, walk, strict=True):
        parts.append(part)
        if told is not None:
            told(stop / n_frames)
    centre, turn, features = (np.concatenate([p[k] for p in parts]) for k in range(3))
    turn[0] = np.eye(3)
    size, spread = sum(p[3] for p in parts), max(p[4] for p in parts)
    seeds, nearest = farthest_points(features, min(_telling(n), n_frames), 0)
    chosen = np.union1d(seeds, np.asarray(keep, dtype=np.int64)).astype(np.int64)
    where = np.searchsorted(chosen, seeds)[nearest]
    where[chosen] = np.arange(len(chosen))
    scale = scale_of(float(np.sqrt(size / (n * n_frames))), spread)
    return Scan(
        alignment=Alignment(centre=centre, turn=turn, scale=scale),
        chosen=chosen,
        nearest=where.astype(np.int64),
    )


def _telling(n_vertices: int) -> int:
    return int(np.clip(_SUBSET // (24 * n_vertices), _FEWEST, _MOST))


@serial_blas()
def _scan_span(
    frames: Frames, first: Array, share: Array | None, probes: NDArray[np.int64]
) -> tuple[Array, Array, Array, float, float]:
    centre, turn = np.empty((len(frames), 3)), np.empty((len(frames), 3, 3))
    features = np.empty((len(frames), 3 * len(probes)))
    sizes, spreads = np.empty(len(frames)), np.empty(len(frames))
    for start, block in frames.blocks():

        def work(_: int, i: int, k: int, start: int = start, block: Any = block) -> None:
            here, centre[start + i : start + k] = centred(block[i:k], share)
            turned = turn_onto(here, first, share)
            turn[start + i : start + k] = turned
            seen = np.matmul(here[:, probes], turned)
            features[start + i : start + k] = seen.reshape(k - i, -1)
            sizes[start + i : start + k] = np.einsum("tic,tic->t", here, here)
            spreads[start + i : start + k] = np.abs(here).max(axis=(1, 2))

        run_chunks(work, chunk_bounds(len(block), 8))
    return centre, turn, features, float(sizes.sum()), float(spreads.max())


def subset(
    sequences: Sequence[MeshSequence],
    frames: NDArray[np.int64],
    *,
    executor: Executor | None = None,
) -> MeshSequence:
    """The named frames, ascending, as one sequence in memory."""
    first = sequences[0]
    spans = spans_of(sum(len(s) for s in sequences))
    bounds = [np.searchsorted(frames, span) for span in spans]
    used = [(span, frames[i:k] - span[0]) for span, (i, k) in zip(spans, bounds, strict=True)]
    used = [u for u in used if len(u[1])]
    walk = (executor or Local()).map(
        Walk(_pick_span, sequences, [span for span, _ in used], lambda k: (used[k][1],))
    )
    vertices = np.concatenate(list(walk)).astype(first.vertices.dtype.newbyteorder("="), copy=False)
    return dataclasses.replace(first, vertices=vertices, validate=False)


def _pick_span(frames: Frames, wanted: NDArray[np.int64]) -> NDArray[np.floating]:
    out, offset = [], 0
    for array, first, last in frames.pieces:
        here = wanted[(wanted >= offset) & (wanted < offset + last - first)] - offset + first
        if len(here):
            source = dataclasses.replace(frames, pieces=((array, int(here[0]), int(here[-1]) + 1),))
            if isinstance(array, np.ndarray):
                out.append(np.asarray(array[here]))
            else:  # chunks of a store are read whole in any case
                for start, block in source.blocks():
                    mine = here - here[0] - start
                    out.append(block[mine[(mine >= 0) & (mine < len(block))]])
        offset += last - first
    return np.concatenate(out)


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


def squared_error(
    sequences: Sequence[MeshSequence],
    rest: Array,
    joints: NDArray[np.int32],
    weights: Array,
    transforms: Array,
    *,
    executor: Executor | None = None,
) -> Array:
    """(V,) Σ_t |d|² against the frames themselves, in one walk over all of them."""
    spans = spans_of(len(transforms))
    walk = (executor or Local()).map(
        Walk(
            _error_span, sequences, spans, lambda k: (transforms[slice(*spans[k])],),
            (rest, joints, weights),
        )
    )  # fmt: skip
    total = np.zeros(len(rest))
    for part in walk:
        total += part
    return total


def _error_span(
    frames: Frames, transforms: Array, rest: Array, joints: NDArray[np.int32], weights: Array
) -> Array:
    total = np.zeros(len(rest))
    for start, block in frames.blocks():
        target = np.ascontiguousarray(block, dtype=np.float64)
        moves = np.ascontiguousarray(transforms[start : start + len(block)])

        def work(_: int, i: int, k: int, target: Array = target, moves: Array = moves) -> None:
            squared_error_range(rest, joints, weights, moves, target, i, k, total)

        run_chunks(work, chunk_bounds(len(rest), CHUNK))
    return total
