from __future__ import annotations

import dataclasses
import json
import logging
import struct
import subprocess
import sys
import types
import zipfile
from pathlib import Path

import numpy as np
import pytest

import ssdr
from ssdr import FormatError, InputError, MeshSequence
from ssdr.io import FORMATS, read_weights


def same_sequence(a, b, *, strict=True):
    np.testing.assert_array_equal(a.vertices[:], b.vertices[:], strict=strict)
    np.testing.assert_array_equal(a.faces, b.faces, strict=True)
    assert a.fps == b.fps


def same_surface(a, b):
    for field in ("uv", "normals", "material_index"):
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field), strict=True)
    assert [dataclasses.asdict(m) for m in a.materials] == [
        dataclasses.asdict(m) for m in b.materials
    ]


# The registry


def test_every_row_of_the_table_says_what_it_can():
    for suffix, row in FORMATS.items():
        assert suffix == suffix.lower()
        assert row.read or row.write_skinning
    assert {s for s, row in FORMATS.items() if row.extra == "blender"} == {".abc", ".fbx"}


def test_importing_the_package_imports_no_format():

    code = (
        "import ssdr, ssdr.io, sys; ssdr.io.load; "
        "print([m for m in ('trimesh', 'pygltflib', 'pxr', 'bpy', 'zarr', 'numba') "
        "if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_unknown_suffixes_name_those_that_are_known(tmp_path, wave):
    (tmp_path / "a.xyz").write_text("1 2 3")
    (tmp_path / "a").write_text("1 2 3")
    with pytest.raises(FormatError, match=r"a\.xyz: the suffix '\.xyz' is none of \.abc, .*\.zarr"):
        ssdr.load(tmp_path / "a.xyz")
    with pytest.raises(FormatError, match="a name without suffix"):
        ssdr.load(tmp_path / "a")
    with pytest.raises(InputError, match="path: expected a suffix of"):
        ssdr.save(wave, tmp_path / "b.xyz")
    with pytest.raises(InputError, match=r"path: expected a suffix of .* for a MeshSequence"):
        ssdr.save(wave, tmp_path / "b.csv")
    with pytest.raises(FormatError, match="no skinning can be read from"):
        ssdr.load_skinning(tmp_path / "a.obj")
    (tmp_path / "w.csv").write_text("")
    with pytest.raises(FormatError, match="read_weights"):
        ssdr.load(tmp_path / "w.csv")
    with pytest.raises(InputError, match="thing: expected a MeshSequence"):
        ssdr.save(wave.vertices, tmp_path / "b.npz")
    with pytest.raises(InputError, match="path: expected a path"):
        ssdr.load(3)


@pytest.mark.parametrize("name", ["a.npz", "a.npy", "a.obj", "a.pc2", "a.zarr", "f_%03d.obj", "f*"])
def test_missing_files_are_missing(tmp_path, name):
    with pytest.raises(FileNotFoundError):
        ssdr.load(tmp_path / name)


def test_options_are_checked(tmp_path, wave):
    ssdr.save(wave, tmp_path / "a.npz")
    with pytest.raises(InputError, match=r"options: expected fps, mmap, max_bytes .*got mesh"):
        ssdr.load(tmp_path / "a.npz", mesh="b.obj")
    with pytest.raises(InputError, match=r"options: expected compress .*got level"):
        ssdr.save(wave, tmp_path / "a.npz", level=3)
    for fps in (0, -1, np.nan, "24", True):
        with pytest.raises(InputError, match="fps: expected a positive number"):
            ssdr.load(tmp_path / "a.npz", fps=fps)
    assert ssdr.load(tmp_path / "a.npz", fps=12).fps == 12


# Atomic files


def test_a_failed_write_leaves_the_old_file_and_no_rubbish(tmp_path, wave):
    path = tmp_path / "a.npz"
    ssdr.save(wave, path)
    before = path.read_bytes()

    class Broken:
        shape, dtype = wave.vertices.shape, wave.vertices.dtype

        def __getitem__(self, key):
            raise OSError("the disk went away")

    broken = MeshSequence(Broken(), wave.faces, validate=False)
    for name in ("a.npz", "new.pc2", "new.mdd"):
        with pytest.raises(OSError, match="went away"):
            ssdr.save(broken, tmp_path / name)
    assert path.read_bytes() == before
    assert [f.name for f in tmp_path.iterdir()] == ["a.npz"]
    with pytest.raises(InputError, match="a file in a folder that exists"):
        ssdr.save(wave, tmp_path / "no" / "a.npz")
    (tmp_path / "d.npz").mkdir()
    with pytest.raises(InputError, match="the folder"):
        ssdr.save(wave, tmp_path / "d.npz")


def test_files_get_the_permissions_of_any_new_file(tmp_path, wave):
    (tmp_path / "plain").write_text("")
    ssdr.save(wave, tmp_path / "a.npz")
    assert (tmp_path / "a.npz").stat().st_mode == (tmp_path / "plain").stat().st_mode


# npz


@pytest.mark.parametrize("compress", [True, False])
def test_npz_keeps_everything(tmp_path, seam, compress):
    welded, _ = seam.weld()
    for k, sequence in enumerate((seam, welded)):
        report = ssdr.save(sequence, tmp_path / f"{k}.npz", compress=compress)
        back = ssdr.load(tmp_path / f"{k}.npz")
        assert report.bytes == (tmp_path / f"{k}.npz").stat().st_size
        assert report.error is None
        same_sequence(back, sequence)
        same_surface(back.surface, sequence.surface)
        assert back.name == "seam"
        assert (back.vertex_map is None) == (k == 0)
    np.testing.assert_array_equal(back.vertex_map, welded.vertex_map)


def test_npz_is_read_by_numpy_and_numpy_is_read(tmp_path, wave):
    ssdr.save(wave, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert {"vertices", "faces", "fps"} <= set(archive.files)
        np.testing.assert_array_equal(archive["vertices"], wave.vertices, strict=True)
    np.savez(
        tmp_path / "b.npz",
        vertices=np.asfortranarray(wave.vertices.astype(">f8")),
        faces=wave.faces.astype(np.uint16),
        fps=[12.5],
        names=["unrelated"],
    )
    back = ssdr.load(tmp_path / "b.npz")
    np.testing.assert_array_equal(back.vertices, wave.vertices)
    assert back.vertices.dtype == np.float64
    assert back.vertices.flags.c_contiguous
    assert back.vertices.flags.writeable
    assert (back.fps, back.name) == (12.5, "b")
    np.savez(tmp_path / "c.npz", vertices=wave.vertices, faces=wave.faces)
    assert ssdr.load(tmp_path / "c.npz").fps == 24


def test_npz_has_the_same_bytes_every_time(tmp_path, seam, skinned):
    for thing in (seam, skinned):
        for name in ("a.npz", "b.npz"):
            ssdr.save(thing, tmp_path / name)
        assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
        with zipfile.ZipFile(tmp_path / "a.npz") as archive:
            assert {i.date_time for i in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_npz_can_be_mapped(tmp_path, wave):
    ssdr.save(wave, tmp_path / "a.npz", compress=False)
    mapped = ssdr.load(tmp_path / "a.npz", mmap=True)
    assert isinstance(mapped.vertices, np.memmap)
    same_sequence(mapped, wave)
    ssdr.save(mapped, tmp_path / "copy.npz")
    same_sequence(ssdr.load(tmp_path / "copy.npz"), wave)
    ssdr.save(wave, tmp_path / "b.npz")
    with pytest.raises(InputError, match="mmap: expected an uncompressed archive"):
        ssdr.load(tmp_path / "b.npz", mmap=True)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_npz_keeps_a_skinning(tmp_path, skinned, seam, dtype):
    keys = np.zeros((6, 5), dtype=bool)
    keys[[0, -1]] = True
    weights = skinned.weights.astype(dtype)
    full = dataclasses.replace(
        skinned,
        weights=weights,
        keyframes=keys,
        bone_names=("hip", "🦴", "knee", "toe", "ear"),
        vertex_map=np.arange(12).repeat(2),
        bone_model="affine",
        surface=ssdr.Surface(materials=seam.surface.materials),
    )
    for thing in (skinned, full):
        report = ssdr.save(thing, tmp_path / "s.npz")
        back = ssdr.load_skinning(tmp_path / "s.npz")
        assert (report.influences, report.error) == (3, None)
        for field in ("rest", "joints", "weights", "transforms", "faces"):
            np.testing.assert_array_equal(getattr(back, field), getattr(thing, field), strict=True)
        for field in ("bone_model", "bone_names", "name", "fps"):
            assert getattr(back, field) == getattr(thing, field)
    np.testing.assert_array_equal(back.keyframes, keys)
    np.testing.assert_array_equal(back.vertex_map, full.vertex_map)
    assert back.surface.materials[1].texture == seam.surface.materials[1].texture


def test_a_skinning_loads_as_its_vertices(tmp_path, skinned):
    ssdr.save(skinned, tmp_path / "s.npz")
    baked = ssdr.load(tmp_path / "s.npz")
    assert baked.fps == 30
    np.testing.assert_array_equal(baked.vertices, skinned.skin(), strict=True)
    assert ssdr.load(tmp_path / "s.npz", fps=60).fps == 60


def test_a_result_is_saved_as_its_skinning(tmp_path, skinned):
    ssdr.save(types.SimpleNamespace(skinning=skinned), tmp_path / "s.npz")
    np.testing.assert_array_equal(ssdr.load_skinning(tmp_path / "s.npz").rest, skinned.rest)


# npy and zarr


@pytest.mark.parametrize("mmap", [False, True])
def test_npy_takes_faces_from_anywhere(tmp_path, wave, mmap):
    path = tmp_path / "clip.npy"
    np.save(path, wave.vertices)
    with pytest.raises(InputError, match=r"faces: expected a mesh, .*clip\.obj beside"):
        ssdr.load(path)
    mesh = dataclasses.replace(wave, vertices=wave.vertices[:1])
    ssdr.save(mesh, tmp_path / "mesh.obj")
    ssdr.save(wave, tmp_path / "mesh.npz")
    np.save(tmp_path / "faces.npy", wave.faces)
    for faces in (
        wave.faces,
        wave.faces.tolist(),
        tmp_path / "mesh.obj",
        str(tmp_path / "mesh.npz"),
        tmp_path / "faces.npy",
        wave,
    ):
        back = ssdr.load(path, faces=faces, fps=25, mmap=mmap)
        same_sequence(back, wave)
        assert back.is_lazy == mmap
    assert len(ssdr.load(path, faces="none").faces) == 0
    with pytest.raises(InputError, match=r"^faces: expected indices from 0 to 11"):
        ssdr.load(path, faces=wave.faces + 1)
    ssdr.save(mesh, tmp_path / "clip.obj")
    same_sequence(ssdr.load(path, fps=25), wave)
    np.save(path, wave.vertices[:, :-1])
    with pytest.raises(FormatError, match=r"clip\.npy: 11 vertices, but .*clip\.obj has 12"):
        ssdr.load(path)


def test_npy_goes_round(tmp_path, wave):
    report = ssdr.save(wave, tmp_path / "clip.npy")
    assert "clip.faces.npy" in report.note
    assert report.bytes == sum(f.stat().st_size for f in tmp_path.iterdir())
    same_sequence(ssdr.load(tmp_path / "clip.npy", fps=25), wave)


def test_zarr_goes_round_and_stays_lazy(tmp_path, wave, skinned):
    zarr = pytest.importorskip("zarr")
    for thing in (skinned, wave):
        report = ssdr.save(thing, tmp_path / "clip.zarr")
        assert report.bytes > 0
    back = ssdr.load(tmp_path / "clip.zarr")
    same_sequence(back, wave)
    assert back.is_lazy
    assert [f.name for f in tmp_path.iterdir()] == ["clip.zarr"]
    zarr.create_array(store=tmp_path / "bare.zarr", data=wave.vertices)
    same_sequence(ssdr.load(tmp_path / "bare.zarr", faces=wave.faces, fps=25), wave)
    (tmp_path / "other.zarr").mkdir()
    (tmp_path / "other.zarr" / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="something else"):
        ssdr.save(wave, tmp_path / "other.zarr")
    with pytest.raises(FormatError, match=r"other\.zarr"):
        ssdr.load(tmp_path / "other.zarr")


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


# Tables of weights


@pytest.mark.parametrize("suffix", ["csv", "json"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_weights_go_round(tmp_path, skinned, suffix, dtype):
    names = ("hip", 'the "big", bone', "bone_10", "bone_9", "idle")
    given = dataclasses.replace(skinned, weights=skinned.weights.astype(dtype), bone_names=names)
    path = tmp_path / f"w.{suffix}"
    report = ssdr.save(given, path)
    assert (report.influences, report.bytes) == (3, path.stat().st_size)
    back = read_weights(path, bones=names)
    assert back.bone_names == names
    np.testing.assert_array_equal(back.joints, given.joints)
    np.testing.assert_array_equal(back.weights.astype(dtype), given.weights)
    in_file = read_weights(path).bone_names
    assert in_file == (names if suffix == "json" else tuple(sorted(names, key=_natural)))
    with pytest.raises(FormatError, match="bone 'hip' is none of the bones asked for"):
        read_weights(path, bones=names[1:])
    with pytest.raises(InputError, match="the same name twice"):
        read_weights(path, bones=["hip", "hip"])


def _natural(name):
    return (name.rstrip("0123456789"), int("0" + "".join(c for c in name if c.isdigit())))


def test_weights_are_what_they_say(tmp_path, skinned):
    ssdr.save(skinned, tmp_path / "w.csv")
    lines = (tmp_path / "w.csv").read_text().splitlines()
    assert lines[0] == "vertex,bone,weight"
    assert "0,bone_4,0" in lines
    dense = np.zeros((12, 5))
    for line in lines[1:]:
        vertex, bone, weight = line.split(",")
        dense[int(vertex), int(bone.removeprefix("bone_"))] += float(weight)
    np.testing.assert_array_equal(dense, skinned.dense_weights())
    ssdr.save(skinned, tmp_path / "w.json")
    table = json.loads((tmp_path / "w.json").read_text())
    assert table["bones"] == list(skinned.names())
    np.testing.assert_array_equal(table["joints"], skinned.joints)
    np.testing.assert_array_equal(table["weights"], skinned.weights)


@pytest.mark.parametrize("suffix", ["csv", "json"])
def test_weights_go_back_to_the_mesh_before_welding(tmp_path, skinned, suffix):
    index = np.array([3, 3, *range(12), 0])
    welded = dataclasses.replace(skinned, vertex_map=index)
    path = tmp_path / f"w.{suffix}"
    assert "12 welded vertices" in ssdr.save(welded, path).note
    ssdr.save(welded, path, unweld=True)
    back = read_weights(path, bones=skinned.names())
    np.testing.assert_array_equal(back.weights, skinned.weights[index])
    with pytest.raises(InputError, match=r"^unweld"):
        ssdr.save(skinned, path, unweld=True)


def test_real_sequences_load_as_they_are(real, data_dir):
    for name in ("fox", "ea_bone", "mannequin_rumba"):
        with np.load(data_dir / f"{name}.npz") as archive:
            sequence = real(name)
            np.testing.assert_array_equal(sequence.vertices, archive["vertices"], strict=True)
            np.testing.assert_array_equal(sequence.faces, archive["faces"])
            assert sequence.fps == archive["fps"]


def test_the_page_on_formats_names_them_all():
    page = (Path(__file__).parents[2] / "docs" / "io.md").read_text(encoding="utf-8")
    table = page[page.index("| suffix") : page.index("Options common")]
    for suffix, row in FORMATS.items():
        line = next(line for line in table.splitlines() if f"`{suffix}`" in line)
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        able = [row.read, row.read_skinning, row.write_sequence, row.write_skinning]
        assert [cell == "yes" for cell in cells[2:5]] == [bool(f) for f in able[:3]]
        assert bool(cells[5]) == bool(row.write_sequence or row.write_skinning)
        assert cells[6] == (f"`ssdr[{row.extra}]`" if row.extra else "")


def test_a_missing_package_says_what_to_install(tmp_path, wave, monkeypatch):
    monkeypatch.setitem(sys.modules, "zarr", None)
    (tmp_path / "a.zarr").mkdir()
    for act in (lambda p: ssdr.load(p), lambda p: ssdr.save(wave, p)):
        with pytest.raises(ssdr.MissingDependencyError, match=r'pip install "ssdr\[zarr\]"'):
            act(tmp_path / "a.zarr")
