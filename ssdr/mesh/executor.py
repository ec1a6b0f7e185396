"""Walks over frames that do not fit into memory, one span of frames at a time.

A walk calls one function for every span, and the caller uses the results in the order of the
spans.  An executor makes the calls: this process, or the workers of a Dask cluster if a client is
active and the workers can open every shot themselves.  The spans do not depend on the executor,
so that the result does not either.
"""

from __future__ import annotations

import collections
import dataclasses
import functools
import logging
import mmap
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.parallel import chunk_bounds
from .sequence import MeshSequence, native

# Bytes of a block in float64: enough for fast matrix products, few enough to hold several.
_BLOCK = 32 << 20
_FEWEST = 8  # frames in a block, whatever their size
# Number of spans: enough for the workers of a cluster, few because each returns sums of (V, 4B).
_SPANS = 32
_ROW = 8  # frames in a span, where not all frames are covered
_logger = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Frames:
    """Successive frames that one task reads, from one or several shots.

    Attributes
    ----------
    pieces : tuple of (array-like, int, int)
        For each shot, in order: its array, the first frame to read, and the one after the last.
    n_vertices : int
    """

    pieces: tuple[tuple[Any, int, int], ...]
    n_vertices: int

    def __len__(self) -> int:
        return sum(last - first for _, first, last in self.pieces)

    def blocks(self) -> Iterator[tuple[int, NDArray[np.floating]]]:
        """Yield blocks (n, V, 3) of a few dozen MiB, each as (index of its first frame, block).

        Frames are counted from the start of the span.
        """
        for start, stop in chunk_bounds(len(self), max(_FEWEST, _BLOCK // (24 * self.n_vertices))):
            read = [native(array[i:k]) for array, i, k in _cut(self.pieces, start, stop)]
            yield start, read[0] if len(read) == 1 else np.concatenate(read)


def spans_of(n_frames: int, most: int | None = None) -> list[tuple[int, int]]:
    """Split frames into a few dozen spans: (first frame, the one after the last) of each.

    If there are more than `most` frames, spans of eight frames, evenly spread, cover about `most`.
    """
    if most is not None and n_frames > most:
        starts = np.linspace(0, n_frames - _ROW, most // _ROW).astype(int).tolist()
        return [(start, start + _ROW) for start in starts]
    return chunk_bounds(n_frames, max(_FEWEST, -(-n_frames // _SPANS)))


def _cut(
    pieces: Iterable[tuple[Any, int, int]], start: int, stop: int
) -> Iterator[tuple[Any, int, int]]:
    """Yield the parts of pieces that hold frames `start` to `stop` - 1 of their concatenation."""
    offset = 0
    for array, first, last in pieces:
        i, k = max(start - offset, 0), min(stop - offset, last - first)
        if i < k:
            yield array, first + i, first + k
        offset += last - first


@dataclasses.dataclass(frozen=True, eq=False)
class SpanTask:
    """Task to call ``function(frames, *arguments(k), *shared)`` for every span k of some shots."""

    function: Callable[..., Any]
    sequences: Sequence[MeshSequence]
    spans: list[tuple[int, int]]
    arguments: Callable[[int], tuple[Any, ...]] = lambda _: ()
    shared: tuple[Any, ...] = ()

    def frames(self, k: int) -> Frames:
        """Frames of span k."""
        shots = [(s.vertices, 0, len(s)) for s in self.sequences]
        return Frames(tuple(_cut(shots, *self.spans[k])), self.sequences[0].n_vertices)


class Local:
    """Executor that runs a task in this process, one span after the other, with all threads."""

    def map(self, task: SpanTask) -> Iterator[Any]:
        """Yield the results in the order of the spans, each computed when it is needed."""
        for k in range(len(task.spans)):
            yield task.function(task.frames(k), *task.arguments(k), *task.shared)


class Cluster:
    """Executor that runs a task on the workers of a Dask client.

    A call carries its arrays or opens their files itself, so that the scheduler can repeat it on
    another worker if one is lost.
    """

    def __init__(self, client: Any) -> None:
        self.client = client

    def map(self, task: SpanTask) -> Iterator[Any]:
        """Yield the results in the order of the spans; some are computed before they are needed."""
        import dask

        common = self.client.submit(_same, task.shared, pure=False)
        waiting: collections.deque[Any] = collections.deque()
        # Results are large: no more of them wait to be used than are being computed.
        most_waiting = 1 + sum(self.client.nthreads().values())
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 GiB"}):
            for k in range(len(task.spans)):
                frames = task.frames(k)
                pieces = [self._portable(*p) for p in frames.pieces]
                call = _remote, task.function, pieces, frames.n_vertices, task.arguments(k), common
                waiting.append(self.client.submit(*call, pure=False, retries=2))
                if len(waiting) >= most_waiting:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()

    def _portable(self, array: Any, first: int, last: int) -> tuple[Any, int, int]:
        if isinstance(array, np.memmap):
            return _reopening(array), first, last
        if hasattr(array, "__dask_graph__"):
            return self.client.compute(array[first:last], retries=2), 0, last - first
        return array, first, last


Executor = Local | Cluster


def _same(shared: tuple[Any, ...]) -> tuple[Any, ...]:
    return shared


def _remote(
    function: Callable[..., Any],
    pieces: list[tuple[Any, int, int]],
    n_vertices: int,
    arguments: tuple[Any, ...],
    shared: tuple[Any, ...],
) -> Any:
    opened = tuple(
        (a() if isinstance(a, functools.partial) else a, first, last) for a, first, last in pieces
    )
    return function(Frames(opened, n_vertices), *arguments, *shared)


def _reopening(array: np.memmap[Any, Any]) -> functools.partial[np.memmap[Any, Any]]:
    """Function by which another process maps the part of a file that `array` maps."""
    # A slice of a map keeps the offset of the whole map; its address tells where it begins.
    begin = int(array.offset) - int(array.offset) % mmap.ALLOCATIONGRANULARITY
    mapped = np.frombuffer(array._mmap, dtype=np.uint8)  # type: ignore[attr-defined]
    offset = begin + int(array.ctypes.data) - int(mapped.ctypes.data)
    file = str(array.filename)
    return functools.partial(np.memmap, file, array.dtype.str, "r", offset, array.shape)


def _opens_elsewhere(array: Any) -> bool:
    """Whether a Dask worker can read the array without this process."""
    if isinstance(array, np.memmap):
        named = isinstance(array.filename, (str, Path))
        return named and array.flags.c_contiguous and getattr(array, "_mmap", None) is not None
    return hasattr(array, "__dask_graph__") or type(array).__module__.split(".")[0] == "zarr"


def executor_for(sequences: Sequence[MeshSequence]) -> Executor:
    """Executor for passes over the frames of some sequences.

    It uses the workers of a Dask client if one is active and the workers can read all sequences.
    Otherwise it uses this process.
    """
    distributed = sys.modules.get("distributed")  # without it there is no client
    if distributed is None:
        return Local()
    try:
        client = distributed.default_client()
    except ValueError:
        return Local()
    if not all(_opens_elsewhere(s.vertices) for s in sequences):
        _logger.info("frames in memory are worked on in this process, not by the Dask workers")
        return Local()
    return Cluster(client)
