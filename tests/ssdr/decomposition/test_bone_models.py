"""Bones that grow (similarity) and stretch (affine): what results with them promise."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.measures import check, pooled
from helpers.stretches import KINDS, MODELS, check_kind, rig, stretched
from ssdr.mesh import executor
from ssdr.search import scan


def test_decompositions_warm_started_along_the_chain_fall() -> None:
    frames = motions.wobble(rig("affine", bones=3, frames=12), 0.03)
    start, errors = None, []
    for kind in MODELS:
        call = {"bones": 3, "bone_model": kind, "effort": "fast", "start": start}
        result = check(ssdr.decompose(frames, **call), frames, 3)
        errors.append(result.rmse)
        start = result.skinning
    assert errors[1] <= errors[0]
    assert errors[2] < 0.9 * errors[1]


THIN = {
    "wings, 2": (motions.wings, 2),
    "wings, 4": (motions.wings, 4),
    "cloth, 4": (motions.cloth, 4),
}


@functools.cache
def rigid_on(name: str) -> tuple[np.ndarray, ssdr.Decomposition]:
    """Frames of a thin sheet, and rigid bones that were found for them."""
    make, bones = THIN[name]
    frames, _ = make()
    return frames, ssdr.decompose(frames, bones=bones)


@pytest.mark.slow
@pytest.mark.parametrize("name", THIN)
@pytest.mark.parametrize("kind", KINDS)
def test_bones_that_stretch_are_no_worse_on_thin_sheets(kind: str, name: str) -> None:
    """On thin sheets the straight path to a better affine bone passes through a reflection."""
    frames, rigid = rigid_on(name)
    found = ssdr.decompose(frames, bones=rigid.skinning.n_bones, bone_model=kind)
    check_kind(found.skinning.transforms, kind)
    assert found.rmse <= rigid.rmse
    if kind == "affine":
        assert found.rmse <= 0.7 * rigid.rmse


@pytest.mark.slow
@pytest.mark.parametrize("name", THIN)
@pytest.mark.parametrize("kind", KINDS)
def test_fitted_bones_that_stretch_are_no_worse_on_thin_sheets(kind: str, name: str) -> None:
    frames, result = rigid_on(name)
    model = result.skinning
    rigid, found = (ssdr.fit_bones(frames, model, bone_model=k) for k in ("rigid", kind))
    check_kind(found.skinning.transforms, kind)
    # frames that are stuck start again from those beside them; one of the cloth stays stuck
    assert rigid.rmse <= 1.02 * result.rmse
    assert found.rmse <= rigid.rmse


def degenerate(name: str) -> np.ndarray:
    rng = np.random.default_rng(0)
    rest = rng.standard_normal((40, 3))
    if name == "planar":
        rest[:, 2] = 0
    elif name == "collinear":
        rest[:, 1:] = 0
    elif name == "coincident":
        rest[:] = rest[0]
    elif name == "few":
        rest = rest[:5]
    n = len(rest)
    m = stretched(motions.motions(rng, 8, 3), "affine")
    frames = motions.blend(rest, rng.integers(0, 3, (n, 1)), np.ones((n, 1)), m)
    if name == "static":
        frames[:] = frames[0]
    elif name == "mirrored":
        frames[4:] *= np.array([1, 1, -1])
    elif name == "flattened":
        frames[3] *= np.array([1, 1, 0])
    elif name == "collapsed":
        frames[5] = frames[5, 0]
    elif name == "noise":
        frames = rng.standard_normal(frames.shape)
    return frames


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "name",
    ["planar", "collinear", "coincident", "few", "static", "mirrored", "flattened", "collapsed",
     "noise"],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::ssdr.SsdrWarning")
def test_degenerate_data_do_not_blow_up(kind: str, name: str) -> None:
    frames = degenerate(name)
    result = ssdr.decompose(frames, bones=3, bone_model=kind, effort="fast")
    check_kind(result.skinning.transforms, kind)
    size = np.linalg.norm(result.skinning.transforms[..., :3], axis=(-2, -1))
    assert size.max() < 60  # 20 √3 and what the gauge makes of it
    spread = np.abs(frames - frames.mean(axis=(0, 1))).max() + 1e-12
    assert np.abs(result.skinning.rest).max() < 100 * (spread + np.abs(frames).max())
    assert result.rmse == pytest.approx(pooled(frames, result.reconstruct()), rel=1e-5, abs=1e-9)
    rigid = ssdr.decompose(frames, bones=3, effort="fast")
    assert result.rmse <= 1.05 * rigid.rmse + 1e-6 * spread


@pytest.mark.parametrize("kind", KINDS)
def test_streamed_bones_that_stretch_beat_rigid_ones(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scan, "_IN_MEMORY", 1)
    monkeypatch.setattr(scan, "_FEWEST", 20)
    monkeypatch.setattr(scan, "_MOST", 20)
    monkeypatch.setattr(executor, "_BLOCK", 24 * 120 * 7)
    truth = rig(kind, bones=3, frames=50)
    frames = truth.frames
    result = check(ssdr.decompose(frames, bones=3, bone_model=kind), frames, 3)
    assert {record.phase for record in result.history} == {"all frames"}
    rigid = ssdr.decompose(frames, bones=3)
    assert result.rmse < 0.3 * rigid.rmse


@pytest.mark.parametrize("kind", KINDS)
def test_smooth_weights_with_bones_that_stretch(kind: str) -> None:
    truth = rig(kind, bones=3)
    frames = motions.wobble(truth, 0.05)
    call = {"faces": truth.faces, "bones": 3, "smoothness": 0.05, "effort": "fast"}
    result = ssdr.decompose(frames, bone_model=kind, **call)
    check_kind(result.skinning.transforms, kind)
    assert result.rmse < ssdr.decompose(frames, **call).rmse


def test_parts_that_grow_from_a_point_are_found() -> None:
    """Frames in which a part has no size are no place to fit its bone."""
    rng = np.random.default_rng(5)
    part, times = rng.uniform(-1, 1, (60, 3)), np.linspace(0, 1, 16)
    frames = np.concatenate(
        [
            np.stack(
                [grow(t) * part @ motions.rotation(a * t, 0.2, 0.1).T + [k, t, 0] for t in times]
            )
            for k, a, grow in ((0.0, 1.5, lambda t: t), (4.0, -1.0, lambda t: 1 - 0.8 * t))
        ],
        axis=1,
    )
    size = np.linalg.norm(np.ptp(frames.reshape(-1, 3), axis=0))
    found = ssdr.decompose(frames, bones=2, bone_model="similarity", effort="fast")
    assert found.rmse < 1e-5 * size
