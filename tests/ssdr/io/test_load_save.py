"""Loading and saving: options, missing files, welding."""

from __future__ import annotations

import logging
import types
from pathlib import Path

import numpy as np
import pytest

import ssdr
from ssdr import InputError


@pytest.mark.parametrize("name", ["a.npz", "a.npy", "a.obj", "a.pc2", "a.zarr", "f_%03d.obj", "f*"])
def test_missing_files_are_missing(tmp_path, name):
    with pytest.raises(FileNotFoundError):
        ssdr.load(tmp_path / name)


@pytest.mark.parametrize("suffix", [".abc", ".fbx", ".mdd", ".npy", ".npz", ".pc2", ".usd"])
def test_a_folder_that_is_called_like_a_file_is_none(tmp_path, suffix):
    (tmp_path / f"a{suffix}").mkdir()
    with pytest.raises(ssdr.FormatError, match=rf"a\{suffix}: a folder, not a file"):
        ssdr.load(tmp_path / f"a{suffix}")


def test_options_are_checked(tmp_path, wave):
    ssdr.save(wave, tmp_path / "a.npz")
    with pytest.raises(
        InputError, match=r"options: expected clip, fps, mmap, max_bytes .*got faces"
    ):
        ssdr.load(tmp_path / "a.npz", faces="b.obj")
    with pytest.raises(
        InputError, match=r"options: expected compress .*units and up for all.*got level"
    ):
        ssdr.save(wave, tmp_path / "a.npz", level=3)
    for fps in (0, -1, np.nan, "24", True):
        with pytest.raises(InputError, match="fps: expected a positive number"):
            ssdr.load(tmp_path / "a.npz", fps=fps)
    assert ssdr.load(tmp_path / "a.npz", fps=12).fps == 12


def test_a_result_is_saved_as_its_skinning(tmp_path, skinned):
    ssdr.save(types.SimpleNamespace(skinning=skinned), tmp_path / "s.npz")
    np.testing.assert_array_equal(ssdr.load_skinning(tmp_path / "s.npz").rest, skinned.rest)


def test_real_sequences_load_as_they_are(real, data_dir):
    for name in ("fox", "ea_bone", "mannequin_rumba"):
        with np.load(data_dir / f"{name}.npz") as archive:
            sequence = real(name)
            np.testing.assert_array_equal(sequence.vertices, archive["vertices"], strict=True)
            np.testing.assert_array_equal(sequence.faces, archive["faces"])
            assert sequence.fps == archive["fps"]


@pytest.mark.parametrize("suffix", ["pc2", "mdd"])
def test_results_go_back_to_the_mesh_before_welding(tmp_path, seam, suffix):
    welded, _ = seam.weld()
    path = tmp_path / f"a.{suffix}"
    assert "15 welded vertices" in str(ssdr.save(welded, path).notes)
    assert ssdr.save(welded, path, unweld=True).notes == ()
    back = ssdr.load(path, faces=seam)
    np.testing.assert_array_equal(back.vertices, seam.vertices, strict=True)
    with pytest.raises(InputError, match=r"^unweld"):
        ssdr.save(seam, path, unweld=True)


def test_load_welds_on_request(tmp_path, seam, caplog):
    ssdr.save(seam, tmp_path / "a.npz")
    with caplog.at_level(logging.INFO, "ssdr"):
        welded = ssdr.load(tmp_path / "a.npz", weld=True)
    assert "welded 18 vertices to 15" in caplog.text
    np.testing.assert_array_equal(welded.unweld(welded.vertices, axis=1), seam.vertices)


def test_a_path_that_no_file_can_have_is_refused(wave):
    for act in (ssdr.load, ssdr.load_skinning, lambda path: ssdr.save(wave, path)):
        for path in ("a\0.npz", b"a.npz", 3):
            with pytest.raises(InputError, match="path: expected a path"):
                act(path)


def test_a_mesh_without_triangles_is_no_mesh_to_other_programs(tmp_path, wave):
    points = ssdr.MeshSequence(wave.vertices)
    model = ssdr.initialize(points, bones=2)
    for name, thing in (("a.glb", model), ("a_%d.obj", points), ("a_%d.ply", points)):
        assert "has no triangles: programs show points" in str(
            ssdr.save(thing, tmp_path / name).notes
        )
    for name, thing in (("b.npz", model), ("b.npz", points)):
        assert "triangles" not in str(ssdr.save(thing, tmp_path / name).notes)
    assert "triangles" not in str(
        ssdr.save(ssdr.initialize(wave, bones=2), tmp_path / "b.glb").notes
    )


def test_the_mesh_of_vertices_is_read_after_the_options_are_checked(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    ssdr.save(ssdr.samples.load("dancer_small"), tmp_path / "%d.obj")
    (tmp_path / "0.obj").rename(path)
    with pytest.raises(ssdr.InputError, match=r"^options: .* got faces"):
        ssdr.load(path, faces="missing.glb")
    np.save(tmp_path / "v.npy", np.zeros((2, 3, 3)))
    with pytest.raises(FileNotFoundError, match=r"missing\.glb"):
        ssdr.load(tmp_path / "v.npy", faces="missing.glb")
