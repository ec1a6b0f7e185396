"""Folders of numbered glTF files, as generators of animated meshes write them, are one sequence."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh
from PIL import Image

import ssdr
from ssdr import FormatError, InputError


def texture():
    colors = np.arange(16 * 16 * 3, dtype=np.uint8).reshape(16, 16, 3)
    return Image.fromarray(colors)


def uv_of(points):
    return np.ascontiguousarray((points[:, :2] * 0.25 + 0.5).astype(np.float32))


def write(path, points, faces, uv):
    look = trimesh.visual.TextureVisuals(
        uv=uv, material=trimesh.visual.material.PBRMaterial(baseColorTexture=texture())
    )
    mesh = trimesh.Trimesh(points, faces, visual=look, process=False)
    path.write_bytes(mesh.export(file_type="glb"))


def pose(points, faces, *, frames=1, surface=None):
    return ssdr.Skinning(
        points,
        np.zeros((len(points), 1), dtype=np.int32),
        np.ones((len(points), 1)),
        np.tile(np.eye(3, 4), (frames, 1, 1, 1)),
        faces=faces,
        surface=surface,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("generated")
    sample = ssdr.samples.load()
    uv = uv_of(sample.vertices[0])
    for t, points in enumerate(sample.vertices):
        write(path / f"mesh_{t:03d}.glb", points, sample.faces, uv)
    return path


def test_72_glb_files_are_the_sample(folder):
    sample = ssdr.samples.load()
    for name in ("", "mesh_%03d.glb", "mesh_*.glb"):
        found = ssdr.load(folder / name)
        assert found.vertices.dtype == np.float32
        np.testing.assert_array_equal(found.vertices, sample.vertices)
        np.testing.assert_array_equal(found.faces, sample.faces)
        assert found.fps == 24
    uv = uv_of(sample.vertices[0])[sample.faces]
    _check_flipped_twice(found.surface.uv, uv)
    picture = io.BytesIO()
    texture().save(picture, format="PNG")
    (material,) = found.surface.materials
    assert material.texture in (folder / "mesh_000.glb").read_bytes()
    with Image.open(io.BytesIO(material.texture)) as back:
        np.testing.assert_array_equal(np.asarray(back), np.asarray(texture()))
    assert ssdr.load(folder, fps=8).fps == 8
    assert ssdr.load(folder / "mesh_003.glb").n_frames == 1


def test_seams_split_by_this_package_close_again(folder, tmp_path):
    sample = ssdr.samples.load("dancer_small")
    rng = np.random.default_rng(0)
    uv = rng.uniform(0.0, 1.0, (len(sample.faces), 3, 2)).astype(np.float32)
    surface = ssdr.Surface(uv=uv)
    for t in range(3):
        ssdr.save(pose(sample.vertices[t], sample.faces, surface=surface), tmp_path / f"m{t}.glb")
    back = ssdr.load(tmp_path)
    np.testing.assert_array_equal(back.vertices, sample.vertices[:3])
    _check_flipped_twice(back.surface.uv, uv)
    # Once they have been through a file, UVs stay as they are.
    (tmp_path / "again").mkdir()
    for t in range(2):
        again = pose(sample.vertices[t], sample.faces, surface=back.surface)
        ssdr.save(again, tmp_path / "again" / f"m{t}.glb")
    np.testing.assert_array_equal(ssdr.load(tmp_path / "again").surface.uv, back.surface.uv)


def _check_flipped_twice(found, expected):
    """u to the bit; v too from 1/2 upwards and on the grid of 2^-24, else to its rounding."""
    np.testing.assert_array_equal(found[..., 0], expected[..., 0])
    a, b = found[..., 1], expected[..., 1]
    exact = (b >= 0.5) | (np.float64(b) * 2**24 % 1 == 0)
    np.testing.assert_array_equal(a[exact], b[exact])
    np.testing.assert_allclose(np.float64(a), np.float64(b), rtol=0, atol=2.0**-25)


def test_each_file_is_one_frame(tmp_path):
    sample = ssdr.samples.load("dancer_small")
    for t in range(2):
        walk = pose(sample.vertices[t], sample.faces, frames=24)
        walk.transforms[5:, :, 0, 3] = 1.0
        ssdr.save(walk, tmp_path / f"walk_{t}.glb")
    with pytest.raises(FormatError, match=r"walk_0\.glb: an animation of 24 frames, where each"):
        ssdr.load(tmp_path)
    with pytest.raises(InputError, match=r"for numbered meshes.*animation"):
        ssdr.load(tmp_path, animation=0)
    with pytest.raises(FileNotFoundError, match="no mesh files"):
        ssdr.load(tmp_path / "run_*.glb")
