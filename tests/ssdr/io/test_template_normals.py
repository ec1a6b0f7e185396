"""Normals in templates: those of the model, outwards in mirrored nodes, hard where the file's are.

Expected normals come from the vertices that the file says, in loops over triangles.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ssdr
from helpers import drawn, naive
from helpers.glb import accessors_of, packed
from helpers.motions import grid

FRAMES = 12


def bent_roof():
    """Vertices (F, V, 3) and triangles of two sheets that meet at a right angle, and bend.

    Vertices at the ridge are doubled, so that each sheet has its own.
    """
    x, y = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 2, 9), indexing="ij")
    left = np.stack([-x, y, -x], axis=-1).reshape(-1, 3)
    right = np.stack([x, y, -x], axis=-1).reshape(-1, 3)
    faces = grid(5, 9)
    faces = np.concatenate([faces[:, ::-1], faces + 45])
    rest, frames = np.concatenate([left, right]), []
    upper = np.clip(rest[:, 1:2] - 0.5, 0, 1)
    for t in range(FRAMES):
        turn = Rotation.from_rotvec([0.7 * np.sin(2 * np.pi * t / FRAMES), 0, 0]).as_matrix()
        frames.append((1 - upper) * rest + upper * ((rest - [0, 1, 0]) @ turn.T + [0, 1, 0]))
    return np.array(frames), faces


def morphing(path, frames, faces, nodes):
    """A ``.glb`` whose nodes show one mesh, with a morph target for each frame but the first."""
    normals = np.zeros_like(frames[0])
    np.add.at(normals, faces, naive.corner_normals(frames[0], faces))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    floats = [frames[0], normals, *(frames[1:] - frames[0])]
    floats += [np.arange(len(frames)) / 24, np.eye(len(frames))[:, 1:].ravel()]
    parts, binary = accessors_of(
        [array.astype("<f4") for array in floats] + [faces.astype("<u2").ravel()]
    )
    count, time = len(frames) - 1, 1 + len(frames)
    primitive = {
        "attributes": {"POSITION": 0, "NORMAL": 1},
        "indices": time + 2,
        "targets": [{"POSITION": 2 + k} for k in range(count)],
    }
    channels = [{"sampler": 0, "target": {"node": k, "path": "weights"}} for k in range(len(nodes))]
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": [{"mesh": 0, **node} for node in nodes],
        "meshes": [{"primitives": [primitive], "weights": [0] * count}],
        "animations": [{"channels": channels, "samplers": [{"input": time, "output": time + 1}]}],
        **parts,
        "buffers": [{"byteLength": len(binary)}],
    }
    return packed(path, document, binary)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("fitted", [False, True])
def test_gltf(tmp_path, mirrored, fitted):
    frames, faces = bent_roof()
    nodes = [{"name": "a"}, {"name": "b", "translation": [3, 0, 0]}]
    if mirrored:
        nodes[1]["scale"] = [-1, 1, 1]
    source = morphing(tmp_path / "a.glb", frames, faces, nodes)
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
    ridge = [np.flatnonzero(np.isclose(frames[0, :, 0], 0) & half) for half in halves()]
    for k in range(3):
        assert naive.angles(first[1][0, ridge[0][k]], first[1][0, ridge[1][k]]) > 60


def halves():
    return np.arange(90) < 45, np.arange(90) >= 45


@pytest.mark.parametrize("grows", [False, True])
@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (1, 2, -0.5)])
def test_usd(tmp_path, scale, grows):
    pytest.importorskip("pxr")
    from pxr import Gf, Usd, UsdGeom, Vt

    frames, faces = bent_roof()
    source, target = tmp_path / "a.usda", tmp_path / "b.usda"
    ssdr.save(ssdr.MeshSequence(frames, faces), source)
    stage = Usd.Stage.Open(str(source))
    (mesh,) = (UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
    size = mesh.AddScaleOp()
    size.Set(Gf.Vec3f(*scale))
    for t in range(3 if grows else 0):
        size.Set(Gf.Vec3f(*scale) * (t / 2), t)
    normals = np.zeros_like(frames[0])
    normals[faces] = naive.corner_normals(frames[0], faces)
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
    mesh.SetNormalsInterpolation("vertex")
    stage.GetRootLayer().Save()
    if grows:  # from a point, which shows no side
        turned = np.sign(np.prod(scale)).astype(int)
        np.testing.assert_array_equal(ssdr.load(source).faces[:, ::turned], faces)
        return
    result = ssdr.decompose(ssdr.load(source), bones=2, effort="fast")
    ssdr.save(result, target)
    expected = drawn.vertex_normals(frames * scale, faces) * np.sign(np.prod(scale))
    turned = -1 if np.prod(scale) < 0 else 1  # a mirrored mesh is written with its outside in front
    found = drawn.from_usd(target, range(FRAMES))[:, :, ::turned]
    error = drawn.mean_angle(found, expected)
    assert error < 5
    assert error == pytest.approx(result.normals.mean, abs=0.5)
