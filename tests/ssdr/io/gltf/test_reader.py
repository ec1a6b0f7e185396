"""What is read from glTF is what the file says; damage is refused."""

from __future__ import annotations

import base64
import json
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import ssdr
from helpers.rig_model import tube


def rebuild(source, target, change):
    """Write a .glb anew after `change` has edited its JSON (and perhaps its buffer)."""
    data = source.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    binary = bytearray(data[20 + length + 8 :])
    change(document, binary)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    total = 28 + len(text) + len(binary)
    target.write_bytes(
        struct.pack("<4sIII4s", b"glTF", 2, total, len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(binary), b"BIN\0")
        + bytes(binary)
    )
    return target


def hand_made(tmp_path, document, **arrays):
    """A .gltf of an accessor for each array: (values, type), in the order given."""
    kinds = {"float32": 5126, "uint16": 5123, "uint8": 5121, "int16": 5122, "int8": 5120}
    blob = b""
    document.update(accessors=[], bufferViews=[], asset={"version": "2.0"})
    for values, kind in arrays.values():
        values = np.asarray(values)
        document["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(blob), "byteLength": values.nbytes}
        )
        document["accessors"].append(
            {
                "bufferView": len(document["bufferViews"]) - 1,
                "componentType": kinds[values.dtype.name],
                "count": len(values),
                "type": kind,
                "normalized": values.dtype.kind != "f" and kind != "SCALAR",
            }
        )
        blob += values.tobytes() + b"\0" * (-values.nbytes % 4)
    uri = "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
    document["buffers"] = [{"byteLength": len(blob), "uri": uri}]
    path = tmp_path / "made.gltf"
    path.write_text(json.dumps(document))
    return path


TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32)


def channel_file(tmp_path, how, values, path="translation", kind="VEC3", **node):
    document = {
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **node}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "animations": [
            {
                "name": "only",
                "channels": [{"sampler": 0, "target": {"node": 0, "path": path}}],
                "samplers": [{"input": 1, "output": 2, "interpolation": how}],
            }
        ],
    }
    times = np.array([0, 0.5, 1], dtype=np.float32)
    return hand_made(
        tmp_path,
        document,
        p=(TRIANGLE, "VEC3"),
        t=(times, "SCALAR"),
        v=(np.asarray(values, dtype=np.float32), kind),
    )


def test_interpolations(tmp_path):
    keys = np.array([[0, 0, 0], [2, 0, 0], [3, 1, 0]], dtype=float)
    moved = {}
    for how in ("LINEAR", "STEP"):
        sequence = ssdr.load(channel_file(tmp_path, how, keys), fps=8)
        moved[how] = sequence.vertices[:, 0, 0]
    np.testing.assert_allclose(moved["LINEAR"], [0, 0.5, 1, 1.5, 2, 2.25, 2.5, 2.75, 3])
    np.testing.assert_allclose(moved["STEP"], [0, 0, 0, 0, 2, 2, 2, 2, 3])
    # Tangents of x = t^3 in every key: a cubic spline gives the cubic back.
    t = np.array([0, 0.5, 1])
    slope = np.stack([3 * t**2, 0 * t, 0 * t], axis=1)
    value = np.stack([t**3, 0 * t, 0 * t], axis=1)
    cubic = np.stack([slope, value, slope], axis=1).reshape(-1, 3)
    sequence = ssdr.load(channel_file(tmp_path, "CUBICSPLINE", cubic), fps=8)
    np.testing.assert_allclose(sequence.vertices[:, 0, 0], (np.arange(9) / 8) ** 3, atol=1e-6)
    assert ssdr.load(channel_file(tmp_path, "LINEAR", keys)).fps == 24


def test_rotation_takes_the_short_way(tmp_path):
    turn = Rotation.from_rotvec(np.deg2rad([[0, 0, 0], [0, 0, 80], [0, 0, 160]])).as_quat()
    turn[1] *= -1
    sequence = ssdr.load(channel_file(tmp_path, "LINEAR", turn, "rotation", "VEC4"), fps=8)
    angle = np.deg2rad(np.arange(9) * 20)
    np.testing.assert_allclose(sequence.vertices[:, 1, 0], np.cos(angle), atol=1e-6)
    np.testing.assert_allclose(sequence.vertices[:, 1, 1], np.sin(angle), atol=1e-6)


def test_morph_targets_sparse_and_integers(tmp_path):
    document = {
        "nodes": [{"mesh": 0, "scale": [-2, 2, 2]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "targets": [{"POSITION": 3}]}]}],
        "animations": [
            {
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
                "samplers": [{"input": 1, "output": 2}],
            }
        ],
    }
    path = hand_made(
        tmp_path,
        document,
        p=((TRIANGLE * 32767).astype(np.int16), "VEC3"),
        t=(np.array([0, 0.5, 1], dtype=np.float32), "SCALAR"),
        w=(np.array([0, 1, 0.5], dtype=np.float32), "SCALAR"),
        d=(np.array([[0, 0, 1]], dtype=np.float32), "VEC3"),
        i=(np.array([2], dtype=np.uint8), "SCALAR"),
    )
    data = json.loads(path.read_text())
    values, where = data["accessors"][3].pop("bufferView"), data["accessors"].pop()["bufferView"]
    data["accessors"][3].update(
        count=3,
        sparse={
            "count": 1,
            "indices": {"bufferView": where, "componentType": 5121},
            "values": {"bufferView": values},
        },
    )
    path.write_text(json.dumps(data))
    sequence = ssdr.load(path, fps=4)
    expected = TRIANGLE * [-2, 2, 2]
    np.testing.assert_allclose(sequence.vertices[0], expected, atol=1e-6)
    np.testing.assert_allclose(sequence.vertices[:, 2, 2], [0, 1, 2, 1.5, 1], atol=1e-6)
    np.testing.assert_array_equal(sequence.faces, [[2, 1, 0]])  # the mirror turns it over
    with pytest.raises(ssdr.FormatError, match="morph targets"):
        ssdr.load_skinning(path)


@pytest.mark.parametrize(
    ("mode", "faces"), [(5, [[0, 1, 2], [2, 1, 3]]), (6, [[0, 1, 2], [0, 2, 3]]), (0, [])]
)
def test_strips_fans_points(tmp_path, mode, faces):
    document = {
        "nodes": [{"mesh": 0, "children": [1]}, {"mesh": 0, "translation": [5, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": mode}]}],
    }
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], dtype=np.float32)
    sequence = ssdr.load(hand_made(tmp_path, document, p=(square, "VEC3")))
    one = np.array(faces, dtype=int).reshape(-1, 3)
    np.testing.assert_array_equal(sequence.faces, np.concatenate([one, one + 4]))
    np.testing.assert_array_equal(
        sequence.vertices[0], np.concatenate([square, square + np.array([5, 0, 0])])
    )


def test_clips_are_chosen_by_name_or_number(tmp_path):
    ssdr.save(tube(), tmp_path / "a.glb")

    def two(document, _):
        second = json.loads(json.dumps(document["animations"][0]))
        second.update(name="still", channels=second["channels"][:1])
        del second["extras"]
        document["animations"].append(second)

    path = rebuild(tmp_path / "a.glb", tmp_path / "b.glb", two)
    assert ssdr.load(path, animation=1).clip == "still"
    still, moving = ssdr.load(path, animation="still"), ssdr.load(path, animation="tube")
    assert (
        np.ptp(still.vertices[:, -1], axis=0).max() < np.ptp(moving.vertices[:, -1], axis=0).max()
    )
    for wrong in ("nothing", 2, -1):
        with pytest.raises(ssdr.InputError, match="animation"):
            ssdr.load(path, animation=wrong)


def _put(section, index, **fields):
    return lambda document, _: document[section][index].update(fields)


def _weights_view(document):
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    return document["accessors"][attributes["JOINTS_0"]]["bufferView"]


def _far_joint(document, binary):
    start = document["bufferViews"][_weights_view(document)]["byteOffset"]
    binary[start] = 250


def _far_index(document, binary):
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]
    start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    binary[start : start + 2] = b"\xfe\xff"


def _nan(document, binary):
    view = document["bufferViews"][document["accessors"][0]["bufferView"]]
    binary[view["byteOffset"] : view["byteOffset"] + 4] = np.float32(np.nan).tobytes()


HOSTILE = {
    "a joint beyond the skin": (_far_joint, "joint 250 of a skin of 5"),
    "an index beyond the vertices": (_far_index, "index 65534 into"),
    "NaN": (_nan, "NaN or Inf"),
    "a huge count": (_put("accessors", 0, count=10**12), "do not fit"),
    "a huge count of nothing": (
        lambda d, _: d["accessors"].__setitem__(
            0, {"componentType": 5126, "type": "VEC3", "count": 10**12}
        ),
        "holds none",
    ),
    "a negative offset": (_put("bufferViews", 0, byteOffset=-4), "byteOffset"),
    "a view beyond the buffer": (_put("bufferViews", 0, byteLength=10**9), "ends at byte"),
    "a cycle": (_put("nodes", 2, children=[1]), "its own ancestor"),
    "two parents": (_put("nodes", 0, children=[3]), "two parents"),
    "a missing joint": (_put("skins", 0, joints=[999]), "a joint is 999"),
    "no joints": (_put("skins", 0, joints=[]), "no joints"),
    "a missing mesh": (_put("nodes", 0, mesh=7), "a mesh is 7"),
    "an unknown extension": (
        lambda d, _: d.update(extensionsRequired=["KHR_texture_basisu"]),
        "requires KHR_texture_basisu",
    ),
    "version 1": (lambda d, _: d.update(asset={"version": "1.0"}), "version 1.0"),
    "no mesh": (lambda d, _: d["nodes"][0].pop("mesh"), "holds no mesh"),
    "falling key times": (
        lambda d, _: d["animations"][0]["samplers"][0].update(input=0),
        "key times is 'VEC3'",
    ),
    "a lazy buffer": (lambda d, _: d["buffers"][0].update(byteLength=10**9), "states 1000000000"),
    "an escape": (lambda d, _: d["buffers"][0].update(uri="../../etc/passwd"), "outside"),
    "a web address": (lambda d, _: d["buffers"][0].update(uri="http://x/y"), "outside"),
    "a bad data URI": (lambda d, _: d["buffers"][0].update(uri="data:;base64,???"), "data URI"),
    "frames without end": (
        lambda d, _: d["animations"][0].update(extras={"ssdr": {"fps": 24, "frames": 10**12}}),
        "max_bytes",
    ),
    "nodes that are no list": (lambda d, _: d.update(nodes=3), "nodes is not a list"),
    "a node that is no object": (lambda d, _: d["nodes"].__setitem__(0, 3), "not an object"),
    "a bool for an index": (_put("nodes", 0, mesh=True), "a mesh is True"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_files(tmp_path, case):
    change, message = HOSTILE[case]
    ssdr.save(tube(frames=3), tmp_path / "a.glb")
    path = rebuild(tmp_path / "a.glb", tmp_path / "b.glb", change)
    for function in (ssdr.load, ssdr.load_skinning):
        with pytest.raises(ssdr.FormatError, match=message) as caught:
            function(path)
        assert "b.glb" in str(caught.value)


def test_truncated_and_mislabelled(tmp_path):
    path = tmp_path / "a.glb"
    ssdr.save(tube(frames=3), path)
    data = path.read_bytes()
    for end in (0, 3, 11, 19, 40, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:end])
        with pytest.raises(ssdr.FormatError, match=r"a\.glb"):
            ssdr.load(path)
    for content in (b"PK\x03\x04" * 20, b"[" * 100_000, b"{}", b"\xff" * 64):
        for name in ("b.glb", "b.gltf"):
            (tmp_path / name).write_bytes(content)
            with pytest.raises(ssdr.FormatError, match=name):
                ssdr.load(tmp_path / name)


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_any_flipped_byte_gives_a_sequence_or_an_ssdr_error(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp()
    source = folder / "flip_source.glb"
    if not source.exists():
        ssdr.save(tube(frames=3, rings=4, sides=4), source)
    content = bytearray(source.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(12, len(content) - 1))] = data.draw(st.integers(0, 255))
    target = folder / "flipped.glb"
    target.write_bytes(content)
    try:
        sequence = ssdr.load(target, max_bytes=1 << 24)
    except ssdr.SsdrError:
        return
    assert np.isfinite(sequence.vertices).all()
