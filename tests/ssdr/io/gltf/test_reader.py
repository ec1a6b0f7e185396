"""What is read from glTF is what the file says; damage is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ssdr
from helpers.glb import hand_made

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
    return hand_made(
        tmp_path / "a.gltf", document, TRIANGLE, times, np.asarray(values, dtype=np.float32)
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


@pytest.mark.parametrize(
    ("path", "pointer"),
    [
        ("translation", "/nodes/0/translation"),
        ("weights", "/nodes/0/weights"),
        ("weights", "/meshes/0/weights"),
    ],
)
def test_a_pointer_at_a_node_or_its_shapes_is_a_channel(tmp_path, path, pointer):
    """KHR_animation_pointer; the same file with an ordinary channel is the witness."""
    keys = [[0, 0, 0], [2, 0, 1], [3, 1, 0]] if path == "translation" else [0.0, 0.5, 1.0]
    plain = channel_file(tmp_path, "LINEAR", keys, path=path)
    document = json.loads(plain.read_text())
    document["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": 0}]
    plain.write_text(json.dumps(document))
    truth = ssdr.load(plain).vertices
    extension = {"KHR_animation_pointer": {"pointer": pointer}}
    target = {"path": "pointer", "extensions": extension}
    document["animations"][0]["channels"][0]["target"] = target
    document["extensionsUsed"] = document["extensionsRequired"] = ["KHR_animation_pointer"]
    plain.write_text(json.dumps(document))
    np.testing.assert_array_equal(ssdr.load(plain).vertices, truth)
    assert np.ptp(truth, axis=0).max() >= 1
    result = ssdr.decompose(ssdr.load(plain), bones=1, effort="fast")
    ssdr.save(result, tmp_path / "b.gltf", template=plain)
    assert "pointer" not in (tmp_path / "b.gltf").read_text().replace("KHR_animation_pointer", "")
    assert ssdr.io.list_left_out(plain) == ()
    for other in ("/cameras/0/perspective/yfov", "/nodes/99/translation"):
        extension["KHR_animation_pointer"]["pointer"] = other
        plain.write_text(json.dumps(document))
        assert ssdr.io.list_left_out(plain) == (other,)


def test_meshes_have_names_that_are_listed_and_taken(tmp_path):
    nodes = ((0, "left"), (0, "right"), (1, ""), (2, ""))
    document = {
        "nodes": [{"mesh": k, **({"name": n} if n else {})} for k, n in nodes],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}}], **({"name": name} if name else {})}
            for name in ("shoe", "hat", "")
        ],
    }
    path = hand_made(tmp_path / "a.gltf", document, TRIANGLE)
    names = ("left", "right", "hat", "node_3")
    assert ssdr.io.list_meshes(path) == names
    for name in names:
        assert ssdr.load(path, meshes=name).n_vertices == 3
    assert ssdr.load(path, meshes="shoe").n_vertices == 6
    known = r"meshes: expected one of \['hat', 'left', 'node_3', 'right', 'shoe'\], got 'cap'"
    with pytest.raises(ssdr.InputError, match=known):
        ssdr.load(path, meshes="cap")


def test_a_buffer_below_a_folder_that_the_user_names_is_read(tmp_path):
    (tmp_path / "scene").mkdir()
    mesh = {"primitives": [{"attributes": {"POSITION": 0}}]}
    path = hand_made(tmp_path / "a.gltf", {"nodes": [{"mesh": 0}], "meshes": [mesh]}, TRIANGLE)
    document = json.loads(path.read_text())
    document["buffers"][0]["uri"] = "../" + document["buffers"][0]["uri"]
    moved = tmp_path / "scene" / "a.gltf"
    moved.write_text(json.dumps(document))
    with pytest.raises(ssdr.FormatError, match="folder= names"):
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
        tmp_path / "a.gltf",
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
    model = ssdr.load_skinning(path, fps=4)
    assert len(model.shapes) == 1
    np.testing.assert_allclose(model.skin(), sequence.vertices, atol=1e-6)


@pytest.mark.parametrize(
    ("mode", "faces"), [(5, [[0, 1, 2], [2, 1, 3]]), (6, [[0, 1, 2], [0, 2, 3]]), (0, [])]
)
def test_strips_fans_points(tmp_path, mode, faces):
    document = {
        "nodes": [{"mesh": 0, "children": [1]}, {"mesh": 0, "translation": [5, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": mode}]}],
    }
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], dtype=np.float32)
    sequence = ssdr.load(hand_made(tmp_path / "a.gltf", document, square))
    one = np.array(faces, dtype=int).reshape(-1, 3)
    np.testing.assert_array_equal(sequence.faces, np.concatenate([one, one + 4]))
    np.testing.assert_array_equal(
        sequence.vertices[0], np.concatenate([square, square + np.array([5, 0, 0])])
    )


def test_a_mirrored_node_that_grows_from_a_point_shows_its_outside(tmp_path):
    """Its first frame has no side; judged by it alone, every triangle was inside out."""
    sizes = np.arange(3)[:, None] * [-1, 1, 1]
    assert ssdr.load(channel_file(tmp_path, "LINEAR", sizes, "scale")).faces.tolist() == [[2, 1, 0]]
