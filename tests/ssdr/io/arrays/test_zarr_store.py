"""zarr."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
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


def test_a_chunk_that_is_missing_is_not_zeros(tmp_path, wave):
    pytest.importorskip("zarr")
    still = ssdr.MeshSequence(np.zeros((4, 12, 3), dtype=np.float32), wave.faces)
    ssdr.save(still, tmp_path / "a.zarr")  # a chunk of zeros is written
    same_sequence(ssdr.load(tmp_path / "a.zarr"), still)
    (tmp_path / "a.zarr" / "vertices" / "c" / "0" / "0" / "0").unlink()
    with pytest.raises(FormatError, match="holds 0 of 1 chunks"):
        ssdr.load(tmp_path / "a.zarr")


@pytest.mark.parametrize("kind", ["blosc", "none", "v2"])
def test_chunks_of_other_programs(tmp_path, wave, kind):
    zarr = pytest.importorskip("zarr")
    from zarr.codecs import BloscCodec

    options = {
        "blosc": {"compressors": BloscCodec()},
        "none": {"compressors": None},
        "v2": {"zarr_format": 2},
    }
    path = tmp_path / "a.zarr"
    chunks = (2, *wave.vertices.shape[1:])
    zarr.create_array(path, data=wave.vertices, chunks=chunks, **options[kind])
    same_sequence(ssdr.load(path, faces=wave.faces, fps=25), wave)
