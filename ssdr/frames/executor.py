"""Passes over frames that are too many for the memory, span by span.

A pass over all frames calls one function for every span of them and adds up the
results in the order of the spans.  An executor makes the calls: this process, or
the workers of a Dask cluster if a client is active and workers can open every
shot by themselves.  The spans are the same for every executor, and so is the
result.
"""

from __future__ import annotations

import collections
import dataclasses
import logging
import mmap
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..parallel import chunk_bounds
from ..sequence import MeshSequence, native

__all__ = ["Executor", "Frames", "Local", "SpanTask", "executor_for", "spans_of"]

# Bytes of a block in float64: enough for fast matrix products, few enough to hold several.
_BLOCK = 32 << 20
_FEWEST = 8  # frames in a block, whatever their size
# Spans of all frames: enough for the workers of a cluster, few since each returns (V, 4B) sums.
_SPANS = 32
_logger = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Frames:
    """Frames of a span, which may belong to several shots.

    Parameters
    ----------
    pieces : tuple of (array-like, int, int)
        Array of a shot, its first frame and the one after its last, in order.
    n_vertices : int
    """

    pieces: tuple[tuple[Any, int, int], ...]
    n_vertices: int

    def __len__(self) -> int:
        return sum(last - first for _, first, last in self.pieces)

    def blocks(self) -> Iterator[tuple[int, NDArray[np.floating]]]:
        """Blocks of a few dozen MiB as (position, (n, V, 3)); short shots are joined."""
        for start, stop in chunk_bounds(len(self), max(_FEWEST, _BLOCK // (24 * self.n_vertices))):
            read = [native(array[i:k]) for array, i, k in _cut(self.pieces, start, stop)]
            yield start, read[0] if len(read) == 1 else np.concatenate(read)


def spans_of(n_frames: int) -> list[tuple[int, int]]:
    """Bounds of the spans, at most a few dozen, the same for every executor."""
    return chunk_bounds(n_frames, max(_FEWEST, -(-n_frames // _SPANS)))


def _cut(
    pieces: Iterable[tuple[Any, int, int]], start: int, stop: int
) -> Iterator[tuple[Any, int, int]]:
    """Pieces between two positions in a row of pieces."""
    offset = 0
    for array, first, last in pieces:
        i, k = max(start - offset, 0), min(stop - offset, last - first)
        if i < k:
            yield array, first + i, first + k
        offset += last - first


@dataclasses.dataclass(frozen=True, eq=False)
class SpanTask:
    """Calls of ``function(frames, *arguments(k), *shared)`` for every span k of some shots."""

    function: Callable[..., Any]
    sequences: Sequence[MeshSequence]
    spans: list[tuple[int, int]]
    arguments: Callable[[int], tuple[Any, ...]] = lambda _: ()
    shared: tuple[Any, ...] = ()

    @property
    def n_vertices(self) -> int:
        return self.sequences[0].n_vertices

    def pieces(self, k: int) -> Iterator[tuple[Any, int, int]]:
        return _cut(((s.vertices, 0, len(s)) for s in self.sequences), *self.spans[k])


class Executor(Protocol):
    """Maker of the calls of a :class:`SpanTask`."""

    def map(self, task: SpanTask) -> Iterator[Any]:
        """Results in the order of the spans, each computed when it is taken or before."""
        ...


class Local:
    """Executor in this process: one span after the other, each with all threads."""

    def map(self, task: SpanTask) -> Iterator[Any]:
        for k in range(len(task.spans)):
            frames = Frames(tuple(task.pieces(k)), task.n_vertices)
            yield task.function(frames, *task.arguments(k), *task.shared)


class Cluster:
    """Executor on the workers of a Dask client.

    A call carries all that it needs or reads it, so that the scheduler can give it
    to another worker when one is lost.
    """

    def __init__(self, client: Any) -> None:
        self.client = client

    def map(self, task: SpanTask) -> Iterator[Any]:
        import dask

        waiting: collections.deque[Any] = collections.deque()
        # No more results wait to be added up than are being computed: each is large.
        most_waiting = 1 + sum(self.client.nthreads().values())
        quiet = dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 GiB"})
        with quiet:
            common = self.client.submit(_same, task.shared, pure=False)
            for k in range(len(task.spans)):
                pieces = [self._portable(*p) for p in task.pieces(k)]
                call = (_remote, task.function, pieces, task.n_vertices, task.arguments(k), common)
                waiting.append(self.client.submit(*call, pure=False, retries=2))
                if len(waiting) >= most_waiting:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()

    def _portable(self, array: Any, first: int, last: int) -> tuple[Any, int, int]:
        if isinstance(array, np.memmap):
            return _MappedFile.of(array), first, last
        if hasattr(array, "__dask_graph__"):
            return self.client.compute(array[first:last], retries=2), 0, last - first
        return array, first, last


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
        (a.open() if isinstance(a, _MappedFile) else a, first, last) for a, first, last in pieces
    )
    return function(Frames(opened, n_vertices), *arguments, *shared)


@dataclasses.dataclass(frozen=True)
class _MappedFile:
    """Place of a memory map in its file, which a worker can open again."""

    path: str
    dtype: str
    shape: tuple[int, ...]
    offset: int

    @staticmethod
    def of(array: np.memmap[Any, Any]) -> _MappedFile:
        # A slice keeps the offset of the whole map; only its address tells where it lies.
        begin = int(array.offset) - int(array.offset) % mmap.ALLOCATIONGRANULARITY
        mapped = np.frombuffer(array._mmap, dtype=np.uint8)  # type: ignore[attr-defined]
        return _MappedFile(
            path=str(array.filename),
            dtype=array.dtype.str,
            shape=array.shape,
            offset=begin + int(array.ctypes.data) - int(mapped.ctypes.data),
        )

    def open(self) -> np.memmap[Any, Any]:
        return np.memmap(
            self.path, dtype=np.dtype(self.dtype), mode="r", shape=self.shape, offset=self.offset
        )


def _opens_elsewhere(array: Any) -> bool:
    """Whether a worker can read the array by itself."""
    if isinstance(array, np.memmap):
        return (
            array.flags.c_contiguous
            and isinstance(array.filename, (str, Path))
            and getattr(array, "_mmap", None) is not None
        )
    return hasattr(array, "__dask_graph__") or type(array).__module__.split(".")[0] == "zarr"


def executor_for(sequences: Sequence[MeshSequence]) -> Executor:
    """Workers of the active Dask client where there is one, else this process."""
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
