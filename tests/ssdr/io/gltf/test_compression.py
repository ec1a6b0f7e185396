"""Draco and meshopt: what is compressed reads as what was compressed; damage is refused.

The stored files are one model: as it was written, and with its vertices and triangles encoded by
DracoPy (nothing quantised, order kept) and by meshoptimizer.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers.glb import rebuild
from ssdr import FormatError, MissingDependencyError
from ssdr.io.gltf.compression import decode_view

STORED = Path(__file__).parents[3] / "helpers" / "compressed"
PLAIN, DRACO, MESHOPT = (STORED / f"{name}.glb" for name in ("plain", "draco", "meshopt"))
PACKAGES = [(DRACO, "DracoPy"), (MESHOPT, "meshoptimizer")]
MESHOPT_NAME = "EXT_meshopt_compression"


def compressed_views(document):
    return [view for view in document["bufferViews"] if "extensions" in view]


@pytest.mark.parametrize(("path", "package"), PACKAGES)
def test_compressed_reads_as_it_was(path, package):
    pytest.importorskip(package)
    truth, found = ssdr.load_skinning(PLAIN), ssdr.load_skinning(path)
    for name in ("rest", "indices", "weights", "transforms"):
        np.testing.assert_array_equal(getattr(found, name), getattr(truth, name), err_msg=name)
    order = np.lexsort(np.sort(found.faces, axis=1).T), np.lexsort(np.sort(truth.faces, axis=1).T)
    np.testing.assert_array_equal(
        np.sort(found.faces, axis=1)[order[0]], np.sort(truth.faces, axis=1)[order[1]]
    )
    np.testing.assert_array_equal(ssdr.load(path).vertices, ssdr.load(PLAIN).vertices)


def test_meshopt_by_its_other_name_and_filters(tmp_path):
    library = pytest.importorskip("meshoptimizer")

    def rename(document, _):
        for view in compressed_views(document):
            view["extensions"] = {"KHR_meshopt_compression": view["extensions"][MESHOPT_NAME]}
        document["extensionsRequired"] = ["KHR_meshopt_compression"]

    renamed = rebuild(MESHOPT, tmp_path / "a.glb", rename)
    np.testing.assert_array_equal(ssdr.load(renamed).vertices, ssdr.load(PLAIN).vertices)
    # mantissa in 24 bits, exponent in 8: 3 · 2^-1 is 1.5
    words = np.full((4, 3), (255 << 24) | 3, dtype=np.uint32)
    blob = library.encode_vertex_buffer(words.view(np.float32), 4, 12)
    values = decode_view(blob, 4, 12, "ATTRIBUTES", "EXPONENTIAL", PLAIN)
    np.testing.assert_array_equal(np.frombuffer(values, dtype=np.float32), 1.5)
    with pytest.raises(FormatError, match="the filter 'OCTAHEDRAL' on elements of 12"):
        decode_view(blob, 4, 12, "ATTRIBUTES", "OCTAHEDRAL", PLAIN)
    with pytest.raises(FormatError, match="mode 'POINTS'"):
        decode_view(blob, 4, 12, "POINTS", "NONE", PLAIN)
    index = library.encode_index_sequence(np.array([5, 3, 1], np.uint32), 3, 6)
    found = np.frombuffer(decode_view(index, 3, 2, "INDICES", "NONE", PLAIN), dtype="<u2")
    assert found.tolist() == [5, 3, 1]


@pytest.mark.parametrize(("path", "package"), PACKAGES)
def test_without_the_library_it_is_named(monkeypatch, path, package):
    monkeypatch.setitem(sys.modules, package, None)
    for read in (ssdr.load, ssdr.load_skinning):
        with pytest.raises(MissingDependencyError, match=rf"{path.name}.*pip install .{package}"):
            read(path)


def test_what_is_there_without_compression_too_needs_no_library(tmp_path, monkeypatch):
    def add(document, _):
        document["meshes"][0]["primitives"][0]["extensions"] = {
            "KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {}}
        }
        document["bufferViews"][0]["extensions"] = {MESHOPT_NAME: {}}
        document["extensionsUsed"] = ["KHR_draco_mesh_compression", MESHOPT_NAME]

    for _, package in PACKAGES:
        monkeypatch.setitem(sys.modules, package, None)
    both = rebuild(PLAIN, tmp_path / "both.glb", add)
    np.testing.assert_array_equal(ssdr.load(both).vertices, ssdr.load(PLAIN).vertices)


def emptied(document, binary):
    for view in compressed_views(document):
        start, size = view["byteOffset"], view["byteLength"]
        binary[start : start + size] = bytes(size)


def claimed(document, _):
    compressed_views(document)[0]["extensions"][MESHOPT_NAME]["count"] = 1 << 40


def cut_off(document, _):
    document["bufferViews"][-1]["byteLength"] = 30


def counted_wrong(document, _):
    number = document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    document["accessors"][number]["count"] += 1


@pytest.mark.parametrize(
    ("path", "package", "change", "says"),
    [
        (MESHOPT, "meshoptimizer", emptied, "cannot be decoded"),
        (MESHOPT, "meshoptimizer", claimed, "decompressed, needs"),
        (DRACO, "DracoPy", cut_off, "cannot be decoded"),
        (DRACO, "DracoPy", counted_wrong, "POSITION: decoded to"),
    ],
)
def test_damage_is_refused(tmp_path, path, package, change, says):
    pytest.importorskip(package)
    with pytest.raises(FormatError, match=rf"a\.glb.*{says}"):
        ssdr.load(rebuild(path, tmp_path / "a.glb", change))
