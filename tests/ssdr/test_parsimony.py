"""The smallest model for a tolerance: what it promises, measured from outside."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import motions
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

import ssdr
from ssdr import cli, parsimony, streaming
from ssdr.fewest import Attempt, Search
from ssdr.given import Given
from ssdr.io.rig import build_rig
from ssdr.model import Fixed, Model
from ssdr.plan import Op
from ssdr.pruning import Tracks, nest
from ssdr.rank import rank_bound, reduced
from ssdr.reseeding import grow_bone
from ssdr.run import Run
from ssdr.tolerance import parse_tolerance
from ssdr.trajectories import Trajectories, gather


def errors_of(skinning: ssdr.Skinning, frames: np.ndarray) -> tuple[float, float]:
    """RMSE and largest distance, by code of the tests alone."""
    s = skinning
    squares = ((motions.blend(s.rest, s.joints, s.weights, s.transforms) - frames) ** 2).sum(-1)
    return float(np.sqrt(squares.mean())), float(np.sqrt(squares.max()))


def diagonal(frames: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(frames, axis=1), axis=1).max())


@functools.cache
def wavy() -> np.ndarray:
    """A chain of five with a motion on top that no rigid bones can follow."""
    out = motions.wobble(motions.chain(bones=5, rows=14, frames=15), 0.05)
    out.setflags(write=False)
    return out


@functools.cache
def small() -> ssdr.Decomposition:
    return ssdr.decompose(wavy(), tolerance="0.8%", effort="fast")


def solved(
    data: Trajectories, bones: int, influences: int = 4, plan: list[Op] | None = None
) -> Model:
    run = Run(
        data, plan or [Op("start", amount=1.0), Op("alternate", count=8)], bones=bones,
        influences=influences, rng=np.random.default_rng(0), fixed=Fixed(), given=Given(),
        smooth=None,
    )  # fmt: skip
    while not run.finished:
        run.advance()
    assert run.best is not None
    return run.best


# what a tolerance may be


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.5%", 0.02),
        (" 1 % ", 0.04),
        ("2e-1%", 0.008),
        (0.3, 0.3),
        (np.float32(0.25), 0.25),
        (2, 2),
    ],
)
def test_tolerances(text: Any, expected: float) -> None:
    assert parse_tolerance(text, 4.0) == pytest.approx(expected)


@pytest.mark.parametrize(
    "bad",
    [
        "half", "0.5", "%", "0%", "-1%", "1.2.3%", "nan%", "inf%", "", 0, -0.1, True, np.nan,
        np.inf, [1],
    ],
)  # fmt: skip
def test_bad_tolerances_are_refused(bad: Any) -> None:
    calls = []
    with pytest.raises(ssdr.InputError, match="a share of the diagonal such as") as caught:
        ssdr.decompose(wavy(), tolerance=bad, callback=lambda p: calls.append(p))
    assert caught.value.argument == "tolerance"
    assert not calls


@pytest.mark.parametrize(
    ("argument", "change"),
    [
        ("tolerance_of", {"tolerance_of": "mean"}),
        ("bones", {"bones": 0}),
        ("bones", {"bones": 85}),
        ("smoothness", {"smoothness": 0.1}),
        ("weights", {"joints": np.zeros((84, 1), int), "weights": np.ones((84, 1))}),
        ("transforms", {"transforms": np.tile(np.eye(4)[:3], (15, 2, 1, 1))}),
        ("vertex_importance", {"vertex_importance": np.arange(84) < 42}),
        ("vertex_importance", {"vertex_importance": np.where(np.arange(84) < 42, 5.0, 4e-6)}),
    ],
)
def test_refuses_beside_a_tolerance(argument: str, change: dict[str, Any]) -> None:
    rig = motions.chain(bones=5, rows=14, frames=15)
    with pytest.raises(ssdr.InputError, match="expected") as caught:
        ssdr.decompose(rig.frames, rig.faces, **({"tolerance": "1%"} | change))
    assert caught.value.argument == argument


def test_without_bones_and_without_tolerance() -> None:
    with pytest.raises(ssdr.InputError, match="or a tolerance") as caught:
        ssdr.decompose(wavy())
    assert caught.value.argument == "bones"


# as few as there are


def test_a_static_mesh_gets_one_bone_one_influence_one_key() -> None:
    pose = np.random.default_rng(0).standard_normal((40, 3))
    result = ssdr.decompose(np.repeat(pose[None], 9, axis=0), tolerance="0.5%")
    assert result.skinning.transforms.shape == (9, 1, 3, 4)
    assert result.skinning.weights.shape == (40, 1)
    assert result.skinning.keyframes is not None
    assert result.skinning.keyframes.sum() == 1
    assert result.rmse < 1e-13
    assert result.stop_reason == "tolerance held"
    assert result.converged


def test_points_that_coincide_get_one_bone() -> None:
    frames = np.repeat(np.random.default_rng(0).standard_normal((6, 1, 3)), 10, axis=1)
    result = ssdr.decompose(frames, tolerance="0.5%")  # of a diagonal of zero
    assert result.skinning.n_bones == 1
    assert result.parsimony is not None
    assert result.parsimony.held


@pytest.mark.parametrize("count", [2, 3])
def test_rigid_boxes_get_a_bone_each(count: int) -> None:
    rig = motions.boxes(count)
    result = ssdr.decompose(rig.frames, tolerance="0.01%")
    assert result.skinning.n_bones == count
    assert result.skinning.n_influences == 1
    bone = result.skinning.joints[:, 0].reshape(count, -1)
    assert (bone == bone[:, :1]).all()
    assert len(set(bone[:, 0])) == count


@pytest.mark.parametrize("tolerance", ["0.1%", "0.001%"])
def test_exact_skinning_gets_no_more_bones_than_it_was_made_with(tolerance: str) -> None:
    rig = motions.chain(bones=5, rows=14, frames=15)
    found = ssdr.decompose(rig.frames, tolerance=tolerance)
    assert found.skinning.n_bones <= 5
    assert found.parsimony is not None
    assert found.parsimony.held
    if tolerance == "0.001%":
        assert found.skinning.n_bones == 5
        assert found.skinning.n_influences == 2  # as it was made


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 1000), bones=st.integers(1, 4))
def test_random_exact_skinning(seed: int, bones: int) -> None:
    rng = np.random.default_rng(seed)
    rest = rng.uniform(-1, 1, (60, 3))
    joints, weights = motions.weights_of(rng, 60, bones, 2)
    frames = motions.blend(rest, joints, weights, motions.motions(rng, 10, bones))
    result = ssdr.decompose(frames, tolerance="0.05%")
    assert result.skinning.n_bones <= bones
    assert errors_of(result.skinning, frames)[0] <= 5e-4 * diagonal(frames) * (1 + 1e-9)


# the tolerance is held


@pytest.mark.parametrize("tolerance_of", ["rmse", "max"])
def test_the_tolerance_is_held_and_said(tolerance_of: Any) -> None:
    frames = wavy()
    result = ssdr.decompose(frames, tolerance="1.5%", tolerance_of=tolerance_of, effort="fast")
    found = result.parsimony
    assert found is not None
    rmse, largest = errors_of(result.skinning, frames)
    reached = rmse if tolerance_of == "rmse" else largest
    assert found.tolerance == pytest.approx(0.015 * diagonal(frames))
    assert reached <= found.tolerance
    assert found.held
    assert found.error == pytest.approx(reached, rel=1e-9)
    assert result.rmse == pytest.approx(rmse, rel=1e-9)
    assert result.history[-1].rmse == result.rmse
    assert found.tolerance_of == tolerance_of
    assert (found.bones, found.influences) == (
        result.skinning.n_bones, result.skinning.n_influences,
    )  # fmt: skip
    assert found.least_bones <= found.bones
    assert not result.warnings


def test_a_stricter_measure_never_gets_fewer_bones() -> None:
    loose = small().parsimony
    strict = ssdr.decompose(wavy(), tolerance="0.8%", tolerance_of="max", effort="fast").parsimony
    assert loose is not None
    assert strict is not None
    assert strict.bones > loose.bones


def test_bounds_on_bones_and_influences_are_kept() -> None:
    with pytest.warns(ssdr.SsdrWarning, match="out of reach"):
        few = ssdr.decompose(wavy(), tolerance="0.3%", bones=2, effort="fast")
    assert few.skinning.n_bones == 2
    one = ssdr.decompose(wavy(), tolerance="3%", influences=1, effort="fast")
    assert one.skinning.n_influences == 1
    assert one.parsimony is not None
    assert one.parsimony.held
    exact = ssdr.decompose(wavy(), tolerance="0.8%", bones=small().skinning.n_bones, effort="fast")
    assert exact.skinning.n_bones == small().skinning.n_bones


def test_an_unreachable_tolerance_says_what_was_reached() -> None:
    with pytest.warns(ssdr.SsdrWarning) as caught:
        result = ssdr.decompose(wavy(), tolerance="0.001%", bones=2, effort="fast")
    (text,) = result.warnings
    assert str(caught[0].message) == text
    rmse = errors_of(result.skinning, wavy())[0]
    assert "tolerance 5.15e-05" in text or "out of reach" in text
    assert f"2 bones of at most 4 influences reach a RMSE of {rmse:.4g}" in text
    assert "rank asks for at least" in text
    assert result.stop_reason == "tolerance out of reach"
    assert not result.converged
    assert result.parsimony is not None
    assert not result.parsimony.held
    assert result.parsimony.prunings == ()


def test_the_same_bits_again_and_with_two_threads() -> None:
    first = small().skinning
    try:
        ssdr.set_threads(2)
        again = ssdr.decompose(wavy(), tolerance="0.8%", effort="fast").skinning
    finally:
        ssdr.set_threads(None)
    for name in ("rest", "joints", "weights", "transforms", "keyframes"):
        assert (getattr(first, name) == getattr(again, name)).all(), name


def test_size_and_place_of_the_mesh_do_not_matter() -> None:
    base = small().skinning
    moved = ssdr.decompose(1e3 * wavy() + 1e4, tolerance="0.8%", effort="fast").skinning
    assert moved.n_bones == base.n_bones


def test_several_shots_and_plain_arrays() -> None:
    shots = [ssdr.MeshSequence(wavy()[:6]), ssdr.MeshSequence(wavy()[6:])]
    result = ssdr.decompose(shots, tolerance="0.8%", effort="fast")
    assert result.offsets.tolist() == [0, 6, 15]
    assert errors_of(result.skinning, wavy())[0] <= 0.008 * diagonal(wavy())
    keys = result.skinning.keyframes
    assert keys is not None
    moving = keys.sum(axis=0) > 1
    # a shot is played by itself: its ends are keys
    assert keys[[0, 5, 6, 14]][:, moving].all()


@pytest.mark.parametrize("bone_model", ["similarity", "affine"])
def test_other_bone_models(bone_model: Any) -> None:
    frames = wavy()
    result = ssdr.decompose(frames, tolerance="0.8%", bone_model=bone_model, effort="fast")
    assert result.skinning.bone_model == bone_model
    assert errors_of(result.skinning, frames)[0] <= 0.008 * diagonal(frames)


def test_frames_that_are_streamed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streaming, "_IN_MEMORY", 1 << 10)
    monkeypatch.setattr(streaming, "_FEWEST", 8)
    monkeypatch.setattr(streaming, "_MOST", 9)
    assert streaming.needs_streaming([ssdr.MeshSequence(wavy())])
    result = ssdr.decompose(wavy(), tolerance="0.8%", effort="fast")
    assert result.skinning.n_frames == 15
    assert errors_of(result.skinning, wavy())[0] <= 0.008 * diagonal(wavy())
    assert result.skinning.n_bones <= small().skinning.n_bones + 1


# what pruning costs


def test_every_pruning_says_what_it_cost() -> None:
    found = small().parsimony
    assert found is not None
    assert [p.what for p in found.prunings] == ["bones", "influences", "keyframes"]
    bones, influences, keyframes = found.prunings
    assert bones.before >= bones.after == found.bones
    assert influences.after < influences.before
    assert influences.bytes_after < influences.bytes_before
    assert keyframes.bytes_after <= keyframes.bytes_before
    assert influences.error_after == keyframes.error_before
    assert keyframes.error_after == found.error
    assert keyframes.bytes_after == found.size.total == parsimony.size(small().skinning).total
    assert influences.after == (small().skinning.weights > 0).sum()
    assert small().skinning.keyframes is not None
    assert keyframes.after == small().skinning.keyframes.sum()
    for p in found.prunings:
        assert p.cost == p.error_after - p.error_before
    tried = {a.bones for a in found.attempts}
    assert found.bones in tried
    assert found.bones == found.least_bones or found.bones - 1 in tried


def test_size_by_hand() -> None:
    joints = np.array([[0, 1], [1, 0], [2, 0]])
    weights = np.array([[0.5, 0.5], [1.0, 0.0], [1.0, 0.0]])
    keys = np.zeros((5, 3), dtype=bool)
    keys[:, 0] = True  # every frame: no times
    keys[[0, 4], 1] = True
    keys[0, 2] = True
    model = ssdr.Skinning(
        np.zeros((3, 3)), joints, weights, np.tile(np.eye(4)[:3], (5, 3, 1, 1)), keyframes=keys
    )
    size = parsimony.size(model)
    assert size == parsimony.Size(
        rest=3 * 12, weights=3 * 1 + 4 * 3, joints=3 * 12, keys=5 * 28 + 2 * 30 + 30
    )
    assert size.total == 36 + 15 + 36 + 230
    whole = ssdr.Skinning(
        np.zeros((1, 3)), [[0]], [[1.0]], np.tile(np.eye(4)[:3], (2, 300, 1, 1)),
        bone_model="affine",
    )  # fmt: skip
    assert parsimony.size(whole).total == 12 + (1 + 4) + 300 * 12 + 2 * 300 * 48


def test_dropped_influences_cost_what_is_said() -> None:
    data = gather([ssdr.MeshSequence(wavy())], bones=5)
    nested = nest(data, solved(data, 5), fixed=Fixed())
    assert (np.diff(nested.counts, axis=0) <= 0).all()
    assert (nested.counts[-1] == 1).all()
    assert (np.diff(nested.errors.sum(axis=1)) > 0).all()
    cheap, none = nested.choose(data.importance, 0.0)
    assert none == pytest.approx(nested.errors.min(axis=0).sum())
    level, error = nested.choose(data.importance, 1e-4)
    assert (level >= cheap).all()
    model = nested.build(level)
    rest, transforms = data.to_world(model.rest, model.transforms)
    built = ssdr.Skinning(rest, model.joints, model.weights, transforms)
    count = 15 * 84
    assert errors_of(built, wavy())[0] == pytest.approx(
        data.scale * np.sqrt(error / count), rel=1e-6
    )
    assert (model.weights > 0).sum() == np.take_along_axis(nested.counts, level[None], 0).sum()


@pytest.mark.parametrize("price", [1e-6, 1e-4, 1e-2])
def test_keys_are_the_best_of_all_subsets(price: float) -> None:
    rig = motions.boxes(1, frames=7, seed=3)
    rng = np.random.default_rng(0)
    transforms = motions.motions(rng, 7, 1, turn=0.05, shift=0.05)
    model = ssdr.Skinning(rig.rest, rig.joints, rig.weights, transforms)
    tracks = Tracks(model, np.array([0, 7]))
    keys, said = tracks.choose(price)
    best = np.inf
    full = model.skin()
    for inner in itertools.product([False, True], repeat=5):
        mask = np.array([True, *inner, True])[:, None]
        error = float(((tracks.play(mask).skin() - full) ** 2).sum())
        bytes_ = 7 * 28 if mask.all() else 30 * int(mask.sum())
        best = min(best, error + price * bytes_)
    for t in range(7):
        mask = np.arange(7)[:, None] == t
        error = float(((tracks.play(mask).skin() - full) ** 2).sum())
        best = min(best, error + price * 30)
    bytes_ = 7 * 28 if keys.all() else 30 * int(keys.sum())
    assert said + price * bytes_ == pytest.approx(best, rel=1e-9)
    # one influence a vertex: what is said is what is added
    added = float(((tracks.play(keys).skin() - full) ** 2).sum())
    assert said == pytest.approx(added, rel=1e-9, abs=1e-15)


def test_keys_of_shared_vertices_cost_at_most_what_is_said() -> None:
    skinning = ssdr.decompose(wavy(), bones=5, effort="fast").skinning
    tracks = Tracks(skinning, np.array([0, 15]))
    for price in (1e-5, 1e-3, 1e-1):
        keys, said = tracks.choose(price)
        played = tracks.play(keys)
        added = float(((played.skin() - skinning.skin()) ** 2).sum())
        assert added <= said * (1 + 1e-9)
        assert (played.transforms[keys] == skinning.transforms[keys]).all()


def test_between_keys_bones_move_as_engines_move_them() -> None:
    skinning = ssdr.decompose(wavy(), bones=4, effort="fast").skinning
    tracks = Tracks(skinning, np.array([0, 15]))
    keys = np.zeros((15, 4), dtype=bool)
    keys[[0, 3, 8, 14]] = True
    played = tracks.play(keys)
    at = np.flatnonzero(keys[:, 0])
    centre = skinning.centroids()
    for b in range(4):
        m = skinning.transforms[at, b]
        turn = Slerp(at, Rotation.from_matrix(m[..., :3]))(np.arange(15)).as_matrix()
        place = m[..., :3] @ centre[b] + m[..., 3]
        path = np.stack([np.interp(np.arange(15), at, place[:, c]) for c in range(3)], axis=1)
        assert np.abs(played.transforms[:, b, :, :3] - turn).max() < 1e-9
        moved = played.transforms[:, b, :, :3] @ centre[b] + played.transforms[:, b, :, 3]
        assert np.abs(moved - path).max() < 1e-9
    # and so does what is exported
    rig = build_rig(played)
    assert (rig.keys == keys).all()
    assert np.abs(rig.matrices(np.arange(15.0)) - played.transforms).max() < 1e-5


def test_a_steady_turn_needs_two_keys() -> None:
    axis = np.array([0.1, 0.2, -0.15])
    rest = np.random.default_rng(0).standard_normal((30, 3))
    rest -= rest.mean(axis=0)
    frames = np.stack([rest @ motions.rotation(*(0.3 * t * axis)).T for t in range(20)])
    result = ssdr.decompose(frames + np.array([1.0, 2.0, 3.0]), tolerance="0.001%")
    assert result.skinning.keyframes is not None
    assert np.flatnonzero(result.skinning.keyframes[:, 0]).tolist() == [0, 19]


def test_the_result_goes_through_a_file(tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    ssdr.save(small(), path)
    back = ssdr.load_skinning(path)
    assert (back.keyframes == small().skinning.keyframes).all()
    assert parsimony.size(back) == small().parsimony.size  # type: ignore[union-attr]


# the search


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1000), bones=st.integers(1, 4))
def test_no_model_is_below_the_rank_bound(seed: int, bones: int) -> None:
    rng = np.random.default_rng(seed)
    rest = rng.uniform(-1, 1, (40, 3))
    joints, weights = motions.weights_of(rng, 40, bones, 3)
    frames = motions.blend(rest, joints, weights, motions.motions(rng, 9, bones))
    frames += 1e-3 * rng.standard_normal(frames.shape)
    data = gather([ssdr.MeshSequence(frames)], bones=40)
    model = solved(data, bones)
    error = model.objective(data)
    assert rank_bound(data, error) <= bones
    # the bound itself, from the frames by a plain SVD of what is left without the centroids
    centred = (frames - frames.mean(axis=1, keepdims=True)).transpose(1, 0, 2).reshape(40, -1)
    values = np.linalg.svd(centred / data.scale, compute_uv=False) ** 2
    left = values.sum() - np.concatenate([[0], np.cumsum(values)])
    rank = int(np.argmax(left <= error))
    assert rank_bound(data, error) == max(1, -(-(rank + 1) // 4))


@pytest.mark.parametrize("shape", [(30, 40), (6, 90)])
def test_reduction_keeps_what_the_tolerance_sees(shape: tuple[int, int]) -> None:
    n_frames, n = shape
    rng = np.random.default_rng(0)
    low = rng.standard_normal((n, 4)) @ rng.standard_normal((4, 3 * n_frames))
    frames = low.reshape(n, n_frames, 3).transpose(1, 0, 2)
    frames = frames + 1e-4 * rng.standard_normal(frames.shape)
    data = gather([ssdr.MeshSequence(frames)], bones=n)
    less = reduced(data, 1e-2 * float(data.x2.sum()))
    assert less.z.shape[1] < data.z.shape[1]
    assert less.q is not None
    assert np.abs(less.q.T @ less.q - np.eye(less.q.shape[1])).max() < 1e-10
    whole = data.z if data.q is None else data.z @ data.q.T
    lost = float(((whole - less.z @ less.q.T) ** 2).sum())
    assert lost == pytest.approx(less.lost, rel=1e-6, abs=1e-12)
    assert lost <= 1e-6 * float(data.x2.sum())


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1000), bones=st.integers(1, 5), influences=st.integers(1, 4))
def test_one_bone_more_never_fits_worse(seed: int, bones: int, influences: int) -> None:
    rng = np.random.default_rng(seed)
    frames = rng.standard_normal((5, 30, 3)) + 2 * rng.standard_normal((1, 30, 3))
    data = gather([ssdr.MeshSequence(frames)], bones=8)
    model = solved(data, bones, influences)
    grown = grow_bone(data, model, alternations=2, fixed=Fixed())
    assert grown.n_bones == bones + 1
    assert grown.n_influences == model.n_influences
    assert grown.objective(data) <= model.objective(data)
    rest, transforms = data.to_world(grown.rest, grown.transforms)
    built = ssdr.Skinning(rest, grown.joints, grown.weights, transforms)
    measured = errors_of(built, frames)[0]
    said = data.scale * np.sqrt(max(grown.objective(data), 0.0) / (5 * 30))
    assert measured == pytest.approx(said, rel=1e-6, abs=1e-9)


def test_progress_and_cancel() -> None:
    told: list[Any] = []
    ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", callback=told.append)
    shares = [p.fraction for p in told]
    assert shares == sorted(shares)
    assert shares[0] >= 0
    assert shares[-1] <= 1
    assert [p.iteration for p in told] == sorted(p.iteration for p in told)
    assert any(np.isfinite(p.rmse) for p in told)
    with pytest.raises(ssdr.Cancelled):
        ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", callback=lambda p: True)


def test_cancelled_and_resumed(tmp_path: Path) -> None:
    def holds(progress: Any) -> bool:
        return bool(np.isfinite(progress.rmse))

    first = ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", callback=holds)
    assert first.stop_reason == "cancelled"
    assert first.parsimony is not None
    assert first.parsimony.held  # the smallest so far that holds is handed out
    path = first.state.save(tmp_path / "state.npz")
    done = ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", resume=path)
    assert done.stop_reason == "tolerance held"
    assert done.skinning.n_bones <= first.skinning.n_bones
    assert done.parsimony is not None
    assert done.parsimony.attempts[0].start == "resumed"
    assert done.history[-1].elapsed > first.history[-1].elapsed
    for change in (
        {"tolerance": "0.7%"},
        {"influences": 3},
        {"sequence": 2 * wavy()},
        {"rest_frame": 1},
    ):
        arguments = {"sequence": wavy(), "tolerance": "0.8%", "effort": "fast"} | change
        with pytest.raises(ssdr.InputError) as caught:
            ssdr.decompose(**arguments, resume=path)
        assert caught.value.argument == "resume"
    with pytest.raises(ssdr.InputError):
        ssdr.decompose(wavy(), bones=4, effort="fast", resume=path)
    best = first.state.best
    assert best is not None
    cut = dataclasses.replace(best, transforms=best.transforms[1:])
    for change, message in (
        ({"progress": {}}, "damaged"),
        ({"progress": first.state.progress | {"rng": {"state": 1}}}, "damaged"),
        ({"progress": first.state.progress | {"iteration": []}}, "damaged"),
        ({"best": cut}, "other sizes"),
    ):
        other = dataclasses.replace(first.state, **change)
        with pytest.raises(ssdr.InputError, match=message) as caught:
            ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", resume=other)
        assert caught.value.argument == "resume"


@pytest.mark.parametrize(
    ("limit", "reason"),
    [({"max_iterations": 1}, "iterations"), ({"time_limit": 1e-6}, "time limit")],
)  # fmt: skip
def test_limits_hand_out_a_model(limit: dict[str, Any], reason: str) -> None:
    with pytest.warns(ssdr.SsdrWarning, match=rf"stopped \({reason}\) before tolerance"):
        result = ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", **limit)
    assert result.stop_reason == reason
    assert np.isfinite(result.rmse)


# the curve


def test_curve_of_exact_skinning_has_its_knee_there() -> None:
    rig = motions.chain(bones=5, rows=14, frames=15)
    curve = parsimony.curve(rig.frames, bones=10)
    assert curve.bones.tolist() == [1, 2, 3, 4, 5, 6, 7, 8, 10]
    assert (np.diff(curve.rmse) <= 0).all()
    assert curve.bones[curve.knee] == 5
    assert curve.diagonal == pytest.approx(diagonal(rig.frames))
    assert curve.percent == pytest.approx(100 * curve.rmse / curve.diagonal)
    assert (curve.bytes >= curve.bones * (12 + 15 * 28) + 84 * (12 + 1 + 3)).all()
    assert (curve.bytes <= curve.bones * (12 + 15 * 28) + 84 * (12 + 1 + 4 * 3)).all()


def test_curve_of_streamed_frames_has_the_bytes_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = wavy().copy()
    frames[8, 40:42] += [[0, 0, -4], [0, 0, 4]]  # vertices by which frames are not compared
    monkeypatch.setattr(streaming, "_IN_MEMORY", 1 << 10)
    monkeypatch.setattr(streaming, "_FEWEST", 6)
    monkeypatch.setattr(streaming, "_MOST", 6)
    monkeypatch.setattr(streaming, "_PROBES", 8)
    sequence = ssdr.MeshSequence(frames)
    assert 8 not in streaming.scan([sequence], None).chosen
    curve = parsimony.curve(frames, bones=2)
    weights = 84 * np.array([[1 + 3, 1 + 3], [1 + 3, 1 + 2 * 3]])
    for bones, stored, least, most in zip(curve.bones, curve.bytes, *weights, strict=True):
        known = 84 * 12 + bones * (12 + 15 * 28)
        assert known + least <= stored <= known + most
    assert curve.diagonal == pytest.approx(diagonal(frames))


def test_knee() -> None:
    sizes = np.array([10, 20, 40, 80, 160])
    assert parsimony.knee(sizes, np.array([1.0, 0.5, 0.01, 0.008, 0.007]), 0.0) == 2
    assert parsimony.knee(sizes, np.array([1.0, 0.5, 0.0, 0.0, 0.0]), 1e-5) == 2
    assert parsimony.knee(sizes, np.zeros(5), 1e-5) == 0
    assert parsimony.knee(sizes[:1], np.ones(1), 0.0) == 0


def test_curve_refuses_and_cancels() -> None:
    with pytest.raises(ssdr.InputError):
        parsimony.curve(wavy(), effort="heroic")  # type: ignore[arg-type]
    with pytest.raises(ssdr.InputError):
        parsimony.curve(wavy(), bones=0)
    with pytest.raises(ssdr.Cancelled):
        parsimony.curve(wavy(), bones=4, callback=lambda p: True)


# the command


def run(capsys: pytest.CaptureFixture[str], *arguments: Any) -> tuple[int, str, str]:
    code = cli.main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return code, out, err


@pytest.mark.filterwarnings("default")
def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, target = tmp_path / "in.npz", tmp_path / "out.npz"
    ssdr.save(ssdr.MeshSequence(wavy()), source)
    flags = ("--tolerance", "0.8%", "--effort", "fast")
    code, out, err = run(capsys, "decompose", source, "-o", target, *flags, "--json")
    assert (code, err) == (0, "")
    document = json.loads(out)
    assert document["held"] is True
    assert document["bones"] == small().skinning.n_bones
    assert document["rmse"] <= document["tolerance"]
    assert document["bytes"] == parsimony.size(ssdr.load_skinning(target)).total
    assert [p["what"] for p in document["prunings"]] == ["bones", "influences", "keyframes"]
    code, out, _ = run(capsys, "decompose", source, "-o", target, *flags, "-q", "--force")
    assert code == 0
    code, out, err = run(
        capsys, "decompose", source, "-o", target, "--tolerance", "0.01", "--bones", 2, "--force",
        "--effort", "fast",
    )  # fmt: skip
    assert code == 0
    assert "2 bones of at most 4 influences reach a RMSE of" in err
    assert "not held" in out


@pytest.mark.parametrize(
    ("flags", "text"),
    [((), "--bones"), (("--tolerance", "half"), "such as"), (("--tolerance", "-1"), "such as")],
)
def test_command_refuses(
    flags: tuple[str, ...], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "in.npz"
    ssdr.save(ssdr.MeshSequence(wavy()), source)
    code, _, err = run(capsys, "decompose", source, "-o", tmp_path / "out.npz", *flags)
    assert code == 2
    assert text in err
    assert not (tmp_path / "out.npz").exists()


def test_no_warning_where_the_tolerance_is_held() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ssdr.decompose(wavy(), tolerance="5%", effort="fast")


class _Oracle(Search):
    """The search over numbers of bones alone: tries hold or fail as they are told."""

    def __init__(self, least: int, held: int, failed: set[int], luck: Any) -> None:
        self.least, self.luck, self.tries = least, luck, 0
        self.held: Any = SimpleNamespace(n_bones=held, widened=SimpleNamespace)
        self.attempts = [Attempt(b, 2.0, 0, "start") for b in failed]
        self.given_up: list[int] = []

    def _guess(self, model: Any) -> int:
        return int(self.luck(1, 4))

    def _outcome(self, bones: int, holds: bool) -> None:
        self.tries += 1
        assert self.tries < 500
        assert self.least <= bones < self.held.n_bones
        if holds:
            self.held = SimpleNamespace(n_bones=bones, widened=SimpleNamespace)

    def _try(self, bones: int, *_: Any) -> Any:
        self._outcome(bones, self.luck(0, 1) == 1)
        return None, 2.0

    def _insist(self, bones: int, *_: Any) -> None:
        self._outcome(bones, self.luck(0, 2) == 2)
        if self.held.n_bones > bones:
            self.given_up.append(bones)

    zeal = SimpleNamespace(polish=1)  # type: ignore[assignment]


@settings(max_examples=200, deadline=None)
@given(data=st.data(), least=st.integers(1, 4), held=st.integers(5, 30))
def test_merging_down_ends_one_above_what_was_given_up(data: Any, least: int, held: int) -> None:
    """Whatever fails or holds, also where what failed once holds later."""
    failed = data.draw(st.sets(st.integers(least, held - 1)))
    search = _Oracle(least, held, failed, lambda a, b: data.draw(st.integers(a, b)))
    search._shrink()
    end = search.held.n_bones
    assert end == least or search.given_up == [end - 1]
