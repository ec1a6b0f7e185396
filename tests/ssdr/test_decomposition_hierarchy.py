"""``decompose(..., hierarchy=...)``: what it promises, what it refuses, where trees fail."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers import motions, promises, trees
from helpers.measures import bits, diagonal, rmse_of
from ssdr.errors import InputError


@functools.cache
def _made() -> trees.Skeleton:
    return trees.skeleton(6, 40, seed=3)


@functools.cache
def _solved() -> ssdr.Decomposition:
    return ssdr.decompose(_made().frames, bones=6, influences=2, hierarchy="rigid")


def _check(result: ssdr.Decomposition, frames: np.ndarray, bones: int, influences: int = 4):
    """What holds for every rigid hierarchy."""
    promises.check(result, frames, bones, influences)
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
    made, result = _made(), _solved()
    model = _check(result, made.frames, 6, 2)
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


def test_joints_are_named() -> None:
    assert _solved().skinning.joint_names == tuple(f"joint_{k}" for k in range(6))


def test_same_seed_same_bits_whatever_the_threads() -> None:
    before = ssdr.get_threads()
    try:
        ssdr.set_threads(1)
        again = ssdr.decompose(_made().frames, bones=6, influences=2, hierarchy="rigid")
    finally:
        ssdr.set_threads(before)
    assert bits(again) == bits(_solved())
    assert np.array_equal(again.skinning.parents, _solved().skinning.parents)
    assert np.array_equal(again.skinning.joint_positions, _solved().skinning.joint_positions)


@pytest.mark.parametrize("stop", [1, 25, 60])
def test_resumed_run_ends_on_the_same_bits(tmp_path: Path, stop: int) -> None:
    options = {"bones": 6, "influences": 2, "hierarchy": "rigid", "effort": "fast"}
    whole = ssdr.decompose(_made().frames, **options)
    part = ssdr.decompose(_made().frames, **options, max_iterations=stop)
    path = part.state.save(tmp_path / "state.npz")
    again = ssdr.decompose(_made().frames, **options, resume=path)
    assert bits(again) == bits(whole)
    assert np.array_equal(again.skinning.joint_positions, whole.skinning.joint_positions)


def test_a_start_that_is_set_aside_outlives_a_stop(tmp_path: Path) -> None:
    options = {"bones": 6, "influences": 2, "hierarchy": "rigid", "effort": "fast"}
    whole = ssdr.decompose(_made().frames, **options)
    for stop in range(30, 120, 10):
        part = ssdr.decompose(_made().frames, **options, max_iterations=stop)
        if part.state.aside is not None:
            break
    assert part.state.aside is not None
    state = ssdr.SolverState.load(part.state.save(tmp_path / "state.npz"))
    assert np.array_equal(state.aside.rest, part.state.aside.rest)
    assert bits(ssdr.decompose(_made().frames, **options, resume=state)) == bits(whole)
    short = dataclasses.replace(state, aside=state.aside.select_vertices(np.arange(5)))
    with pytest.raises(InputError, match="resume"):
        ssdr.decompose(_made().frames, **options, resume=short)


def test_a_state_with_a_damaged_tree_is_refused(tmp_path: Path) -> None:
    options = {"bones": 6, "influences": 2, "hierarchy": "rigid", "effort": "fast"}
    part = ssdr.decompose(_made().frames, **options, max_iterations=40)
    path = part.state.save(tmp_path / "state.npz")
    arrays = dict(np.load(path))
    for name, value in (
        ("best_parents", np.array([1, 0, 0, 0, 0, 0])),
        ("best_points", np.full((6, 3), np.nan)),
        ("best_rigid", np.array([1.0])),
    ):
        np.savez(tmp_path / "damaged.npz", **(arrays | {name: value}))
        with pytest.raises(ssdr.FormatError, match="not a saved state"):
            ssdr.SolverState.load(tmp_path / "damaged.npz")


def test_another_hierarchy_does_not_go_on_from_a_state() -> None:
    options = {"bones": 6, "influences": 2, "effort": "fast", "max_iterations": 2}
    flat = ssdr.decompose(_made().frames, **options)
    hung = ssdr.decompose(_made().frames, **options, hierarchy="rigid")
    for state, hierarchy in ((flat.state, "rigid"), (hung.state, "none"), (flat.state, "loose")):
        with pytest.raises(InputError, match="resume"):
            ssdr.decompose(_made().frames, **options, hierarchy=hierarchy, resume=state)


def test_a_loose_tree_leaves_the_flat_result_as_it_is() -> None:
    options = {"bones": 6, "influences": 2}
    flat = ssdr.decompose(_made().frames, **options)
    loose = ssdr.decompose(_made().frames, **options, hierarchy="loose")
    assert bits(flat) == bits(loose)
    model = loose.skinning
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


@pytest.mark.parametrize(
    ("options", "argument"),
    [
        ({"hierarchy": "tree"}, "hierarchy"),
        ({"hierarchy": True}, "hierarchy"),
        ({"hierarchy": "rigid", "bone_model": "affine"}, "bone_model"),
        ({"hierarchy": "loose", "bone_model": "similarity"}, "bone_model"),
        ({"hierarchy": "rigid", "smoothness": 0.1}, "smoothness"),
        ({"hierarchy": "rigid", "transforms": _made().transforms}, "transforms"),
        (
            {"hierarchy": "rigid", "indices": _made().indices, "weights": _made().weights},
            "weights",
        ),
    ],
)
def test_what_does_not_go_with_a_hierarchy_is_refused(options, argument) -> None:
    arguments = {"bones": 6} | options
    sequence = ssdr.MeshSequence(_made().frames, motions.grid(2, 72)[:1] * 0 + [[0, 1, 2]])
    with pytest.raises(InputError, match=f"^{argument}"):
        ssdr.decompose(sequence, **arguments)


# --- where methods fail --------------------------------------------------------------------------

_OPTIONS = {"hierarchy": "rigid", "effort": "fast"}


def test_a_static_mesh() -> None:
    frames = np.broadcast_to(np.random.default_rng(0).normal(size=(40, 3)), (6, 40, 3)).copy()
    with pytest.warns(ssdr.SsdrWarning):
        result = ssdr.decompose(frames, bones=4, **_OPTIONS)
    _check(result, frames, 4)
    assert result.rmse < 1e-9


def test_one_rigid_part() -> None:
    rig = motions.chain(bones=1, frames=8)
    with pytest.warns(ssdr.SsdrWarning, match="could each go"):
        result = ssdr.decompose(rig.frames, bones=3, **_OPTIONS)
    _check(result, rig.frames, 3)
    assert result.rmse < 1e-6 * diagonal(rig.frames)


def test_one_bone() -> None:
    rig = motions.chain(bones=3, frames=8)
    result = ssdr.decompose(rig.frames, bones=1, **_OPTIONS)
    assert _check(result, rig.frames, 1).parents.tolist() == [-1]


def test_parts_that_never_touch_move_apart() -> None:
    boxes = motions.boxes(2, frames=12)
    result = ssdr.decompose(boxes.frames, bones=2, **_OPTIONS)
    _check(result, boxes.frames, 2)
    assert result.rmse < 1e-3 * diagonal(boxes.frames)


@pytest.mark.filterwarnings("ignore:.*could each go")  # five bones do, but for rounding
def test_a_closed_chain() -> None:
    """Two hands that hold each other: a tree cuts the circle somewhere and stays near."""
    rig = motions.chain(bones=6, frames=20)
    angle = 2 * np.pi * (rig.rest[:, 0] - rig.rest[:, 0].min()) / np.ptp(rig.rest[:, 0])
    ring = np.stack([np.cos(angle), np.sin(angle), 0.2 * rig.rest[:, 2]], axis=1)
    sway = 0.3 * np.sin(np.linspace(0, 6, 20))[:, None]
    frames = np.repeat(ring[None], 20, axis=0)
    frames[..., 2] += sway * np.cos(2 * angle) + 0.1 * sway * np.cos(3 * angle + 4 * sway)
    frames[..., 0] *= 1 + 0.5 * sway
    result = ssdr.decompose(frames, bones=6, **_OPTIONS)
    _check(result, frames, 6)
    assert result.rmse < 0.03 * diagonal(frames)


def test_a_tentacle() -> None:
    rig = motions.chain(bones=12, frames=30, rows=60)
    result = ssdr.decompose(rig.frames, bones=8, **_OPTIONS)
    model = _check(result, rig.frames, 8)
    children = np.bincount(model.parents[model.parents >= 0], minlength=8)
    assert children.max() <= 2
    assert result.rmse < 0.02 * diagonal(rig.frames)


def test_a_ball_that_squashes() -> None:
    points = np.random.default_rng(0).normal(size=(120, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    squash = 1 + 0.4 * np.sin(np.linspace(0, 6, 16))
    frames = np.stack([points * [1 / np.sqrt(s), s, 1 / np.sqrt(s)] for s in squash])
    result = ssdr.decompose(frames, bones=5, **_OPTIONS)
    _check(result, frames, 5)


def test_a_frame_that_teleports() -> None:
    frames = _made().frames.copy()
    frames[20:] += 50.0
    result = ssdr.decompose(frames, bones=6, influences=2, **_OPTIONS)
    _check(result, frames, 6, 2)
    assert result.rmse < 0.05 * diagonal(_made().frames)


def test_mirrored_frames_keep_proper_rotations() -> None:
    frames = _made().frames.copy()
    frames[20:, :, 0] *= -1
    _check(ssdr.decompose(frames, bones=4, influences=2, **_OPTIONS), frames, 4, 2)


def test_more_joints_than_vertices_is_refused() -> None:
    with pytest.raises(InputError, match="bones"):
        ssdr.decompose(np.random.default_rng(0).normal(size=(4, 5, 3)), bones=6, **_OPTIONS)


def test_as_many_joints_as_vertices() -> None:
    frames = np.random.default_rng(0).normal(size=(4, 5, 3))
    _check(ssdr.decompose(frames, bones=5, **_OPTIONS), frames, 5, 4)


def test_a_tolerance_finds_as_many_joints_as_there_are(tmp_path: Path) -> None:
    made, size = _made(), diagonal(_made().frames)
    result = ssdr.decompose(
        made.frames, hierarchy="rigid", influences=2, tolerance=2e-4 * size, effort="fast"
    )
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


def test_a_tolerance_of_the_largest_error() -> None:
    made, size = _made(), diagonal(_made().frames)
    result = ssdr.decompose(
        made.frames,
        hierarchy="rigid",
        influences=2,
        tolerance=0.02 * size,
        tolerance_of="max",
        effort="fast",
    )
    assert result.parsimony is not None
    assert result.parsimony.held
    assert result.skinning.joint_gaps().max() < 1e-6 * size


def test_a_tolerance_beside_loose_joints_is_that_without_joints() -> None:
    frames = _made().frames
    options = {"influences": 2, "tolerance": 0.01 * diagonal(frames), "effort": "fast"}
    loose = ssdr.decompose(frames, hierarchy="loose", **options)
    flat = ssdr.decompose(frames, **options)
    assert loose.parsimony is not None
    assert flat.parsimony is not None
    assert loose.parsimony.bones == flat.parsimony.bones
    assert loose.parsimony.held
    assert loose.skinning.parents is not None


def test_renumbered_vertices_give_the_same_tree() -> None:
    made = _made()
    order = np.random.default_rng(1).permutation(len(made.rest))
    options = {"bones": 6, "influences": 2, "hierarchy": "rigid"}
    other = ssdr.decompose(made.frames[:, order], **options).skinning
    back = dataclasses.replace(
        made, rest=made.rest[order], indices=made.indices[order], weights=made.weights[order]
    )
    here, there = trees.matched(_solved().skinning, made), trees.matched(other, back)

    def named(model, place):
        rank = np.argsort(place)
        return {frozenset(int(rank[k]) for k in edge) for edge in trees.edges(model.parents)}

    assert named(_solved().skinning, here) == named(other, there)
