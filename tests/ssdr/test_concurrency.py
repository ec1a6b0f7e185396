"""``ssdr`` beside other Python threads."""

from __future__ import annotations

import threading
import time

import numpy as np

import ssdr
from helpers.measures import bits, frames, longest_silence
from ssdr.kernels.bones import sweep_bones
from ssdr.solver.model import Model
from ssdr.solver.moments import bone_sums, coupled_bones
from ssdr.solver.trajectories import gather


def test_a_kernel_releases_the_lock_of_python() -> None:
    """One long call of a kernel, nothing of Python in it, and another thread goes on."""
    bones = 8
    data = gather([ssdr.MeshSequence(np.random.default_rng(0).random((1, 40, 3)))], bones=bones)
    indices = np.tile(np.arange(bones, dtype=np.int32), (40, 1))
    weights = np.random.default_rng(1).dirichlet(np.ones(bones), 40)
    transforms = np.tile(np.eye(3, 4), (1, bones, 1, 1))
    u, c = bone_sums(data, Model.with_weights(transforms, data.frame(0), indices, weights, bones))
    start, neighbour = coupled_bones(u)
    locked = np.zeros(bones, dtype=bool)

    def sweep(count: int) -> float:
        began = time.perf_counter()
        sweep_bones(transforms, c, u, start, neighbour, locked, False, count)
        return time.perf_counter() - began

    sweep(1)
    rate = sweep(1000) / 1000
    spent, silence = longest_silence(lambda: sweep(int(1.0 / rate)))
    assert spent > 0.3
    assert silence < 0.5 * spent


def test_two_runs_at_once() -> None:
    alone = bits(ssdr.decompose(frames(), bones=4, effort="fast"))
    found: list[tuple[bytes, ...]] = []

    def run() -> None:
        found.append(bits(ssdr.decompose(frames(), bones=4, effort="fast")))

    threads = [threading.Thread(target=run) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [alone] * 3
