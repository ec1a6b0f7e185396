"""Draco and meshopt: what is compressed reads as what was compressed; damage is refused."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest

import ssdr
from helpers.glb import opened, packed, values_of
from helpers.rig_model import tube
from ssdr import FormatError, MissingDependencyError
from ssdr.io.gltf.compression import decode_view


@pytest.fixture
def plain(tmp_path):
    path = tmp_path / "plain.glb"
    ssdr.save(dataclasses.replace(tube(), surface=None), path)
    return path


def joined(path, document, blobs):
    """A .glb of these buffer views, one behind the other."""
    binary = b""
    for item, blob in zip(document["bufferViews"], blobs, strict=True):
        item["byteOffset"], item["byteLength"] = len(binary), len(blob)
        binary += blob + b"\0" * (-len(blob) % 4)
    document["buffers"] = [{"byteLength": len(binary)}]
    return packed(path, document, binary)


def split(path):
    """JSON, bytes, and the bytes of each buffer view of a .glb."""
    document, binary = opened(path)
    views = document["bufferViews"]
    return document, binary, [binary[v["byteOffset"] :][: v["byteLength"]] for v in views]


def with_draco(source, target, *, change=None):
    draco = pytest.importorskip("DracoPy", reason="DracoPy is not installed")
    document, binary, blobs = split(source)
    (primitive,) = document["meshes"][0]["primitives"]
    names = primitive["attributes"]
    # Draco would change the order of vertices and faces otherwise, and round positions.
    data = draco.encode(
        values_of(document, binary, names["POSITION"]),
        values_of(document, binary, primitive["indices"]).reshape(-1, 3).astype(np.uint32),
        quantization_bits=0,
        preserve_order=True,
        generic_attributes={
            name: values_of(document, binary, k) for name, k in names.items() if name != "POSITION"
        },
    )
    known = {
        (entry["name"] or "POSITION"): entry["unique_id"] for entry in draco.decode(data).attributes
    }
    for number in [*names.values(), primitive["indices"]]:
        document["accessors"][number].pop("bufferView")
    document["bufferViews"].append({"buffer": 0})
    primitive["extensions"] = {
        "KHR_draco_mesh_compression": {"bufferView": len(blobs), "attributes": known}
    }
    document["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    blobs.append(data)
    if change:
        change(document, blobs)
    return joined(target, document, blobs)


def with_meshopt(source, target, *, change=None, name="EXT_meshopt_compression"):
    library = pytest.importorskip("meshoptimizer", reason="meshoptimizer is not installed")
    document, binary, blobs = split(source)
    (primitive,) = document["meshes"][0]["primitives"]
    count = document["accessors"][primitive["attributes"]["POSITION"]]["count"]
    for number in [*primitive["attributes"].values(), primitive["indices"]]:
        item = document["accessors"][number]
        view = document["bufferViews"][item["bufferView"]]
        values = values_of(document, binary, number)
        assert not item.get("byteOffset")
        state = {"buffer": 0, "count": item["count"]}
        if number == primitive["indices"]:
            index = values.reshape(-1).astype(np.uint32)
            mode = "TRIANGLES"
            blob = library.encode_index_buffer(index, len(index), count)
            state |= {"mode": mode, "byteStride": values.dtype.itemsize}
        else:
            rows = values.view(np.uint8).reshape(len(values), -1)
            rows = np.pad(rows, ((0, 0), (0, -rows.shape[1] % 4)))
            words = np.ascontiguousarray(rows).view(np.float32)
            blob = library.encode_vertex_buffer(words, len(words), rows.shape[1])
            state |= {"mode": "ATTRIBUTES", "byteStride": rows.shape[1]}
            view["byteStride"] = rows.shape[1]
        state["byteLength"] = len(blob)
        blobs[item["bufferView"]] = blob
        view["extensions"] = {name: state}
    document["extensionsRequired"] = [name]
    offset = 0
    for view, blob in zip(document["bufferViews"], blobs, strict=True):
        if "extensions" in view:
            view["extensions"][name]["byteOffset"] = offset
        offset += len(blob) + -len(blob) % 4
    if change:
        change(document, blobs)
    return joined(target, document, blobs)


@pytest.mark.parametrize("compress", [with_draco, with_meshopt])
def test_compressed_reads_as_it_was(plain, tmp_path, compress):
    target = compress(plain, tmp_path / "small.glb")
    truth, found = ssdr.load_skinning(plain), ssdr.load_skinning(target)
    for name in ("rest", "indices", "weights", "transforms"):
        np.testing.assert_array_equal(getattr(found, name), getattr(truth, name), err_msg=name)
    order = np.lexsort(np.sort(found.faces, axis=1).T), np.lexsort(np.sort(truth.faces, axis=1).T)
    np.testing.assert_array_equal(
        np.sort(found.faces, axis=1)[order[0]], np.sort(truth.faces, axis=1)[order[1]]
    )
    sequence = ssdr.load(target)
    np.testing.assert_array_equal(sequence.vertices, ssdr.load(plain).vertices)


def test_meshopt_by_its_other_name_and_filters(plain, tmp_path):
    target = with_meshopt(plain, tmp_path / "a.glb", name="KHR_meshopt_compression")
    assert ssdr.load(target).n_vertices == ssdr.load(plain).n_vertices
    library = pytest.importorskip("meshoptimizer")
    # mantissa in 24 bits, exponent in 8: 3 · 2^-1 is 1.5
    words = np.full((4, 3), (255 << 24) | 3, dtype=np.uint32)
    blob = library.encode_vertex_buffer(words.view(np.float32), 4, 12)
    values = decode_view(blob, 4, 12, "ATTRIBUTES", "EXPONENTIAL", plain)
    np.testing.assert_array_equal(np.frombuffer(values, dtype=np.float32), 1.5)
    with pytest.raises(FormatError, match="the filter 'OCTAHEDRAL' on elements of 12"):
        decode_view(blob, 4, 12, "ATTRIBUTES", "OCTAHEDRAL", plain)
    with pytest.raises(FormatError, match="mode 'POINTS'"):
        decode_view(blob, 4, 12, "POINTS", "NONE", plain)
    index = library.encode_index_sequence(np.array([5, 3, 1], np.uint32), 3, 6)
    found = np.frombuffer(decode_view(index, 3, 2, "INDICES", "NONE", plain), dtype="<u2")
    assert found.tolist() == [5, 3, 1]

    def claim(document, _):
        views = [v for v in document["bufferViews"] if "extensions" in v]
        views[0]["extensions"]["EXT_meshopt_compression"]["count"] = 1 << 40

    with pytest.raises(FormatError, match="decompressed, needs"):
        ssdr.load(with_meshopt(plain, tmp_path / "b.glb", change=claim))


@pytest.mark.parametrize(
    ("compress", "package"),
    [(with_draco, "DracoPy"), (with_meshopt, "meshoptimizer")],
)
def test_without_the_library_it_is_named(plain, tmp_path, monkeypatch, compress, package):
    target = compress(plain, tmp_path / "small.glb")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingDependencyError, match=rf"small\.glb.*pip install .{package}"):
        ssdr.load(target)
    with pytest.raises(MissingDependencyError, match=rf"pip install .{package}"):
        ssdr.load_skinning(target)


def test_what_is_there_without_compression_too_needs_no_library(plain, tmp_path, monkeypatch):
    document, _, blobs = split(plain)
    document["meshes"][0]["primitives"][0]["extensions"] = {
        "KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {}}
    }
    document["bufferViews"][0]["extensions"] = {"EXT_meshopt_compression": {}}
    document["extensionsUsed"] = ["KHR_draco_mesh_compression", "EXT_meshopt_compression"]
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    monkeypatch.setitem(sys.modules, "meshoptimizer", None)
    both = joined(tmp_path / "both.glb", document, blobs)
    np.testing.assert_array_equal(ssdr.load(both).vertices, ssdr.load(plain).vertices)


def emptied(document, blobs):
    for k, view in enumerate(document["bufferViews"]):
        if "extensions" in view:
            blobs[k] = bytes(len(blobs[k]))


def cut_off(_, blobs):
    blobs[-1] = blobs[-1][:30]


def counted_wrong(document, _):
    number = document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    document["accessors"][number]["count"] += 1


@pytest.mark.parametrize(
    ("compress", "change", "says"),
    [
        (with_meshopt, emptied, "cannot be decoded"),
        (with_draco, cut_off, "cannot be decoded"),
        (with_draco, counted_wrong, "POSITION: decoded to"),
    ],
)
def test_damage_is_refused(plain, tmp_path, compress, change, says):
    with pytest.raises(FormatError, match=rf"a\.glb.*{says}"):
        ssdr.load(compress(plain, tmp_path / "a.glb", change=change))
