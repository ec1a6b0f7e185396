"""Sequences through every format that holds them: what it holds comes back, the rest is said."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.surfaces import same_surface
from ssdr import Clip, InputError
from ssdr.io import FORMATS
from ssdr.mesh.normals import corner_normals

# Of a file: what it holds beside vertices and faces, and the option that reads it.
EXACT = {"float64", "fps", "uv", "normals", "materials", "vertex map", "name"}
HOLDS = {
    "a.npz": EXACT,
    "a.npy": {"float64"},
    "a_%02d.obj": {"float64", "uv", "normals", "names"},
    "a_%02d.ply": {"float64"},
    "a.pc2": set(),
    "a.mdd": {"fps"},
    "a.abc": {"fps", "uv", "normals", "names", "name"},
    "a.usda": {"fps", "uv", "names"},
    "a.usdc": {"fps", "uv", "names"},
}
CACHES = (".pc2", ".mdd")
MODULES = {".abc": "alembic3d", ".usda": "pxr.UsdSkel", ".usdc": "pxr.UsdSkel"}


@pytest.fixture(params=HOLDS)
def path(request, tmp_path):
    suffix = request.param[request.param.index(".") :]
    if suffix in MODULES:
        pytest.importorskip(MODULES[suffix])
    return tmp_path / request.param


def there_and_back(sequence, path):
    """Report of saving, and the sequence that is read; a cache with the mesh of its vertices."""
    options = {}
    if path.suffix in CACHES:
        options["faces"] = sequence.faces if len(sequence.faces) else "none"
    report = ssdr.save(sequence, path)
    written = [f for f in path.parent.iterdir() if f.is_file()]
    assert report.bytes == sum(f.stat().st_size for f in written)
    back = ssdr.load(path, **options)
    frames = back.frames(slice(None))
    if "float64" in HOLDS[path.name]:
        assert (report.error, report.max_error) == (0, 0)
        np.testing.assert_array_equal(frames.astype(sequence.vertices.dtype), sequence.vertices)
    else:
        np.testing.assert_array_equal(frames, sequence.vertices.astype(np.float32))
        off = np.linalg.norm(frames.astype(np.float64) - sequence.vertices, axis=2)
        assert report.error == pytest.approx(np.sqrt((off**2).mean()))
        assert (report.max_error or 0) == pytest.approx(off.max())
    np.testing.assert_array_equal(back.faces, sequence.faces)
    if "fps" in HOLDS[path.name]:
        assert back.fps == pytest.approx(sequence.fps, rel=1e-4 if path.suffix == ".mdd" else 1e-9)
    return report, back


def test_every_format_of_sequences_is_in_the_table():
    able = {suffix for suffix, row in FORMATS.items() if row.writes_sequences}
    assert able == {name[name.index(".") :] for name in HOLDS} | {".usd"}


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("fps", [24000 / 1001, 30.0])
def test_a_sequence_comes_back(path, wave, rng, dtype, fps):
    vertices = np.concatenate([wave.vertices, rng.normal(0, 1e3, (9, 12, 3))]).astype(dtype)
    sequence = ssdr.MeshSequence(vertices, wave.faces, fps, name="sheet")
    _, back = there_and_back(sequence, path)
    if "name" in HOLDS[path.name]:
        assert back.name == "sheet"


@pytest.mark.parametrize("welded", [False, True])
def test_a_surface_comes_back_as_far_as_the_format_holds_it(path, seam, welded):
    sequence = seam.weld()[0] if welded else seam
    holds = HOLDS[path.name]
    report, back = there_and_back(sequence, path)
    own, found = sequence.surface, back.surface
    if not holds & {"uv", "normals", "materials", "names"}:
        assert found is None
        assert "not kept" in str(report.notes) or path.suffix in CACHES
        return
    np.testing.assert_array_equal(found.uv, own.uv)
    kept = [own.materials[k].name for k in own.material_index]
    assert [found.materials[k].name for k in found.material_index] == kept
    if path.suffix == ".abc":
        truth = corner_normals(sequence.vertices[0], sequence.faces, own)
        np.testing.assert_allclose(found.normals, truth, atol=1e-6)
    elif "normals" in holds:
        np.testing.assert_array_equal(found.normals, own.normals)
    if "materials" in holds:
        same_surface(found, own)
    assert (back.vertex_map is not None) == (welded and "vertex map" in holds)
    if back.vertex_map is not None:
        np.testing.assert_array_equal(back.vertex_map, sequence.vertex_map)


def test_points_and_names_of_any_kind(path):
    points = np.random.default_rng(0).normal(size=(3, 5, 3))
    _, back = there_and_back(ssdr.MeshSequence(points, name="a/b ü"), path)
    assert len(back.faces) == 0


def test_a_model_is_baked(path, skinned):
    clips = (Clip("walk", 0, 4, 30.0), Clip("jump", 4, 6, 30.0))
    report = ssdr.save(dataclasses.replace(skinned, clips=clips), path)
    if FORMATS[path.suffix].writes_skinnings:
        assert "clips" not in str(report.notes)
        return
    assert "clips are not kept apart: walk from frame 0, jump from frame 4" in str(report.notes)
    options = {"faces": "none"} if path.suffix in CACHES else {}
    back = ssdr.load(path, **options).frames(slice(None))
    np.testing.assert_array_equal(back.astype(np.float32), skinned.skin().astype(np.float32))


def test_a_coordinate_beyond_float32_is_kept_or_leaves_no_file(path, wave):
    far = ssdr.MeshSequence(wave.vertices.astype(np.float64) * 1e39, wave.faces)
    if "float64" in HOLDS[path.name]:
        there_and_back(far, path)
        return
    with pytest.raises(InputError, match="thing: expected coordinates that float32 can hold"):
        ssdr.save(far, path)
    assert not list(path.parent.iterdir())
