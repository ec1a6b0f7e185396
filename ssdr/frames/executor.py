"""Frames that stay where they are, and functions brought to them span by span.

A walk over all frames is one function of a span of them, called for every span,
and a reduction of what comes back in the order of the spans.  Who calls it is an
executor: this process, or the workers of a Dask cluster where a client is active
and every shot is something that workers can open by themselves.  Spans do not
depend on who works on them, so the result does not either.
"""

from __future__ import annotations

import collections
import dataclasses
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..parallel import chunk_bounds
from ..sequence import MeshSequence, native

__all__ = ["Executor", "Frames", "Local", "Walk", "executor_for", "spans_of"]

# Bytes of a block in float64: large enough for matrix products at full speed, and a few of them
# are held at once.
_BLOCK = 32 << 20
_FEWEST = 8  # frames a block, whatever their size
# Spans of all frames: enough for the workers of a cluster, and each sends home (V, 4B) sums.
_SPANS = 32
_logger = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Frames:
    """Some frames of some shots, in order: ``(array, first, last)`` each; picklable if those are.

    Parameters
    ----------
    pieces : tuple of (array-like, int, int)
    n_vertices : int
    """

    pieces: tuple[tuple[Any, int, int], ...]
    n_vertices: int

    def __len__(self) -> int:
        return sum(last - first for _, first, last in self.pieces)

    def blocks(self) -> Iterator[tuple[int, NDArray[np.floating]]]:
        """A few dozen MiB at a time, as (position, (n, V, 3)); short shots are put together."""
        for start, stop in chunk_bounds(len(self), max(_FEWEST, _BLOCK // (24 * self.n_vertices))):
            read = [native(array[i:k]) for array, i, k in _cut(self.pieces, start, stop)]
            yield start, read[0] if len(read) == 1 else np.concatenate(read)


def spans_of(n_frames: int) -> list[tuple[int, int]]:
    """Bounds of the spans: at most a few dozen, the same whoever works on them."""
    return chunk_bounds(n_frames, max(_FEWEST, -(-n_frames // _SPANS)))


def _cut(
    pieces: Iterable[tuple[Any, int, int]], start: int, stop: int
) -> Iterator[tuple[Any, int, int]]:
    """What lies between two positions in a row of pieces."""
    offset = 0
    for array, first, last in pieces:
        i, k = max(start - offset, 0), min(stop - offset, last - first)
        if i < k:
            yield array, first + i, first + k
        offset += last - first


@dataclasses.dataclass(frozen=True, eq=False)
class Walk:
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
    """Makes the calls of a walk."""

    def map(self, walk: Walk) -> Iterator[Any]:
        """Results in the order of the spans, each made when it is asked for or before."""
        ...


class Local:
    """One span after the other in this process; threads work inside of each."""

    def map(self, walk: Walk) -> Iterator[Any]:
        for k in range(len(walk.spans)):
            frames = Frames(tuple(walk.pieces(k)), walk.n_vertices)
            yield walk.function(frames, *walk.arguments(k), *walk.shared)


class Cluster:
    """Spans on the workers of a Dask client.

    All that a call needs travels with it or is read by it, so that the scheduler
    can give it to another worker when one is lost.
    """

    def __init__(self, client: Any) -> None:
        self.client = client

    def map(self, walk: Walk) -> Iterator[Any]:
        import dask

        waiting: collections.deque[Any] = collections.deque()
        # as many results as are being made, and no more, wait to be added up
        most_waiting = 1 + sum(self.client.nthreads().values())
        quiet = dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 GiB"})
        with quiet:
            common = self.client.submit(_same, walk.shared, pure=False)
            for k in range(len(walk.spans)):
                pieces = [self._portable(*p) for p in walk.pieces(k)]
                waiting.append(
                    self.client.submit(
                        _remote,
                        walk.function,
                        pieces,
                        walk.n_vertices,
                        walk.arguments(k),
                        common,
                        pure=False,
                        retries=2,
                    )
                )
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
    """Where a memory map lies in its file."""

    path: str
    dtype: str
    shape: tuple[int, ...]
    offset: int

    @staticmethod
    def of(array: np.memmap[Any, Any]) -> _MappedFile:
        # a slice keeps the offset of the whole: its place is known by its address alone
        begin = int(array.offset) - int(array.offset) % _granularity()
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


def _granularity() -> int:
    import mmap

    return mmap.ALLOCATIONGRANULARITY


def _opens_elsewhere(array: Any) -> bool:
    """Whether a worker can read this by itself."""
    if isinstance(array, np.memmap):
        return (
            array.flags.c_contiguous
            and isinstance(array.filename, (str, Path))
            and getattr(array, "_mmap", None) is not None
        )
    return hasattr(array, "__dask_graph__") or type(array).__module__.split(".")[0] == "zarr"


def executor_for(sequences: Sequence[MeshSequence]) -> Executor:
    """The workers of the active Dask client, where there is one, else this process."""
    distributed = sys.modules.get("distributed")  # never imported from here
    if distributed is None:
        return Local()
    try:
        client = distributed.default_client()
    except ValueError:
        return Local()
    if not all(_opens_elsewhere(s.vertices) for s in sequences):
        _logger.info("frames that are in memory stay in this process, not on the Dask workers")
        return Local()
    return Cluster(client)
