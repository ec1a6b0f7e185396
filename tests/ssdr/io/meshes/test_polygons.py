"""Polygons become triangles that cover them, face as they do and are the same in all frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import ssdr
from ssdr.io.meshes.polygons import cut

# an L whose fan at its first corner leaves it
ELL = np.array([[2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0], [0, 0, 0]], float)


def areas(vertices, triangles):
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    return np.cross(b - a, c - a) / 2


@given(st.integers(0, 2**32 - 1), st.integers(3, 12))
def test_a_star_is_covered_once(seed, count):
    """Its triangles all face one way, and their areas add up to that by the shoelace formula."""
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.2, 1, count)
    angle = 2 * np.pi * (np.arange(count) + rng.uniform(0, 0.3, count)) / count
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    area = 0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()
    turn = Rotation.random(rng=rng).as_matrix() if seed % 4 else np.eye(3)[[1, 2, 0]]
    flat = np.stack([x, y, 0 * x], axis=1)
    for points, normal in ((flat, turn[:, 2]), (flat[::-1], -turn[:, 2])):
        corners, _ = cut(np.array([count]), np.arange(count), points @ turn.T)
        along = areas(points @ turn.T, corners) @ normal
        assert corners.shape == (count - 2, 3)
        assert along.min() > -1e-12
        assert along.sum() == pytest.approx(area)


def test_the_others_stay_fans():
    vertices = np.concatenate([ELL, ELL + 1])
    index = np.array([0, 1, 2, 5, 6, 7, 8, 9, 10, 11, 0, 1, 6])
    corners, polygon = cut(np.array([4, 6, 3]), index, vertices)
    assert polygon.tolist() == [0, 0, 1, 1, 1, 1, 2]
    assert corners[[0, 1, 6]].tolist() == [[0, 1, 2], [0, 2, 3], [10, 11, 12]]
    assert np.linalg.norm(areas(vertices, index[corners[2:6]]), axis=1).sum() == pytest.approx(3)


# The L as one polygon in three frames; the second is turned over.
FRAMES = np.stack([ELL, ELL * [1, -1, 1], ELL + 1])
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\n"
    "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
)


def numbered(folder, kind):
    for k, points in enumerate(FRAMES):
        rows = [" ".join(map(str, point)) for point in points]
        text = "".join(f"v {row}\n" for row in rows) + "f 1 2 3 4" + " " * k + " 5 6\n"
        if kind == "ply":
            text = PLY + "\n".join([*rows, "6 0 1 2 3 4 5\n"])
        (folder / f"a_{k}.{kind}").write_text(text)
    return folder / f"a_%d.{kind}"


def stage(folder):
    pytest.importorskip("pxr.UsdSkel")
    from pxr import Usd, UsdGeom, Vt

    made = Usd.Stage.CreateNew(str(folder / "a.usda"))
    mesh = UsdGeom.Mesh.Define(made, "/ell")
    mesh.CreateFaceVertexCountsAttr([6])
    mesh.CreateFaceVertexIndicesAttr([*range(6)])
    points = mesh.CreatePointsAttr()
    for k, frame in enumerate(FRAMES):
        points.Set(Vt.Vec3fArray.FromNumpy(frame.astype(np.float32)), k)
    made.GetRootLayer().Save()
    return folder / "a.usda"


@pytest.mark.parametrize("kind", ["obj", "ply", "usda"])
def test_polygons_of_files_are_cut_as_in_the_first_frame(kind, tmp_path):
    path = stage(tmp_path) if kind == "usda" else numbered(tmp_path, kind)
    back = ssdr.load(path)
    for frame in np.asarray(back.vertices, dtype=np.float64):
        assert np.linalg.norm(areas(frame, back.faces), axis=1).sum() == pytest.approx(3)
    assert (areas(ELL, back.faces)[:, 2] > 0).all()
