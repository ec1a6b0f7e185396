"""What is written as USD plays back: usd-core's own skinning is the witness."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.rig_model import baked_by_usd, largest_distance, tube
from ssdr.io.rig import build_rig

pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")
from pxr import Usd, UsdGeom, UsdSkel


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
@pytest.mark.parametrize("options", [{}, {"bones": 12, "influences": 10}])
def test_usd_skins_the_same_vertices(tmp_path, suffix, options):
    model, path = tube(**options), tmp_path / f"model{suffix}"
    ssdr.save(model, path)
    assert ssdr.load_skinning(path).n_influences == model.n_influences
    assert largest_distance(baked_by_usd(path, range(20)), model.skin()) < 3e-6


def test_between_frames_is_what_usd_shows(tmp_path):
    model = tube()
    report = ssdr.save(model, tmp_path / "a.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(binding.GetSkeleton())
    times = np.arange(19) + 0.5
    ours = build_rig(model).matrices(times)
    theirs = np.array([np.array(query.ComputeSkinningTransforms(t)) for t in times])
    np.testing.assert_allclose(np.swapaxes(theirs, 2, 3)[:, :, :3], ours, atol=2e-6)
    shown = ssdr.skin(model.rest, model.indices, model.weights, ours)
    truth = model.skin()
    gap = shown - (truth[1:] + truth[:-1]) / 2
    assert report.between_frames == pytest.approx(np.sqrt((gap**2).sum(axis=2).mean()), rel=1e-4)


def test_point_cache(tmp_path):
    model = tube()
    sequence = ssdr.MeshSequence(model.skin(), model.faces, 30.0, surface=model.surface)
    path = tmp_path / "cache.usdc"
    report = ssdr.save(sequence, path, up="z", units=0.01)
    assert report.max_error < 1e-6
    assert ("normals" in str(report.notes)) == (model.surface.normals is not None)
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    del stage
    back = ssdr.load(path)
    assert back.fps == 30
    assert largest_distance(back.vertices, sequence.vertices) < 1e-6
    np.testing.assert_array_equal(back.surface.uv, model.surface.uv)
    turned = ssdr.io.in_space(back, ssdr.Space(up="y"))
    assert largest_distance(turned.vertices, back.vertices[..., [0, 2, 1]] * [1, 1, -1]) == 0
    with pytest.raises(ssdr.FormatError, match="its points move"):
        ssdr.load_skinning(path)
    exact = ssdr.MeshSequence(sequence.vertices.astype(np.float32), model.faces)
    assert ssdr.save(exact, path).error == 0
    np.testing.assert_array_equal(ssdr.load(path).vertices, exact.vertices)
    with pytest.raises(ssdr.InputError, match="units"):
        ssdr.save(exact, path, units=0)
