"""What is read from USD is what the file says; damage is refused."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

import ssdr
from helpers.rig_model import baked_by_usd, largest_distance, tube
from helpers.stages import mesh

pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")


def test_sampling_and_fps(tmp_path):
    ssdr.save(tube(frames=11), tmp_path / "a.usdc")
    twice = ssdr.load(tmp_path / "a.usdc", fps=48)
    assert (twice.n_frames, twice.fps) == (21, 48)
    assert largest_distance(twice.vertices[::2], tube(frames=11).skin()) < 1e-6


@pytest.mark.parametrize("read", [ssdr.load, ssdr.load_skinning])
def test_irregular_samples_are_sampled_and_what_that_loses_is_said(tmp_path, read):
    codes = [0, 0.31, 1.2, 1.94, 4.8, 7.92, 9.65, 12.24, 18.4, 22.41]
    stage = Usd.Stage.CreateNew(str(tmp_path / "a.usda"))
    stage.SetTimeCodesPerSecond(24)
    x = np.sin(np.array(codes) * 0.4)
    moved = mesh(stage, "/m", [(0, 0, 0), (1, 0, 0), (0, 1, 0)]).AddTranslateOp()
    for code, value in zip(codes, x.tolist(), strict=True):
        moved.Set(Gf.Vec3d(value, 0, 0), code)
    stage.GetRootLayer().Save()
    frames = np.arange(24)
    worst = np.abs(np.interp(codes, frames, np.interp(frames, codes, x)) - x).max()
    with pytest.warns(ssdr.SsdrWarning, match=rf"9 keys .* are up to {worst:.3g} \("):
        thing = read(tmp_path / "a.usda")
    assert (thing.fps, thing.n_frames) == (24, 24)
    read(tmp_path / "a.usda", fps=24)


def test_polygons_transforms_and_primvars(tmp_path):
    path = tmp_path / "a.usda"
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetTimeCodesPerSecond(24)
    top = UsdGeom.Xform.Define(stage, "/top")
    spin = top.AddRotateZOp()
    spin.Set(0.0, 1.0)
    spin.Set(90.0, 4.0)
    for k in range(2):
        points = [(0, 0, k), (1, 0, k), (1, 1, k), (0, 1, k), (-1, 1, k)]
        one = mesh(stage, f"/top/m{k}", points, range(5))
        uv = UsdGeom.PrimvarsAPI(one).CreatePrimvar(
            "uvs", Sdf.ValueTypeNames.TexCoord2fArray, "vertex"
        )
        uv.Set([(i, k) for i in range(5)])
    one.CreateOrientationAttr("leftHanded")
    hidden = UsdGeom.Mesh.Define(stage, "/top/hidden")
    hidden.CreateVisibilityAttr("invisible")
    stage.GetRootLayer().Save()
    sequence = ssdr.load(path)
    fan = [[0, 1, 2], [0, 2, 3], [0, 3, 4]]
    other = [[7, 6, 5], [8, 7, 5], [9, 8, 5]]
    np.testing.assert_array_equal(sequence.faces, fan + other)
    assert sequence.n_frames == 4
    np.testing.assert_allclose(sequence.vertices[3, 1], [0, 1, 0], atol=1e-6)
    angle = np.deg2rad(30)
    np.testing.assert_allclose(
        sequence.vertices[1, 1], [np.cos(angle), np.sin(angle), 0], atol=1e-6
    )
    np.testing.assert_array_equal(sequence.surface.uv[0], [[0, 0], [1, 0], [2, 0]])
    model = ssdr.load_skinning(path)
    assert model.names() == ("m0", "m1")
    assert largest_distance(model.skin(), sequence.vertices) < 1e-6


def test_blend_shapes_and_bind_transform_against_usd(tmp_path):
    ssdr.save(tube(frames=6), tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    shape = UsdSkel.BlendShape.Define(stage, "/tube/Mesh/bulge")
    rows = np.arange(0, 250, 7, dtype=np.int32)
    shape.CreateOffsetsAttr([(0.3, 0.1 * i, -0.2) for i in range(len(rows))])
    shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(rows))
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath("/tube/Mesh"))
    binding.CreateBlendShapesAttr(["bulge"])
    binding.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])
    binding.GetGeomBindTransformAttr().Set(Gf.Matrix4d(1).SetTranslate(Gf.Vec3d(0.5, 0, 0.25)))
    animation = UsdSkel.Animation(stage.GetPrimAtPath("/tube/Skeleton/Animation"))
    animation.CreateBlendShapesAttr(["bulge"])
    weights = animation.CreateBlendShapeWeightsAttr()
    for frame in range(6):
        weights.Set([frame / 5], frame)
    UsdGeom.Xformable(stage.GetPrimAtPath("/tube")).AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    stage.GetRootLayer().Export(str(tmp_path / "b.usda"))
    sequence = ssdr.load(tmp_path / "b.usda")
    truth = baked_by_usd(tmp_path / "b.usda", range(6))
    assert largest_distance(sequence.vertices, truth) < 5e-6
    assert largest_distance(sequence.vertices, tube(frames=6).skin()) > 1
    model = ssdr.load_skinning(tmp_path / "b.usda")
    assert model.shapes.names == ("bulge",)
    np.testing.assert_array_equal(np.flatnonzero(model.shapes.moved[0]), rows)
    assert largest_distance(model.skin(), truth) < 5e-6


def test_meshes_are_chosen_by_name(tmp_path):
    path = tmp_path / "a.usda"
    stage = Usd.Stage.CreateNew(str(path))
    for k, name in enumerate(("/skirt/SkirtShape", "/body/Shape")):
        mesh(stage, name, [(k, 0, 0), (k, 1, 0), (k, 0, 1)])
    stage.GetRootLayer().Save()
    assert ssdr.load(path).n_vertices == 6
    for name in ("skirt", "SkirtShape", ["SkirtShape"]):
        assert ssdr.load(path, meshes=name).vertices[0, :, 0].tolist() == [0, 0, 0]
    assert ssdr.load_skinning(path, meshes="body").rest[:, 0].tolist() == [1, 1, 1]
    with pytest.raises(ssdr.InputError, match=r"meshes: .*SkirtShape.*'trousers'"):
        ssdr.load(path, meshes="trousers")
    assert ssdr.io.list_meshes(path) == ("SkirtShape", "Shape")
    stage = Usd.Stage.Open(str(path))
    Sdf.CopySpec(stage.GetRootLayer(), "/body/Shape", stage.GetRootLayer(), "/skirt/Shape")
    stage.GetRootLayer().Save()
    assert ssdr.io.list_meshes(path) == ("SkirtShape", "/skirt/Shape", "/body/Shape")
    assert ssdr.load(path, meshes="Shape").n_vertices == 6
    assert ssdr.load(path, meshes="/skirt/Shape").n_vertices == 3
