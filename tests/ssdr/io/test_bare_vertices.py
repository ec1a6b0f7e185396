"""Vertices without faces, as .npy and point caches: the mesh comes from anywhere."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.surfaces import same_sequence
from ssdr import FormatError, InputError


@pytest.mark.parametrize("mmap", [False, True])
@pytest.mark.parametrize("suffix", ["npy", "pc2", "mdd"])
def test_faces_come_from_anywhere(tmp_path, wave, suffix, mmap):
    path = tmp_path / f"clip.{suffix}"
    report = ssdr.save(wave, path)
    assert report.error == 0
    if suffix == "npy":
        assert "clip.faces.npy" in str(report.notes)
        same_sequence(ssdr.load(path, fps=25), wave)
        (tmp_path / "clip.faces.npy").rename(tmp_path / "faces.npy")
    np.save(tmp_path / "faces.npy", wave.faces)
    with pytest.raises(InputError, match=r"faces: expected a mesh, .*clip\.obj beside"):
        ssdr.load(path)
    mesh = dataclasses.replace(wave, vertices=wave.vertices[:1])
    ssdr.save(mesh, tmp_path / "clip.obj")
    ssdr.save(wave, tmp_path / "mesh.npz")
    for faces in (
        *(None, wave, wave.faces, wave.faces.tolist()),
        *(tmp_path / "clip.obj", str(tmp_path / "mesh.npz"), tmp_path / "faces.npy"),
    ):
        back = ssdr.load(path, faces=faces, mmap=mmap, fps=None if suffix == "mdd" else 25)
        same_sequence(back, wave, strict=not mmap)
        assert back.is_lazy == mmap
        np.testing.assert_array_equal(back.frames(2), wave.frames(2), strict=True)
    assert len(ssdr.load(path, faces="none").faces) == 0
    for wrong, text in (
        (wave.faces + 1, r"^faces: expected indices from 0 to 11"),
        (ssdr.MeshSequence(wave.vertices[:, 1:]), "^faces: expected a mesh of 12 vertices, got 11"),
    ):
        with pytest.raises(InputError, match=text):
            ssdr.load(path, faces=wrong)
    ssdr.save(ssdr.MeshSequence(wave.vertices[:, :-1]), path)
    (tmp_path / "clip.faces.npy").unlink(missing_ok=True)
    with pytest.raises(FormatError, match=rf"clip\.{suffix}: 11 vertices, but .*clip\.obj has 12"):
        ssdr.load(path)
