"""Threads: same bits for any number, errors, nesting, forks and the cap on BLAS."""

from __future__ import annotations

import multiprocessing
import threading
import time

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import ssdr
from helpers.measures import longest_silence
from ssdr import InputError
from ssdr.kernels.bones import sweep_bones
from ssdr.parallel import chunk_bounds, run_chunks, serial_blas
from ssdr.solver.model import Model
from ssdr.solver.moments import bone_sums, coupled_bones
from ssdr.solver.trajectories import gather


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
    seen = set()

    def work(k, start, stop):
        seen.add(threading.get_ident())
        time.sleep(0.001 * (k % 3))
        return k, start, stop

    bounds = chunk_bounds(40, 3)
    assert run_chunks(work, bounds) == [(k, *ends) for k, ends in enumerate(bounds)]
    assert len(seen) <= threads
    assert run_chunks(work, []) == []


def test_two_threads_really_run_beside_each_other():
    ssdr.set_threads(2)
    meet = threading.Barrier(2, timeout=20)  # raises where the chunks run one after the other
    run_chunks(lambda *_: meet.wait(), [(0, 1), (1, 2)])


def test_same_bits_for_any_number_of_threads():
    rng = np.random.default_rng(0)
    rest = rng.normal(size=(5000, 3)).astype(np.float32)
    indices = rng.integers(0, 9, (5000, 4))
    weights = rng.dirichlet(np.ones(4), 5000).astype(np.float32)
    transforms = rng.normal(size=(6, 9, 3, 4)).astype(np.float32)
    results = []
    for threads in (1, 2, 3):
        ssdr.set_threads(threads)
        results.append(ssdr.skin(rest, indices, weights, transforms).tobytes())
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_errors_propagate_and_end_the_work(threads):
    ssdr.set_threads(threads)
    calls = []

    def work(k, *_):
        calls.append(k)
        if k == 3:
            raise KeyError("chunk 3")
        time.sleep(0.001)

    with pytest.raises(KeyError, match="chunk 3"):
        run_chunks(work, [(k, k + 1) for k in range(200)])
    assert len(calls) < 50
    assert run_chunks(lambda k, *_: k, [(0, 1)] * 5) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_nested_calls_do_not_deadlock(threads):
    ssdr.set_threads(threads)

    def inner(k, *_):
        time.sleep(0.0005)
        return k

    def outer(k, *_):
        return k * sum(run_chunks(inner, [(0, 1)] * 6))

    assert within(60, lambda: run_chunks(outer, [(0, 1)] * 8)) == [15 * k for k in range(8)]


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
        caller.join(60)
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
        assert queue.get(timeout=60) == list(range(6))
    finally:
        child.join(10)
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
                leave.wait(20)
                inside.append(blas_threads())

        thread = threading.Thread(target=second)
        with serial_blas():
            thread.start()
            assert entered.wait(20)
        leave.set()
        thread.join(20)
        assert set(inside[0]) <= {1}
        assert blas_threads() == before


def test_a_kernel_releases_the_lock_of_python() -> None:
    """One long call of a kernel, nothing of Python in it, and another thread goes on."""
    bones = 8
    data = gather([ssdr.MeshSequence(np.random.default_rng(0).random((1, 40, 3)))], bones=bones)
    indices = np.tile(np.arange(bones, dtype=np.int32), (40, 1))
    weights = np.random.default_rng(1).dirichlet(np.ones(bones), 40)
    transforms = np.tile(np.eye(3, 4), (1, bones, 1, 1))
    u, c = bone_sums(data, Model.with_weights(transforms, data.frame(0), indices, weights, bones))
    start, neighbour = coupled_bones(u)

    def sweep(count: int) -> float:
        began = time.perf_counter()
        sweep_bones(transforms, c, u, start, neighbour, False, count)
        return time.perf_counter() - began

    sweep(1)
    rate = sweep(1000) / 1000
    spent, silence = longest_silence(lambda: sweep(int(1.0 / rate)))
    assert spent > 0.3
    assert silence < 0.5 * spent
