"""What is written as glTF plays back, here and in other readers."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from pygltflib import GLTF2

import ssdr
from helpers.rig_model import largest_distance, tube
from ssdr.io.axes import turn_skinning_up
from ssdr.io.gltf.document import Document
from ssdr.io.rig import build_rig, quantise


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
    indices, stored, _ = quantise(rig.indices, rig.weights, storage)
    assert (stored.sum(axis=1, dtype=int) == steps).all()
    assert (indices[stored == 0] == 0).all()
    assert np.abs(stored / steps - rig.weights).max() < 1 / steps
    back = ssdr.load_skinning(tmp_path / "a.glb")
    gap = back.skin(dtype=np.float64) - model.skin()
    assert report.error == pytest.approx(np.sqrt((gap**2).sum(axis=2).mean()), rel=1e-2)
    assert report.max_error == pytest.approx(largest_distance(back.skin(), model.skin()), rel=1e-2)


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
        model.rest, model.indices, model.weights, sheared, faces=model.faces, bone_model="affine"
    )
    with pytest.raises(ssdr.InputError, match=r"bone 2, frame 3"):
        ssdr.save(affine, tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())


def test_keyframes_alone_are_written(tmp_path):
    model = tube(frames=21)
    keys = np.zeros((21, 5), dtype=bool)
    keys[[0, 20]] = True
    keys[::4, 1] = True
    sparse = ssdr.Skinning(
        model.rest,
        model.indices,
        model.weights,
        model.transforms,
        faces=model.faces,
        keyframes=keys,
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
    bare = ssdr.Skinning(model.rest, model.indices, model.weights, model.transforms, fps=30)
    report = ssdr.save(bare, tmp_path / "a.glb")
    assert report.between_frames is None
    back = ssdr.load(tmp_path / "a.glb")
    assert len(back.faces) == 0
    assert back.fps == 30
    assert largest_distance(back.vertices, bare.skin()) < 1e-6


def test_textures_and_options_are_checked(tmp_path):
    with pytest.raises(ssdr.InputError, match="weights"):
        ssdr.save(tube(frames=2), tmp_path / "a.glb", weights="float16")
    with pytest.raises(ssdr.InputError, match="up"):
        ssdr.save(tube(frames=2), tmp_path / "a.glb", up="x")
    with pytest.raises(ssdr.InputError, match="influences"):
        ssdr.save(tube(frames=2), tmp_path / "a.glb", influences=0)
    ssdr.save(tube(frames=2), tmp_path / "a.glb", name="hero")
    assert Document(tmp_path / "a.glb").json["scenes"][0]["name"] == "hero"
