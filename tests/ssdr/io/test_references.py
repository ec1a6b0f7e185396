"""What a file from elsewhere may make the reader open: nothing outside its folder, no device."""

from __future__ import annotations

import dataclasses
import os

import pytest

import ssdr
from ssdr import FormatError, InputError

PNG = b"\x89PNG\r\n\x1a\n secret"
OBJ = "mtllib {library}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n"


@pytest.mark.parametrize(
    "name", ["../secret.png", "{folder}/secret.png", "link.png", "deep/../../secret.png"]
)
def test_a_texture_of_an_mtl_outside_the_folder_is_left_out(name, tmp_path, caplog):
    """It was read, and went on into what was written."""
    (tmp_path / "secret.png").write_bytes(PNG)
    inner = tmp_path / "model"
    (inner / "deep").mkdir(parents=True)
    (inner / "link.png").symlink_to(tmp_path / "secret.png")
    (inner / "a.obj").write_text(OBJ.format(library="a.mtl"))
    (inner / "a.mtl").write_text(f"newmtl a\nmap_Kd {name.format(folder=tmp_path)}\n")
    assert ssdr.load(inner / "a.obj").surface.materials[0].texture is None
    assert "lies outside its folder and is left out" in caplog.text
    (inner / "secret.png").write_bytes(PNG)
    texture = ssdr.load(inner / "a.obj").surface.materials[0].texture
    assert texture == (None if name == "link.png" else PNG)  # by its name alone


def test_a_material_library_outside_the_folder_is_left_out(tmp_path, caplog):
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 1 0 0\n")
    inner = tmp_path / "model"
    inner.mkdir()
    for library in ("../a.mtl", str(tmp_path / "a.mtl"), "n" * 300 + ".mtl", "a\0.mtl"):
        (inner / "a.obj").write_text(OBJ.format(library=library.replace("\0", "")))
        assert ssdr.load(inner / "a.obj").surface.materials[0].base_color[:3] == (0.8, 0.8, 0.8)
    assert "material library ../a.mtl lies outside its folder" in caplog.text


MESHES = ["obj", "ply", "off", "stl", "glb"]
SUFFIXES = [*MESHES, "npz", "npy", "pc2", "mdd", "gltf", "usda", "usdc", "abc", "fbx"]
ENDLESS = [getattr(os, "mkfifo", None), lambda path: path.symlink_to("/dev/zero")]
needs_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders here")


@needs_pipes
@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("make", ENDLESS, ids=["pipe", "device"])
def test_pipes_and_devices_are_refused_at_once(suffix, make, tmp_path):
    """A link to an endless device was read until memory ended, a pipe for ever."""
    path = tmp_path / f"a.{suffix}"
    make(path)
    readers = [ssdr.load, *([ssdr.load_skinning] if suffix in ("npz", "glb", "usda") else [])]
    for read in readers:
        with pytest.raises(FormatError, match="a device, a pipe or a socket"):
            read(path)


@needs_pipes
@pytest.mark.parametrize("make", ENDLESS, ids=["pipe", "device"])
@pytest.mark.parametrize("suffix", MESHES)
def test_pipes_and_devices_among_numbered_files_are_refused_at_once(suffix, make, tmp_path):
    sample = ssdr.samples.load("dancer_small")
    first = dataclasses.replace(sample, vertices=sample.vertices[:1])
    if suffix in ("obj", "ply"):
        ssdr.save(first, tmp_path / f"m_1.{suffix}")
    make(tmp_path / f"m_2.{suffix}")
    for path in (tmp_path, tmp_path / f"m_%d.{suffix}", tmp_path / f"m_*.{suffix}"):
        with pytest.raises(FormatError, match=rf"m_2\.{suffix}: a device, a pipe or a socket"):
            ssdr.load(path)


@needs_pipes
@pytest.mark.parametrize("make", ENDLESS, ids=["pipe", "device"])
def test_a_companion_that_is_a_pipe_or_a_device_is_not_opened(make, tmp_path, caplog):
    ssdr.save(ssdr.samples.load("dancer_small"), tmp_path / "a.npy")
    (tmp_path / "a.faces.npy").unlink()
    for name in ("a.faces.npy", "a.obj", "m.npz", "a.mtl"):
        make(tmp_path / name)
    with pytest.raises(InputError, match="faces: expected"):
        ssdr.load(tmp_path / "a.npy")
    for faces in ("a.faces.npy", "m.npz"):
        with pytest.raises(FormatError, match="a device, a pipe or a socket"):
            ssdr.load(tmp_path / "a.npy", faces=tmp_path / faces)
    (tmp_path / "b.obj").write_text(OBJ.format(library="a.mtl"))
    assert ssdr.load(tmp_path / "b.obj").n_vertices == 3
    assert "material library a.mtl is missing" in caplog.text
