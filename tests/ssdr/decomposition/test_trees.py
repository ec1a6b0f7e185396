"""``decompose(..., rig="rigid")`` and ``"loose"``: what they promise, where trees fail."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers import motions, trees
from helpers.measures import bits, check, diagonal, rmse_of

_RIG = {"rig": "rigid", "effort": "fast"}


@functools.cache
def _solved() -> ssdr.Decomposition:
    return ssdr.decompose(trees.six_bones().frames, bones=6, influences=2, rig="rigid")


def _check(result: ssdr.Decomposition, frames: np.ndarray, bones: int, influences: int = 4):
    """What holds for every rigid hierarchy."""
    check(result, frames, bones, influences)
    model = result.skinning
    size = max(diagonal(frames), float(np.abs(frames).max()), 1e-12)
    assert model.joint_gaps().max() <= 1e-6 * size
    assert model.parents.shape == (bones,)
    assert model.joint_positions.shape == (bones, 3)
    local = model.local_transforms()
    roots = np.flatnonzero(model.parents < 0)
    posed = model.pose(local[..., :3], local[..., 3][:, roots])
    np.testing.assert_allclose(posed.skin(), model.skin(), atol=1e-6 * size)
    return model


def test_a_made_skeleton_is_found() -> None:
    made, result = trees.six_bones(), _solved()
    model = _check(result, made.frames, 6, 2)
    assert model.names() == tuple(f"joint_{k}" for k in range(6))
    assert result.rmse < 2e-3 * diagonal(made.frames)
    place = trees.matched(model, made)
    theirs = {frozenset(int(place[k]) for k in edge) for edge in trees.edges(made.parents)}
    assert trees.edges(model.parents) == theirs
    for child in np.flatnonzero(made.parents >= 0):
        a, b = int(place[child]), int(place[made.parents[child]])
        joint = model.joint_positions[a if model.parents[a] == b else b]
        # the rest pose is the model's own: compare where the joint is in the frames
        there = np.einsum("tij,j->ti", model.transforms[:, a, :, :3], joint)
        there += model.transforms[:, a, :, 3]
        truth = np.einsum("tij,j->ti", made.transforms[:, child, :, :3], made.points[child])
        truth += made.transforms[:, child, :, 3]
        away = np.linalg.norm(there - truth, axis=1).mean()
        assert away < 0.02 * diagonal(made.frames)


def test_a_loose_tree_leaves_the_flat_result_as_it_is() -> None:
    options = {"bones": 6, "influences": 2}
    flat = ssdr.decompose(trees.six_bones().frames, **options)
    loose = ssdr.decompose(trees.six_bones().frames, **options, rig="loose")
    model = loose.skinning
    unhung = dataclasses.replace(model, parents=None, joint_positions=None)
    assert bits(flat) == bits(dataclasses.replace(loose, skinning=unhung))
    assert flat.skinning.parents is None
    assert (model.parents < 0).sum() == 1
    gaps = model.joint_gaps()
    assert gaps.max() > 0
    # no other parent that keeps the tree a tree has less translation
    squares = (gaps**2).sum(axis=0)
    m = model.transforms.astype(float)
    for child in np.flatnonzero(model.parents >= 0):
        below = {int(child)}
        for k in range(6):
            at = k
            while at >= 0:
                if at in below:
                    below.add(k)
                at = int(model.parents[at])
        for other in set(range(6)) - below:
            apart = m[:, child] - m[:, other]
            rows, right = apart[..., :3].reshape(-1, 3), -apart[..., 3].ravel()
            best = np.linalg.lstsq(rows, right)[0]
            assert ((rows @ best - right) ** 2).sum() >= 0.99 * squares[child] - 1e-9


def _ring() -> np.ndarray:
    """Two hands that hold each other: a tree cuts the circle somewhere and stays near."""
    rig = motions.chain(bones=6, frames=20)
    angle = 2 * np.pi * (rig.rest[:, 0] - rig.rest[:, 0].min()) / np.ptp(rig.rest[:, 0])
    ring = np.stack([np.cos(angle), np.sin(angle), 0.2 * rig.rest[:, 2]], axis=1)
    sway = 0.3 * np.sin(np.linspace(0, 6, 20))[:, None]
    frames = np.repeat(ring[None], 20, axis=0)
    frames[..., 2] += sway * np.cos(2 * angle) + 0.1 * sway * np.cos(3 * angle + 4 * sway)
    frames[..., 0] *= 1 + 0.5 * sway
    return frames


def _ball() -> np.ndarray:
    """It squashes."""
    points = np.random.default_rng(0).normal(size=(120, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    squash = 1 + 0.4 * np.sin(np.linspace(0, 6, 16))
    return np.stack([points * [1 / np.sqrt(s), s, 1 / np.sqrt(s)] for s in squash])


def _changed(change: Callable[[np.ndarray], object]) -> np.ndarray:
    frames = trees.six_bones().frames.copy()
    change(frames[20:])
    return frames


def _teleport(frames: np.ndarray) -> None:
    frames += 50.0


def _mirror(frames: np.ndarray) -> None:
    frames[..., 0] *= -1


def _tentacle() -> np.ndarray:
    return motions.chain(bones=12, frames=30, rows=60).frames


def _still() -> np.ndarray:
    return np.repeat(motions.chain(bones=1, frames=8).frames[:1], 6, axis=0)


# frames, bones, and the largest error as a part of the diagonal of the first frame
HARD: dict[str, tuple[Callable[[], np.ndarray], int, float]] = {
    "static": (_still, 1, 1e-6),
    "static, three bones": (_still, 3, 1e-6),
    "one rigid part": (lambda: motions.chain(bones=1, frames=8).frames, 1, 1e-6),
    "one rigid part, three bones": (lambda: motions.chain(bones=1, frames=8).frames, 3, 1e-6),
    "one bone for three": (lambda: motions.chain(bones=3, frames=8).frames, 1, np.inf),
    "parts that never touch": (lambda: motions.boxes(2, frames=12).frames, 2, 1e-3),
    "a closed chain": (_ring, 6, 0.03),
    "a tentacle": (_tentacle, 8, 0.02),
    "a ball that squashes": (_ball, 5, np.inf),
    "a frame that teleports": (lambda: _changed(_teleport), 6, 0.05),
    "mirrored frames": (lambda: _changed(_mirror), 4, np.inf),
    "as many as vertices": (lambda: np.random.default_rng(0).normal(size=(4, 5, 3)), 5, np.inf),
}


@pytest.mark.parametrize("name", HARD)
@pytest.mark.filterwarnings("ignore:.*could each go")
def test_where_methods_fail(name: str) -> None:
    make, bones, bound = HARD[name]
    frames = make()
    result = ssdr.decompose(frames, bones=bones, **_RIG)
    model = _check(result, frames, bones)
    assert result.rmse < bound * diagonal(frames[:1])
    assert ("three bones" not in name) or result.warnings
    if name == "a tentacle":
        assert np.bincount(model.parents[model.parents >= 0]).max() <= 2


def test_a_tolerance_finds_as_many_joints_as_there_are(tmp_path: Path) -> None:
    made, size = trees.six_bones(), diagonal(trees.six_bones().frames)
    result = ssdr.smallest(made.frames, influences=2, tolerance=2e-4 * size, **_RIG)
    model, report = result.skinning, result.parsimony
    assert report is not None
    assert report.held
    assert rmse_of(model, made.frames) <= 2e-4 * size
    assert 6 <= model.n_bones <= 8
    assert (model.parents < 0).sum() <= 2  # sticks that hardly touch may count as parts
    assert model.joint_gaps().max() < 1e-6 * size
    assert "keyframes" in {pruning.what for pruning in report.prunings}
    ssdr.save(model, tmp_path / "rig.glb")
    back = ssdr.load_skinning(tmp_path / "rig.glb")
    assert np.array_equal(back.parents, model.parents)
    assert rmse_of(back, made.frames) <= 2.1e-4 * size


def test_a_tolerance_beside_loose_joints_is_that_without_joints() -> None:
    frames = trees.six_bones().frames
    options = {"influences": 2, "tolerance": 0.01 * diagonal(frames), "effort": "fast"}
    loose, flat = (ssdr.smallest(frames, rig=rig, **options) for rig in ("loose", None))
    assert loose.parsimony.bones == flat.parsimony.bones
    assert loose.parsimony.held
    assert loose.skinning.parents is not None


def test_renumbered_vertices_give_the_same_tree() -> None:
    made = trees.six_bones()
    order = np.random.default_rng(1).permutation(len(made.rest))
    options = {"bones": 6, "influences": 2, "rig": "rigid"}
    other = ssdr.decompose(made.frames[:, order], **options).skinning
    back = dataclasses.replace(
        made, rest=made.rest[order], indices=made.indices[order], weights=made.weights[order]
    )
    here, there = trees.matched(_solved().skinning, made), trees.matched(other, back)

    def named(model, place):
        rank = np.argsort(place)
        return {frozenset(int(rank[k]) for k in edge) for edge in trees.edges(model.parents)}

    assert named(_solved().skinning, here) == named(other, there)
