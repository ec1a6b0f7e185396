"""Levels of detail: the bones of a coarser level are the first of a finer one, in one file."""

from __future__ import annotations

import functools
import json
import struct

import numpy as np
import pytest

import ssdr

COUNTS = (10, 6, 3)


@functools.cache
def found() -> ssdr.LevelsOfDetail:
    return ssdr.levels(ssdr.samples.load("dancer_small"), bones=COUNTS, effort="fast")


def test_levels_share_bones_and_state_their_errors():
    dancer = ssdr.samples.load("dancer_small")
    result = found()
    assert tuple(level.n_bones for level in result.levels) == COUNTS
    assert result.skinning is result.levels[0]
    for level, error, alone in zip(result.levels, result.errors, result.alone, strict=True):
        shared = result.skinning.transforms[:, : level.n_bones]
        np.testing.assert_array_equal(level.transforms, shared)
        gap = level.skin(dtype=np.float64) - dancer.vertices
        assert error == pytest.approx(np.sqrt((gap**2).sum(axis=2).mean()), rel=1e-6)
        assert alone <= error < 2 * alone
    assert result.rmse == result.errors[0]
    assert list(result.errors) == sorted(result.errors)


def test_levels_beat_bones_taken_from_the_finest_model():
    dancer = ssdr.samples.load("dancer_small")
    fine = ssdr.decompose(dancer, bones=COUNTS[0], effort="fast").skinning
    count = COUNTS[-1]
    heavy = np.argsort(-fine.dense_weights().sum(axis=0))[:count]
    taken = ssdr.Skinning(
        fine.rest,
        np.zeros((fine.n_vertices, 1), dtype=int),
        np.ones((fine.n_vertices, 1)),
        fine.transforms[:, heavy],
    )
    assert found().errors[-1] < ssdr.fit_weights(dancer, taken).rmse


def test_one_skeleton_and_a_mesh_for_each_level(tmp_path):
    result, path = found(), tmp_path / "a.glb"
    ssdr.save(result, path, levels=result.levels[1:], name="dancer")
    data = path.read_bytes()
    document = json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])
    names = [f"dancer_LOD{k}" for k in range(3)]
    assert [mesh["name"] for mesh in document["meshes"]] == names
    assert len(document["skins"]) == 1
    assert len(document["skins"][0]["joints"]) == COUNTS[0]
    assert document["nodes"][0]["extensions"]["MSFT_lod"]["ids"] == [1, 2]
    assert not {1, 2} & set(document["scenes"][0]["nodes"])
    for name, level in zip(names, result.levels, strict=True):
        back = ssdr.load_skinning(path, meshes=name)
        np.testing.assert_allclose(back.skin(), level.skin(), atol=2e-6)
    np.testing.assert_allclose(ssdr.load_skinning(path).skin(), result.skinning.skin(), atol=2e-6)


def test_other_bones_are_no_level(tmp_path):
    result = found()
    other = ssdr.initialize(ssdr.samples.load("dancer_small"), bones=4)
    with pytest.raises(ssdr.InputError, match="levels"):
        ssdr.save(result, tmp_path / "a.glb", levels=[other])


@pytest.mark.parametrize("bones", [6, (6,), (3, 6), (6, 6), "60,30"])
def test_numbers_of_bones_must_fall(bones):
    with pytest.raises(ssdr.InputError, match="bones"):
        ssdr.levels(ssdr.samples.load("dancer_small"), bones=bones)


def test_callback_stops_the_run():
    with pytest.raises(ssdr.Cancelled):
        ssdr.levels(
            ssdr.samples.load("dancer_small"), bones=(4, 2), effort="fast", callback=lambda _: True
        )
