"""Mesh sequences: what they refuse, read lazily and keep; welding against a naive twin."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers import naive
from ssdr import InputError, MeshSequence

FACES = np.array([[0, 1, 2]])


def frames(n_frames=2, n_vertices=4, dtype=np.float64):
    return np.arange(n_frames * n_vertices * 3, dtype=dtype).reshape(n_frames, n_vertices, 3)


class Counted:
    """A lazy array that records how many frames were read at once."""

    def __init__(self, array):
        self.array = array
        self.shape, self.dtype = array.shape, array.dtype
        self.largest = 0

    def __getitem__(self, key):
        block = self.array[key]
        self.largest = max(self.largest, len(block) if isinstance(key, slice) else 1)
        return block


@pytest.mark.parametrize(
    ("given_dtype", "kept"),
    [
        (np.float32, np.float32),
        (np.float64, np.float64),
        (np.float16, np.float32),
        (np.int16, np.float64),
        (np.uint8, np.float64),
        (">f4", np.float32),
        (">f8", np.float64),
    ],
)
def test_precision_is_kept(given_dtype, kept):
    array = frames().astype(given_dtype)
    sequence = MeshSequence(array, FACES)
    assert sequence.vertices.dtype == np.dtype(kept)
    assert sequence.vertices.dtype.isnative
    np.testing.assert_array_equal(sequence.vertices, array)
    assert sequence.faces.dtype == np.int32


def test_nothing_is_copied_or_changed_on_the_way_in():
    array = frames(dtype=np.float32)
    assert np.shares_memory(MeshSequence(array, FACES).vertices, array)
    assert len(MeshSequence(array).faces) == 0


def test_chunks_cover_the_frames_in_order():
    array = frames(7, 4)
    pieces = list(MeshSequence(array).chunks(max_bytes=2 * 4 * 3 * 8))
    assert [start for start, _ in pieces] == [0, 2, 4, 6]
    np.testing.assert_array_equal(np.concatenate([block for _, block in pieces]), array)
    assert [len(block) for _, block in MeshSequence(array).chunks(max_bytes=1)] == [1] * 7


def test_lazy_frames_are_read_by_chunks_only(monkeypatch):
    monkeypatch.setattr("ssdr.mesh.sequence._CHUNK_BYTES", 2 * 4 * 3 * 8)
    source = Counted(frames(9, 4))
    sequence = MeshSequence(source, FACES)
    assert source.largest == 2
    assert sequence.is_lazy
    assert not MeshSequence(frames()).is_lazy
    bad = frames(9, 4)
    bad[5, 2, 0] = np.nan
    with pytest.raises(InputError, match="frame 5, vertex 2"):
        MeshSequence(Counted(bad), FACES)
    MeshSequence(Counted(bad), FACES, validate=False)


def test_memory_maps_stay_maps(tmp_path):
    array = frames(5, 6, np.float32)
    array.astype(">f4").tofile(tmp_path / "raw")
    mapped = np.memmap(tmp_path / "raw", ">f4", "r", shape=(5, 6, 3))
    sequence = MeshSequence(mapped)
    assert isinstance(sequence.vertices, np.memmap)
    assert sequence.is_lazy
    for block in (sequence.frames(2), sequence.frames([4, 0]), next(sequence.chunks())[1]):
        assert block.dtype.isnative
        assert block.dtype == np.float32
    np.testing.assert_array_equal(sequence.frames([4, 0]), array[[4, 0]])


def test_zarr_arrays_stay_lazy(tmp_path):
    zarr = pytest.importorskip("zarr")
    array = frames(5, 6, np.float32)
    store = zarr.create_array(store=tmp_path / "a.zarr", data=array, chunks=(2, 6, 3))
    sequence = MeshSequence(store, [[0, 1, 5]])
    assert sequence.vertices is store
    assert sequence.is_lazy
    assert sequence.vertices.dtype == np.float32
    np.testing.assert_array_equal(sequence.frames(slice(1, 4)), array[1:4])
    np.testing.assert_array_equal(sequence.frames([3, 3, 0]), array[[3, 3, 0]])
    assert sequence.diagonal() == MeshSequence(array).diagonal()
    welded, _ = sequence.weld()
    np.testing.assert_array_equal(welded.vertices, array)


@pytest.mark.parametrize("lazy", [False, True])
def test_frames_reads_what_is_named(lazy):
    array = frames(5, 4)
    sequence = MeshSequence(Counted(array) if lazy else array)
    np.testing.assert_array_equal(sequence.frames(3), array[3])
    np.testing.assert_array_equal(sequence.frames(slice(1, None, 2)), array[1::2])
    np.testing.assert_array_equal(sequence.frames([4, 1]), array[[4, 1]])
    np.testing.assert_array_equal(sequence.frames(array[:, 0, 0] > 20), array[2:])
    assert len(sequence) == 5


def test_diagonal_is_that_of_the_largest_frame():
    array = np.zeros((3, 2, 3))
    array[1, 1] = 3, 4, 12
    array[2, 1] = 1, 0, 0
    assert MeshSequence(array).diagonal() == 13
    assert MeshSequence(array).diagonal() == MeshSequence(array + 7).diagonal()
    # also where its square is no number
    assert MeshSequence(1e200 * np.eye(3)[None]).diagonal() == pytest.approx(np.sqrt(3) * 1e200)


@settings(max_examples=60)
@given(st.data())
def test_weld_agrees_with_a_naive_twin(data):
    n_frames = data.draw(st.integers(1, 3))
    n_vertices = data.draw(st.integers(1, 14))
    # Few values of each coordinate: copies, near copies and copies in some frames only.
    cells = st.lists(
        st.sampled_from([0.0, -0.0, 1.0, 1.0 + 1e-4, 1.0 + 2e-4, 2.0]),
        min_size=n_frames * n_vertices * 3,
        max_size=n_frames * n_vertices * 3,
    )
    vertices = np.array(data.draw(cells)).reshape(n_frames, n_vertices, 3)
    tolerance = data.draw(st.sampled_from([0.0, 0.6e-4]))
    # The corners of a cube of side 2 fix the diagonal.
    corners = np.broadcast_to([[-1.0, -1, -1], [3, 3, 3]], (n_frames, 2, 3))
    vertices = np.concatenate([corners, vertices], axis=1)
    welded, report = MeshSequence(vertices).weld(tolerance)
    expected = naive.weld(vertices, tolerance * np.sqrt(48))
    _, keep = np.unique(expected, return_index=True)
    assert report.before == n_vertices + 2
    assert report.after == welded.n_vertices == len(keep)
    np.testing.assert_array_equal(welded.vertices, vertices[:, keep])
    np.testing.assert_array_equal(keep[welded.vertex_map], expected)


def test_weld_undoes_a_seam_and_goes_back(seam):
    welded, report = seam.weld()
    assert (report.before, report.after) == (18, 15)
    assert welded.surface is seam.surface
    assert welded.vertices.dtype == np.float32
    np.testing.assert_array_equal(
        welded.vertices[:, welded.faces], seam.vertices[:, seam.faces], strict=True
    )
    np.testing.assert_array_equal(welded.vertices[:, welded.vertex_map], seam.vertices)


def test_weld_keeps_what_parts_later(seam):
    vertices = seam.vertices.copy()
    vertices[-1, 15:] += 0.1
    parted = dataclasses.replace(seam, vertices=vertices)
    welded, report = parted.weld()
    assert report.after == 18
    np.testing.assert_array_equal(welded.vertices, vertices)


def test_weld_twice_maps_back_to_the_first_mesh(seam):
    soup = MeshSequence(
        seam.vertices[:, seam.faces.ravel()], np.arange(seam.faces.size).reshape(-1, 3)
    )
    moved = soup.vertices.astype(np.float64)
    moved[:, ::2] += 1e-9
    jittered = dataclasses.replace(soup, vertices=moved)
    once, first = jittered.weld(0.0)
    twice, second = once.weld(1e-6)
    assert first.before > first.after > second.after == 15
    assert len(twice.vertex_map) == seam.faces.size
    np.testing.assert_allclose(
        twice.vertices[:, twice.vertex_map], jittered.vertices, atol=1e-8, rtol=0
    )


def test_weld_of_many_copies_at_one_place_is_cheap():
    welded, report = MeshSequence(np.ones((2, 200_000, 3), np.float32)).weld()
    assert (report.before, report.after) == (200_000, 1)
    assert not welded.vertex_map.any()
