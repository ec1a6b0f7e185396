"""glTF: what is written plays back, what is read is what the file says, damage is refused."""

from __future__ import annotations

import base64
import json
import struct

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from pygltflib import GLTF2
from rig_model import largest_distance, tube
from scipy.spatial.transform import Rotation, Slerp

import ssdr
from ssdr.io.corners import corner_normals, split_corners
from ssdr.io.gltf.document import Document
from ssdr.io.rig import build_rig, frame_rate, quantise, turn_skinning_up, unique_names


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


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("options", [{}, {"scaled": True}, {"bones": 9, "influences": 7}])
def test_round_trip(tmp_path, suffix, options):
    model = tube(**options)
    path = tmp_path / f"a model{suffix}"
    report = ssdr.save(model, path)
    truth = model.skin()
    assert report.influences == model.n_influences
    assert report.error < 2e-7
    assert report.bytes == sum(f.stat().st_size for f in tmp_path.iterdir())
    sequence, back = ssdr.load(path), ssdr.load_skinning(path)
    assert (sequence.fps, sequence.n_frames, sequence.name) == (24.0, 20, "tube")
    assert largest_distance(sequence.vertices, truth) < 1e-6
    assert largest_distance(back.skin(), truth) < 1e-6
    assert back.bone_model == model.bone_model
    assert back.names() == model.names()
    order = np.argsort(model.surface.material_index, kind="stable")
    np.testing.assert_array_equal(back.faces, model.faces[order])
    np.testing.assert_allclose(back.surface.uv, model.surface.uv[order], atol=1e-7)
    np.testing.assert_array_equal(back.surface.material_index, model.surface.material_index[order])
    np.testing.assert_array_equal(
        back.surface.materials[0].texture, model.surface.materials[0].texture
    )
    assert back.surface.materials[1].double_sided
    np.testing.assert_allclose(back.surface.materials[1].base_color, [0.1, 0.6, 0.2, 1])


def test_other_readers_agree(tmp_path):
    model = tube()
    ssdr.save(model, tmp_path / "a.glb")
    peer = GLTF2().load(str(tmp_path / "a.glb"))
    skin = peer.skins[0]
    assert len(skin.joints) == model.n_bones
    view = peer.bufferViews[peer.accessors[skin.inverseBindMatrices].bufferView]
    blob = peer.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
    inverse = np.frombuffer(blob, "<f4").reshape(-1, 4, 4)
    np.testing.assert_allclose(inverse[:, 3, :3], -model.centroids(), atol=1e-6)
    scene = trimesh.load(tmp_path / "a.glb", process=False)
    area = sum(g.area for g in scene.geometry.values())
    assert area == pytest.approx(trimesh.Trimesh(model.rest, model.faces, process=False).area)
    for accessor in peer.accessors:
        assert accessor.bufferView is not None
        assert accessor.count > 0


@pytest.mark.parametrize(("storage", "steps"), [("uint16", 65535), ("uint8", 255)])
def test_quantised_weights_sum_to_one_and_cost_is_told(tmp_path, storage, steps):
    model = tube(influences=5)
    report = ssdr.save(model, tmp_path / "a.glb", weights=storage)
    rig = build_rig(model)
    joints, stored, _ = quantise(rig.joints, rig.weights, storage)
    assert (stored.sum(axis=1, dtype=int) == steps).all()
    assert (joints[stored == 0] == 0).all()
    assert np.abs(stored / steps - rig.weights).max() < 1 / steps
    back = ssdr.load_skinning(tmp_path / "a.glb")
    gap = back.skin(dtype=np.float64) - model.skin()
    assert report.error == pytest.approx(np.sqrt((gap**2).sum(axis=2).mean()), rel=1e-2)
    assert report.max_error == pytest.approx(largest_distance(back.skin(), model.skin()), rel=1e-2)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["float32", "uint16", "uint8"]))
def test_quantise_keeps_the_sum(seed, storage):
    rng = np.random.default_rng(seed)
    weights = -np.sort(-rng.dirichlet(np.full(6, 0.3), size=50), axis=1)
    weights[weights < 1e-3] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    _, stored, values = quantise(np.zeros(weights.shape, np.int32), weights, storage)
    np.testing.assert_allclose(values.sum(axis=1), 1, atol=1e-7)
    assert (stored[weights == 0] == 0).all()


def test_influences_beyond_the_format(tmp_path):
    model = tube(bones=12, influences=10)
    with pytest.raises(ssdr.InputError, match="influences=8 prunes"):
        ssdr.save(model, tmp_path / "a.glb")
    report = ssdr.save(model, tmp_path / "a.glb", influences=4)
    pruned = ssdr.load_skinning(tmp_path / "a.glb")
    assert report.influences == pruned.n_influences == 4
    assert report.max_error == pytest.approx(
        largest_distance(pruned.skin(), model.skin()), rel=1e-3
    )
    assert largest_distance(pruned.skin(), model.prune(4).skin()) < 2e-6


def test_shear_is_refused_before_anything_is_written(tmp_path):
    model = tube()
    sheared = model.transforms.copy()
    sheared[3, 2, 0, 1] += 0.5
    affine = ssdr.Skinning(
        model.rest, model.joints, model.weights, sheared, faces=model.faces, bone_model="affine"
    )
    with pytest.raises(ssdr.InputError, match=r"bone 2, frame 3"):
        ssdr.save(affine, tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())


def test_between_frames_against_scipy():
    model = tube(frames=12)
    rig = build_rig(model)
    total = 0.0
    for frame in range(11):
        moved = np.empty((model.n_bones, 3, 4))
        for bone in range(model.n_bones):
            turns = Rotation.from_matrix(model.transforms[frame : frame + 2, bone, :, :3])
            middle = Slerp([0, 1], turns)(0.5).as_matrix()
            c = model.centroids()[bone]
            ends = model.transforms[frame : frame + 2, bone, :, :3] @ c
            ends = ends + model.transforms[frame : frame + 2, bone, :, 3]
            moved[bone, :, :3] = middle
            moved[bone, :, 3] = ends.mean(axis=0) - middle @ c
        shown = ssdr.skin(model.rest, model.joints, model.weights, moved)
        total += ((shown - model.skin([frame, frame + 1]).mean(axis=0)) ** 2).sum(axis=1).mean()
    assert rig.error(model, between=True).rmse == pytest.approx(np.sqrt(total / 11), rel=1e-4)
    assert build_rig(tube(frames=1)).error(model, between=True).rmse is None


def test_quaternions_do_not_flip():
    rig = build_rig(tube(frames=60, bones=3))
    assert (np.sum(rig.rotations[1:] * rig.rotations[:-1], axis=-1) > 0).all()
    assert np.sum(rig.rotations[0] * rig.rotations[-1], axis=-1).min() < 0  # a flip was there


def test_keyframes_alone_are_written(tmp_path):
    model = tube(frames=21)
    keys = np.zeros((21, 5), dtype=bool)
    keys[[0, 20]] = True
    keys[::4, 1] = True
    sparse = ssdr.Skinning(
        model.rest, model.joints, model.weights, model.transforms, faces=model.faces, keyframes=keys
    )
    report = ssdr.save(sparse, tmp_path / "a.glb")
    back = ssdr.load_skinning(tmp_path / "a.glb")
    assert back.n_frames == 21
    assert back.fps == 24
    kept = back.transforms[::4, 1], model.transforms[::4, 1]
    np.testing.assert_allclose(*kept, atol=2e-6)
    gap = back.skin(dtype=np.float64) - model.skin()
    assert report.error == pytest.approx(np.sqrt((gap**2).sum(axis=2).mean()), rel=1e-4)
    assert report.error > 1e-3


def test_up_axis_is_turned(tmp_path):
    model = tube()
    standing = turn_skinning_up(model, "y", "z")
    assert np.ptp(standing.rest, axis=0).argmax() == 2
    ssdr.save(standing, tmp_path / "a.glb", up="z")
    assert largest_distance(ssdr.load(tmp_path / "a.glb").vertices, model.skin()) < 1e-6


def test_points_without_faces_and_one_frame(tmp_path):
    model = tube(frames=1)
    bare = ssdr.Skinning(model.rest, model.joints, model.weights, model.transforms, fps=30)
    report = ssdr.save(bare, tmp_path / "a.glb")
    assert report.between_frames is None
    back = ssdr.load(tmp_path / "a.glb")
    assert len(back.faces) == 0
    assert back.fps == 30
    assert largest_distance(back.vertices, bare.skin()) < 1e-6


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_split_corners_is_the_inverse_of_its_map(seed):
    rng = np.random.default_rng(seed)
    faces = rng.integers(0, 9, size=(14, 3)).astype(np.int32)
    uv = rng.integers(0, 2, size=(14, 3, 2)).astype(np.float32)
    normals = rng.integers(0, 2, size=(14, 3, 3)).astype(np.float32)
    split = split_corners(faces, 9, uv, normals)
    np.testing.assert_array_equal(split.vertex[:9], np.arange(9))
    np.testing.assert_array_equal(split.vertex[split.faces], faces)
    np.testing.assert_array_equal(split.uv[split.faces], uv)
    np.testing.assert_array_equal(split.normals[split.faces], normals)
    rows = {
        (v, *u, *n)
        for v, u, n in zip(faces.ravel(), uv.reshape(-1, 2), normals.reshape(-1, 3), strict=True)
    }
    unused = 9 - len(set(faces.ravel()))
    assert len(split.vertex) == len(rows) + unused


def test_corner_normals_keep_hard_edges():
    model = tube()
    normals = corner_normals(model.rest, model.faces, model.surface)
    assert largest_distance(normals, model.surface.normals) < 0.02
    smooth = corner_normals(model.rest, model.faces, None)
    mesh = trimesh.Trimesh(model.rest, model.faces, process=False)
    peer = trimesh.geometry.weighted_vertex_normals(
        len(model.rest), mesh.faces, mesh.face_normals, mesh.face_angles
    )
    np.testing.assert_allclose(smooth, peer[model.faces], atol=1e-5)


def test_frame_rate():
    ticks = np.arange(50)
    assert frame_rate([(ticks / 24).astype(np.float32).astype(float)]) == 24
    assert frame_rate([ticks * 1001 / 30000]) == pytest.approx(30000 / 1001)
    assert frame_rate([np.array([0, 0.5, 2.0]), np.array([0, 1.25])]) == 24
    assert frame_rate([np.array([0.0, 0.2, 1.4])]) == 25
    assert frame_rate([np.zeros(1)]) is None
    assert unique_names(["a", "a", "", "a_1", "a"]) == ("a", "a_1", "bone", "a_1_1", "a_2")


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
    assert ssdr.load(path, animation=1).name == "still"
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
        lambda d, _: d.update(extensionsRequired=["KHR_draco_mesh_compression"]),
        "compressed with Draco",
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


def test_textures_and_options_are_checked(tmp_path):
    with pytest.raises(ssdr.InputError, match="weights"):
        ssdr.save(tube(frames=2), tmp_path / "a.glb", weights="float16")
    with pytest.raises(ssdr.InputError, match="up"):
        ssdr.save(tube(frames=2), tmp_path / "a.glb", up="x")
    with pytest.raises(ssdr.InputError, match="influences"):
        ssdr.save(tube(frames=2), tmp_path / "a.glb", influences=0)
    ssdr.save(tube(frames=2), tmp_path / "a.glb", name="hero")
    assert Document(tmp_path / "a.glb").json["scenes"][0]["name"] == "hero"
