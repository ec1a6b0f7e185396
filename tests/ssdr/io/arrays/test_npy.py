"""npy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.surfaces import same_sequence
from ssdr import FormatError, InputError


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


def test_npy_says_where_its_faces_are(tmp_path, wave):
    assert "clip.faces.npy" in str(ssdr.save(wave, tmp_path / "clip.npy").notes)
