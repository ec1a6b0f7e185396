"""What is written as USD plays back: usd-core's own skinning is the witness."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.rig_model import tube
from ssdr.io.played_model import as_played

pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")
from pxr import Usd, UsdGeom, UsdSkel


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
    ours = as_played(model).matrices(times)
    theirs = np.array([np.array(query.ComputeSkinningTransforms(t)) for t in times])
    np.testing.assert_allclose(np.swapaxes(theirs, 2, 3)[:, :, :3], ours, atol=2e-6)
    shown = ssdr.skin(model.rest, model.indices, model.weights, ours)
    truth = model.skin()
    gap = shown - (truth[1:] + truth[:-1]) / 2
    assert report.between_frames == pytest.approx(np.sqrt((gap**2).sum(axis=2).mean()), rel=1e-4)


def test_a_point_cache_is_no_skinning(tmp_path):
    model, path = tube(), tmp_path / "cache.usdc"
    sequence = ssdr.MeshSequence(model.skin(), model.faces, surface=model.surface)
    assert "normals" in str(ssdr.save(sequence, path, up="z", units=0.01).notes)
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    with pytest.raises(ssdr.FormatError, match="its points move"):
        ssdr.load_skinning(path)
