"""A USD file with a new skin is the file that it was, but for the skin."""

from __future__ import annotations

import struct

import numpy as np
import pytest

import ssdr
from helpers.gltf_asset import grid, png
from helpers.rig_model import tube

pytest.importorskip("pxr")
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt


def make_stage(path):
    """Two moving meshes with materials and primvars, a camera, a light and another prim."""
    (path.parent / "maps").mkdir(exist_ok=True)
    for name, color in (("base", (200, 60, 40)), ("bumps", (128, 128, 255))):
        (path.parent / "maps" / f"{name}.png").write_bytes(png(color))
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(24)
    stage.SetStartTimeCode(10)
    stage.SetEndTimeCode(22)
    top = UsdGeom.Xform.Define(stage, "/World")
    top.AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    stage.SetDefaultPrim(top.GetPrim())
    top.GetPrim().SetCustomDataByKey("studio", "ours")
    look = UsdShade.Material.Define(stage, "/World/Looks/Skin")
    shader = UsdShade.Shader.Define(stage, "/World/Looks/Skin/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    for channel, file in (("diffuseColor", "base"), ("normal", "bumps")):
        picture = UsdShade.Shader.Define(stage, f"/World/Looks/Skin/{file}")
        picture.CreateIdAttr("UsdUVTexture")
        picture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(f"./maps/{file}.png")
        picture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
        shader.CreateInput(channel, Sdf.ValueTypeNames.Color3f).ConnectToSource(
            picture.ConnectableAPI(), "rgb"
        )
    look.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    for k, name in enumerate(("Body", "Coat")):
        points, normals, _, uv, faces = grid(7, 9, 1.0, 2.0, 0.3 + k)
        mesh = UsdGeom.Mesh.Define(stage, f"/World/{name}")
        mesh.AddTranslateOp().Set(Gf.Vec3d(k, 0, 0))
        mesh.AddScaleOp().Set(Gf.Vec3f(1, 2, 1))
        mesh.CreateSubdivisionSchemeAttr("none")
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).reshape(-1)))
        mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals))
        mesh.SetNormalsInterpolation("vertex")
        for code in range(10, 23):
            moved = points + np.float32(0.1) * normals * np.sin(np.float32(code - 10 + k))
            mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(moved.astype(np.float32)), code)
        api = UsdGeom.PrimvarsAPI(mesh)
        types = Sdf.ValueTypeNames
        for label, kind, values in (
            ("st", types.TexCoord2fArray, uv),
            ("st1", types.TexCoord2fArray, uv[:, ::-1].copy()),
        ):
            api.CreatePrimvar(label, kind, "vertex").Set(Vt.Vec2fArray.FromNumpy(values))
        colors = Vt.Vec3fArray.FromNumpy(np.abs(normals))
        api.CreatePrimvar("displayColor", types.Color3fArray, "vertex").Set(colors)
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(look)
    camera = UsdGeom.Camera.Define(stage, "/World/View")
    camera.AddTranslateOp().Set(Gf.Vec3d(0, 0, 9), 10)
    UsdLux.SphereLight.Define(stage, "/World/Lamp").CreateIntensityAttr(40)
    UsdGeom.Xform.Define(stage, "/Other/Empty")
    stage.GetRootLayer().Save()
    return path


def attributes(path):
    """Every property of the root layer as text, by its path."""
    layer = Sdf.Layer.OpenAsAnonymous(str(path))
    found = {}

    def visit(place):
        spec = layer.GetObjectAtPath(place)
        if spec is None:
            return
        if place.IsPropertyPath():
            found[str(place)] = {str(k): repr(spec.GetInfo(k)) for k in spec.ListInfoKeys()}
            samples = layer.ListTimeSamplesForPath(place)
            found[str(place)]["samples"] = [repr(layer.QueryTimeSample(place, t)) for t in samples]
        elif place.IsPrimPath():
            found[str(place)] = {
                str(k): repr(spec.GetInfo(k))
                for k in spec.ListInfoKeys()
                if k not in ("specifier", "typeName")
            }
            found[str(place)]["type"] = spec.typeName

    layer.Traverse("/", visit)
    return found


def model_for(sequence):
    sequence = ssdr.MeshSequence(
        sequence.vertices, sequence.faces, sequence.fps, name=sequence.name, clip=sequence.clip
    )
    return ssdr.initialize(sequence, bones=4)


@pytest.mark.parametrize("ending", ["usda", "usdc"])
@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_stage_with_materials_comes_out_as_itself(tmp_path, ending, elsewhere):
    source = make_stage(tmp_path / "all.usda")
    folder = tmp_path / "there" if elsewhere else tmp_path
    folder.mkdir(exist_ok=True)
    target = folder / f"out.{ending}"
    sequence = ssdr.load(source)
    model = model_for(sequence)
    report = ssdr.save(model, target, template=source, strict=True)
    assert report.lost == ()
    before, after = attributes(source), attributes(target)
    assert not before.keys() - after.keys()
    changed = {k for k in before if before[k] != after[k]}
    if elsewhere:
        files = {k for k in changed if k.endswith(".inputs:file")}
        assert all("../maps/" in after[k]["default"] for k in files)
        changed -= files
    meshes = ("/World/Body", "/World/Coat")
    allowed = {"/World", *meshes, *(f"{m}.points" for m in meshes)}
    assert changed <= allowed | {f"{m}.normals" for m in meshes}
    new = {k for k in after.keys() - before.keys() if not k.startswith("/World/Skeleton")}
    assert all(".skel:" in k or ".primvars:skel:" in k for k in new)
    seen = ssdr.load(target)
    assert seen.n_frames == sequence.n_frames
    assert np.abs(seen.vertices - model.skin()).max() < 1e-6 * sequence.diagonal()
    stage = Usd.Stage.Open(str(target))
    bound = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/World/Coat")).ComputeBoundMaterial()
    assert str(bound[0].GetPath()) == "/World/Looks/Skin"
    picture = stage.GetPrimAtPath("/World/Looks/Skin/bumps").GetAttribute("inputs:file").Get()
    assert picture.resolvedPath.endswith("bumps.png")
    # Put in again: the new skeleton gives way to a newer one.
    again = folder / f"again.{ending}"
    ssdr.save(model, again, template=target)
    assert attributes(again).keys() == after.keys()
    assert np.abs(ssdr.load(again).vertices - model.skin()).max() < 1e-6 * sequence.diagonal()


def test_pixar_sees_the_same_vertices(tmp_path):
    from pxr import UsdSkel

    source = make_stage(tmp_path / "all.usda")
    model = model_for(ssdr.load(source))
    ssdr.save(model, tmp_path / "out.usda", template=source)
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetPrimAtPath("/World")))
    truth = model.skin()
    for frame in (0, 5, 12):
        start = 0
        for name in ("Body", "Coat"):
            prim = stage.GetPrimAtPath(f"/World/{name}")
            points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(10 + frame), dtype=float)
            place = np.array(UsdGeom.XformCache(10 + frame).GetLocalToWorldTransform(prim))
            world = points @ place[:3, :3] + place[3, :3]
            expected = truth[frame, start : start + len(points)]
            start += len(points)
            np.testing.assert_allclose(world, expected, atol=2e-5)


def test_copy_and_what_is_left_out(tmp_path):
    source = make_stage(tmp_path / "all.usda")
    ssdr.io.copy(source, tmp_path / "out.usdc")
    assert attributes(source) == attributes(tmp_path / "out.usdc")
    assert {"cameras", "lights", "normal of materials", "the primvar st1"} <= set(
        ssdr.io.left_out(source)
    )


def _layer_of_many(path):
    """A binary layer with a mesh, and a prim of 23 integers and a long compressed array."""
    ssdr.save(tube(frames=3), path)
    stage = Usd.Stage.Open(str(path))
    prim = stage.DefinePrim("/tube/More")
    for k in range(23):
        prim.CreateAttribute(f"n{k}", Sdf.ValueTypeNames.Int)
    many = np.tile(np.random.default_rng(0).integers(0, 2**31, 100), 4000).astype(np.int32)
    array = stage.GetPrimAtPath("/tube").CreateAttribute("many", Sdf.ValueTypeNames.IntArray)
    array.Set(Vt.IntArray.FromNumpy(many))
    stage.GetRootLayer().Export(str(path.with_name("b.usdc")))
    return path.with_name("b.usdc").read_bytes()


def _unpackable(data):
    """The long array, which no one reads until it is copied, is noise."""
    at = data.index(struct.pack("<Q", 400_000)) + 16
    return data[:at] + b"\xff" * 64 + data[at + 64 :]


def _nameless(data):
    """A property has a name that the file does not hold: usd-core would end the process."""
    at = data.index(struct.pack("<Q", 23)) + 8
    return data[:at] + b"\xee" * 4 + data[at + 4 :]


@pytest.mark.parametrize("damage", [_unpackable, _nameless])
@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_damage_that_shows_when_a_file_is_copied_is_the_files(tmp_path, damage, suffix):
    path, target = tmp_path / "b.usdc", tmp_path / f"c{suffix}"
    path.write_bytes(damage(_layer_of_many(tmp_path / "a.usdc")))
    for write in (
        lambda: ssdr.io.copy(path, target),
        lambda: ssdr.save(tube(frames=3), target, template=path),
    ):
        with pytest.raises(ssdr.FormatError, match=r"b\.usdc: .*damaged"):
            write()
    assert not target.exists()
