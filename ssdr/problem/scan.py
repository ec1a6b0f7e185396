"""The first pass over frames that do not fit into memory: alignment and representative frames.

Frames are compared by a few vertices after alignment and chosen by farthest-point sampling, so that
rare poses are among the representative frames.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..frames.executor import Executor, Frames, Local, SpanTask, spans_of
from ..parallel import chunk_bounds, run_chunks, serial_blas
from ..sequence import MeshSequence
from ..solver.alignment import Alignment, centred, rotations_onto, scale_of
from ..solver.initialization import farthest_points
from ..solver.trajectories import Array

_IN_MEMORY = 1 << 30  # bytes of float64 trajectories up to which all frames are held in memory
_SUBSET = 128 << 20  # bytes of the trajectories of the representative frames
_FEWEST, _MOST = 120, 1000  # bounds of the number of representative frames
# Most bytes of trajectories, and most frames, on which the model is settled: a third of the bytes
# that may be held in memory, since the polish needs more than as much again.
_SETTLED, _MOST_SETTLED = 320 << 20, 4000
_PROBES = 64  # vertices by which frames are compared: enough to tell poses apart

Report = Callable[[float], None]  # called with the fraction that is done; may raise Stop


def needs_streaming(sequences: Sequence[MeshSequence]) -> bool:
    """Whether the trajectories of all frames are too large to be held in memory."""
    frames = sum(len(s) for s in sequences)
    return sequences[0].n_vertices * frames * 24 > _IN_MEMORY and frames > _FEWEST


@dataclasses.dataclass(frozen=True, eq=False)
class Scan:
    """Alignment of all frames, and the frames that represent them.

    Attributes
    ----------
    alignment : Alignment
        Alignment of all frames.
    chosen : (S,) int64
        Representative frames, ascending; the first frame is one of them.
    nearest : (F,) int64
        For each frame, the index in `chosen` of the most similar chosen frame.
    extended_evenly : bool
        Whether evenly spread frames were added, so that each chosen frame stands for itself alone.
    """

    alignment: Alignment
    chosen: NDArray[np.int64]
    nearest: NDArray[np.int64]
    extended_evenly: bool = False

    def importance(self, frames: Array | None) -> Array:
        """Importance (S,) of each chosen frame: the sum over the frames that it stands for.

        `frames` is the importance (F,) of all frames; None if each has 1.
        """
        each = np.ones(len(self.nearest)) if frames is None else frames
        if self.extended_evenly:
            return each[self.chosen]
        counts = np.bincount(self.nearest, weights=each, minlength=len(self.chosen))
        return counts.astype(np.float64)

    def extended(self, n_vertices: int) -> Scan | None:
        """A copy with further chosen frames, evenly spread, as many as fit into memory.

        Returns None if fewer than twice the frames chosen so far fit.
        """
        n_frames = len(self.nearest)
        count = min(_SETTLED // (24 * n_vertices), _MOST_SETTLED, n_frames)
        if count < 2 * len(self.chosen):
            return None
        spread = np.linspace(0, n_frames - 1, count).round().astype(np.int64)
        chosen = np.union1d(self.chosen, spread)
        nearest = np.searchsorted(chosen, self.chosen)[self.nearest]
        nearest[chosen] = np.arange(len(chosen))
        return dataclasses.replace(self, chosen=chosen, nearest=nearest, extended_evenly=True)


@serial_blas()
def scan(
    sequences: Sequence[MeshSequence],
    importance: Array | None,
    keep: Sequence[int] = (),
    *,
    executor: Executor | None = None,
    report: Report | None = None,
) -> Scan:
    """Read all frames once; return their alignment and the representative frames.

    `importance` is that of the vertices.  The frames `keep` are chosen in any case.  `report` is
    called with the fraction of the frames that is done.
    """
    n, n_frames = sequences[0].n_vertices, sum(len(s) for s in sequences)
    weight = None if importance is None else importance / importance.sum()
    probes = np.linspace(0, n - 1, min(n, _PROBES)).astype(np.int64)
    first, _ = centred(sequences[0].frames(0), weight)
    spans = spans_of(n_frames)
    parts = []
    walk = (executor or Local()).map(
        SpanTask(_scan_span, sequences, spans, shared=(first, weight, probes))
    )
    for (_, stop), part in zip(spans, walk, strict=True):
        parts.append(part)
        if report is not None:
            report(stop / n_frames)
    centre, rotation, features = (np.concatenate([p[k] for p in parts]) for k in range(3))
    rotation[0] = np.eye(3)
    size, spread = sum(p[3] for p in parts), max(p[4] for p in parts)
    seeds, nearest = farthest_points(features, min(_representatives(n), n_frames), 0)
    chosen = np.union1d(seeds, np.asarray(keep, dtype=np.int64)).astype(np.int64)
    where = np.searchsorted(chosen, seeds)[nearest]
    where[chosen] = np.arange(len(chosen))
    scale = scale_of(float(np.sqrt(size / (n * n_frames))), spread)
    return Scan(
        alignment=Alignment(centre=centre, rotation=rotation, scale=scale),
        chosen=chosen,
        nearest=where.astype(np.int64),
    )


def _representatives(n_vertices: int) -> int:
    return int(np.clip(_SUBSET // (24 * n_vertices), _FEWEST, _MOST))


@serial_blas()
def _scan_span(
    frames: Frames, first: Array, weight: Array | None, probes: NDArray[np.int64]
) -> tuple[Array, Array, Array, float, float]:
    centre, rotation = np.empty((len(frames), 3)), np.empty((len(frames), 3, 3))
    features = np.empty((len(frames), 3 * len(probes)))
    sizes, spreads = np.empty(len(frames)), np.empty(len(frames))
    for start, block in frames.blocks():

        def work(_: int, i: int, k: int, start: int = start, block: Any = block) -> None:
            here, centre[start + i : start + k] = centred(block[i:k], weight)
            onto_first = rotations_onto(here, first, weight)
            rotation[start + i : start + k] = onto_first
            seen = np.matmul(here[:, probes], onto_first)
            features[start + i : start + k] = seen.reshape(k - i, -1)
            sizes[start + i : start + k] = np.einsum("tic,tic->t", here, here)
            spreads[start + i : start + k] = np.abs(here).max(axis=(1, 2))

        run_chunks(work, chunk_bounds(len(block), 8))
    return centre, rotation, features, float(sizes.sum()), float(spreads.max())


def subset(
    sequences: Sequence[MeshSequence],
    frames: NDArray[np.int64],
    *,
    executor: Executor | None = None,
) -> MeshSequence:
    """Read the frames with the indices `frames`, ascending, into one sequence in memory."""
    first = sequences[0]
    spans = spans_of(sum(len(s) for s in sequences))
    bounds = [np.searchsorted(frames, span) for span in spans]
    used = [(span, frames[i:k] - span[0]) for span, (i, k) in zip(spans, bounds, strict=True)]
    used = [u for u in used if len(u[1])]
    walk = (executor or Local()).map(
        SpanTask(_pick_span, sequences, [span for span, _ in used], lambda k: (used[k][1],))
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
