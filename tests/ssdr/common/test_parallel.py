"""Threads: same bits for any number, errors, nesting, forks and the cap on BLAS."""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import sys
import threading

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import ssdr
from ssdr import InputError
from ssdr.common.parallel import chunk_bounds, run_chunks, serial_blas
from ssdr.kernels.bones import sweep_bones
from ssdr.solver.model import Model
from ssdr.solver.moments import bone_sums, coupled_bones
from ssdr.solver.trajectories import gather

GUARD = 600  # seconds until a deadlock is one


@pytest.fixture(autouse=True)
def _restore_threads():
    yield
    ssdr.set_threads(None)


def within(seconds, function):
    """Result of `function`, run in a daemon thread so that a deadlock fails the test."""
    box = []
    thread = threading.Thread(target=lambda: box.append(function()), daemon=True)
    thread.start()
    thread.join(seconds)
    assert box, "deadlock or error"
    return box[0]


def test_chunks_cover_the_range_once():
    for n in (0, 1, 5, 10, 11):
        bounds = chunk_bounds(n, 5)
        assert [i for a, b in bounds for i in range(a, b)] == list(range(n))
        assert all(b - a <= 5 for a, b in bounds)


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
def test_results_come_in_the_order_of_chunks(threads):
    ssdr.set_threads(threads)
    seen, last = set(), threading.Event()

    def work(k, start, stop):
        seen.add(threading.get_ident())
        if k == 13:
            last.set()
        elif k == 0 and threads > 1:
            assert last.wait(GUARD)  # the first chunk ends after all others were begun
        return k, start, stop

    bounds = chunk_bounds(40, 3)
    assert run_chunks(work, bounds) == [(k, *ends) for k, ends in enumerate(bounds)]
    assert len(seen) <= threads
    assert run_chunks(work, []) == []


def test_two_threads_really_run_beside_each_other():
    ssdr.set_threads(2)
    meet = threading.Barrier(2, timeout=GUARD)  # raises where the chunks run one after the other
    run_chunks(lambda *_: meet.wait(), [(0, 1), (1, 2)])


@pytest.mark.parametrize(("threads", "caller"), [(1, True), (2, True), (3, True), (3, False)])
def test_errors_propagate_and_end_the_work(threads, caller, monkeypatch):
    """No chunk is begun after an error; `caller`: whether it is raised in the calling thread."""
    ssdr.set_threads(threads)
    calls, ended = [], threading.Event()

    def work(k, *_):
        calls.append(k)
        if (threading.current_thread() is threading.main_thread()) == caller:
            raise KeyError(f"chunk {k}")
        assert ended.wait(GUARD)

    # the first things that are done once the chunks that are left have been given up
    name = "cancel" if caller else "set_exception"
    done = getattr(concurrent.futures.Future, name)
    monkeypatch.setattr(
        concurrent.futures.Future, name, lambda *args: (ended.set(), done(*args))[1]
    )
    with pytest.raises(KeyError, match="chunk"):
        run_chunks(work, [(k, k + 1) for k in range(200)])
    assert len(calls) <= threads
    assert run_chunks(lambda k, *_: k, [(0, 1)] * 5) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_nested_calls_do_not_deadlock(threads):
    ssdr.set_threads(threads)

    def inner(k, *_):
        return k + 0 * sum(range(10_000))

    def outer(k, *_):
        return k * sum(run_chunks(inner, [(0, 1)] * 6))

    assert within(GUARD, lambda: run_chunks(outer, [(0, 1)] * 8)) == [15 * k for k in range(8)]


def test_callers_in_several_threads_share_the_pool():
    ssdr.set_threads(3)

    def call():
        return [sum(run_chunks(lambda k, *_: k, [(0, 1)] * 20)) for _ in range(30)]

    results = []
    callers = [threading.Thread(target=lambda: results.append(call())) for _ in range(4)]
    for caller in callers:
        caller.start()
    ssdr.set_threads(2)  # in the middle of it
    for caller in callers:
        caller.join(GUARD)
    assert results == [[190] * 30] * 4


def _child(queue):
    ssdr.set_threads(2)
    with serial_blas():
        queue.put(run_chunks(lambda k, *_: k, [(0, 1)] * 6))


@pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="the system has no fork"
)
# Python 3.12 warns of exactly what is tested here: forking a process that has threads.
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_child_gets_threads_of_its_own():
    ssdr.set_threads(2)
    run_chunks(lambda k, *_: k, [(0, 1)] * 6)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_child, args=(queue,))
    child.start()
    try:
        assert queue.get(timeout=GUARD) == list(range(6))
    finally:
        child.join(GUARD)
        child.kill()


def test_number_of_threads(monkeypatch):
    ssdr.set_threads(5)
    assert ssdr.get_threads() == 5
    ssdr.set_threads(None)
    monkeypatch.setenv("SSDR_NUM_THREADS", "3")
    assert ssdr.get_threads() == 3
    for bad in ("0", "-1", "two", "1.5"):
        monkeypatch.setenv("SSDR_NUM_THREADS", bad)
        with pytest.raises(InputError, match="SSDR_NUM_THREADS"):
            ssdr.get_threads()
    monkeypatch.delenv("SSDR_NUM_THREADS")
    assert ssdr.get_threads() >= 1
    for bad in (0, -1, 1.5, True, "2"):
        with pytest.raises(InputError, match="count"):
            ssdr.set_threads(bad)


def blas_threads():
    return [info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas"]


def test_blas_gets_one_thread_and_its_own_number_back():
    def fail():
        with serial_blas():
            assert set(blas_threads()) <= {1}
            with serial_blas():
                assert set(blas_threads()) <= {1}
            assert set(blas_threads()) <= {1}
            raise KeyError

    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        with pytest.raises(KeyError):
            fail()
        assert blas_threads() == before


def test_blas_gets_its_number_back_when_threads_overlap():
    # A enters, B enters, A leaves, B leaves: B must not put back the 1 that it found.
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        entered, leave = threading.Event(), threading.Event()
        inside = []

        def second():
            with serial_blas():
                entered.set()
                leave.wait(GUARD)
                inside.append(blas_threads())

        thread = threading.Thread(target=second)
        with serial_blas():
            thread.start()
            assert entered.wait(GUARD)
        leave.set()
        thread.join(GUARD)
        assert set(inside[0]) <= {1}
        assert blas_threads() == before


def test_a_kernel_releases_the_lock_of_python() -> None:
    """Another thread counts on during one call, though Python's own code is never interrupted."""
    bones = 8
    data = gather([ssdr.MeshSequence(np.random.default_rng(0).random((1, 40, 3)))], bones=bones)
    indices = np.tile(np.arange(bones, dtype=np.int32), (40, 1))
    weights = np.random.default_rng(1).dirichlet(np.ones(bones), 40)
    transforms = np.tile(np.eye(3, 4), (1, bones, 1, 1))
    u, c = bone_sums(data, Model.with_weights(transforms, data.frame(0), indices, weights, bones))
    start, neighbour = coupled_bones(u)
    counted, done = 0, threading.Event()

    def count() -> None:
        nonlocal counted
        while not done.wait(1e-4):
            counted += 1

    def moved(sweeps: int) -> bool:
        before = counted
        sweep_bones(transforms, c, u, start, neighbour, False, sweeps)
        return counted > before

    moved(1)  # compiled
    thread, interval = threading.Thread(target=count), sys.getswitchinterval()
    thread.start()
    sys.setswitchinterval(1e4)  # from here on this thread keeps the lock until it gives it up
    try:
        # as long as the other thread needs to get a core
        assert any(moved(1 << k) for k in range(23))
    finally:
        sys.setswitchinterval(interval)
        done.set()
        thread.join(GUARD)
