"""Choice of frames to solve, in a walk over all frames of what does not fit into memory.

Frames are compared by a few vertices after alignment and chosen by farthest-point sampling, so that
rare poses are among them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.parallel import chunk_bounds, run_chunks, serial_blas
from ..mesh.executor import Executor, Frames, Local, SpanTask, spans_of
from ..mesh.sequence import MeshSequence
from ..solver.alignment import centred, rotations_onto
from ..solver.initialization import farthest_points
from ..solver.trajectories import Array

_IN_MEMORY = 1 << 30  # bytes of float64 trajectories up to which all frames are held in memory
_SUBSET = 128 << 20  # bytes of the trajectories of the frames that differ most
_FEWEST, _MOST = 120, 1000  # bounds of their number
# Most bytes of trajectories, and most frames, that are chosen if evenly spread frames are added: a
# sixth of the bytes that may be held in memory, since a polish needs several times as much.
_SPREAD, _MOST_SPREAD = 160 << 20, 2000
_PROBES = 64  # vertices by which frames are compared: enough to tell poses apart

Report = Callable[[float], None]  # called with the fraction that is done; may raise Stop


def needs_streaming(sequences: Sequence[MeshSequence]) -> bool:
    """Whether the trajectories of all frames are too large to be held in memory."""
    frames = sum(map(len, sequences))
    return sequences[0].n_vertices * frames * 24 > _IN_MEMORY and frames > _FEWEST


@dataclasses.dataclass(frozen=True, eq=False)
class Scan:
    """Frames that are chosen, and how all frames lie to them.

    Attributes
    ----------
    centre : (F, 3) array
        Centroid of each frame.
    rotation : (F, 3, 3) array
        Rotation of each frame onto the first.
    chosen : (S,) int64
        Chosen frames, ascending; the first frame is one of them.
    nearest : (F,) int64
        For each frame, the index in `chosen` of the most similar of the frames that differ most;
        chosen frames have their own.
    """

    centre: Array
    rotation: Array
    chosen: NDArray[np.int64]
    nearest: NDArray[np.int64]


@serial_blas()
def scan(
    sequences: Sequence[MeshSequence],
    importance: Array | None,
    keep: int,
    *,
    spread: bool,
    executor: Executor | None = None,
    report: Report | None = None,
) -> Scan:
    """Read all frames once, and choose those that differ most.

    Parameters
    ----------
    sequences : list of MeshSequence
    importance : (V,) array or None
        Importance of the vertices.
    keep : int
        A frame that is chosen in any case.
    spread : bool
        Whether evenly spread frames are chosen as well, as many as memory holds.
    executor : Executor, optional
    report : callable, optional
        Called with the fraction of the frames that is done.
    """
    n, n_frames = sequences[0].n_vertices, sum(len(s) for s in sequences)
    weight = None if importance is None else importance / importance.sum()
    probes = np.linspace(0, n - 1, min(n, _PROBES)).astype(np.int64)
    first, _ = centred(sequences[0].frames(0), weight)
    spans, parts = spans_of(n_frames), []
    task = SpanTask(_scan_span, sequences, spans, shared=(first, weight, probes))
    for (_, stop), part in zip(spans, (executor or Local()).map(task), strict=True):
        parts.append(part)
        if report is not None:
            report(stop / n_frames)
    centre, rotation, features = (np.concatenate(p) for p in zip(*parts, strict=True))
    rotation[0] = np.eye(3)
    count = int(np.clip(_SUBSET // (24 * n), _FEWEST, _MOST))
    seeds, nearest = farthest_points(features, min(count, n_frames), 0)
    chosen = np.union1d(seeds, [keep]).astype(np.int64)
    if spread:
        count = min(_SPREAD // (24 * n), _MOST_SPREAD, n_frames)
        even = np.linspace(0, n_frames - 1, max(count - len(chosen), 0)).round()
        chosen = np.union1d(chosen, even.astype(np.int64))
    where = np.searchsorted(chosen, seeds)[nearest]
    where[chosen] = np.arange(len(chosen))
    return Scan(centre, rotation, chosen, where.astype(np.int64))


@serial_blas()
def _scan_span(
    frames: Frames, first: Array, weight: Array | None, probes: NDArray[np.int64]
) -> tuple[Array, Array, Array]:
    centre, rotation = np.empty((len(frames), 3)), np.empty((len(frames), 3, 3))
    features = np.empty((len(frames), 3 * len(probes)))
    for start, block in frames.blocks():

        def work(_: int, i: int, k: int, start: int = start, block: Any = block) -> None:
            here, centre[start + i : start + k] = centred(block[i:k], weight)
            rotation[start + i : start + k] = onto_first = rotations_onto(here, first, weight)
            seen = np.matmul(here[:, probes], onto_first)
            features[start + i : start + k] = seen.reshape(k - i, -1)

        run_chunks(work, chunk_bounds(len(block), 8))
    return centre, rotation, features


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
    wanted = [frames[i:k] - start for (start, _), (i, k) in zip(spans, bounds, strict=True)]
    task = SpanTask(_pick_span, sequences, spans, lambda k: (wanted[k],))
    vertices = np.concatenate(list((executor or Local()).map(task)))
    vertices = vertices.astype(first.vertices.dtype.newbyteorder("="), copy=False)
    return dataclasses.replace(first, vertices=vertices, validate=False)


def _pick_span(frames: Frames, wanted: NDArray[np.int64]) -> NDArray[np.floating]:
    picked = [
        block[wanted[(wanted >= start) & (wanted < start + len(block))] - start]
        for start, block in frames.blocks()
    ]
    return np.concatenate(picked)
