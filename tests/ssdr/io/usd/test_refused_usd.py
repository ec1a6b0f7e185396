"""Damaged and hostile USD files are refused in words."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.refused import Refused, raw
from helpers.rig_model import tube

pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

TABLE = Refused()

TABLE.add("usda", lambda path, text: raw(path, f"#usda 1.0\n{text}"), {
    "cut off": ('def Xform "a" {', r"\(USD says: 2:16: Expected }"),
    "a wrong tuple": ('def Mesh "a" { point3f[] points = [(0,0)] }', "USD says: .*Tuple dim"),
    "a missing layer": ("( subLayers = [@./gone.usda@] )", "refers to gone.usda, which is missing"),
})  # fmt: skip
TABLE.add("usda", raw, {"no USD": ("hello\n", "not a USD file|USD says")})


def referring(path, _):
    raw(path.with_name("a.usd"), "hello\n")
    raw(path, "#usda 1.0\n( subLayers = [@./a.usd@] )")


TABLE.add("usda", referring, {"no layer": (None, "refers to a.usd, which is no USD file")})

# usd-core ends the process, whatever hides the closing brackets from a naive count
DEEP = [
    ("dictionary a = {\n", "}\n"),
    ('def Xform "a" {\n', "}\n"),
    ("double b = (", ")"),
    ('def Xform "a" { # }\n', "}\n"),
    ('def Xform "a" { /* } */\n', "}\n"),
    ('def Xform "a" { string s = "}"\n', "}\n"),
    ('def Xform "a" { string s = """ } " """\n', "}\n"),
    ("def Xform \"a\" { string s = '\\'}'\n", "}\n"),
    ('def Xform "a" { asset s = @}@\n', "}\n"),
    ('def Xform "a" { asset s = @@@}\\@@@}@@@\n', "}\n"),
    ("rel a = <" + "/A.r[", "]"),
]
for _opening, _closing in DEEP:
    _data = "#usda 1.0\n" + _opening * 100_000 + _closing * 100_000
    TABLE.add("usda", raw, {f"nested {_opening.strip()}": (_data, r"bad\.usda is nested \d+ deep")})

# --- scenes ---


def edited(path, change):
    whole = path.with_name("whole.usda")
    ssdr.save(tube(frames=3), whole)
    stage = Usd.Stage.Open(str(whole))
    change(stage, UsdGeom.Mesh(stage.GetPrimAtPath("/tube/Mesh")))
    stage.GetRootLayer().Export(str(path))


def _joints(value):
    def change(_, mesh):
        primvar = UsdSkel.BindingAPI(mesh).GetJointIndicesPrimvar()
        values = np.array(primvar.Get())
        values[5] = value
        primvar.Set(Vt.IntArray.FromNumpy(values))

    return change


def _faces(_, mesh):
    values = np.array(mesh.GetFaceVertexIndicesAttr().Get())
    values[5] = 10**6
    mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(values))


def _infinite(stage, mesh):
    """A mesh without a skin, below a transform without a size."""
    for name in ("skel:joints", "skel:skeleton", "primvars:skel:jointIndices"):
        mesh.GetPrim().RemoveProperty(name)
    matrix = Gf.Matrix4d(1.0)
    matrix[0, 0] = np.inf
    UsdGeom.Xformable(mesh).AddTransformOp().Set(matrix)


def _infinite_later(stage, mesh):
    _infinite(stage, mesh)
    (moved,) = UsdGeom.Xformable(mesh).GetOrderedXformOps()
    matrix = moved.Get()
    moved.Set(Gf.Matrix4d(1.0), 0)
    moved.Set(matrix, 1)


def _claimed(stage, _):
    """Another clip, of more frames than memory holds."""
    layer, old, new = stage.GetRootLayer(), "/tube/Skeleton/Animation", "/tube/Skeleton/more"
    Sdf.CopySpec(layer, old, layer, new)
    stage.GetPrimAtPath(new).SetCustomDataByKey("ssdr", {"fps": 24.0, "frames": 2_000_000_000})


def _nan(_, mesh):
    points = np.array(mesh.GetPointsAttr().Get())
    points[3, 1] = np.nan
    mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(points))


SCENES = [
    (_joints(99), "joint 99 of a skin of 5"),
    (_joints(-1), "joint -1 of a skin of 5"),
    (_faces, "1000000 for 254 vertices"),
    (_nan, "finite"),
    (_infinite, "a transform that is not finite"),
    (_infinite_later, "a transform that is not finite"),
    (lambda _, m: m.GetFaceVertexCountsAttr().Set([3, 3]), "polygons have 6 corners"),
    (lambda _, m: m.GetPointsAttr().Set([]), "no points"),
    (lambda _, m: m.GetPointsAttr().Set([(0, 0, 0)]), "for 1 vertices"),
    (lambda s, _: s.SetEndTimeCode(1e15), "max_bytes"),
    (lambda s, _: s.SetEndTimeCode(1e7), "10000001 frames of 5 bones needs"),
    (_claimed, "max_bytes"),
    (lambda s, _: s.SetTimeCodesPerSecond(0), "timeCodesPerSecond is 0"),
    (lambda _, m: m.GetFaceVertexCountsAttr().Set([2**31 - 1]), "polygons have 2147483647 corners"),
    (lambda s, _: s.SetEndTimeCode(-5), "time codes run"),
    (lambda s, _: s.RemovePrim("/tube/Mesh"), "no visible mesh"),
    (
        lambda _, m: UsdSkel.BindingAPI(m).GetJointWeightsPrimvar().Set([0.0] * 254 * 4),
        "vertices have no skin weight",
    ),
]
TABLE.add("usda", edited, {f"scene {k}": row for k, row in enumerate(SCENES)}, ssdr.load_skinning)


def _many_of_one(path):
    """3,000 meshes that inherit the points of one."""
    stage = Usd.Stage.CreateNew(str(path))
    one = UsdGeom.Mesh(stage.CreateClassPrim("/one"))
    stage.GetPrimAtPath("/one").SetTypeName("Mesh")
    n = 2000
    strip = np.arange(n - 2, dtype=np.int32)[:, None] + np.arange(3, dtype=np.int32)
    one.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.eye(n, 3, dtype=np.float32)))
    one.CreateFaceVertexCountsAttr(Vt.IntArray(n - 2, 3))
    one.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(strip.ravel()))
    with Sdf.ChangeBlock():
        for k in range(3000):
            prim = Sdf.CreatePrimInLayer(stage.GetRootLayer(), f"/m{k}")
            prim.specifier, prim.typeName = Sdf.SpecifierDef, "Mesh"
            prim.inheritPathList.prependedItems.append("/one")
    stage.Save()


def _packed(path):
    """Five million equal triangles, which a binary layer holds in some kB."""
    stage = Usd.Stage.CreateNew(str(path))
    mesh = UsdGeom.Mesh.Define(stage, "/m")
    mesh.CreatePointsAttr(Vt.Vec3fArray(3))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray(5_000_000, 3))
    corners = np.tile(np.arange(3, dtype=np.int32), 5_000_000)
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(corners))
    stage.Save()


def small(path, write):
    write(path)
    assert path.stat().st_size < 1 << 20


BESIDE = "corners beside others needs"
MANY = {"many of one": (_many_of_one, BESIDE), "packed": (_packed, BESIDE)}
TABLE.add("usdc", small, MANY, ssdr.load, ssdr.load_skinning, ssdr.list_clips)


def cut_off(path, share):
    ssdr.save(tube(frames=3), path)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])


TABLE.add("usdc", cut_off, {f"cut at {share}": (share, "bad") for share in (0, 0.05, 0.5)})


@pytest.mark.parametrize("case", TABLE)
def test_the_file_is_refused_in_words(tmp_path, case):
    TABLE.check(case, tmp_path)
