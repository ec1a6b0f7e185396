"""The same seed gives the same bits: again, on any number of threads, beside other runs."""

from __future__ import annotations

import functools
import json
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import threadpoolctl

import ssdr
from helpers import motions
from helpers.measures import bits, frames, wavy
from helpers.rig_model import tube
from helpers.surfaces import animation
from ssdr.model.drawn_normals import with_fitted_normals
from ssdr.show import render_frame

Decompose = functools.partial(ssdr.decompose, effort="fast")


@functools.cache
def big() -> np.ndarray:
    """Vertices for several chunks."""
    return motions.wobble(motions.chain(bones=6, rows=140, ring=8, frames=40), 0.05)


def sheet() -> tuple[np.ndarray, np.ndarray]:
    return motions.wings(frames=15, rows=40, columns=14)


def gradients() -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(1)
    n, bones = 5000, 4
    places, weights = rng.integers(0, bones, (n, 3)), rng.standard_normal((n, 3))
    moves, g = rng.standard_normal((7, bones, 3, 4)), rng.standard_normal((7, n, 3))
    found = ssdr.skin_gradients(rng.standard_normal((n, 3)), places, weights, moves, g)
    return found.rest, found.weights, found.transforms


def normals() -> np.ndarray:
    model = tube(rings=30, sides=40)
    points = model.skin() + 0.02 * np.random.default_rng(0).normal(size=(20, model.n_vertices, 3))
    sequence = ssdr.MeshSequence(points, model.faces, surface=model.surface)
    return with_fitted_normals([sequence], model).surface.normals


def measures() -> str:
    (a, faces), (b, _) = (animation(k, F=30, subdivisions=2) for k in (0, 1))
    return json.dumps(ssdr.metrics.compare(a, b, faces).as_dict(arrays=True))


CALLS: dict[str, Callable[[], Any]] = {
    "points": lambda: Decompose(big(), bones=6, influences=3, effort="balanced"),
    "similarity": lambda: Decompose(big(), bones=6, influences=3, bone_model="similarity"),
    "affine": lambda: Decompose(big(), bones=6, influences=3, bone_model="affine"),
    "rig": lambda: Decompose(big(), bones=6, influences=3, rig="rigid"),
    "surface": lambda: Decompose(*sheet(), bones=4, effort="balanced"),
    "rig with a surface": lambda: Decompose(*sheet(), bones=4, rig="rigid"),
    "smooth": lambda: Decompose(*sheet(), bones=4, smoothness=0.05),
    "smallest": lambda: ssdr.smallest(wavy(), tolerance="0.8%", effort="fast"),
    "gradients": gradients,
    "normals": normals,
    "measures": measures,
    "a picture": lambda: np.asarray(render_frame(tube(), 2, size=(200, 200))),
}


def numbers(found: Any) -> Any:
    if isinstance(found, ssdr.Decomposition):
        keys = found.skinning.keyframes
        return bits(found), None if keys is None else keys.tobytes()
    parts = found if isinstance(found, tuple) else (found,)
    return tuple(part if isinstance(part, str) else part.tobytes() for part in parts)


@pytest.mark.parametrize("name", CALLS)
def test_the_same_bits_for_any_number_of_threads(name: str) -> None:
    """Of this package and of BLAS."""
    found = set()
    try:
        for threads in (1, 2):
            ssdr.set_threads(threads)
            with threadpoolctl.threadpool_limits(threads, user_api="blas"):
                found.add(numbers(CALLS[name]()))
    finally:
        ssdr.set_threads(None)
    assert len(found) == 1


def test_two_runs_at_once() -> None:
    alone = bits(Decompose(frames(), bones=4))
    found: list[tuple[bytes, ...]] = []
    threads = [
        threading.Thread(target=lambda: found.append(bits(Decompose(frames(), bones=4))))
        for _ in range(3)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [alone] * 3


def test_seed_decides() -> None:
    def run(rng: object) -> tuple[bytes, ...]:
        return bits(ssdr.decompose(frames(), bones=5, rng=rng))

    assert run(3) == run(3) == run(np.int64(3))
    assert run(np.random.default_rng(8)) == run(np.random.default_rng(8))
    assert any(run(seed) != run(3) for seed in range(4, 10))


def test_the_global_generator_is_left_alone() -> None:
    np.random.seed(1)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    Decompose(frames(), bones=3)
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002
