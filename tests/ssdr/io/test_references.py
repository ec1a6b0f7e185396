"""What a file from elsewhere may make the reader open: nothing outside its folder, no device."""

from __future__ import annotations

import dataclasses
import os

import pytest

import ssdr
from ssdr import FormatError, InputError

MESHES = ["obj", "ply"]
SUFFIXES = [*MESHES, "glb", "npz", "npy", "pc2", "mdd", "gltf", "usda", "usdc", "abc", "fbx"]
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
    ssdr.save(first, tmp_path / f"m_1.{suffix}")
    make(tmp_path / f"m_2.{suffix}")
    for path in (tmp_path, tmp_path / f"m_%d.{suffix}", tmp_path / f"m_*.{suffix}"):
        with pytest.raises(FormatError, match=rf"m_2\.{suffix}: a device, a pipe or a socket"):
            ssdr.load(path)


@needs_pipes
@pytest.mark.parametrize("make", ENDLESS, ids=["pipe", "device"])
def test_a_companion_that_is_a_pipe_or_a_device_is_not_opened(make, tmp_path):
    ssdr.save(ssdr.samples.load("dancer_small"), tmp_path / "a.npy")
    (tmp_path / "a.faces.npy").unlink()
    for name in ("a.faces.npy", "a.obj", "m.npz"):
        make(tmp_path / name)
    with pytest.raises(InputError, match="faces: expected"):
        ssdr.load(tmp_path / "a.npy")
    for faces in ("a.faces.npy", "m.npz"):
        with pytest.raises(FormatError, match="a device, a pipe or a socket"):
            ssdr.load(tmp_path / "a.npy", faces=tmp_path / faces)
