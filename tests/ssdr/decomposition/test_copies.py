"""Vertices that coincide in every frame are one vertex of every solver."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions
from ssdr.mesh.surface import coincident, distinct


@pytest.fixture(scope="module")
def soup() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frames and faces of a mesh whose triangles share no vertices, and the mesh's own vertices."""
    shots, faces = motions.wings(frames=12, rows=13, columns=5)
    corners = np.arange(faces.size, dtype=np.int32).reshape(-1, 3)
    return shots[:, faces.ravel()], corners, faces.ravel()


def crack(skinning: ssdr.Skinning, vertex: np.ndarray) -> float:
    """Largest distance in any frame of a corner from the first corner of the same vertex."""
    posed = skinning.skin()
    first = np.full(vertex.max() + 1, -1)
    first[vertex[::-1]] = np.arange(len(vertex))[::-1]
    return float(np.abs(posed - posed[:, first[vertex]]).max())


CALLS: dict[str, Callable[..., Any]] = {
    "rigid": lambda s, f: ssdr.decompose(s, f, bones=4, effort="fast"),
    "affine": lambda s, f: ssdr.decompose(s, f, bones=4, bone_model="affine", effort="fast"),
    "free": lambda s, f: ssdr.decompose(s, f, bones=4, rest_pose="free", effort="fast"),
    "joints": lambda s, f: ssdr.decompose(s, f, bones=4, rig="rigid", effort="fast"),
    "smooth": lambda s, f: ssdr.decompose(s, f, bones=4, smoothness=0.01, effort="fast"),
    "smallest": lambda s, f: ssdr.smallest(s, f, tolerance="2%", effort="fast"),
}


@pytest.mark.parametrize("name", CALLS)
def test_no_corner_leaves_the_others(name: str, soup: tuple[np.ndarray, ...]) -> None:
    shots, corners, vertex = soup
    result = CALLS[name](shots, corners)
    assert result.copies == len(vertex) - len(np.unique(vertex))
    assert result.skinning.rest.shape == shots[0].shape
    np.testing.assert_array_equal(result.skinning.faces, corners)
    assert crack(result.skinning, vertex) == 0


FITS: dict[str, Callable[..., Any]] = {
    "weights": lambda s, m: ssdr.fit_weights(s, m),
    "smooth weights": lambda s, m: ssdr.fit_weights(s, m, smoothness=0.05),
    "weights near others": lambda s, m: ssdr.fit_weights(s, m, prior=m, prior_length=0.05),
    "rest pose": lambda s, m: ssdr.fit_rest_pose(s, m),
    "free rest pose": lambda s, m: ssdr.fit_rest_pose(s, m, rest_pose="free"),
    "bones": lambda s, m: ssdr.fit_bones(s, m, max_sweeps=3),
}


@pytest.mark.parametrize("name", FITS)
def test_no_corner_leaves_the_others_in_a_fit(name: str, soup: tuple[np.ndarray, ...]) -> None:
    shots, corners, vertex = soup
    sequence = ssdr.MeshSequence(shots, corners)
    start = ssdr.initialize(sequence, bones=4)
    found = FITS[name](sequence, start)
    assert found.skinning.rest.shape == shots[0].shape
    assert found.squared_error.shape == vertex.shape
    np.testing.assert_array_equal(found.skinning.faces, corners)
    assert crack(found.skinning, vertex) == 0
    assert crack(start, vertex) == 0


def test_no_corner_of_a_real_soup_leaves_the_others(
    real: Callable[[str], ssdr.MeshSequence],
) -> None:
    horse = real("horse_gallop")
    vertex, corners = horse.faces.ravel(), np.arange(horse.faces.size).reshape(-1, 3)
    start = ssdr.initialize(horse, bones=12)
    parts = start.rest[vertex], start.indices[vertex], start.weights[vertex], start.transforms
    sequence = ssdr.MeshSequence(horse.vertices[:, vertex], corners)
    smooth = ssdr.fit_weights(sequence, ssdr.Skinning(*parts), smoothness=0.01 * horse.diagonal())
    solved = ssdr.fit_rest_pose(sequence, smooth)
    assert crack(smooth.skinning, vertex) == crack(solved.skinning, vertex) == 0


def test_a_fit_of_copies_is_that_of_one_vertex() -> None:
    """Smoothness sees the importance of all copies, and what a vertex resembles has as much."""
    shots, faces = motions.wings(frames=8, rows=9, columns=4)
    n = shots.shape[1]
    start = ssdr.initialize(shots, faces, bones=3)
    rows = np.r_[np.arange(n), :5]
    parts = start.rest[rows], start.indices[rows], start.weights[rows], start.transforms
    twice = ssdr.MeshSequence(shots[:, rows], faces), ssdr.Skinning(*parts)
    once = ssdr.MeshSequence(shots, faces), start
    count = np.bincount(rows)
    smooth = ssdr.fit_weights(*once, smoothness=0.05, vertex_importance=count).skinning
    found = ssdr.fit_weights(*twice, smoothness=0.05).skinning
    np.testing.assert_array_equal(found.weights, smooth.weights[rows])
    target = np.eye(3)[np.arange(n) % 3]
    near = ssdr.fit_weights(*once, prior=target, prior_length=0.05).skinning
    found = ssdr.fit_weights(*twice, prior=target[rows], prior_length=0.05).skinning
    np.testing.assert_allclose(found.dense_weights(), near.dense_weights()[rows], atol=1e-9)
    rest = ssdr.fit_rest_pose(*twice).skinning.rest
    np.testing.assert_array_equal(rest[n:], rest[:5])


def test_what_a_fit_keeps_tells_copies_apart(soup: tuple[np.ndarray, ...]) -> None:
    """A torn rest pose is the caller's: each vertex is fitted to its own, as if it were alone."""
    shots, corners, vertex = soup
    start = ssdr.initialize(shots, corners, bones=4)
    rng = np.random.default_rng(0)
    torn = start.rest + rng.normal(scale=0.05, size=start.rest.shape)
    found = ssdr.fit_weights(shots, torn, start.transforms).skinning
    np.testing.assert_array_equal(found.rest, torn)
    some = np.unique(vertex, return_index=True)[1]
    alone = ssdr.fit_weights(shots[:, some], torn[some], start.transforms).skinning
    np.testing.assert_allclose(found.dense_weights()[some], alone.dense_weights(), atol=1e-6)
    model = ssdr.Skinning(torn, start.indices, start.weights, start.transforms, faces=corners)
    rest = ssdr.fit_rest_pose(shots, model).skinning.rest
    _, first, back = np.unique(vertex, return_index=True, return_inverse=True)
    np.testing.assert_array_equal(rest, rest[first][back])


def test_copies_count_as_one_vertex_of_their_importance() -> None:
    """A mesh with a vertex twice is solved as one in which it counts twice."""
    shots, faces = motions.wings(frames=8, rows=9, columns=4)
    count = np.ones(shots.shape[1])
    count[:5] = 2
    options: dict[str, Any] = {"bones": 3, "effort": "fast", "normals": False}
    twice = ssdr.decompose(np.concatenate([shots, shots[:, :5]], axis=1), faces, **options)
    once = ssdr.decompose(shots, faces, vertex_importance=count, **options)
    np.testing.assert_array_equal(twice.skinning.rest[: len(count)], once.skinning.rest)
    np.testing.assert_array_equal(twice.skinning.weights[: len(count)], once.skinning.weights)


@pytest.mark.filterwarnings("ignore:.*bones could each go")
def test_vertices_whose_weights_are_kept_apart_stay_apart(
    soup: tuple[np.ndarray, ...],
) -> None:
    shots, corners, vertex = soup
    indices = np.arange(len(vertex), dtype=np.int32)[:, None] % 3
    start = ssdr.Kept(indices=indices, weights=np.ones((len(vertex), 1)))
    found = ssdr.decompose(shots, corners, bones=3, start=start, effort="fast").skinning
    np.testing.assert_array_equal(found.indices[:, 0], indices[:, 0])


@pytest.mark.filterwarnings("ignore:.*bones could each go")
def test_more_bones_than_vertices_that_differ() -> None:
    """As many as there are vertices may be asked for, and then copies are solved apart."""
    shots = np.repeat(np.random.default_rng(2).normal(size=(4, 3, 3)), 2, axis=1)
    assert ssdr.decompose(shots, bones=5, effort="fast").rmse < 1e-9


def test_a_start_with_cracks_is_mended_or_kept_as_it_is(soup: tuple[np.ndarray, ...]) -> None:
    shots, corners, vertex = soup
    good = ssdr.decompose(shots, corners, bones=4, effort="fast").skinning
    rng = np.random.default_rng(0)
    parts = {name: getattr(good, name) for name in ("indices", "weights", "transforms", "faces")}
    torn = ssdr.Skinning(good.rest + rng.normal(scale=0.01, size=good.rest.shape), **parts)
    result = ssdr.decompose(shots, corners, start=torn, effort="fast")
    assert crack(torn, vertex) > 0.01
    assert crack(result.skinning, vertex) == 0


def test_labels_beside_those_of_all_positions() -> None:
    """Independent: whole trajectories compared as rows of numbers."""
    rng = np.random.default_rng(1)
    base = rng.integers(0, 2, size=(6, 40, 3)).astype(float)
    base[:, 20:30] = base[:, :10]
    base[0, 5] = -0.0
    base[0, 25] = 0.0
    kept, row = distinct(coincident(iter([base[:1], base[:4], base[4:]]), 40))
    rows = base.transpose(1, 0, 2).reshape(40, -1)
    for i in range(40):
        first = next(k for k in range(40) if (rows[k] == rows[i]).all())
        assert kept[row[i]] == first


def test_frames_read_on_demand_stay_so(tmp_path: Path, soup: tuple[np.ndarray, ...]) -> None:
    shots, corners, vertex = soup
    np.save(tmp_path / "soup.npy", shots)
    lazy = ssdr.MeshSequence(np.load(tmp_path / "soup.npy", mmap_mode="r"), corners)
    kept, row = distinct(coincident(iter([shots]), len(vertex)))
    fewer = lazy.with_vertices(kept, row)
    assert fewer.is_lazy
    np.testing.assert_array_equal(fewer.frames([2, 5]), shots[[2, 5]][:, kept])
    np.testing.assert_array_equal(fewer.faces, row[corners])
