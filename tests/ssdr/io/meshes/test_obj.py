"""OBJ and its materials."""

from __future__ import annotations

import logging

import numpy as np
import pytest

import ssdr
from helpers.surfaces import same_surface
from ssdr import FormatError, MeshSequence


def test_obj_keeps_seams_edges_and_materials(tmp_path, seam):
    welded, _ = seam.weld()
    for sequence in (seam, welded):
        ssdr.save(sequence, tmp_path / "o" / "frame_%d.obj", start=5)
        names = sorted(f.name for f in (tmp_path / "o").iterdir())
        assert names == [
            "frame.mtl",
            *(f"frame_{k}.obj" for k in range(5, 9)),
            "frame_texture_1.png",
        ]
        back = ssdr.load(tmp_path / "o")
        np.testing.assert_array_equal(back.vertices.astype(np.float32), sequence.vertices)
        np.testing.assert_array_equal(back.faces, sequence.faces)
        same_surface(back.surface, sequence.surface)


def test_obj_normals_of_later_frames_follow_the_surface(tmp_path):
    # A quad and a flap with a hard edge between them; then all is turned about x.
    rest = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [3, 2, 4]])
    flat = np.cross(rest[faces][:, 1] - rest[faces][:, 0], rest[faces][:, 2] - rest[faces][:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    turn = np.array([[1, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]])
    normals = np.repeat(flat[:, None], 3, axis=1).astype(np.float32)
    sequence = MeshSequence(
        np.stack([rest, rest @ turn.T]), faces, surface=ssdr.Surface(normals=normals)
    )
    ssdr.save(sequence, tmp_path / "f%d.obj")
    np.testing.assert_array_equal(ssdr.load(tmp_path / "f0.obj").surface.normals, normals)
    np.testing.assert_allclose(
        ssdr.load(tmp_path / "f1.obj").surface.normals, normals @ turn.T, atol=1e-6
    )


def test_mtl_of_other_programs(tmp_path, caplog):
    (tmp_path / "a.obj").write_text(
        "mtllib my look.mtl\nv 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nvt 0 0\nvt 1 0.5 0\n"
        "usemtl glass\nf 1/1 2/2 \\\n3/-1\nusemtl lost\nf 3//  2 1\n"
    )
    (tmp_path / "my look.mtl").write_text(
        "# look\nnewmtl glass\nKd 0.5 0.25 0\nTr 0.75\nmap_Kd -s 1 1 1 tex\\wood.jpg\n"
        "newmtl unused\nd 0.5\n"
    )
    (tmp_path / "tex").mkdir()
    (tmp_path / "tex" / "wood.jpg").write_bytes(b"\xff\xd8\xff\xe0 picture")
    with caplog.at_level(logging.WARNING, "ssdr"):
        surface = ssdr.load(tmp_path / "a.obj").surface
    glass, lost = surface.materials
    assert (glass.name, glass.base_color) == ("glass", (0.5, 0.25, 0.0, 0.25))
    assert (glass.texture, glass.texture_type) == (b"\xff\xd8\xff\xe0 picture", "image/jpeg")
    assert (lost.name, lost.texture) == ("lost", None)
    assert surface.material_index.tolist() == [0, 1]
    assert surface.uv.tolist() == [[[0, 0], [1, 0.5], [1, 0.5]], [[0, 0], [0, 0], [0, 0]]]
    assert "3 corners have no uv" in caplog.text
    (tmp_path / "my look.mtl").unlink()
    ssdr.load(tmp_path / "a.obj")
    assert "my look.mtl is missing" in caplog.text


@pytest.mark.parametrize(
    "line",
    [
        *("f 1 2 4", "f 0 1 2", "f 1 2 -4", "f 1 2", "f 1 2 x", "f 1/1 2 3"),
        *("v 1 2", "v 1 2 x", "v 1 2 nan", "v 1 2 inf", "v 1 2 1e999"),
    ],
)
def test_obj_indices_must_exist_and_vertices_be_finite_numbers(tmp_path, line):
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{line}\nf 1 2 3\n")
    with pytest.raises(FormatError, match=r"a\.obj"):
        ssdr.load(tmp_path / "a.obj")
