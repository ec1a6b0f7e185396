"""Threads that work on fixed chunks, so that results do not depend on the number of threads.

Kernels run without the GIL and have no parallel loops of their own.  Work is always split into the
same chunks of vertices or frames, and sums are taken in the order of the chunks.  BLAS gets one
thread while a kernel runs: spinning BLAS threads cost more than they bring, and the order of
summation inside BLAS depends on how many there are.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import threadpoolctl

from .errors import InputError, is_whole

_lock = threading.Lock()
_pool: ThreadPoolExecutor | None = None
_threads: int | None = None
_controller: threadpoolctl.ThreadpoolController | None = None
_limiter: Any = None
_limited = 0  # number of open blocks of serial_blas; the last to end lifts the limit


def get_threads() -> int:
    """Number of threads that kernels use.

    This is the number given to :func:`set_threads`, else the value of the environment variable
    ``SSDR_NUM_THREADS``, else the number of cores that the process may use.

    Examples
    --------
    >>> ssdr.get_threads() >= 1
    True
    """
    if _threads is not None:
        return _threads
    text = os.environ.get("SSDR_NUM_THREADS", "")
    if text:
        if not text.isdigit() or int(text) < 1:
            raise InputError("SSDR_NUM_THREADS", "a positive integer", repr(text))
        return int(text)
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else (os.cpu_count() or 1)


def set_threads(count: int | None) -> None:
    """Set the number of threads for this process; None restores the default.

    The results of all functions are the same, bit for bit, with any number of threads.

    Examples
    --------
    >>> before = ssdr.get_threads()
    >>> ssdr.set_threads(2)
    >>> ssdr.get_threads()
    2
    >>> ssdr.set_threads(before)
    """
    global _threads, _pool
    if count is not None and not (is_whole(count) and count >= 1):
        raise InputError("count", "a positive integer or None", repr(count))
    with _lock:
        _threads = None if count is None else int(count)
        # The old pool is not shut down, since another thread may be about to use it; its idle
        # workers end with the object.
        _pool = None


def chunk_bounds(n: int, size: int) -> list[tuple[int, int]]:
    """Bounds of consecutive chunks of at most `size` that cover ``range(n)``.

    Examples
    --------
    >>> ssdr.common.parallel.chunk_bounds(10, 4)
    [(0, 4), (4, 8), (8, 10)]
    """
    return [(start, min(n, start + size)) for start in range(0, n, size)]


def run_chunks(function: Callable[..., Any], bounds: list[tuple[int, int]]) -> list[Any]:
    """Run ``function(chunk index, start, stop)`` for all chunks in threads; return the results.

    The results are in the order of the chunks.  The first exception ends the work and is raised.
    The function may itself call ``run_chunks``.

    Examples
    --------
    >>> bounds = ssdr.common.parallel.chunk_bounds(10, 4)
    >>> ssdr.common.parallel.run_chunks(lambda chunk, start, stop: sum(range(start, stop)), bounds)
    [6, 22, 17]
    """
    global _pool
    threads = min(get_threads(), len(bounds)) if len(bounds) > 1 else 1
    if threads <= 1:
        return [function(k, start, stop) for k, (start, stop) in enumerate(bounds)]
    with _lock:
        if _pool is None:
            _pool = ThreadPoolExecutor(max(1, get_threads() - 1), thread_name_prefix="ssdr")
        pool = _pool
    # Each thread runs one task that takes chunks from a shared counter: waking a thread costs more
    # than a small chunk.
    results: list[Any] = [None] * len(bounds)
    order = iter(range(len(bounds)))
    feed = threading.Lock()

    def work() -> None:
        nonlocal order
        while True:
            with feed:
                k = next(order, -1)
            if k < 0:
                return
            try:
                results[k] = function(k, *bounds[k])
            except BaseException:
                order = iter(())
                raise

    futures = [pool.submit(work) for _ in range(threads - 1)]
    try:
        work()
    finally:
        # Tasks that have not started are not needed any more; in a nested call they never would.
        errors = [future.exception() for future in futures if not future.cancel()]
    for error in errors:
        if error is not None:
            raise error
    return results


def _forget_pool() -> None:
    global _pool, _lock, _limiter, _limited
    _pool, _lock, _limiter, _limited = None, threading.Lock(), None, 0


if hasattr(os, "register_at_fork"):  # a forked child has none of its parent's threads
    os.register_at_fork(after_in_child=_forget_pool)


@contextlib.contextmanager
def serial_blas() -> Iterator[None]:
    """Limit BLAS to one thread inside the block; nested blocks cost nothing.

    The limit holds for the whole process.  The former number of BLAS threads is restored when the
    last of all open blocks ends.

    Examples
    --------
    >>> with ssdr.common.parallel.serial_blas():
    ...     product = np.eye(3) @ np.ones(3)
    >>> product.shape
    (3,)
    """
    global _controller, _limiter, _limited
    with _lock:
        if _limited == 0:
            if _controller is None:
                _controller = threadpoolctl.ThreadpoolController()
            with _any_thread_may_limit():
                _limiter = _controller.limit(limits=1, user_api="blas")
        _limited += 1
    try:
        yield
    finally:
        with _lock:
            _limited = max(0, _limited - 1)
            if _limited == 0 and _limiter is not None:
                with _any_thread_may_limit():
                    _limiter.restore_original_limits()
                _limiter = None


@contextlib.contextmanager
def _any_thread_may_limit() -> Iterator[None]:
    # Newer versions of threadpoolctl ignore limits from any thread but the first that set one.
    openblas = getattr(threadpoolctl, "OpenBLASController", None)
    release = getattr(openblas, "clear_controlling_thread", lambda force: None)
    release(force=True)
    try:
        yield
    finally:
        release(force=True)
