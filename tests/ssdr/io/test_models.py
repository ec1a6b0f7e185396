"""Models through every format that holds them: what it holds comes back, as others play it too."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers import drawn
from helpers.rig_model import baked_by_usd, largest_distance, tube
from helpers.rig_tree import creature, stretched
from ssdr import Clip, Space
from ssdr.io import FORMATS

CLIPS = (Clip("walk", 0, 9, 24.0), Clip("jump/high", 9, 19, 60.0), Clip("death", 19, 20, 25.0))


def points():
    model = tube(frames=1)
    parts = model.rest, model.indices, model.weights, model.transforms
    return ssdr.Skinning(*parts, fps=30, name="tube")


MODELS = {
    "tube": tube,
    "many influences": lambda: tube(bones=12, influences=7),
    "similarity": lambda: tube(scaled=True),
    "a scale that the model does not name": lambda: dataclasses.replace(
        tube(scaled=True), bone_model="rigid"
    ),
    "stretched": lambda: stretched(tube()),
    "stretched tree": lambda: stretched(creature()),
    "clips": lambda: dataclasses.replace(tube(), clips=CLIPS),
    "scaled clips": lambda: dataclasses.replace(tube(scaled=True), clips=CLIPS),
    "a named clip": lambda: dataclasses.replace(tube(), clips=[Clip("bend", 0, 20, 24.0)]),
    "points in one frame": points,
}
NOTHING = "unit not stated, up axis not stated: taken for 1 m a unit, y up"
SUFFIXES = [".npz", ".glb", ".gltf", ".usda", ".usdc", ".usd"]


def test_every_format_of_models_is_in_the_table():
    able = {suffix for suffix, row in FORMATS.items() if row.writes_skinnings}
    assert able - {".fbx"} == set(SUFFIXES)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("what", MODELS)
def test_a_model_comes_back(tmp_path, what, suffix):
    usd = suffix.startswith(".usd")
    if usd:
        pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")
    model, path = MODELS[what](), tmp_path / f"a file{suffix}"
    report, truth = ssdr.save(model, path), model.skin()
    halves = usd and (what == "a scale that the model does not name" or model.bone_model != "rigid")
    bound = 1e-5 if model.bone_model == "affine" else 4e-6
    bound = bound if not halves else 0.02 if model.bone_model == "affine" else 4e-3
    assert ("half precision" in str(report.notes)) == halves
    back = ssdr.load_skinning(path)
    gap = np.linalg.norm(back.skin(dtype=np.float64) - truth, axis=2)
    assert gap.max() < bound
    assert report.error < 2e-7 or report.error == pytest.approx(np.sqrt((gap**2).mean()), rel=1e-2)
    assert (report.max_error or 0) < bound
    assert report.max_error < 1e-6 or report.max_error == pytest.approx(gap.max(), rel=1e-2)
    if not usd:
        assert report.bytes == sum(f.stat().st_size for f in path.parent.iterdir())
    # of what is not known, nothing is turned; formats with units and axes of their own state theirs
    assert (NOTHING in str(report.notes)) == (suffix != ".npz")
    assert back.space == (Space() if suffix == ".npz" else Space(1.0, "y"))
    for field in ("clips", "fps", "name", "n_influences"):
        assert getattr(back, field) == getattr(model, field)
    assert back.names() == model.names()
    assert np.array_equal(back.parents, model.parents)
    if what != "a scale that the model does not name":
        assert back.bone_model == model.bone_model
    shown = ssdr.load(path)
    assert (shown.clip, shown.name) == (model.clips[0].name, model.name)
    assert largest_distance(shown.vertices, truth[model.clips[0].frames]) < bound
    if what.startswith("points"):
        assert (report.between_frames or 0, len(back.faces)) == (0, 0)
    elif suffix == ".glb":
        for clip in model.clips:
            ((seen, _, _, vertex),) = drawn.from_gltf(path, clip=clip.name)
            assert largest_distance(seen, truth[clip.frames][:, vertex]) < bound
    elif usd and len(model.clips) == 1:
        assert largest_distance(baked_by_usd(path, range(model.n_frames)), truth) < bound


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_surface_comes_back(tmp_path, suffix):
    if usd := suffix.startswith(".usd"):
        pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")
    model = tube(frames=2)
    report = ssdr.save(model, tmp_path / f"a{suffix}")
    assert ("the names alone" in str(report.notes)) == usd
    back = ssdr.load_skinning(tmp_path / f"a{suffix}")
    own, found, order = model.surface, back.surface, np.arange(len(model.faces))
    if suffix in (".glb", ".gltf"):
        order = np.argsort(own.material_index, kind="stable")  # a primitive for each material
    np.testing.assert_array_equal(back.faces, model.faces[order])
    np.testing.assert_allclose(found.uv, own.uv[order], atol=1e-7)
    np.testing.assert_array_equal(found.material_index, own.material_index[order])
    assert largest_distance(found.normals, own.normals[order]) < 0.02
    assert [m.name for m in found.materials] == [m.name for m in own.materials]
    if not usd:
        assert found.materials[0].texture == own.materials[0].texture
        assert found.materials[1].double_sided
        np.testing.assert_allclose(found.materials[1].base_color, [0.1, 0.6, 0.2, 1])
