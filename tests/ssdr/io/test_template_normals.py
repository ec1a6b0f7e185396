"""Normals in templates and mirrored meshes: those of the model, outwards, hard where they were.

Expected normals come from the vertices that the file says, in loops over triangles.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ssdr
from helpers import drawn, naive
from helpers.glb import hand_made
from helpers.motions import grid
from helpers.stages import items

FRAMES = 12


@pytest.fixture(scope="module")
def roof():
    """Vertices (F, V, 3) and triangles of two sheets that meet at a right angle, and bend.

    Vertices at the ridge are doubled, so that each sheet has its own.
    """
    x, y = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 2, 9), indexing="ij")
    rest = np.concatenate([np.stack([s * x, y, -x], axis=-1).reshape(-1, 3) for s in (-1, 1)])
    faces = np.concatenate([grid(5, 9)[:, ::-1], grid(5, 9) + 45])
    upper, frames = np.clip(rest[:, 1:2] - 0.5, 0, 1), []
    for t in range(FRAMES):
        turn = Rotation.from_rotvec([0.7 * np.sin(2 * np.pi * t / FRAMES), 0, 0]).as_matrix()
        frames.append((1 - upper) * rest + upper * ((rest - [0, 1, 0]) @ turn.T + [0, 1, 0]))
    return np.array(frames), faces


def vertex_normals(frame, faces):
    """Normals (V, 3), of a roof whose sheets share no vertex."""
    normals = np.zeros(frame.shape, np.float32)
    normals[faces] = naive.corner_normals(frame, faces)
    return normals


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("fitted", [False, True])
def test_gltf(tmp_path, roof, mirrored, fitted):
    """Two nodes that show one mesh, with a morph target for each frame but the first."""
    frames, faces = roof
    count, time = FRAMES - 1, 1 + FRAMES
    floats = [frames[0], vertex_normals(frames[0], faces), *(frames[1:] - frames[0])]
    floats += [np.arange(FRAMES) / 24, np.eye(FRAMES)[:, 1:].ravel()]
    primitive = {
        "attributes": {"POSITION": 0, "NORMAL": 1},
        "indices": time + 2,
        "targets": [{"POSITION": 2 + k} for k in range(count)],
    }
    channels = [{"sampler": 0, "target": {"node": k, "path": "weights"}} for k in range(2)]
    document = {
        "nodes": [
            {"mesh": 0, "name": "a"},
            {"mesh": 0, "name": "b", "translation": [3, 0, 0]}
            | ({"scale": [-1, 1, 1]} if mirrored else {}),
        ],
        "meshes": [{"primitives": [primitive], "weights": [0] * count}],
        "animations": [{"channels": channels, "samplers": [{"input": time, "output": time + 1}]}],
    }
    arrays = [array.astype("<f4") for array in floats] + [faces.astype("<u2").ravel()]
    source = hand_made(tmp_path / "a.gltf", document, *arrays)
    model = ssdr.decompose(ssdr.load(source), bones=2, effort="balanced").skinning
    if not fitted:
        plain = dataclasses.replace(model.surface, normals=None)
        model = dataclasses.replace(model, surface=plain)
    ssdr.save(model, tmp_path / "b.glb", template=source)
    first, second = drawn.from_gltf(tmp_path / "b.glb")
    expected = drawn.vertex_normals(frames, faces)
    assert np.abs(first[0] - frames).max() < 0.03
    for (_, normals, triangles, _), sign in ((first, 1), (second, -1 if mirrored else 1)):
        turned = triangles[:, ::sign]
        np.testing.assert_array_equal(turned, faces)  # a mirrored node turned the front away
        error = drawn.mean_angle(normals[:, turned], expected * [sign, 1, 1])
        assert error < (3 if fitted else 10)
    ridge = np.flatnonzero(np.isclose(frames[0, :, 0], 0)).reshape(2, -1)
    for left, right in ridge[:, :3].T:
        assert naive.angles(first[1][0, left], first[1][0, right]) > 60


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (1, 2, -0.5)])
def test_usd(tmp_path, roof, scale):
    pytest.importorskip("pxr")
    from pxr import Gf, Usd, UsdGeom, Vt

    frames, faces = roof
    source, target = tmp_path / "a.usda", tmp_path / "b.usda"
    ssdr.save(ssdr.MeshSequence(frames, faces), source)
    stage = Usd.Stage.Open(str(source))
    (mesh,) = items(stage, UsdGeom.Mesh)
    size = mesh.AddScaleOp()
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(vertex_normals(frames[0], faces)))
    mesh.SetNormalsInterpolation("vertex")
    turned = -1 if np.prod(scale) < 0 else 1  # a mirrored mesh is written with its outside in front
    for t in range(3):  # it grows from a point, which shows no side
        size.Set(Gf.Vec3f(*scale) * (t / 2), t)
    stage.GetRootLayer().Save()
    np.testing.assert_array_equal(ssdr.load(source).faces[:, ::turned], faces)
    size.GetAttr().Clear()
    size.Set(Gf.Vec3f(*scale))
    stage.GetRootLayer().Save()
    result = ssdr.decompose(ssdr.load(source), bones=2, effort="fast")
    ssdr.save(result, target)
    expected = drawn.vertex_normals(frames * scale, faces) * turned
    error = drawn.mean_angle(drawn.from_usd(target, range(FRAMES))[:, :, ::turned], expected)
    assert error < 5
    assert error == pytest.approx(result.normals.mean, abs=0.5)
