"""zarr."""

from __future__ import annotations

import os
import struct

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


def test_zarr_shapes_are_not_believed(tmp_path):
    zarr = pytest.importorskip("zarr")
    for name, shape, step in (("a", (10**9, 2, 3), 1), ("b", (10**9, 2, 3), 10**9)):
        path = tmp_path / f"{name}.zarr"
        zarr.create_array(path, shape=shape, chunks=(step, 2, 3), dtype="f4", compressors=None)
        with pytest.raises(FormatError, match=r"holds 0 of \d+ chunks of the shape \(1000000000,"):
            ssdr.load(path, faces="none")
    (path / "c" / "0" / "0").mkdir(parents=True)
    (path / "c" / "0" / "0" / "0").write_bytes(b"few")
    with pytest.raises(FormatError, match="a chunk needs 24000000000 bytes, above the limit of"):
        ssdr.load(path, faces="none")
    group = zarr.create_group(store=tmp_path / "g.zarr")
    group.create_array("points", data=np.zeros(3))
    with pytest.raises(FormatError, match="no array vertices; it holds"):
        ssdr.load(tmp_path / "g.zarr")


def test_a_chunk_that_is_missing_is_not_zeros(tmp_path, wave):
    pytest.importorskip("zarr")
    still = ssdr.MeshSequence(np.zeros((4, 12, 3), dtype=np.float32), wave.faces)
    ssdr.save(still, tmp_path / "a.zarr")  # a chunk of zeros is written
    same_sequence(ssdr.load(tmp_path / "a.zarr"), still)
    (tmp_path / "a.zarr" / "vertices" / "c" / "0" / "0" / "0").unlink()
    with pytest.raises(FormatError, match="holds 0 of 1 chunks"):
        ssdr.load(tmp_path / "a.zarr")


def zstd(*frames):
    """Frames of zeros, each as (bytes, bytes that its header states), in blocks of one byte."""
    data = b""
    for size, stated in frames:
        blocks, rest = divmod(size, 1 << 17)
        heads = [(1 << 17) << 3 | 2] * blocks + [rest << 3 | 3]
        data += struct.pack("<IBBQ", 0xFD2FB528, 0xC0, 0x38, stated)
        data += b"".join(struct.pack("<I", head)[:3] + b"\0" for head in heads)
    return data


@pytest.mark.parametrize(
    ("chunk", "says"),
    [
        (zstd((72, 72)), ""),
        (zstd((60, 60), (12, 12)), ""),
        (zstd((72, 72))[:-2], r"a\.zarr"),
        (zstd((3_000_000_000, 3_000_000_000)), "3000000000 bytes, inflated 32761-fold"),
        (zstd((72, 72), (3_000_000_000, 3_000_000_000)), "3000000072 bytes, inflated"),
        (zstd((3_000_000_000, 72)), r"a\.zarr"),
        (zstd((72, 3_000_000_000)), "3000000000 bytes, inflated"),
        (b"nonsense", "no zstd frame"),
        (b"", r"a\.zarr"),
    ],
    ids=["whole", "two", "cut", "bomb", "second", "more", "less", "text", "empty"],
)
def test_a_chunk_inflates_to_its_size_and_no_more(tmp_path, chunk, says):
    """A chunk of 92 KB took 3 GB for the shape (2, 3, 3)."""
    zarr = pytest.importorskip("zarr")
    path = tmp_path / "a.zarr"
    zarr.create_array(path, shape=(2, 3, 3), chunks=(2, 3, 3), dtype="f4")
    (path / "c" / "0" / "0").mkdir(parents=True)
    (path / "c" / "0" / "0" / "0").write_bytes(chunk)
    if says:
        with pytest.raises(FormatError, match=says):
            ssdr.load(path, faces="none")
    else:
        assert not ssdr.load(path, faces="none").frames(0).any()


@pytest.mark.parametrize("kind", ["blosc", "none", "v2", "gzip", "shards", "two codecs"])
def test_chunks_of_other_programs(tmp_path, wave, kind):
    zarr = pytest.importorskip("zarr")
    from zarr.codecs import BloscCodec, GzipCodec, ZstdCodec

    options = {
        "blosc": {"compressors": BloscCodec()},
        "none": {"compressors": None},
        "v2": {"zarr_format": 2},
        "gzip": {"compressors": GzipCodec()},
        "shards": {"shards": wave.vertices.shape},
        "two codecs": {"compressors": [ZstdCodec(), BloscCodec()]},
    }
    path = tmp_path / "a.zarr"
    chunks = (2, *wave.vertices.shape[1:])
    zarr.create_array(path, data=wave.vertices, chunks=chunks, **options[kind])
    if kind in ("blosc", "none", "v2"):
        same_sequence(ssdr.load(path, faces=wave.faces, fps=25), wave)
    else:
        with pytest.raises(FormatError, match=r"whole chunks by zstd or Blosc are read"):
            ssdr.load(path, faces="none")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders here")
@pytest.mark.parametrize("place", ["zarr.json", "vertices/zarr.json", "vertices/c/0/0/0", "x"])
@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_pipes_and_devices_in_a_store_are_refused_at_once(tmp_path, wave, place, kind):
    """A pipe was waited for, an endless device read until memory ended."""
    pytest.importorskip("zarr")
    ssdr.save(wave, tmp_path / "a.zarr")
    inside = tmp_path / "a.zarr" / place
    inside.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(inside)
    else:
        inside.symlink_to("/dev/zero" if kind == "device" else tmp_path)
    with pytest.raises(FormatError, match=r"a device, a pipe or a socket|a link to a folder"):
        ssdr.load(tmp_path / "a.zarr")
