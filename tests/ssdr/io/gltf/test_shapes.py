"""Morph targets that are written play back, here and by a reader of its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from pygltflib import GLTF2

import ssdr
from helpers import drawn, naive
from helpers.glb import opened, values_of
from helpers.rig_model import largest_distance, tube
from ssdr.io.gltf.shapes import Shapes


def shapes(model, count=3):
    rng = np.random.default_rng(0)
    moved = 0.05 * rng.normal(size=(count, model.n_vertices, 3))
    return Shapes(moved, rng.random((model.n_frames, count)))


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_skin_of_the_displaced_rest_pose(tmp_path, suffix):
    model = tube()
    added = shapes(model)
    path = tmp_path / f"a.{suffix}"
    ssdr.save(model, path, shapes=added)
    expected = []
    for f in range(model.n_frames):
        rest = model.rest + np.einsum("k,kvc->vc", added.amounts[f], added.displacements)
        moved = dataclasses.replace(model, rest=rest, transforms=model.transforms[f : f + 1])
        expected.append(moved.skin()[0])
    assert largest_distance(ssdr.load(path).vertices, np.stack(expected)) < 1e-5
    peer = GLTF2().load(str(path))
    mesh = peer.meshes[0]
    assert mesh.weights == pytest.approx(added.amounts.mean(axis=0), abs=1e-6)
    for primitive in mesh.primitives:
        assert len(primitive.targets) == 3
        target = peer.accessors[primitive.targets[0]["POSITION"]]
        assert target.count == peer.accessors[primitive.attributes.POSITION].count
        np.testing.assert_allclose(target.max, added.displacements[0].max(axis=0), atol=1e-6)
    (channel,) = [c for c in peer.animations[0].channels if c.target.path == "weights"]
    output = peer.animations[0].samplers[channel.sampler].output
    assert peer.accessors[output].count == 3 * model.n_frames


@pytest.mark.parametrize("hard", [False, True])
def test_normals_follow_the_shapes(tmp_path, hard):
    """As an engine draws them: morph targets first, then the bones."""
    model = tube(rings=9, sides=10)
    surface = dataclasses.replace(model.surface, uv=None, normals=model.surface.normals)
    model = dataclasses.replace(model, surface=surface if hard else None)
    added = shapes(model)
    ssdr.save(model, tmp_path / "a.glb", shapes=added)
    ((positions, normals, faces, vertex),) = drawn.from_gltf(tmp_path / "a.glb")
    assert len(vertex) == model.n_vertices + (20 if hard else 0)  # the rims of both caps
    expected = drawn.vertex_normals(positions, faces)
    error = drawn.mean_angle(normals[:, faces], expected)
    # as they would be without a fit: those of the rest pose with each shape added alone
    rest = model.rest[vertex]
    alone = drawn.vertex_normals([rest, *(rest + added.displacements[:, vertex])], faces)
    turns = np.einsum("vb,fbij->fvij", model.dense_weights()[vertex], model.transforms[..., :3])
    mixed = alone[0] + np.einsum("fs,stcj->ftcj", added.amounts, alone[1:] - alone[0])
    plain = drawn.mean_angle(np.einsum("ftcij,ftcj->ftci", turns[:, faces], mixed), expected)
    assert error < 0.8 * plain
    document, binary = opened(tmp_path / "a.glb")
    number = document["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]
    lengths = np.linalg.norm(values_of(document, binary, number), axis=1)
    np.testing.assert_allclose(lengths, 1, atol=1e-6)


def test_a_shape_that_is_never_used_changes_normals_as_the_rest_pose_would(tmp_path):
    model = dataclasses.replace(tube(rings=9, sides=10), surface=None)
    added = shapes(model)
    added.amounts[:, 1] = 0
    ssdr.save(model, tmp_path / "a.glb", shapes=added)
    document, binary = opened(tmp_path / "a.glb")
    (primitive,) = document["meshes"][0]["primitives"]
    n, d = (
        values_of(document, binary, one["NORMAL"])
        for one in (primitive["attributes"], primitive["targets"][1])
    )
    rest = np.stack([model.rest, model.rest + added.displacements[1]])
    before, after = drawn.vertex_normals(rest, model.faces)
    assert naive.angles(d[model.faces], after - before).max() < 0.01
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1, atol=1e-6)


def test_shapes_that_do_not_fit(tmp_path):
    model, path = tube(), tmp_path / "a.glb"
    added = shapes(model)
    with pytest.raises(ssdr.InputError, match="amounts: expected 3 columns, got 2"):
        Shapes(added.displacements, added.amounts[:, :2])
    with pytest.raises(ssdr.InputError, match=r"shapes: expected .* frames"):
        ssdr.save(model, path, shapes=Shapes(added.displacements, added.amounts[1:]))
    ssdr.save(model, path)
    with pytest.raises(ssdr.InputError, match="none beside a template"):
        ssdr.save(model, tmp_path / "b.glb", template=path, shapes=added)
    assert not (tmp_path / "b.glb").exists()
