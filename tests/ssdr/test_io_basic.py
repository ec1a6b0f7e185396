from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
import types
import zipfile
from pathlib import Path

import numpy as np
import pytest
from surfaces import same_sequence, same_surface

import ssdr
from ssdr import FormatError, InputError, MeshSequence
from ssdr.io import FORMATS, read_weights

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
