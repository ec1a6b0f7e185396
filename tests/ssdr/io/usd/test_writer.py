"""What is written as USD plays back: usd-core's own skinning is the witness."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel

import ssdr
from helpers.disks import small_files
from helpers.rig_model import baked_by_usd, largest_distance, tube
from ssdr.io.axes import turn_skinning_up
from ssdr.io.rig import build_rig

pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
@pytest.mark.parametrize("options", [{}, {"bones": 12, "influences": 10}])
def test_round_trip(tmp_path, suffix, options):
    model = tube(**options)
    path = tmp_path / f"model{suffix}"
    report = ssdr.save(model, path)
    truth = model.skin()
    assert report.error < 2e-7
    assert report.influences == model.n_influences
    assert largest_distance(baked_by_usd(path, range(20)), truth) < 3e-6
    sequence, back = ssdr.load(path), ssdr.load_skinning(path)
    assert (sequence.fps, sequence.n_frames, sequence.name) == (24.0, 20, "tube")
    assert largest_distance(sequence.vertices, truth) < 1e-6
    assert largest_distance(back.skin(), truth) < 1e-6
    assert back.bone_model == "rigid"
    assert back.names() == model.names()
    np.testing.assert_array_equal(back.faces, model.faces)
    np.testing.assert_array_equal(back.surface.uv, model.surface.uv)
    np.testing.assert_array_equal(back.surface.material_index, model.surface.material_index)
    assert back.surface.materials[0].texture == model.surface.materials[0].texture
    assert largest_distance(back.surface.normals, model.surface.normals) < 0.02
    np.testing.assert_allclose(back.surface.materials[1].base_color, [0.1, 0.6, 0.2, 1])


def test_similarity_bones_cost_what_the_report_says(tmp_path):
    model = tube(scaled=True)
    report = ssdr.save(model, tmp_path / "a.usdc")
    back = ssdr.load_skinning(tmp_path / "a.usdc")
    assert back.bone_model == "similarity"
    assert "half precision" in report.note
    gap = largest_distance(back.skin(dtype=np.float64), model.skin())
    assert report.max_error == pytest.approx(gap, rel=1e-2)
    assert gap < 1e-3 * 5


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
    rig = build_rig(model)
    ours = rig.matrices(times)
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
    report = ssdr.save(sequence, path, up="z", meters_per_unit=0.01)
    assert report.max_error < 1e-6
    assert ("normals" in report.note) == (model.surface.normals is not None)
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    del stage
    back = ssdr.load(path)
    assert back.fps == 30
    assert largest_distance(back.vertices, sequence.vertices) < 1e-6
    np.testing.assert_array_equal(back.surface.uv, model.surface.uv)
    turned = ssdr.load(path, up="y")
    assert largest_distance(turned.vertices, back.vertices[..., [0, 2, 1]] * [1, 1, -1]) == 0
    with pytest.raises(ssdr.FormatError, match="points or blend shapes"):
        ssdr.load_skinning(path)
    exact = ssdr.MeshSequence(sequence.vertices.astype(np.float32), model.faces)
    assert ssdr.save(exact, path).error is None
    np.testing.assert_array_equal(ssdr.load(path).vertices, exact.vertices)


def test_up_of_a_skinning(tmp_path):
    model = turn_skinning_up(tube(), "y", "z")
    ssdr.save(model, tmp_path / "a.usda", up="z")
    back = ssdr.load_skinning(tmp_path / "a.usda", up="y")
    assert largest_distance(back.skin(), tube().skin()) < 1e-6


def test_keyframes_are_kept_together(tmp_path):
    model = tube(frames=9)
    keys = np.zeros((9, 5), dtype=bool)
    keys[[0, 8]] = True
    keys[4, 1] = True
    sparse = ssdr.Skinning(
        model.rest,
        model.indices,
        model.weights,
        model.transforms,
        faces=model.faces,
        keyframes=keys,
    )
    report = ssdr.save(sparse, tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    animation = UsdSkel.Animation(stage.GetPrimAtPath("/a/Skeleton/Animation"))
    assert animation.GetRotationsAttr().GetTimeSamples() == [0, 4, 8]
    back = ssdr.load(tmp_path / "a.usda")
    assert back.n_frames == 9
    assert report.max_error == pytest.approx(
        largest_distance(back.vertices, model.skin()), rel=1e-3
    )


def test_options_are_checked(tmp_path):
    for options in ({"up": "x"}, {"meters_per_unit": 0}, {"influences": 0}):
        with pytest.raises(ssdr.InputError):
            ssdr.save(tube(frames=2), tmp_path / "a.usda", **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.usdc", "a.usda"])
def test_a_full_disk_is_an_error_of_the_system_that_names_the_file(tmp_path, name):
    """Not pxr's own, which nobody catches."""
    sample = ssdr.samples.load("dancer_small")
    with small_files(4000), pytest.raises(OSError, match="File too large") as caught:
        ssdr.save(sample, tmp_path / name)
    assert caught.value.filename == str(tmp_path / name)
    assert list(tmp_path.iterdir()) == []
