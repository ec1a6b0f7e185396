"""What is read from glTF is what the file says; damage is refused."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import tracemalloc

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ssdr
from helpers.glb import opened, packed
from helpers.gltf_asset import Made, make_asset
from helpers.rig_model import tube
from helpers.rig_tree import creature
from ssdr import cli


def rebuild(source, target, change):
    """Write a .glb anew after `change` has edited its JSON (and perhaps its buffer)."""
    document, binary = opened(source)
    change(document, binary)
    return packed(target, document, binary)


def hand_made(tmp_path, document, *arrays):
    """A .gltf of an accessor for each array, in the order given; integers are normalised."""
    made = Made()
    made.json = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}
    for values in map(np.asarray, arrays):
        made.put(values, normalized=values.dtype.kind != "f" and values.ndim > 1)
    made.json.update(document)
    return made.save(tmp_path / "made.gltf")


TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32)


def channel_file(tmp_path, how, values, path="translation", times=(0, 0.5, 1), **node):
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
    times = np.array(times, dtype=np.float32)
    return hand_made(tmp_path, document, TRIANGLE, times, np.asarray(values, dtype=np.float32))


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


def test_meshes_have_names_that_info_lists_and_meshes_takes(tmp_path, capsys):
    nodes = ((0, "left"), (0, "right"), (1, ""), (2, ""))
    document = {
        "nodes": [{"mesh": k, **({"name": n} if n else {})} for k, n in nodes],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}}], **({"name": name} if name else {})}
            for name in ("shoe", "hat", "")
        ],
    }
    path = hand_made(tmp_path, document, TRIANGLE)
    names = ("left", "right", "hat", "node_3")
    assert ssdr.io.list_meshes(path) == names
    for name in names:
        assert ssdr.load(path, meshes=name).n_vertices == 3
    assert ssdr.load(path, meshes="shoe").n_vertices == 6
    assert cli.main(["info", str(path)]) == 0
    assert "4, read as one (--read meshes=NAME takes one): left, right" in capsys.readouterr().out
    assert cli.main(["info", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["meshes"] == list(names)
    known = r"meshes: expected one of \['hat', 'left', 'node_3', 'right', 'shoe'\], got 'cap'"
    with pytest.raises(ssdr.InputError, match=known):
        ssdr.load(path, meshes="cap")
    for wrong in (3, [], ["hat", 3], [None]):
        with pytest.raises(
            ssdr.InputError, match="meshes: expected the name of a mesh, or several"
        ):
            ssdr.load(path, meshes=wrong)


def test_a_buffer_below_a_folder_that_the_user_names_is_read(tmp_path):
    (tmp_path / "scene").mkdir()
    mesh = {"primitives": [{"attributes": {"POSITION": 0}}]}
    path = hand_made(tmp_path, {"nodes": [{"mesh": 0}], "meshes": [mesh]}, TRIANGLE)
    document = json.loads(path.read_text())
    document["buffers"][0]["uri"] = "../" + document["buffers"][0]["uri"]
    moved = tmp_path / "scene" / "a.gltf"
    moved.write_text(json.dumps(document))
    with pytest.raises(ssdr.FormatError, match="--read folder="):
        ssdr.load(moved)
    np.testing.assert_array_equal(ssdr.load(moved, folder=tmp_path).vertices[0], TRIANGLE)


TIMES = np.array([0, 0.013, 0.05, 0.081, 0.2, 0.33, 0.402, 0.51, 0.77, 0.934])


@pytest.mark.parametrize("read", [ssdr.load, ssdr.load_skinning])
def test_irregular_keys_are_sampled_and_what_that_loses_is_said(tmp_path, read):
    x = np.sin(9 * TIMES)
    path = channel_file(tmp_path, "LINEAR", np.stack([x, 0 * x, 0 * x], axis=1), times=TIMES)
    ticks = np.arange(24) / 24  # the last lies after the last key
    shown = np.interp(TIMES, ticks, np.interp(ticks, TIMES, x))
    worst = np.abs(shown - x).max()
    percent = f"{100 * worst / np.sqrt(2):.2g}"
    said = rf"9 keys .* are 24 a second: .* up to {worst:.3g} \({percent} % of the diagonal\)"
    with pytest.warns(ssdr.SsdrWarning, match=said):
        thing = read(path)
    assert (thing.fps, thing.n_frames) == (24, 24)
    read(path, fps=24)  # asked for


def test_irregular_keys_that_nothing_is_lost_between_are_no_news(tmp_path):
    times = np.r_[TIMES[:-1], 23 / 24]
    x = 3 * times
    ssdr.load(channel_file(tmp_path, "LINEAR", np.stack([x, x, x], axis=1), times=times))


def test_rotation_takes_the_short_way(tmp_path):
    turn = Rotation.from_rotvec(np.deg2rad([[0, 0, 0], [0, 0, 80], [0, 0, 160]])).as_quat()
    turn[1] *= -1
    sequence = ssdr.load(channel_file(tmp_path, "LINEAR", turn, "rotation"), fps=8)
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
        (TRIANGLE * 32767).astype(np.int16),
        np.array([0, 0.5, 1], dtype=np.float32),
        np.array([0, 1, 0.5], dtype=np.float32),
        np.array([[0, 0, 1]], dtype=np.float32),
        np.array([2], dtype=np.uint8),
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
    sequence = ssdr.load(hand_made(tmp_path, document, square))
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
    assert ssdr.load(path, clip=1).clip == "still"
    still, moving = ssdr.load(path, clip="still"), ssdr.load(path, clip="tube")
    assert (
        np.ptp(still.vertices[:, -1], axis=0).max() < np.ptp(moving.vertices[:, -1], axis=0).max()
    )
    for wrong in ("nothing", 2, -1):
        with pytest.raises(ssdr.InputError, match="clip"):
            ssdr.load(path, clip=wrong)


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
    with contextlib.suppress(ssdr.FormatError):  # what is damaged may stay so
        ssdr.io.copy(path, tmp_path / "c.gltf")
        ssdr.io.copy(path, tmp_path / "c.glb", clips=[0])


@pytest.mark.parametrize("depth", [500, 990, 100_000])
def test_json_that_is_nested_deeply_is_read_or_refused(tmp_path, depth):
    source = make_asset(tmp_path / "all.gltf")
    text = source.read_text()
    source.write_text(text[:-1] + ', "deep": ' + '{"extras":' * depth + "1" + "}" * depth + "}")
    for read in (ssdr.load, ssdr.io.left_out, lambda p: ssdr.io.copy(p, tmp_path / "b.gltf")):
        with contextlib.suppress(ssdr.FormatError):
            read(source)


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
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "endless.png").symlink_to("/dev/zero")
    document = json.loads(source.read_text())
    document[what][0]["uri"] = uri
    source.write_text(json.dumps(document))
    for target in ("b.glb", "b.gltf"):
        with pytest.raises(ssdr.FormatError, match=r"all\.gltf: .*" + IMAGES[uri] + "|no text"):
            ssdr.io.copy(source, tmp_path / target)
    with pytest.raises(ssdr.FormatError, match=r"all\.gltf"):
        ssdr.load(source)


@pytest.mark.parametrize("number", ["1e999", "-1e999", "NaN", "9" * 5000])
def test_numbers_that_are_none_are_refused(tmp_path, number):
    source = make_asset(tmp_path / "all.gltf")
    source.write_text(source.read_text().replace("0.7", number, 1))
    for read in (ssdr.load, ssdr.list_clips, lambda p: ssdr.io.copy(p, tmp_path / "b.glb")):
        with pytest.raises(ssdr.FormatError, match=r"all\.gltf"):
            read(source)


def test_mislabelled(tmp_path):
    for content in (b"PK\x03\x04" * 20, b"[" * 100_000, b"{}", b"\xff" * 64):
        for name in ("b.glb", "b.gltf"):
            (tmp_path / name).write_bytes(content)
            with pytest.raises(ssdr.FormatError, match=name):
                ssdr.load(tmp_path / name)


def test_a_skeleton_without_a_mesh_has_a_vertex_at_each_joint(tmp_path):
    model = creature()
    ssdr.save(model, tmp_path / "a.glb")

    def strip(document, _):
        for node in document["nodes"]:
            node.pop("mesh", None)
            node.pop("skin", None)
        for part in ("meshes", "skins", "materials"):
            document.pop(part, None)

    path = rebuild(tmp_path / "a.glb", tmp_path / "b.glb", strip)
    bare = ssdr.load_skinning(path, joints_alone=True)
    order = [bare.names().index(name) for name in model.names()]
    np.testing.assert_allclose(bare.transforms[:, order], model.transforms, atol=1e-5)
    np.testing.assert_allclose(bare.rest[order], model.joint_positions, atol=1e-6)
    assert (bare.n_vertices, len(bare.faces), bare.clips) == (model.n_bones, 0, model.clips)
    above = [bare.names()[p] if p >= 0 else "" for p in bare.parents[order]]
    assert above == [model.names()[p] if p >= 0 else "" for p in model.parents]
    with pytest.raises(ssdr.FormatError, match="holds no mesh"):
        ssdr.load_skinning(path)
    whole = ssdr.load_skinning(tmp_path / "a.glb", joints_alone=True)
    assert whole.n_vertices == model.n_vertices  # a mesh that is there is read


def test_keys_with_one_odd_gap_are_sampled_at_their_own_rate(tmp_path):
    """Not five times as often, which would make the clip the greater part of a fit."""
    model = tube(frames=25)
    ssdr.save(dataclasses.replace(model, fps=24), tmp_path / "run.gltf")
    document = json.loads((tmp_path / "run.gltf").read_text())
    (animation,) = document["animations"]
    del animation["extras"]
    times = (np.r_[np.arange(17), 20.8 + np.arange(8)] / 24).astype(np.float32)
    item = document["accessors"][animation["samplers"][0]["input"]]
    view = document["bufferViews"][item["bufferView"]]
    blob = bytearray((tmp_path / "run.bin").read_bytes())
    blob[view["byteOffset"] : view["byteOffset"] + times.nbytes] = times.tobytes()
    item["max"] = [float(times[-1])]
    (tmp_path / "run.bin").write_bytes(blob)
    (tmp_path / "run.gltf").write_text(json.dumps(document))
    said = r"8 keys of the clip .* lie between .*, which are 24 a second: .* \(2.5 %.*--read fps="
    with pytest.warns(ssdr.SsdrWarning, match=said):
        found = ssdr.load(tmp_path / "run.gltf")
    assert (found.fps, len(found)) == (24, 29)
    truth = model.skin()
    np.testing.assert_allclose(found.vertices[:17], truth[:17], atol=1e-5)
    np.testing.assert_allclose(found.vertices[-1], truth[-1], atol=1e-5)  # its end is not cut off
    assert len(ssdr.load(tmp_path / "run.gltf", fps=120)) == 140
