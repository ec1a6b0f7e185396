"""Numbered meshes and point caches go round, and follow what other programs write."""

from __future__ import annotations

import dataclasses
import logging
import struct

import numpy as np
import pytest
from surfaces import same_sequence, same_surface

import ssdr
from ssdr import FormatError, InputError, MeshSequence

# Numbered meshes


@pytest.mark.parametrize("suffix", ["obj", "ply"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_numbered_meshes_go_round(tmp_path, wave, rng, suffix, dtype):
    vertices = np.concatenate([wave.vertices, rng.normal(0, 1e3, (9, 12, 3))]).astype(dtype)
    sequence = MeshSequence(vertices, wave.faces, 24.0)
    report = ssdr.save(sequence, tmp_path / "out" / f"frame_%02d.{suffix}")
    files = sorted((tmp_path / "out").iterdir())
    assert [f.name for f in files] == [f"frame_{k:02d}.{suffix}" for k in range(13)]
    assert report.bytes == sum(f.stat().st_size for f in files)
    for pattern in ("", f"frame_%02d.{suffix}", f"frame_*.{suffix}", "frame_*", "*"):
        back = ssdr.load(tmp_path / "out" / pattern)
        np.testing.assert_array_equal(back.vertices.astype(dtype), vertices)
        np.testing.assert_array_equal(back.faces, wave.faces)
    one = ssdr.load(files[3])
    assert one.n_frames == 1
    with pytest.raises(InputError, match="one number such as %04d"):
        ssdr.save(sequence, tmp_path / f"all.{suffix}")


def test_files_come_in_natural_order_and_gaps_are_told(tmp_path, caplog):
    for number in (1, 2, 10, 11, 9):
        (tmp_path / f"m{number}.obj").write_text(f"v {number} 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with caplog.at_level(logging.WARNING, "ssdr"):
        sequence = ssdr.load(tmp_path)
    assert sequence.vertices[:, 0, 0].tolist() == [1, 2, 9, 10, 11]
    assert "frames are missing after 2" in caplog.text
    assert ssdr.load(tmp_path / "m%02d.obj").n_frames == 2
    (tmp_path / "m01.obj").write_text("v 1 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(FormatError, match="have the same number"):
        ssdr.load(tmp_path)
    (tmp_path / "m3.stl").write_text("")
    with pytest.raises(FormatError, match=r"files of \.obj, \.stl"):
        ssdr.load(tmp_path)


def test_topology_must_agree(tmp_path):
    a = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 3 4\n"
    (tmp_path / "f1.obj").write_text(a)
    for text, says in (
        (a + "v 2 2 2\n", r"f2\.obj: 5 vertices, but f1\.obj has 4"),
        (a + "f 1 2 4\n", r"f2\.obj: 3 triangles, but f1\.obj has 2"),
        (a.replace("f 2 3 4", "f 2 4 3"), r"triangle 1 is \(1, 3, 2\), in f1\.obj it is \(1, 2, 3"),
    ):
        (tmp_path / "f2.obj").write_text(text)
        with pytest.raises(FormatError, match=says):
            ssdr.load(tmp_path)
    relative = a.replace("f 1 2 3", "f -4 2 -2")
    (tmp_path / "f2.obj").write_text(relative)
    assert ssdr.load(tmp_path).n_frames == 2


POLYGONS = [[0, 1, 2, 3], [2, 1, 4], [0, 3, 5, 6, 7]]
FANS = [[0, 1, 2], [0, 2, 3], [2, 1, 4], [0, 3, 5], [0, 5, 6], [0, 6, 7]]


def mixed_polygons(kind):
    points = np.arange(24).reshape(8, 3) / 4
    rows = "".join("{} {} {}\n".format(*p) for p in points)
    listed = "".join(f"{len(p)} {' '.join(map(str, p))}\n" for p in POLYGONS)
    head = (
        "ply\nformat {} 1.0\ncomment made by hand\nelement vertex 8\nproperty float x\n"
        "property float y\nproperty float z\nelement face 3\n"
        "property list uchar int vertex_index\nproperty uchar flags\nend_header\n"
    )
    if kind == "off":
        text = "OFF # comment\n8 3 0\n" + rows + "\n# faces\n" + listed
    elif kind == "obj":
        faces = "".join(f"f {' '.join(str(i + 1) for i in p)}\n" for p in POLYGONS)
        text = "# by hand\r\no thing\n" + "".join(f"v  {p}\n" for p in rows.splitlines()) + faces
    elif kind == "ascii":
        flagged = listed.replace("\n", " 7\n")
        text = head.format("ascii") + rows + flagged
    else:
        order = "<" if kind == "little" else ">"
        return (
            head.format(f"binary_{kind}_endian").encode()
            + points.astype(f"{order}f4").tobytes()
            + b"".join(struct.pack(f"{order}B{len(p)}iB", len(p), *p, 7) for p in POLYGONS)
        ), points
    return text.encode(), points


@pytest.mark.parametrize("kind", ["off", "obj", "ascii", "little", "big"])
def test_polygons_are_cut_into_fans_in_order(tmp_path, kind):
    data, points = mixed_polygons(kind)
    path = tmp_path / f"a.{kind if kind in ('off', 'obj') else 'ply'}"
    path.write_bytes(data)
    sequence = ssdr.load(path)
    np.testing.assert_array_equal(sequence.vertices[0], points)
    np.testing.assert_array_equal(sequence.faces, FANS)


def test_ply_normals_and_texture_coordinates_go_to_corners(tmp_path):
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\n"
        "property double z\nproperty float nx\nproperty float ny\nproperty float nz\n"
        "property float s\nproperty float t\nelement face 1\n"
        "property list uchar uint vertex_indices\nend_header\n"
        "0 0 0 0 0 1 0.25 0.5\n1 0 0 0 1 0 0 1\n0 1 0 1 0 0 1 0\n3 2 0 1\n"
    )
    surface = ssdr.load(tmp_path / "a.ply").surface
    np.testing.assert_array_equal(surface.uv, [[[1, 0], [0.25, 0.5], [0, 1]]])
    np.testing.assert_array_equal(surface.normals, [[[1, 0, 0], [0, 0, 1], [0, 1, 0]]])


def test_trimesh_agrees(tmp_path, wave):
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh(wave.vertices[0], wave.faces, process=False)
    for suffix in ("obj", "ply", "off"):
        mesh.export(tmp_path / f"a.{suffix}")
        back = ssdr.load(tmp_path / f"a.{suffix}")
        np.testing.assert_allclose(back.vertices[0], wave.vertices[0], rtol=0, atol=1e-7)
        np.testing.assert_array_equal(back.faces, wave.faces)
    for suffix in ("obj", "ply"):
        ssdr.save(wave, tmp_path / f"b_%d.{suffix}")
        back = trimesh.load(tmp_path / f"b_2.{suffix}", process=False)
        np.testing.assert_allclose(back.vertices, wave.vertices[2], rtol=0, atol=1e-7)
        np.testing.assert_array_equal(back.faces, wave.faces)


@pytest.mark.parametrize("text", [False, True])
def test_stl_is_welded_the_same_in_every_frame(tmp_path, wave, caplog, text):
    trimesh = pytest.importorskip("trimesh")
    for k, frame in enumerate(wave.vertices):
        trimesh.Trimesh(frame, wave.faces, process=False).export(
            tmp_path / f"f{k}.stl", file_type="stl_ascii" if text else "stl"
        )
    with caplog.at_level(logging.INFO, "ssdr"):
        sequence = ssdr.load(tmp_path)
    assert "36 corners became 12 vertices" in caplog.text
    assert sequence.vertex_map.shape == (36,)
    np.testing.assert_allclose(
        sequence.vertices[:, sequence.faces], wave.vertices[:, wave.faces], rtol=0, atol=1e-7
    )
    np.testing.assert_array_equal(sequence.vertex_map.reshape(-1, 3), sequence.faces)


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
    assert "my look.mtl is not there" in caplog.text


# Point caches


@pytest.mark.parametrize("suffix", ["pc2", "mdd"])
@pytest.mark.parametrize("mmap", [False, True])
def test_point_caches_go_round(tmp_path, wave, suffix, mmap):
    path = tmp_path / f"clip.{suffix}"
    report = ssdr.save(wave, path)
    assert report.error is None
    assert report.bytes == path.stat().st_size
    with pytest.raises(InputError, match=r"mesh: expected a mesh, .*clip\.obj beside"):
        ssdr.load(path)
    ssdr.save(dataclasses.replace(wave, vertices=wave.vertices[:1]), tmp_path / "clip.obj")
    for mesh in (None, wave, wave.faces, tmp_path / "clip.obj"):
        back = ssdr.load(path, mesh=mesh, mmap=mmap, fps=25 if suffix == "pc2" else None)
        same_sequence(back, wave, strict=not mmap)
        assert back.is_lazy == mmap
        np.testing.assert_array_equal(back.frames(2), wave.frames(2), strict=True)
    assert len(ssdr.load(path, mesh="none").faces) == 0
    with pytest.raises(InputError, match=r"^mesh: expected a mesh of 12 vertices, got 11"):
        ssdr.load(path, mesh=MeshSequence(wave.vertices[:, 1:]))


def test_point_caches_follow_their_layouts(tmp_path, wave):
    ssdr.save(wave, tmp_path / "a.pc2")
    data = (tmp_path / "a.pc2").read_bytes()
    assert data[:12] == b"POINTCACHE2\0"
    assert struct.unpack("<iiffi", data[12:32]) == (1, 12, 0.0, 1.0, 4)
    assert data[32:] == wave.vertices.astype("<f4").tobytes()
    ssdr.save(wave, tmp_path / "a.mdd")
    data = (tmp_path / "a.mdd").read_bytes()
    assert struct.unpack(">ii4f", data[:24]) == (4, 12, *np.float32([0, 0.04, 0.08, 0.12]).tolist())
    assert data[24:] == wave.vertices.astype(">f4").tobytes()


@pytest.mark.parametrize("fps", [12.5, 23.976, 24, 29.97, 60, 120])
def test_mdd_times_carry_the_rate(tmp_path, fps):
    sequence = MeshSequence(np.zeros((500, 1, 3)), None, fps)
    ssdr.save(sequence, tmp_path / "a.mdd")
    assert ssdr.load(tmp_path / "a.mdd", mesh="none").fps == pytest.approx(fps, abs=1e-3)
    assert ssdr.load(tmp_path / "a.mdd", mesh="none", fps=7).fps == 7


def test_uneven_mdd_times_are_told(tmp_path, caplog):
    head = struct.pack(">ii3f", 3, 1, 0.0, 0.04, 0.2)
    (tmp_path / "a.mdd").write_bytes(head + bytes(36))
    with caplog.at_level(logging.WARNING, "ssdr"):
        assert ssdr.load(tmp_path / "a.mdd", mesh="none").fps == 10
    assert "not even" in caplog.text
    head = struct.pack(">ii3f", 3, 1, 0.0, 0.2, 0.1)
    (tmp_path / "a.mdd").write_bytes(head + bytes(36))
    with pytest.raises(FormatError, match="not increasing"):
        ssdr.load(tmp_path / "a.mdd", mesh="none")


def test_point_caches_of_a_skinning_state_their_error(tmp_path, skinned):
    exact = skinned.skin()
    for suffix in ("pc2", "mdd"):
        report = ssdr.save(skinned, tmp_path / f"a.{suffix}")
        back = ssdr.load(tmp_path / f"a.{suffix}", mesh="none")
        gap = back.vertices.astype(np.float64) - exact
        distance = np.sqrt((gap**2).sum(axis=2))
        assert report.error == pytest.approx(np.sqrt((distance**2).mean()))
        assert report.max_error == pytest.approx(distance.max())
        assert 0 < report.max_error < 1e-6
    assert back.fps == 30
    far = dataclasses.replace(skinned, rest=skinned.rest.astype(np.float64) * 1e300)
    with pytest.raises(InputError, match="within float32"):
        ssdr.save(far, tmp_path / "far.pc2")


@pytest.mark.parametrize("suffix", ["pc2", "mdd"])
def test_results_go_back_to_the_mesh_before_welding(tmp_path, seam, suffix):
    welded, _ = seam.weld()
    path = tmp_path / f"a.{suffix}"
    assert "15 welded vertices" in ssdr.save(welded, path).note
    assert ssdr.save(welded, path, unweld=True).note == ""
    back = ssdr.load(path, mesh=seam)
    np.testing.assert_array_equal(back.vertices, seam.vertices, strict=True)
    with pytest.raises(InputError, match=r"^unweld"):
        ssdr.save(seam, path, unweld=True)


def test_load_welds_on_request(tmp_path, seam, caplog):
    ssdr.save(seam, tmp_path / "a.npz")
    with caplog.at_level(logging.INFO, "ssdr"):
        welded = ssdr.load(tmp_path / "a.npz", weld=True)
    assert "welded 18 vertices to 15" in caplog.text
    np.testing.assert_array_equal(welded.unweld(welded.vertices, axis=1), seam.vertices)
