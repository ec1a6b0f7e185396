"""Sequences and models beside NumPy, trimesh, torch, pickle and copy."""

from __future__ import annotations

import copy
import dataclasses
import importlib
import inspect
import pickle
import pkgutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import ssdr
from helpers import motions

CHAIN = motions.chain(frames=6)
MODEL = CHAIN.skinning
FRAMES = ssdr.MeshSequence(MODEL.skin(), MODEL.faces, 12, name="chain")
SMILE = ssdr.Shapes(np.ones((1, FRAMES.n_vertices, 3)), np.zeros((6, 1)))
FACE = ssdr.ShapedSkinning(MODEL, SMILE)
MESHES = [trimesh.Trimesh(v, FRAMES.faces, process=False) for v in FRAMES]


def test_meshes_of_trimesh_are_sequences_and_come_back() -> None:
    for mesh, frame in zip(MESHES, FRAMES, strict=True):
        np.testing.assert_array_equal(mesh.vertices, frame)
    taken = ssdr.MeshSequence(MESHES, fps=12)
    np.testing.assert_array_equal(taken.vertices, FRAMES.vertices)
    np.testing.assert_array_equal(taken.faces, FRAMES.faces)
    for model in (FRAMES, MODEL, FACE):
        back = model.mesh(2)
        np.testing.assert_allclose(back.vertices, FRAMES[2], atol=1e-12)
        np.testing.assert_array_equal(back.faces, FRAMES.faces)
        back.vertices[:] = 0  # a copy
    np.testing.assert_array_equal(MODEL.mesh().vertices, MODEL.rest)


def test_a_mesh_of_trimesh_is_taken_wherever_a_mesh_is(tmp_path: Path) -> None:
    uv = np.random.default_rng(0).random((FRAMES.n_vertices, 2))
    one = trimesh.Trimesh(FRAMES[0], FRAMES.faces, process=False)
    one.visual = trimesh.visual.TextureVisuals(uv=uv)
    np.testing.assert_allclose(ssdr.MeshSequence(one).surface.uv, uv[FRAMES.faces], atol=1e-6)
    assert ssdr.metrics.rmse(MESHES, MODEL) < 1e-12
    assert ssdr.fit_bones(MESHES, MESHES[0], MODEL.indices, MODEL.weights).rmse < 1
    with pytest.raises(ssdr.InputError, match="meshes with the same faces, got others in mesh 1"):
        ssdr.MeshSequence([MESHES[0], trimesh.creation.box()])
    ssdr.save(MESHES, tmp_path / "a.npz")
    assert ssdr.load(tmp_path / "a.npz").n_frames == 6
    ssdr.view(MESHES, MESHES, tmp_path / "a.html")
    ssdr.show.render_frame(MESHES, reference=MESHES, size=(64, 64))


def test_frames_are_read_by_one_rule() -> None:
    assert FRAMES[2].shape == MODEL.skin(2).shape == FRAMES.frames(2).shape
    part = FRAMES[1:5:2]
    assert (part.n_frames, part.fps, part.name) == (2, 12, "chain")
    np.testing.assert_array_equal(part.vertices, FRAMES.vertices[1:5:2])
    np.testing.assert_array_equal(FRAMES[[4, 0]].vertices, FRAMES.vertices[[4, 0]])
    np.testing.assert_array_equal(list(FRAMES), FRAMES.vertices)
    np.testing.assert_array_equal(np.asarray(FRAMES), FRAMES.vertices)
    assert np.array(FRAMES, dtype=np.float32).flags.writeable


def test_skin_takes_a_model_as_the_fits_do() -> None:
    arrays = MODEL.rest, MODEL.indices, MODEL.weights, MODEL.transforms
    np.testing.assert_array_equal(ssdr.skin(MODEL), ssdr.skin(*arrays))
    g = np.random.default_rng(0).random(FRAMES.vertices.shape)
    one, other = ssdr.skin_gradients(MODEL, gradient=g), ssdr.skin_gradients(*arrays, g)
    np.testing.assert_array_equal(one.transforms, other.transforms)
    with pytest.raises(ssdr.InputError, match="transforms: expected None beside a model"):
        ssdr.skin(MODEL, transforms=MODEL.transforms)
    with pytest.raises(ssdr.InputError, match="rest: expected a model without shapes"):
        ssdr.skin_gradients(FACE, gradient=g)


def test_tensors_are_taken_as_arrays() -> None:
    torch = pytest.importorskip("torch")
    arrays = MODEL.rest, MODEL.indices, MODEL.weights, MODEL.transforms
    tensors = [torch.tensor(x, requires_grad=x.dtype.kind == "f") for x in arrays]
    np.testing.assert_array_equal(ssdr.skin(*tensors), MODEL.skin())
    frames = [torch.tensor(frame, requires_grad=True) for frame in FRAMES]
    np.testing.assert_array_equal(ssdr.MeshSequence(frames).vertices, FRAMES.vertices)


def _frozen() -> list[Any]:
    fit = ssdr.fit_weights(FRAMES, MODEL)
    split = ssdr.laplacian.split_frequencies(FRAMES, length=0.1)
    result = ssdr.decompose(FRAMES, bones=2, effort="fast")
    comparison = ssdr.metrics.compare(FRAMES, MODEL)
    start = ssdr.Kept(rest=MODEL.rest)
    return [FRAMES, MODEL, FACE, fit, split, split.smoother, result, comparison, start]


@pytest.mark.parametrize("again", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
def test_everything_is_pickled_and_copied(again: Callable[[Any], Any]) -> None:
    for thing in _frozen():
        other = again(thing)
        assert repr(other) == repr(thing)
        assert other != thing  # what holds arrays is equal to itself alone
    smoother = ssdr.laplacian.LaplacianSmoother(FRAMES[0], FRAMES.faces, 0.1)
    np.testing.assert_array_equal(again(smoother).smooth(FRAMES[1]), smoother.smooth(FRAMES[1]))


def test_what_holds_arrays_is_equal_to_itself_alone() -> None:
    for found in pkgutil.walk_packages(ssdr.__path__, "ssdr."):
        if ".blender" in found.name or found.name.endswith("__main__"):
            continue
        for kind in vars(importlib.import_module(found.name)).values():
            compares = inspect.isclass(kind) and kind.__eq__ is not object.__eq__
            if compares and dataclasses.is_dataclass(kind):
                held = [f.name for f in dataclasses.fields(kind) if "NDArray" in str(f.type)]
                assert not held, kind


def test_arrays_of_frozen_objects_cannot_be_written() -> None:
    own = np.array(FRAMES.vertices)
    for thing in (ssdr.MeshSequence(own, FRAMES.faces), MODEL, FACE.shapes):
        arrays = [value for value in vars(thing).values() if isinstance(value, np.ndarray)]
        assert len(arrays) >= 2
        for array in arrays:
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0
    own[0] = 0  # the caller's array stays the caller's
