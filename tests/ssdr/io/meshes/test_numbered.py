"""Numbered meshes go round, and follow what other programs write."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from ssdr import FormatError, MeshSequence


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_numbered_meshes_are_found_by_patterns(tmp_path, wave, suffix):
    vertices = np.tile(wave.vertices, (4, 1, 1))[:13]
    sequence = MeshSequence(vertices, wave.faces, 24.0)
    ssdr.save(sequence, tmp_path / "out" / f"frame_%02d.{suffix}")
    files = sorted((tmp_path / "out").iterdir())
    assert [f.name for f in files] == [f"frame_{k:02d}.{suffix}" for k in range(13)]
    for pattern in ("", f"frame_%02d.{suffix}", f"frame_*.{suffix}", "frame_*", "*"):
        back = ssdr.load(tmp_path / "out" / pattern)
        np.testing.assert_array_equal(back.vertices.astype(np.float32), vertices)
    one = ssdr.load(files[3])
    assert one.n_frames == 1


def test_files_come_in_natural_order_and_gaps_are_told(tmp_path):
    for number in (1, 2, 10, 11, 9):
        (tmp_path / f"m{number}.obj").write_text(f"v {number} 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.warns(ssdr.SsdrWarning, match="6 frames are missing, after 2: those after"):
        sequence = ssdr.load(tmp_path)
    assert sequence.vertices[:, 0, 0].tolist() == [1, 2, 9, 10, 11]
    assert ssdr.load(tmp_path / "m%02d.obj").n_frames == 2
    (tmp_path / "m01.obj").write_text("v 1 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(FormatError, match="have the same number"):
        ssdr.load(tmp_path)
    (tmp_path / "m3.ply").write_text("")
    with pytest.raises(FormatError, match=r"files of \.obj, \.ply"):
        ssdr.load(tmp_path)


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_frames_of_a_longer_animation_that_are_left_are_told(tmp_path, wave, suffix):
    path = tmp_path / f"f_%03d.{suffix}"
    ssdr.save(wave, path)
    ssdr.save(wave, path)  # all of them overwritten
    shorter = MeshSequence(wave.vertices[:2], wave.faces)
    with pytest.warns(ssdr.SsdrWarning, match=f"lie 2 older ones of such names, as f_002.{suffix}"):
        ssdr.save(shorter, path)


def test_topology_must_agree(tmp_path):
    a = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 3 4\n"
    (tmp_path / "f1.obj").write_text(a)
    for text, says in (
        (a + "v 2 2 2\n", r"f2\.obj: 5 vertices, but f1\.obj has 4"),
        (a + "f 1 2 4\n", r"f2\.obj: 3 faces, but f1\.obj has 2"),
        (a.replace("f 2 3 4", "f 2 4 3"), r"triangle 1 is \(1, 3, 2\), in f1\.obj it is \(1, 2, 3"),
    ):
        (tmp_path / "f2.obj").write_text(text)
        with pytest.raises(FormatError, match=says):
            ssdr.load(tmp_path)
    relative = a.replace("f 1 2 3", "f -4 2 -2")
    (tmp_path / "f2.obj").write_text(relative)
    assert ssdr.load(tmp_path).n_frames == 2


def test_trimesh_agrees(tmp_path, wave):
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh(wave.vertices[0], wave.faces, process=False)
    for suffix in ("obj", "ply"):
        mesh.export(tmp_path / f"a.{suffix}")
        back = ssdr.load(tmp_path / f"a.{suffix}")
        np.testing.assert_allclose(back.vertices[0], wave.vertices[0], rtol=0, atol=1e-7)
        np.testing.assert_array_equal(back.faces, wave.faces)
    for suffix in ("obj", "ply"):
        ssdr.save(wave, tmp_path / f"b_%d.{suffix}")
        back = trimesh.load(tmp_path / f"b_2.{suffix}", process=False)
        np.testing.assert_allclose(back.vertices, wave.vertices[2], rtol=0, atol=1e-7)
        np.testing.assert_array_equal(back.faces, wave.faces)
