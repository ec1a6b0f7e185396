"""zarr."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.disks import small_files
from helpers.surfaces import same_sequence
from ssdr import FormatError, InputError


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


def test_zarr_shapes_are_not_believed(tmp_path):
    zarr = pytest.importorskip("zarr")
    zarr.create_array(
        store=tmp_path / "a.zarr", shape=(10**9, 10**6, 3), chunks=(1, 10**6, 3), dtype="f4"
    )
    with pytest.raises(FormatError, match="states 12000000000000000 bytes"):
        ssdr.load(tmp_path / "a.zarr", faces="none")
    group = zarr.create_group(store=tmp_path / "b.zarr")
    group.create_array("points", data=np.zeros(3))
    with pytest.raises(FormatError, match="no array vertices; it holds"):
        ssdr.load(tmp_path / "b.zarr")


def test_a_full_disk_is_named_by_the_store(tmp_path):
    pytest.importorskip("zarr")
    sample = ssdr.samples.load("dancer_small")
    with small_files(4000), pytest.raises(OSError, match="File too large") as caught:
        ssdr.save(sample, tmp_path / "a.zarr")
    assert caught.value.filename == str(tmp_path / "a.zarr")
    assert list(tmp_path.iterdir()) == []
