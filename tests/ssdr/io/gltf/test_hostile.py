"""Damaged and hostile glTF files are refused, by name and before they take memory."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import tracemalloc

import numpy as np
import pytest

import ssdr
from helpers.glb import rebuild
from helpers.gltf_asset import make_asset
from helpers.rig_model import tube


def _put(section, index, **fields):
    return lambda document, _: document[section][index].update(fields)


def _set(**fields):
    return lambda document, _: document.update(fields)


def _bytes(number_of, replacement, offset=0):
    """Overwrite bytes of the view of an accessor."""

    def change(document, binary):
        primitive = document["meshes"][0]["primitives"][0]
        accessor = document["accessors"][number_of(primitive)]
        start = document["bufferViews"][accessor["bufferView"]]["byteOffset"] + offset
        binary[start : start + len(replacement)] = replacement

    return change


def _nothing(count):
    """Positions without data."""

    def change(document, _):
        positions = document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
        document["accessors"][positions] = {"componentType": 5126, "type": "VEC3", "count": count}

    return change


def _last_key(document, binary):
    accessor = document["accessors"][document["animations"][0]["samplers"][0]["input"]]
    stop = document["bufferViews"][accessor["bufferView"]]["byteOffset"] + 4 * accessor["count"]
    binary[stop - 4 : stop] = np.float32(3e7).tobytes()
    del document["animations"][0]["extras"]


def _nested(document, _):
    """2,000 nodes that hang on each other, the first of which moves over 9,600 frames."""
    nodes, animation = document["nodes"], document["animations"][0]
    first = len(nodes)
    nodes += [{"children": [first + k + 1]} for k in range(2000)] + [{"mesh": 0}]
    document["scenes"][0]["nodes"].append(first)
    animation["channels"].append({"sampler": 0, "target": {"node": first, "path": "translation"}})
    animation["extras"]["ssdr"]["frames"] = 9600


def _beside(document, binary):
    """The same nodes, each of which holds the mesh and moves for itself."""
    _nested(document, binary)
    nodes, animation = document["nodes"], document["animations"][0]
    first = len(nodes) - 2001
    document["scenes"][0]["nodes"] += range(first + 1, first + 2001)
    for k in range(first, first + 2001):
        nodes[k] = {"mesh": 0}
        target = {"node": k, "path": "translation"}
        animation["channels"].append({"sampler": 0, "target": target})


def _frames(count):
    return _put("animations", 0, extras={"ssdr": {"fps": 24, "frames": count}})


HOSTILE = {
    "a joint beyond the skin": (
        _bytes(lambda p: p["attributes"]["JOINTS_0"], b"\xfa"),
        "joint 250 of a skin of 5",
    ),
    "an index beyond the vertices": (
        _bytes(lambda p: p["indices"], b"\xfe\xff"),
        "index 65534 into",
    ),
    "NaN": (_bytes(lambda p: 0, np.float32(np.nan).tobytes()), "NaN or Inf"),
    "a count beyond the data": (_put("accessors", 0, count=10**4), "do not fit"),
    "a huge count": (_put("accessors", 0, count=10**12), r"elements needs 2400000000\d+ bytes"),
    "80 million vertices without data": (_nothing(80_000_000), "POSITION of 80000000 elements"),
    "frames without data": (_frames(200_000_000), "200000000 frames at 24 per second needs"),
    "frames without end": (_frames(10**12), "max_bytes"),
    "times beyond float64": (
        _put("animations", 0, extras={"ssdr": {"fps": 1e-308, "frames": 100}}),
        "100 frames at 1e-308 per second from",
    ),
    "a last key after a year": (_last_key, "720000001 frames at 24 per second needs"),
    "nested nodes over many frames": (_nested, "nodes over 9600 frames needs"),
    "nodes beside each other over many frames": (_beside, "nodes over 9600 frames needs"),
    "a negative offset": (
        _put("bufferViews", 0, byteOffset=-4),
        "byteOffset of bufferView 0 is -4",
    ),
    "an offset that is text": (_put("bufferViews", 0, byteOffset="4"), "byteOffset .* is '4'"),
    "a view beyond the buffer": (_put("bufferViews", 0, byteLength=10**9), "ends at byte"),
    "a cycle": (_put("nodes", 2, children=[1]), "its own ancestor"),
    "two parents": (_put("nodes", 0, children=[3]), "two parents"),
    "a missing joint": (_put("skins", 0, joints=[999]), "none of the 7 nodes"),
    "no joints": (_put("skins", 0, joints=[]), "no joints"),
    "a missing mesh": (_put("nodes", 0, mesh=7), "mesh 7 is none of the 1 meshes"),
    "a bool for an index": (_put("nodes", 0, mesh=True), "mesh True is none of"),
    "nodes that are no list": (_set(nodes=3), "nodes is not a list"),
    "a node that is no object": (
        lambda d, _: d["nodes"].__setitem__(0, 3),
        "nodes is not a list of objects",
    ),
    "an unknown extension": (
        _set(extensionsRequired=["KHR_texture_basisu"]),
        "requires KHR_texture_basisu",
    ),
    "version 1": (_set(asset={"version": "1.0"}), "version 1.0"),
    "no mesh": (lambda d, _: d["nodes"][0].pop("mesh"), "holds no mesh"),
    "keys of another kind": (
        lambda d, _: d["animations"][0]["samplers"][0].update(input=0),
        "key times is 'VEC3'",
    ),
    "a lazy buffer": (_put("buffers", 0, byteLength=10**9), "states 1000000000"),
    "an escape": (_put("buffers", 0, uri="../../etc/passwd"), "outside"),
    "a web address": (_put("buffers", 0, uri="http://x/y"), "outside"),
    "a bad data URI": (_put("buffers", 0, uri="data:;base64,???"), "data URI"),
}


@pytest.mark.parametrize("change", [_nested, _beside])
def test_nodes_are_refused_before_they_take_memory(tmp_path, change):
    ssdr.save(tube(frames=3), tmp_path / "a.glb")
    path = rebuild(tmp_path / "a.glb", tmp_path / "b.glb", change)
    for function in (ssdr.load, ssdr.load_skinning):
        tracemalloc.start()
        try:
            with pytest.raises(ssdr.FormatError, match="nodes over 9600 frames needs"):
                function(path)
            assert tracemalloc.get_traced_memory()[1] < 32 << 20
        finally:
            tracemalloc.stop()


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_files(tmp_path, case):
    change, message = HOSTILE[case]
    ssdr.save(tube(frames=3), tmp_path / "a.glb")
    path = rebuild(tmp_path / "a.glb", tmp_path / "b.glb", change)
    for function in (ssdr.load, ssdr.load_skinning):
        with pytest.raises(ssdr.FormatError, match=message) as caught:
            function(path)
        assert "b.glb" in str(caught.value)
    with pytest.raises((ssdr.FormatError, ssdr.InputError)):
        ssdr.save(tube(frames=3), tmp_path / "c.gltf", template=path)


@pytest.mark.parametrize("depth", [500, 990, 100_000])
def test_json_that_is_nested_deeply_is_read_or_refused(tmp_path, depth):
    source = make_asset(tmp_path / "all.gltf")
    text = source.read_text()
    source.write_text(text[:-1] + ', "deep": ' + '{"extras":' * depth + "1" + "}" * depth + "}")
    with contextlib.suppress(ssdr.FormatError):
        model = dataclasses.replace(ssdr.load_skinning(source), shapes=None)
        ssdr.save(model, tmp_path / "b.gltf", template=source)


IMAGES = {
    "a\0b.png": "is missing",
    "a" * 100_000: "is missing",
    "../p.png": "lies outside",
    "pipe.png": "is missing",
    "endless.png": "lies outside",
    "http://x/p.png": "lies outside",
    7: "is missing",
}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders here")
@pytest.mark.parametrize("uri", IMAGES, ids=[str(uri)[:12].replace("\0", "0") for uri in IMAGES])
@pytest.mark.parametrize("what", ["images", "buffers"])
def test_files_that_a_file_names_are_files_of_its_folder(tmp_path, uri, what):
    source = make_asset(tmp_path / "all.gltf")
    model = dataclasses.replace(ssdr.load_skinning(source), shapes=None)
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "endless.png").symlink_to("/dev/zero")
    document = json.loads(source.read_text())
    document[what][0]["uri"] = uri
    source.write_text(json.dumps(document))
    for target in ("b.glb", "b.gltf"):
        with pytest.raises(ssdr.FormatError, match=r"all\.gltf: .*" + IMAGES[uri] + "|no text"):
            ssdr.save(model, tmp_path / target, template=source)
    with pytest.raises(ssdr.FormatError, match=r"all\.gltf"):
        ssdr.load(source)


@pytest.mark.parametrize("number", ["1e999", "-1e999", "NaN", "9" * 5000])
def test_numbers_that_are_none_are_refused(tmp_path, number):
    source = make_asset(tmp_path / "all.gltf")
    source.write_text(source.read_text().replace("0.7", number, 1))
    for read in (ssdr.load, ssdr.list_clips):
        with pytest.raises(ssdr.FormatError, match=r"all\.gltf"):
            read(source)


def test_mislabelled(tmp_path):
    for content in (b"PK\x03\x04" * 20, b"[" * 100_000, b"{}", b"\xff" * 64):
        for name in ("b.glb", "b.gltf"):
            (tmp_path / name).write_bytes(content)
            with pytest.raises(ssdr.FormatError, match=name):
                ssdr.load(tmp_path / name)
