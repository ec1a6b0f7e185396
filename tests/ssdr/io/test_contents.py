"""What scenes hold beside moving meshes: kept, read, said; the table of the page on formats."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers.alembic_cache import Cache, uniform
from helpers.fbx_text import FbxText
from helpers.glb import hand_made
from helpers.rig_model import tube
from ssdr.io import FORMATS

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32)
RGBA = np.array([[1, 0, 0, 1], [0, 0.5, 0, 1], [0, 0, 0.25, 1]], dtype=np.float32)
MOVES = np.arange(4)[:, None] * [1.0, 0, 0]  # of all meshes, in the frames 1 to 4
PLACES = np.array([[0, 0, 0], [0, 0, 3], [0, 0, 7]])  # of flag, shell and twin
TRUTH = (MOVES[:, None, None] + PLACES[:, None] + TRIANGLE).reshape(4, 9, 3)
SCENES = {".gltf": None, ".usda": "pxr.UsdGeom", ".abc": "alembic3d", ".fbx": "ufbx"}


def gltf(path):
    """A flag with colours, a shell that vanishes after frame 2, a twin of the flag's mesh."""
    seen = "/nodes/1/extensions/KHR_node_visibility/visible"
    targets = [{"node": 3, "path": "translation"}]
    targets += [{"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": p}}}
                for p in (seen, "/materials/0/emissiveFactor")]  # fmt: skip
    samplers = [{"input": 2, "output": k} for k in (3, 4, 3)]
    samplers[1]["interpolation"] = "STEP"
    channels = [{"sampler": k, "target": target} for k, target in enumerate(targets)]
    colours = [{"attributes": {"POSITION": 0, "COLOR_0": 1}}]
    names = (("flag", 0), ("shell", 1), ("twin", 0))
    nodes = [{"name": name, "mesh": mesh, "translation": place.tolist()}
             for (name, mesh), place in zip(names, PLACES, strict=True)]  # fmt: skip
    nodes += [{"children": [0, 1, 2, 4]}, {"camera": 0, "name": "eye"}]
    used = ["KHR_animation_pointer", "KHR_node_visibility", "KHR_materials_sheen"]
    document = {
        "nodes": nodes,
        "cameras": [{}],
        "materials": [{"emissiveFactor": [1, 0, 0]}],
        "meshes": [{"primitives": colours}, {"primitives": [{"attributes": {"POSITION": 0}}]}],
        "animations": [{"name": "go", "channels": channels, "samplers": samplers}],
        "extensionsUsed": used,
    }
    times, states = np.arange(1, 5, dtype="f4") / 24, np.array([1, 1, 0, 0], dtype="u1")
    hand_made(path, document, TRIANGLE, RGBA, times, MOVES.astype("f4"), states)


def usda(path):
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, Vt

    stage = Usd.Stage.CreateNew(str(path))
    stage.SetTimeCodesPerSecond(24)
    top = UsdGeom.Xform.Define(stage, "/top")
    move = top.AddTranslateOp()
    for k, by in enumerate(MOVES):
        move.Set(Gf.Vec3d(*by), k + 1)
    for name, place in zip(("flag", "shell", "twin"), PLACES, strict=True):
        mesh = UsdGeom.Mesh.Define(stage, f"/top/{name}")
        mesh.AddTranslateOp().Set(Gf.Vec3d(*map(float, place)))
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(TRIANGLE))
        mesh.CreateFaceVertexCountsAttr([3])
        mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
        if name != "shell":
            shown = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
                "displayColor", Sdf.ValueTypeNames.Color3fArray, "vertex"
            )
            shown.Set(Vt.Vec3fArray.FromNumpy(RGBA[:, :3].copy()))
        else:
            for code, state in ((1, "inherited"), (3, "invisible")):
                mesh.CreateVisibilityAttr().Set(state, code)
    UsdLux.SphereLight.Define(stage, "/lamp")
    many = UsdGeom.PointInstancer.Define(stage, "/many")
    UsdGeom.Mesh.Define(stage, many.GetPath().AppendChild("drop"))
    stage.GetRootLayer().Save()


def abc(path):
    cache = Cache(path)
    clock, held = cache.clock(*uniform(24, 1 / 24)), {}
    for name, place in zip(("flag", "shell", "twin"), PLACES, strict=True):
        matrices = [np.vstack([np.column_stack([np.eye(3), by + place]), [0, 0, 0, 1]])
                    for by in MOVES]  # fmt: skip
        above = cache.above(name, matrices, clock)
        if name == "shell":
            visible = cache.geometry.CreateVisibilityProperty(above, clock)
            for state in (-1, 1, 0, 0):
                visible.setValue(state)
        if name == "twin":
            above.addChildInstance(held["flag"], "twinShape")
            continue
        item = cache.mesh(f"{name}Shape", [TRIANGLE], clock, above, polygons=[(2, 1, 0)])
        if name == "flag":
            cache.colors(item, RGBA)
        held[name] = item
        del item
    held.clear()
    del above
    cache.geometry.OCamera(cache.top, "eye")
    cache.close()


def fbx(path):
    file = FbxText()
    top = file.node("top", kind="Null")
    nodes = [file.node(name, top, t=place, Visibility=1)
             for name, place in zip(("flag", "shell", "twin"), PLACES, strict=True)]  # fmt: skip
    mesh = file.mesh(nodes[0], TRIANGLE, [[0, 1, 2]], colors=RGBA)
    file.link(mesh, nodes[2])
    file.mesh(nodes[1], TRIANGLE, [[0, 1, 2]])
    file.lamp(top)
    times = np.arange(1, 5) / 24
    states = [(time, state) for time, state in zip(times, (1, 1, 0, 0), strict=True)]
    moves = [(time, by[0]) for time, by in zip(times, MOVES, strict=True)]
    curves = {(top, "Lcl Translation", "X"): moves, (nodes[1], "Visibility", "Visibility"): states}
    file.stack("go", times[0], times[-1], curves)
    file.save(path)


LEFT = {
    ".gltf": ("1 camera", "/materials/0/emissiveFactor", "KHR_materials_sheen", "emissiveFactor"),
    ".usda": ("drop (hidden)", "1 SphereLight", "1 PointInstancer"),
    ".abc": ("1 Camera",),
    ".fbx": ("lights: 1",),
}


@pytest.fixture(params=SCENES)
def scene(request, tmp_path):
    if SCENES[request.param]:
        pytest.importorskip(SCENES[request.param])
    path = tmp_path / f"a{request.param}"
    globals()[request.param[1:]](path)
    return path


def test_a_mesh_that_vanishes_is_named_or_shrinks(scene):
    said = r"shell: hidden in frames 3 to 4 of the clip \w+, shown here \(vanish= "
    with pytest.warns(ssdr.SsdrWarning, match=said):
        back = ssdr.load(scene)
    np.testing.assert_allclose(back.vertices, TRUTH, atol=1e-6)
    truth = TRUTH.copy()
    truth[2:, 3:6] = truth[2:, 3:6].mean(axis=1, keepdims=True)
    for read in (ssdr.load, ssdr.io.load_any):  # a skinning holds no mesh that vanishes
        np.testing.assert_allclose(read(scene, vanish=True).vertices, truth, atol=1e-6)
    flag = ssdr.load(scene, meshes="flag", vanish=True)
    np.testing.assert_allclose(flag.vertices, TRUTH[:, :3], atol=1e-6)


@pytest.mark.filterwarnings("ignore:.*hidden in frames")
def test_frames_are_chosen_by_the_files_own_numbers(scene):
    for frames, kept in (((2, 3), slice(1, 3)), ("2:99", slice(1, 4)), ((-1, 1.5), slice(0, 1))):
        np.testing.assert_allclose(ssdr.load(scene, frames=frames).vertices, TRUTH[kept], atol=1e-6)
    model = ssdr.io.load_any(scene, frames="3:4")
    frames = model.vertices if scene.suffix == ".abc" else model.skin()
    np.testing.assert_allclose(frames, TRUTH[2:], atol=1e-6)
    with pytest.raises(ssdr.InputError, match="frames: expected some of the frames 1 to 4, got 7"):
        ssdr.load(scene, frames=(7, 9))


@pytest.mark.parametrize("name", ["a_%03d.obj", "a.npz", "a.npy", "a.mdd", "model.npz"])
def test_frames_of_other_files(tmp_path, name):
    """Those of the numbers in names, else counted from 0; of a model, from 0 in each clip."""
    path, model, numbers = tmp_path / name, whole(), slice(2, 5)
    if name == "model.npz":
        ssdr.save(model, path)
        part = ssdr.load_skinning(path, frames="2:9", clip="walk")
        np.testing.assert_allclose(part.skin(), model.skin()[2:5])
        np.testing.assert_allclose(ssdr.load(path, frames=(2, 9)).vertices, model.skin()[2:5])
        return
    ssdr.save(ssdr.MeshSequence(model.skin(), model.faces), path)
    if name == "a_%03d.obj":  # number 000 is the first
        (tmp_path / "a_000.obj").unlink()
    options = {"faces": model.faces} if path.suffix in (".npy", ".mdd") else {}
    back = ssdr.load(path, frames="2:4", **options)
    np.testing.assert_allclose(back.vertices, model.skin()[numbers], atol=1e-6)
    for wrong in ("2", "4:2", (1, 2, 3), (0, "x"), (None, 4), "nan:4"):
        with pytest.raises(ssdr.InputError, match="frames: expected the first and the last frame"):
            ssdr.load(path, frames=wrong, **options)
    with pytest.raises(ssdr.InputError, match="frames: expected some of the frames"):
        ssdr.load(path, frames=(20, 30), **options)


@pytest.mark.filterwarnings("ignore:.*hidden in frames")
def test_colours_are_kept_and_what_is_not_read_is_named(scene, tmp_path):
    back = ssdr.load(scene)
    colours = np.concatenate([RGBA, np.ones((3, 4)), RGBA])[back.faces]
    np.testing.assert_allclose(back.surface.colors, colours, atol=1e-6)
    assert ssdr.io.list_left_out(scene) == LEFT[scene.suffix]


# --- the table of the page -----------------------------------------------------------------------


def whole():
    """A model with everything that a file may hold of one."""
    rng, plain = np.random.default_rng(0), tube(bones=3, frames=8, rings=5, sides=6)
    colors = rng.integers(0, 256, (plain.n_vertices, 4)).astype("f4") / 255
    model = dataclasses.replace(
        plain,
        surface=dataclasses.replace(plain.surface, colors=colors[plain.faces]),
        clips=(ssdr.Clip("walk", 0, 5, 30), ssdr.Clip("jump", 5, 8, 30)),
        fps=30,
        parents=[-1, 0, 1],
        joint_positions=plain.centroids(),
    )
    moved = 0.1 * rng.normal(size=(1, plain.n_vertices, 3))
    return ssdr.ShapedSkinning(model, ssdr.Shapes(moved, rng.random((8, 1)), names=("smile",)))


def alike(field, tolerance=1e-6):
    """Whether two meshes have the same values at the corners of their triangles."""

    def same(a, b):
        one, two = (getattr(x.surface, field, None) for x in (a, b))
        if two is None:
            return False
        order = (np.lexsort(x.faces.T) for x in (a, b))  # glTF sorts triangles by material
        return np.abs(one[next(order)] - two[next(order)]).max() < tolerance

    return same


def frames_of(thing):
    return thing.vertices[:] if isinstance(thing, ssdr.MeshSequence) else thing.skin()


def materials_of(a, b):
    one, two = (getattr(x.surface, "materials", ()) for x in (a, b))
    if [dataclasses.asdict(m) for m in one] == [dataclasses.asdict(m) for m in two]:
        return "kept"
    return "names" if {m.name for m in one} == {m.name for m in two} else ""


KEPT = {
    "positions": lambda a, b: np.allclose(frames_of(a), frames_of(b), atol=1e-5),
    "times": lambda a, b: np.isclose(a.fps, b.fps, rtol=1e-4),
    "clips": lambda a, b: [c.name for c in a.clips] == [c.name for c in b.clips],
    "skeleton": lambda a, b: a.skinning.parents.tolist() == b.skinning.parents.tolist(),
    "shapes": lambda a, b: np.allclose(a.shapes.amounts, b.shapes.amounts, atol=1e-5),
    "colours": alike("colors"),
    "UVs": alike("uv"),
    "materials": materials_of,
}
PLY = """ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y
property float z\nproperty float s\nproperty float t\nproperty uchar red\nproperty uchar green
property uchar blue\nelement face 1\nproperty list uchar int vertex_index\nend_header
0 0 0 0 0 255 0 0\n1 0 0 1 0 0 128 0\n0 1 0 0 1 0 0 64\n3 0 1 2\n"""
OBJ = "v 0 0 0 1 0 0\nv 1 0 0 0 .5 0\nv 0 1 0 0 0 .25\nf 1 2 3\n"


def written(path):
    """What comes back from a file that `save` writes, and of what this is said to be left out."""
    thing, row = whole(), {}
    if not FORMATS[path.suffix].writes_skinnings:
        thing = ssdr.MeshSequence(thing.skin(), thing.faces, 30, surface=thing.surface)
    report = ssdr.save(thing, path)
    given = {"faces": thing.faces} if path.suffix in (".npy", ".pc2", ".mdd") else {}
    back = ssdr.io.load_any(path, **given)
    several = isinstance(back, ssdr.MeshSequence)
    for column, same in KEPT.items():
        if not (several and column in ("clips", "skeleton", "shapes")) and (
            got := same(thing, back)
        ):
            row[column] = got if column == "materials" else "kept"
    assert ("colours are not kept" in str(report.notes)) == (row.get("colours") is None)
    return row


def fbx_rig(path):
    """What is read of a file with two clips, two joints and everything on one mesh."""
    file, one = FbxText(fps_mode=6), np.ones(1)
    node = file.node("sheet")
    mesh = file.mesh(node, TRIANGLE, [[0, 1, 2]], uv=TRIANGLE[:, :2], colors=RGBA)
    file.material(node, "paint")
    low = file.node("low", kind="LimbNode")
    high = file.node("high", low, kind="LimbNode")
    binds = {low: ([0], one, np.eye(4)), high: ([1, 2], np.ones(2), np.eye(4))}
    file.skin(mesh, binds)
    smile = file.shapes(mesh, "smile", {100.0: ([2], [[0, 0, 1]])})
    for name in ("walk", "jump"):
        curves = {(high, "Lcl Translation", "X"): [(0, 0), (0.1, 1)]}
        file.stack(
            name, 0, 0.1, curves | {(smile, "DeformPercent", "DeformPercent"): [(0, 0), (0.1, 50)]}
        )
    back = ssdr.load_skinning(file.save(path))
    moved = [[0, 0, 0], [2, 0, 0], [1, 1, 0.5]]
    surface = back.surface
    found = {
        "positions": np.allclose(back.skin()[3], moved, atol=1e-6),
        "times": back.fps == 30,
        "clips": [clip.name for clip in back.clips] == ["walk", "jump"],
        "skeleton": back.skinning.parents.tolist() == [-1, 0],
        "shapes": np.allclose(back.shapes.amounts[3], 0.5),
        "colours": np.allclose(surface.colors, RGBA),
        "UVs": np.allclose(surface.uv, TRIANGLE[:, :2]),
    }
    names = [one.name for one in surface.materials] == ["paint"]
    return {c: "read" for c, good in found.items() if good} | (
        {"materials": "names"} if names else {}
    )


def read(path):
    """What is read of files made by hand."""
    row = fbx_rig(path) if path.suffix == ".fbx" else {}
    if path.suffix in SCENES:
        globals()[path.suffix[1:]](path)
        with pytest.warns(ssdr.SsdrWarning, match="shell: hidden in frames 3 to 4"):
            back = ssdr.load(path)
        row["visibility"] = "said"
        if np.allclose(back.vertices, TRUTH, atol=1e-6):
            row["instances"] = "read"
    else:
        path.write_text(PLY if path.suffix == ".ply" else OBJ)
        back = ssdr.load(path)
    if np.allclose(back.surface.colors[0], RGBA, atol=3e-3):
        row.setdefault("colours", "read")
    return row | ({"UVs": "read"} if back.surface.uv is not None else {})


def table():
    page = (Path(__file__).parents[3] / "docs" / "io.md").read_text(encoding="utf-8")
    lines = page[page.index("| format |") :].split("\n\n")[0].splitlines()
    head, _, *rows = [[c.strip() for c in line.strip("|").split("|")] for line in lines]
    return {row[0].strip("`"): dict(zip(head[1:], row[1:], strict=True)) for row in rows}


def test_the_table_names_every_format():
    assert {*table(), ".glb", ".usd", ".usdc"} == {*FORMATS}


@pytest.mark.filterwarnings("ignore:.*not kept")
@pytest.mark.parametrize("suffix", table())
def test_every_cell_of_the_table_is_so(suffix, tmp_path):
    module = SCENES.get(suffix)
    if module:
        pytest.importorskip(module)
    row = (
        written(
            tmp_path / f"a_%d{suffix}" if suffix in (".obj", ".ply") else tmp_path / f"a{suffix}"
        )
        if suffix != ".fbx"
        else {}
    )
    if suffix in (*SCENES, ".obj", ".ply"):
        row = read(tmp_path / f"b{suffix}") | row
    stated = table()[suffix]
    assert {column: row.get(column, "–") for column in stated} == stated
