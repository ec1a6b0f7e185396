"""Fingerprints of frames, which tell whether frames are the same as at an earlier reading.

Each frame has its own, so that they do not depend on the blocks in which frames are read, and
a pass over some of the frames can check these alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..parallel import chunk_bounds, run_chunks
from ..sequence import MeshSequence
from .executor import Executor, Frames, Local, SpanTask, spans_of

__all__ = ["BYTES", "Digests", "check_same", "digests_of", "of_block", "of_frame"]

BYTES = 16  # of the digest of a frame
Digests = NDArray[np.uint8]
_AT_ONCE = 8  # frames


def of_frame(frame: NDArray[np.floating]) -> Digests:
    """Digest (16,) of the positions of a frame, the same for equal numbers of any dtype."""
    numbers = np.add(frame, 0.0, dtype=np.float64)  # -0.0 equals 0.0, but not its bytes
    return np.frombuffer(hashlib.sha256(numbers.tobytes()).digest()[:BYTES], dtype=np.uint8)


def of_block(block: NDArray[np.floating]) -> Digests:
    """Digests (n, 16) of n frames."""
    out = np.empty((len(block), BYTES), dtype=np.uint8)

    def work(_: int, i: int, k: int) -> None:
        for t in range(i, k):
            out[t] = of_frame(block[t])

    run_chunks(work, chunk_bounds(len(block), _AT_ONCE))
    return out


def digests_of(sequences: Sequence[MeshSequence], executor: Executor | None = None) -> Digests:
    """Digests (F, 16) of all frames, in one pass over them."""
    spans = spans_of(sum(len(s) for s in sequences))
    parts: Iterable[Digests] = (executor or Local()).map(SpanTask(_of_span, sequences, spans))
    return np.concatenate(list(parts))


def _of_span(frames: Frames) -> Digests:
    return np.concatenate([of_block(block) for _, block in frames.blocks()])


def check_same(
    seen: Digests, expected: Digests, frames: NDArray[np.int64] | range, *, resumed: bool
) -> None:
    """Refuse frames that differ from those of an earlier reading.

    Raises
    ------
    InputError
        If a frame differs: about `resume` if the run that is resumed has read the earlier one.
    """
    other = (seen != expected).any(axis=1)
    if not other.any():
        return
    frame = frames[int(other.argmax())]
    if resumed:
        raise InputError(
            "resume", "a state of a run on these very frames", f"one on another frame {frame}"
        )
    raise InputError(
        "sequence", "frames that stay as they are during the run", f"a change in frame {frame}"
    )
