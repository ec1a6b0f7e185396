"""OBJ: seams, hard edges and names of materials."""

from __future__ import annotations

import dataclasses
import logging

import numpy as np

import ssdr
from helpers.surfaces import same_surface


def test_obj_keeps_seams_edges_and_names_of_materials(tmp_path, seam):
    welded, _ = seam.weld()
    names = tuple(ssdr.Material(name=m.name) for m in seam.surface.materials)
    named = dataclasses.replace(seam.surface, materials=names)
    for sequence in (seam, welded):
        report = ssdr.save(sequence, tmp_path / "o" / "frame_%d.obj")
        assert "only the names are kept" in str(report.notes)
        assert sorted(f.name for f in report.path.parent.iterdir()) == [
            f"frame_{k}.obj" for k in range(4)
        ]
        back = ssdr.load(tmp_path / "o")
        np.testing.assert_array_equal(back.vertices.astype(np.float32), sequence.vertices)
        np.testing.assert_array_equal(back.faces, sequence.faces)
        same_surface(back.surface, named)
        later = ssdr.load(tmp_path / "o" / "frame_1.obj").surface
        same_surface(later, dataclasses.replace(named, normals=None))


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
