"""OBJ: seams, hard edges and names of materials."""

from __future__ import annotations

import logging

import numpy as np

import ssdr


def test_obj_of_other_programs(tmp_path, caplog):
    (tmp_path / "a.obj").write_text(
        "mtllib my look.mtl\nv 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nvt 0 0\nvt 1 0.5 0\n"
        "usemtl clear glass\nf 1/1 2/2 \\\n3/-1\nusemtl lost\nf 3//  2 1\n"
    )
    with caplog.at_level(logging.WARNING, "ssdr"):
        surface = ssdr.load(tmp_path / "a.obj").surface
    assert [m.name for m in surface.materials] == ["clear glass", "lost"]
    assert surface.material_index.tolist() == [0, 1]
    assert surface.uv.tolist() == [[[0, 0], [1, 0.5], [1, 0.5]], [[0, 0], [0, 0], [0, 0]]]
    assert "3 corners have no uv" in caplog.text


def test_the_normals_of_the_first_frame_are_those_that_are_kept(tmp_path, seam):
    report = ssdr.save(seam, tmp_path / "frame_%d.obj")
    assert "only the names are kept" in str(report.notes)
    first, later = (ssdr.load(tmp_path / f"frame_{k}.obj").surface for k in (0, 1))
    np.testing.assert_array_equal(first.normals, seam.surface.normals, strict=True)
    np.testing.assert_array_equal(later.uv, first.uv)
    assert later.normals is None


def test_polygons_are_cut_into_fans_in_order(tmp_path):
    points = np.arange(24).reshape(8, 3) / 4
    lines = ["v  {} {} {}".format(*p) for p in points] + ["f 1 2 3 4", "f 3 2 5", "f 1 4 6 7 8"]
    (tmp_path / "a.obj").write_text("\n".join(["# by hand\r", "o thing", *lines, ""]))
    sequence = ssdr.load(tmp_path / "a.obj")
    np.testing.assert_array_equal(sequence.vertices[0], points)
    fans = [[0, 1, 2], [0, 2, 3], [2, 1, 4], [0, 3, 5], [0, 5, 6], [0, 6, 7]]
    np.testing.assert_array_equal(sequence.faces, fans)
