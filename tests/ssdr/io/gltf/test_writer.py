"""What is written as glTF plays back, here and in other readers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from pygltflib import GLTF2

import ssdr
from helpers.rig_model import largest_distance, tube
from ssdr.io.gltf.document import Document
from ssdr.io.played_model import as_played


def test_other_readers_agree(tmp_path):
    model = dataclasses.replace(tube(), name="hero")
    ssdr.save(model, tmp_path / "a.glb")
    peer = GLTF2().load(str(tmp_path / "a.glb"))
    skin = peer.skins[0]
    assert peer.scenes[0].name == "hero"
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
def test_quantised_weights_cost_what_is_told(tmp_path, storage, steps):
    model = tube(influences=5)
    report = ssdr.save(model, tmp_path / "a.glb", weights=storage)
    exact, rig = as_played(model), as_played(model, storage=storage)
    assert np.abs(rig.weights / steps - exact.weights).max() < 1 / steps
    back = ssdr.load_skinning(tmp_path / "a.glb")
    gap = back.skin(dtype=np.float64) - model.skin()
    assert report.error == pytest.approx(np.sqrt((gap**2).sum(axis=2).mean()), rel=1e-2)
    assert report.max_error == pytest.approx(largest_distance(back.skin(), model.skin()), rel=1e-2)


def test_influences_beyond_the_format(tmp_path):
    model = tube(bones=12, influences=10)
    ssdr.save(model.prune(4), tmp_path / "a.glb")
    pruned = ssdr.load_skinning(tmp_path / "a.glb")
    assert pruned.n_influences == 4
    assert largest_distance(pruned.skin(), model.prune(4).skin()) < 2e-6


def test_pictures_stay_beside_a_file_of_their_folder_and_go_into_others(tmp_path):
    ssdr.save(tube(frames=2), tmp_path / "a.gltf")
    model = ssdr.load_skinning(tmp_path / "a.gltf")
    document = Document(tmp_path / "a.gltf")
    (tmp_path / "p.png").write_bytes(document.picture(document.items("images")[0]))
    text = (tmp_path / "a.gltf").read_text()
    number = document.items("images")[0]["bufferView"]
    (tmp_path / "a.gltf").write_text(text.replace(f'"bufferView": {number}', '"uri": "p.png"', 1))
    (tmp_path / "there").mkdir()
    for target, beside in ((tmp_path / "b.gltf", True), (tmp_path / "there" / "b.gltf", False)):
        ssdr.save(model, target, template=tmp_path / "a.gltf")
        copied = Document(target)
        assert ("uri" in copied.items("images")[0]) == beside
        assert copied.picture(copied.items("images")[0]) == (tmp_path / "p.png").read_bytes()
