"""Damaged and hostile glTF files are refused in words, as templates too."""

from __future__ import annotations

import contextlib
import json
import os
import tracemalloc

import numpy as np
import pytest

import ssdr
from helpers.glb import rebuild
from helpers.gltf_asset import make_asset
from helpers.refused import Refused, raw
from helpers.rig_model import tube
from ssdr import FormatError, InputError

TABLE = Refused()


def put(section, index, **fields):
    return lambda document, _: document[section][index].update(fields)


def top(**fields):
    return lambda document, _: document.update(fields)


def overwritten(number_of, replacement):
    """Bytes of the view of an accessor."""

    def change(document, binary):
        primitive = document["meshes"][0]["primitives"][0]
        accessor = document["accessors"][number_of(primitive)]
        start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
        binary[start : start + len(replacement)] = replacement

    return change


def without_data(document, _):
    positions = document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    huge = {"componentType": 5126, "type": "VEC3", "count": 80_000_000}
    document["accessors"][positions] = huge


def last_key(document, binary):
    accessor = document["accessors"][document["animations"][0]["samplers"][0]["input"]]
    stop = document["bufferViews"][accessor["bufferView"]]["byteOffset"] + 4 * accessor["count"]
    binary[stop - 4 : stop] = np.float32(3e7).tobytes()
    del document["animations"][0]["extras"]


def nested(document, _):
    """1,000 nodes that hang on each other, the first of which moves over 9,600 frames."""
    nodes, animation = document["nodes"], document["animations"][0]
    first = len(nodes)
    nodes += [{"children": [first + k + 1]} for k in range(1000)] + [{"mesh": 0}]
    document["scenes"][0]["nodes"].append(first)
    animation["channels"].append({"sampler": 0, "target": {"node": first, "path": "translation"}})
    animation["extras"]["ssdr"]["frames"] = 9600


def beside(document, binary):
    """The same nodes, each of which holds the mesh and moves for itself."""
    nested(document, binary)
    nodes, animation = document["nodes"], document["animations"][0]
    first = len(nodes) - 1001
    document["scenes"][0]["nodes"] += range(first + 1, first + 1001)
    for k in range(first, first + 1001):
        nodes[k] = {"mesh": 0}
        target = {"node": k, "path": "translation"}
        animation["channels"].append({"sampler": 0, "target": target})


def stated(**clip):
    return put("animations", 0, extras={"ssdr": {"fps": 24, **clip}})


def other_target(document, _):
    """A morph target of seven vertices."""
    document["accessors"].append({"componentType": 5126, "count": 7, "type": "VEC3"})
    number = len(document["accessors"]) - 1
    document["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": number}]


def glb(path, change):
    ssdr.save(tube(frames=3), path.with_name("whole.glb"))
    rebuild(path.with_name("whole.glb"), path, change)


JOINTS, INDICES = (lambda p: p["attributes"]["JOINTS_0"]), (lambda p: p["indices"])
GLB = {
    "a joint beyond the skin": (overwritten(JOINTS, b"\xfa"), "joint 250 of a skin of 5"),
    "an index beyond the vertices": (overwritten(INDICES, b"\xfe\xff"), "index 65534 into"),
    "NaN": (overwritten(lambda p: 0, np.float32(np.nan).tobytes()), "NaN or Inf"),
    "a count beyond the data": (put("accessors", 0, count=10**4), "do not fit"),
    "a huge count": (put("accessors", 0, count=10**12), r"elements needs 2400000000\d+ bytes"),
    "80 million vertices without data": (without_data, "POSITION of 80000000 elements"),
    "frames without data": (stated(frames=200_000_000), "200000000 frames at 24 per second needs"),
    "frames without end": (stated(frames=10**12), "max_bytes"),
    "times beyond float64": (
        stated(fps=1e-308, frames=100), "100 frames at 1e-308 per second from"),
    "a last key after a year": (last_key, "720000001 frames at 24 per second needs"),
    "nested nodes over many frames": (nested, "nodes over 9600 frames needs"),
    "nodes beside each other over many frames": (beside, "nodes over 9600 frames needs"),
    "a negative offset": (
        put("bufferViews", 0, byteOffset=-4), "byteOffset of bufferView 0 is -4"),
    "an offset that is text": (put("bufferViews", 0, byteOffset="4"), "byteOffset .* is '4'"),
    "a view beyond the buffer": (put("bufferViews", 0, byteLength=10**9), "ends at byte"),
    "a cycle": (put("nodes", 2, children=[1]), "its own ancestor"),
    "two parents": (put("nodes", 0, children=[3]), "two parents"),
    "a missing joint": (put("skins", 0, joints=[999]), "none of the 7 nodes"),
    "no joints": (put("skins", 0, joints=[]), "no joints"),
    "a missing mesh": (put("nodes", 0, mesh=7), "mesh 7 is none of the 1 meshes"),
    "a bool for an index": (put("nodes", 0, mesh=True), "mesh True is none of"),
    "nodes that are no list": (top(nodes=3), "nodes is not a list"),
    "a node that is no object": (
        lambda d, _: d["nodes"].__setitem__(0, 3), "nodes is not a list of objects"),
    "an unknown extension": (
        top(extensionsRequired=["KHR_texture_basisu"]), "requires KHR_texture_basisu"),
    "version 1": (top(asset={"version": "1.0"}), "version 1.0"),
    "of a later reader": (top(asset={"version": "2.0", "minVersion": "2.1"}), "reader of glTF 2.1"),
    "no positions": (
        lambda d, _: d["meshes"][0]["primitives"][0]["attributes"].pop("POSITION"), "no POSITION"),
    "other vertices": (other_target, "a morph target of other vertices"),
    "no mesh": (lambda d, _: d["nodes"][0].pop("mesh"), "holds no mesh"),
    "keys of another kind": (
        lambda d, _: d["animations"][0]["samplers"][0].update(input=0), "key times is 'VEC3'"),
    "a lazy buffer": (put("buffers", 0, byteLength=10**9), "states 1000000000"),
    "an escape": (put("buffers", 0, uri="../../etc/passwd"), "outside"),
    "a web address": (put("buffers", 0, uri="http://x/y"), "outside"),
    "a bad data URI": (put("buffers", 0, uri="data:;base64,???"), "data URI"),
}  # fmt: skip
TABLE.add("glb", glb, GLB, ssdr.load, ssdr.load_skinning)


def gltf(path, fields):
    raw(path, json.dumps({"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}]} | fields))


KIND = "an entry holds another kind of value"
GLTF = {
    "no attributes": ({"meshes": [{"primitives": [{}]}]}, "it has no 'attributes'"),
    "no primitives": ({"meshes": [{}]}, "it has no 'primitives'"),
    "a number for a list": ({"meshes": [{"primitives": 3}]}, KIND),
    "a text for nodes": ({"meshes": [{}], "nodes": [{"mesh": 0, "children": "ab"}]}, KIND),
}
TABLE.add("gltf", gltf, GLTF, ssdr.load, ssdr.load_skinning)


def with_number(path, number):
    raw(path, make_asset(path).read_text().replace("0.7", number, 1))


NUMBERS = {number[:9]: (number, "bad") for number in ("1e999", "-1e999", "NaN", "9" * 5000)}
TABLE.add("gltf", with_number, NUMBERS, ssdr.load, ssdr.list_clips)
OTHERS = {"a zip": b"PK\x03\x04" * 20, "brackets": b"[" * 100_000, "{}": b"{}", "255": b"\xff" * 64}
for _suffix in ("glb", "gltf"):
    TABLE.add(_suffix, raw, {what: (data, "bad") for what, data in OTHERS.items()})


# files that a file names are files of its folder
NAMED = {
    "a\0b.png": "is missing",
    "a" * 100_000: "is missing",
    "../p.png": "lies outside",
    "pipe.png": "is missing",
    "endless.png": "lies outside",
    "http://x/p.png": "lies outside",
    7: "is missing",
}


def naming(path, given):
    what, uri = given
    document = json.loads(make_asset(path).read_text())
    path.with_name("whole.gltf").write_text(json.dumps(document))
    os.mkfifo(path.with_name("pipe.png"))
    path.with_name("endless.png").symlink_to("/dev/zero")
    document[what][0]["uri"] = uri
    path.write_text(json.dumps(document))


def as_template(path):
    model = ssdr.load_skinning(path.with_name("whole.gltf")).skinning
    for target in ("b.glb", "b.gltf"):
        with pytest.raises(FormatError) as caught:
            ssdr.save(model, path.with_name(target), template=path)
    raise caught.value


for _what in ("images", "buffers"):
    _named = {
        f"{_what} {k}": ((_what, uri), rf"bad\.gltf: .*{says}|no text")
        for k, (uri, says) in enumerate(NAMED.items())
    }
    TABLE.add("gltf", naming, _named, ssdr.load, as_template)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders here")
@pytest.mark.parametrize("case", TABLE)
def test_the_file_is_refused_in_words(tmp_path, case):
    TABLE.check(case, tmp_path)


@pytest.mark.parametrize("change", [nested, beside])
def test_nodes_are_refused_before_they_take_memory(tmp_path, change):
    glb(tmp_path / "bad.glb", change)
    for function in (ssdr.load, ssdr.load_skinning):
        tracemalloc.start()
        try:
            with pytest.raises(FormatError, match="nodes over 9600 frames needs"):
                function(tmp_path / "bad.glb")
            assert tracemalloc.get_traced_memory()[1] < 32 << 20
        finally:
            tracemalloc.stop()


@pytest.mark.parametrize("case", GLB)
def test_a_hostile_template_is_refused(tmp_path, case):
    glb(tmp_path / "bad.glb", GLB[case][0])
    with pytest.raises((FormatError, InputError)):
        ssdr.save(tube(frames=3), tmp_path / "c.gltf", template=tmp_path / "bad.glb")


@pytest.mark.parametrize("depth", [500, 990, 100_000])
def test_json_that_is_nested_deeply_is_read_or_refused(tmp_path, depth):
    source = make_asset(tmp_path / "all.gltf")
    text = source.read_text()
    source.write_text(text[:-1] + ', "deep": ' + '{"extras":' * depth + "1" + "}" * depth + "}")
    with contextlib.suppress(FormatError):
        model = ssdr.load_skinning(source).skinning
        ssdr.save(model, tmp_path / "b.gltf", template=source)
