"""Shapes that are written as morph targets play back, here and by readers of their own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from pygltflib import GLTF2

import ssdr
from helpers import drawn, naive
from helpers.glb import opened, rebuild, values_of
from helpers.rig_model import largest_distance, tube


def shaped(count=3, *, sparse=False, **options):
    """A tube with shapes, each of which moves all vertices or ten."""
    model, rng = tube(**options), np.random.default_rng(0)
    moved = 0.05 * rng.normal(size=(count, model.n_vertices, 3))
    if sparse:
        for s in range(count):
            moved[s, np.arange(model.n_vertices) // 10 != s] = 0
    amounts = rng.random((model.n_frames, count))
    return ssdr.ShapedSkinning(model, ssdr.Shapes(moved, amounts))


def with_bones(model, **changes):
    return dataclasses.replace(model, skinning=dataclasses.replace(model.skinning, **changes))


@pytest.mark.parametrize("sparse", [False, True])
def test_skin_of_the_displaced_rest_pose(tmp_path, sparse):
    model, path = shaped(sparse=sparse), tmp_path / "a.glb"
    report = ssdr.save(model, path)
    shapes, bones = model.shapes, model.skinning
    rests = bones.rest + np.tensordot(shapes.amounts, shapes.displacements, 1)
    expected = np.concatenate([
        naive.skin(rest, bones.indices, bones.weights, m[None])
        for rest, m in zip(rests, bones.transforms, strict=True)
    ])  # fmt: skip
    assert report.max_error < 1e-5
    back = ssdr.load_skinning(path)
    assert largest_distance(back.skin(), expected) < 1e-5
    assert largest_distance(ssdr.load(path).vertices, expected) < 1e-5
    assert back.shapes.names == shapes.names
    np.testing.assert_allclose(back.shapes.amounts, shapes.amounts, atol=1e-5)
    np.testing.assert_array_equal(back.shapes.moved, shapes.moved)
    # by readers of their own, and with other vertices at seams
    ((positions, _, _, vertex),) = drawn.from_gltf(path)
    assert largest_distance(positions, expected[:, vertex]) < 2 * report.max_error + 1e-6
    peer = GLTF2().load(str(path))
    mesh = peer.meshes[0]
    assert mesh.weights == pytest.approx(shapes.amounts.mean(axis=0), abs=1e-6)
    assert mesh.extras == {"targetNames": ["shape_0", "shape_1", "shape_2"]}
    for primitive in mesh.primitives:
        assert len(primitive.targets) == 3
        target = peer.accessors[primitive.targets[0]["POSITION"]]
        assert target.count == peer.accessors[primitive.attributes.POSITION].count
        np.testing.assert_allclose(target.max, shapes.displacements[0].max(axis=0), atol=1e-6)
    (channel,) = [c for c in peer.animations[0].channels if c.target.path == "weights"]
    output = peer.animations[0].samplers[channel.sampler].output
    assert peer.accessors[output].count == 3 * bones.n_frames


def test_sparse_targets_take_fewer_bytes(tmp_path):
    plain, path = ssdr.save(tube(), tmp_path / "plain.glb").bytes, tmp_path / "a.glb"
    dense = ssdr.save(shaped(), path).bytes - plain
    sparse = ssdr.save(shaped(sparse=True), path).bytes - plain
    document, _ = opened(path)
    targets = document["meshes"][0]["primitives"][0]["targets"]
    item = document["accessors"][targets[0]["POSITION"]]
    assert 10 <= item["sparse"]["count"] < 40  # with the copies at seams
    assert "bufferView" not in item
    assert sparse < 0.8 * dense  # of a mesh so small, much is JSON


@pytest.mark.parametrize("hard", [False, True])
def test_normals_follow_the_shapes(tmp_path, hard):
    """As an engine draws them: morph targets first, then the bones."""
    model = shaped(rings=9, sides=10)
    surface = dataclasses.replace(model.surface, uv=None, normals=model.surface.normals)
    model = with_bones(model, surface=surface if hard else None)
    ssdr.save(model, tmp_path / "a.glb")
    ((positions, normals, faces, vertex),) = drawn.from_gltf(tmp_path / "a.glb")
    assert len(vertex) == model.n_vertices + (20 if hard else 0)  # the rims of both caps
    expected = drawn.vertex_normals(positions, faces)
    error = drawn.mean_angle(normals[:, faces], expected)
    # as they would be without a fit: those of the rest pose with each shape added alone
    rest, added = model.skinning.rest[vertex], model.shapes.displacements[:, vertex]
    alone = drawn.vertex_normals([rest, *(rest + added)], faces)
    moves = model.skinning.transforms[..., :3]
    turns = np.einsum("vb,fbij->fvij", model.skinning.dense_weights()[vertex], moves)
    mixed = alone[0] + np.einsum("fs,stcj->ftcj", model.shapes.amounts, alone[1:] - alone[0])
    plain = drawn.mean_angle(np.einsum("ftcij,ftcj->ftci", turns[:, faces], mixed), expected)
    assert error < 0.8 * plain
    document, binary = opened(tmp_path / "a.glb")
    number = document["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]
    lengths = np.linalg.norm(values_of(document, binary, number), axis=1)
    np.testing.assert_allclose(lengths, 1, atol=1e-6)
    # what is measured of the model is what the file draws
    measured = ssdr.metrics.normals(ssdr.MeshSequence(model.skin(), model.faces), model)
    if not hard:
        assert measured.mean == pytest.approx(error, rel=0.05)


def test_clips_and_points_alone(tmp_path):
    model = shaped(2)
    clips = ssdr.Clip("a", 0, 5, 24), ssdr.Clip("b", 5, 20, 30)
    bare = with_bones(model, faces=None, surface=None, clips=clips, fps=None)
    ssdr.save(bare, tmp_path / "a.glb")
    back = ssdr.load_skinning(tmp_path / "a.glb")
    assert largest_distance(back.skin(), model.skin()) < 1e-5
    np.testing.assert_allclose(back.select("b").shapes.amounts, model.shapes.amounts[5:], atol=1e-6)
    np.testing.assert_allclose(back.select("b").skin(), model.skin()[5:], atol=1e-5)


def test_shapes_change_only_the_normals_of_what_they_reach(tmp_path):
    """One that is never used changes them as the rest pose would."""
    model = with_bones(shaped(sparse=True, rings=9, sides=10), surface=None)
    unused = dataclasses.replace(model.shapes, amounts=model.shapes.amounts * [1, 0, 1])
    model = dataclasses.replace(model, shapes=unused)
    ssdr.save(model, tmp_path / "a.glb")
    document, binary = opened(tmp_path / "a.glb")
    (primitive,) = document["meshes"][0]["primitives"]
    faces, rest = model.faces, model.skinning.rest
    reached = np.zeros((3, model.n_vertices), dtype=bool)
    for k, moved in enumerate(model.shapes.moved):
        reached[k, faces[moved[faces].any(axis=1)]] = True
    own = values_of(document, binary, primitive["attributes"]["NORMAL"])
    added = [values_of(document, binary, one["NORMAL"]) for one in primitive["targets"]]
    plain, unused = drawn.vertex_normals(
        np.stack([rest, rest + model.shapes.displacements[1]]), faces
    )
    np.testing.assert_array_equal(np.any(added, axis=2), reached)
    alone = ~reached.any(axis=0)[faces]
    assert naive.angles(own[faces], plain)[alone].max() < 0.01
    of_unused = naive.angles(added[1][faces], unused - plain)[reached[1][faces]]
    assert of_unused.max() < 0.01


def test_names_of_other_targets_are_passed_over(tmp_path):
    def change(document, _):
        document["meshes"][0]["extras"] = {"targetNames": ["one"]}

    ssdr.save(shaped(2), tmp_path / "a.glb")
    path = rebuild(tmp_path / "a.glb", tmp_path / "b.glb", change)
    assert ssdr.load_skinning(path).shapes.names == ("shape_0", "shape_1")
