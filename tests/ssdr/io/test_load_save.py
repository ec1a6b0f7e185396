"""Loading and saving: options, missing files, welding."""

from __future__ import annotations

import logging
import types

import numpy as np
import pytest

import ssdr


def test_a_result_is_saved_as_its_skinning(tmp_path, skinned):
    ssdr.save(types.SimpleNamespace(skinning=skinned), tmp_path / "s.npz")
    np.testing.assert_array_equal(ssdr.load_skinning(tmp_path / "s.npz").rest, skinned.rest)


@pytest.mark.parametrize("suffix", ["pc2", "mdd"])
def test_a_cache_of_the_mesh_before_welding(tmp_path, seam, suffix):
    welded, _ = seam.weld()
    path = tmp_path / f"a.{suffix}"
    assert "15 welded vertices" in str(ssdr.save(welded, path).notes)
    before = ssdr.MeshSequence(welded.vertices[:, welded.vertex_map])
    assert ssdr.save(before, path).notes == ()
    back = ssdr.load(path, faces=seam)
    np.testing.assert_array_equal(back.vertices, seam.vertices, strict=True)


def test_load_welds_on_request(tmp_path, seam, caplog):
    ssdr.save(seam, tmp_path / "a.npz")
    with caplog.at_level(logging.INFO, "ssdr"):
        welded = ssdr.load(tmp_path / "a.npz", weld=True)
    assert "welded 18 vertices to 15" in caplog.text
    np.testing.assert_array_equal(welded.vertices[:, welded.vertex_map], seam.vertices)


def test_a_mesh_without_triangles_is_no_mesh_to_other_programs(tmp_path, wave):
    points = ssdr.MeshSequence(wave.vertices)
    model = ssdr.initialize(points, bones=2)
    for name, thing in (("a.glb", model), ("a_%d.obj", points), ("a_%d.ply", points)):
        assert "has no triangles: programs show points" in str(
            ssdr.save(thing, tmp_path / name).notes
        )
    for name, thing in (("b.npz", model), ("b.npz", points)):
        assert "triangles" not in str(ssdr.save(thing, tmp_path / name).notes)
    assert "triangles" not in str(
        ssdr.save(ssdr.initialize(wave, bones=2), tmp_path / "b.glb").notes
    )
