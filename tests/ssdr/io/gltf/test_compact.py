"""Compressed files for engines: what a reader decodes is what the report says."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
from scipy.spatial import cKDTree

import ssdr
from helpers.rig_model import tube
from ssdr.io.gltf.compact import coarse_rig, decoded_quaternions, encoded_quaternions, steady_slots
from ssdr.io.rig import build_rig

KINDS = ("quantized", "meshopt")


def matched(path, model):
    """Distances (F, N) of the file's vertices to the model's vertices that they come from."""
    if path is not None:
        pytest.importorskip("meshoptimizer")
    here = ssdr.load_skinning(path).skin(dtype=np.float64)
    there = model.skin(dtype=np.float64)

    def rows(frames):
        return frames.transpose(1, 0, 2).reshape(frames.shape[1], -1)

    _, near = cKDTree(rows(there)).query(rows(here))
    assert len(np.unique(near)) == model.n_vertices
    return np.linalg.norm(here - there[:, near], axis=2)


def document(path):
    data = path.read_bytes()
    return json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])


@pytest.mark.parametrize("compression", KINDS)
@pytest.mark.parametrize("tolerance", [None, "0.5%"])
def test_reader_finds_the_reported_error(tmp_path, compression, tolerance):
    model, path = tube(influences=4), tmp_path / "a.glb"
    pytest.importorskip("meshoptimizer")
    report = ssdr.save(model, path, compression=compression, tolerance=tolerance)
    found = matched(path, model)
    assert found.max() == pytest.approx(report.max_error, rel=1e-3, abs=1e-6)
    diagonal = np.linalg.norm(np.ptp(model.rest, axis=0))
    assert report.max_error <= (0.005 if tolerance else 2e-4) * diagonal
    json = document(path)
    assert "KHR_mesh_quantization" in json["extensionsRequired"]
    assert report.bytes == path.stat().st_size


def test_without_tolerance_all_keys_stay(tmp_path):
    model = tube(influences=4)
    rig, _ = coarse_rig(model, None)
    assert rig.keys.all()
    fewer, _ = coarse_rig(model, 0.02 * float(np.ptp(model.rest)))
    assert fewer.keys.sum() <= rig.keys.sum()
    assert fewer.keys[[0, -1]].all() or (fewer.keys.sum(axis=0) == 1).any()


def test_compression_makes_files_smaller(tmp_path):
    pytest.importorskip("meshoptimizer")
    model = ssdr.initialize(ssdr.samples.load("dancer_small"), bones=8)
    plain, quantized, packed, coarse = (
        ssdr.save(model, tmp_path / "a.glb", weights="uint8", **options).bytes
        for options in (
            {},
            {"compression": "quantized"},
            {"compression": "meshopt"},
            {"compression": "meshopt", "tolerance": "2%"},
        )
    )
    assert plain > quantized > packed > coarse


@pytest.mark.parametrize("bits", [6, 8, 12, 16])
def test_quaternions_of_the_filter_agree_with_the_library(bits):
    library = pytest.importorskip("meshoptimizer")
    turns = np.random.default_rng(bits).standard_normal((200, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    stored = encoded_quaternions(turns, bits)
    ours = decoded_quaternions(stored)
    theirs = library.decode_filter_quat(stored.copy(), len(stored), 8)
    theirs = np.frombuffer(theirs.tobytes(), "<i2").reshape(-1, 4) / 32767
    assert np.abs(ours - theirs).max() <= 1.01 / 32767
    off = np.minimum(np.abs(ours - turns).max(axis=1), np.abs(ours + turns).max(axis=1))
    assert off.max() < 2.5 * 2.0**-bits + 2 / 32767


def test_slots_hold_the_same_weights():
    rig = build_rig(tube(influences=4), storage="uint8")
    vertex = np.arange(len(rig.rest))[::-1]
    indices, weights = steady_slots(rig, vertex)
    for row, v in enumerate(vertex):
        ours = {(b, w) for b, w in zip(indices[row], weights[row], strict=True) if w}
        assert ours == {(b, w) for b, w in zip(rig.indices[v], rig.weights[v], strict=True) if w}


def test_what_cannot_be_held_is_refused(tmp_path):
    model = tube(influences=4)
    with pytest.raises(ssdr.InputError, match="tolerance"):
        ssdr.save(model, tmp_path / "a.glb", tolerance=0.1)
    with pytest.raises(ssdr.InputError, match="compression"):
        ssdr.save(model, tmp_path / "a.glb", compression="zip")
    with pytest.raises(ssdr.InputError, match="finer weights"):
        ssdr.save(
            model, tmp_path / "a.glb", compression="quantized", weights="uint8", tolerance=1e-9
        )
    assert not (tmp_path / "a.glb").exists()
