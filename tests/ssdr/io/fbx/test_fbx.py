"""FBX as it is read: files made here as text, each of which can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.fbx_text import FbxText

pytest.importorskip("ufbx", reason="ufbx is not installed")

SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
CORNERS = {"uv": [[0, 0], [1, 0], [1, 1], [0, 1]], "normals": [[0, 0, 1]] * 4}
MOVES = "Lcl Translation"


def at(*place):
    return np.vstack([np.column_stack([np.eye(3), place]), [0, 0, 0, 1]])


def sheet(file, name="sheet", **properties):
    """Number of a node that holds a unit square, and of its mesh."""
    node = file.node(name, **properties)
    return node, file.mesh(node, SQUARE, [[0, 1, 2, 3]], **CORNERS)


def chain(file, **properties):
    """Two joints along y, the second at a height of 1."""
    lower = file.node("lower", kind="LimbNode", **properties)
    return lower, file.node("upper", lower, kind="LimbNode", t=(0, 1, 0))


def bound(file, mesh, lower, upper, upper_vertices=(2, 3)):
    one = np.ones(2), at(0, 0, 0)
    file.skin(mesh, {lower: ([0, 1], *one), upper: (upper_vertices, one[0], at(0, 1, 0))})


def test_a_skin_with_its_bind_pose_clip_surface_and_shapes(tmp_path):
    file = FbxText()
    node, mesh = sheet(file, t=(5, 5, 5))  # where a skinned mesh stands does not matter
    file.material(node, "paint")
    lower, upper = chain(file)
    bound(file, mesh, lower, upper)
    smile = file.shapes(mesh, "smile", {50.0: ([2], [[0, 1, 0]]), 100.0: ([2, 3], [[0, 1, 0]] * 2)})
    turns = {(upper, "Lcl Rotation", "Z"): [(1, 0), (1.5, 90)]}
    turns[smile, "DeformPercent", "DeformPercent"] = [(1, 0), (1.5, 75)]
    file.stack("bend", 1, 1.5, turns)
    path = file.save(tmp_path / "a.fbx")
    assert ssdr.list_clips(path) == (ssdr.Clip("bend", 0, 13, 24.0),)
    assert ssdr.io.list_meshes(path) == ("sheet",)
    seen, model = ssdr.load(path), ssdr.load_skinning(path)
    top = [[-1, 1 + 1, 0], [-0.5, 1, 0]]  # vertices 2 and 3, with 1 and 0.5 of y, turned by 90°
    np.testing.assert_allclose(seen.vertices[0], SQUARE, atol=1e-6)
    np.testing.assert_allclose(seen.vertices[-1], [*SQUARE[:2], *top], atol=1e-6)
    np.testing.assert_allclose(model.skin(), seen.vertices, atol=1e-6)
    assert (model.shapes.names, model.shapes.amounts[-1].tolist()) == (
        ("smile50", "smile100"),
        [0.5, 0.5],
    )
    bones = model.skinning
    assert (bones.names(), bones.parents.tolist(), bones.bone_model) == (
        ("lower", "upper"),
        [-1, 0],
        "rigid",
    )
    np.testing.assert_allclose(bones.joint_positions, [[0, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(seen.faces, [[0, 1, 2], [0, 2, 3]])
    np.testing.assert_array_equal(seen.surface.uv[1], [[0, 0], [1, 1], [0, 1]])
    np.testing.assert_array_equal(seen.surface.normals, np.tile([0.0, 0, 1], (2, 3, 1)))
    assert [material.name for material in seen.surface.materials] == ["paint"]
    assert (seen.name, seen.clip, seen.space) == ("sheet", "bend", ssdr.Space(1.0, "y"))


@pytest.mark.parametrize(
    ("unit", "up", "corner"),
    [(100.0, "y", [0, 1, 0]), (1.0, "y", [0, 0.01, 0]), (1.0, "z", [0, 0, -0.01])],
)
def test_units_and_axes_become_metres_with_y_up(tmp_path, unit, up, corner):
    file = FbxText(unit=unit, up=up)
    sheet(file)
    found = ssdr.load(file.save(tmp_path / "a.fbx"))
    np.testing.assert_allclose(found.vertices[0, 3], corner, atol=1e-9)


def test_a_joint_that_inherits_no_scale_keeps_its_size(tmp_path):
    """Maya's segment scale compensation: what hangs on the upper joint stays 1 wide."""
    file = FbxText()
    _, mesh = sheet(file)
    lower, _ = chain(file)
    upper = file.node("free", lower, kind="LimbNode", t=(0, 1, 0), InheritType=2)
    bound(file, mesh, lower, upper)
    file.stack("swell", 0, 1, {(lower, "Lcl Scaling", "X"): [(0, 1), (1, 3)]})
    last = ssdr.load(file.save(tmp_path / "a.fbx")).vertices[-1]
    np.testing.assert_allclose(np.ptp(last[:2, 0]), 3, atol=1e-6)
    np.testing.assert_allclose(np.ptp(last[2:, 0]), 1, atol=1e-6)


def test_meshes_share_bones_stand_alone_or_are_left_out(tmp_path, caplog):
    caplog.set_level("INFO", "ssdr")
    file = FbxText()
    lower, upper = chain(file)
    for name in ("body", "coat"):
        _, mesh = sheet(file, name)
        bound(file, mesh, lower, upper, upper_vertices=(2, 2) if name == "coat" else (2, 3))
    _, other = sheet(file, "other")  # the same joint, bound elsewhere
    file.skin(other, {upper: ([0, 1, 2, 3], np.ones(4), at(0, 2, 0))})
    box, mesh = sheet(file, "box")
    file.link(mesh, file.node("twin", t=(0, 0, 7)))
    sheet(file, "ghost", Visibility=0)
    group = file.node("group", kind="Null", Visibility=0)
    file.mesh(file.node("below", group), SQUARE, [[0, 1, 2]])
    file.stack(
        "go", 0, 1, {(box, MOVES, "X"): [(0, 0), (1, 1)], (upper, MOVES, "X"): [(0, 0), (1, 1)]}
    )
    path = file.save(tmp_path / "a.fbx")
    model, seen = ssdr.load_skinning(path), ssdr.load(path)
    np.testing.assert_allclose(model.skin(), seen.vertices, atol=1e-6)
    assert model.names() == ("lower", "upper", "coat", "box", "twin", "upper_1")
    assert model.parents.tolist() == [-1, 0, -1, -1, -1, -1]
    assert model.n_vertices == 20
    np.testing.assert_allclose(seen.vertices[-1, 7], SQUARE[3], atol=1e-6)  # of no bone
    np.testing.assert_allclose(
        seen.vertices[-1, 12:], [*np.add(SQUARE, [1, 0, 0]), *np.add(SQUARE, [0, 0, 7])]
    )
    assert all(f"{name} is not shown" in caplog.text for name in ("ghost", "below"))
    assert ssdr.io.list_meshes(path) == ("body", "coat", "other", "box", "twin")
    assert ssdr.load(path, meshes="box").n_vertices == 4
    with pytest.raises(ssdr.InputError, match=r"^meshes: expected one of \['body', "):
        ssdr.load(path, meshes="hat")


def test_clips_are_the_stacks_that_move_something(tmp_path):
    file = FbxText()
    node, _ = sheet(file)
    file.stack("empty", 0, 5)
    file.stack("walk", 0, 1, {(node, MOVES, "X"): [(0, 0), (1, 1)]})
    # a layer on top adds; keys beyond the range that is stated are played
    file.stack(
        "walk",
        1,
        2,
        {(node, MOVES, "X"): [(1, 0), (2.5, 3)]},
        {(node, MOVES, "Y"): [(1, 0), (2, 2)]},
    )
    path = file.save(tmp_path / "a.fbx")
    assert [(c.name, c.n_frames) for c in ssdr.list_clips(path)] == [("walk", 25), ("walk_1", 37)]
    model = ssdr.load_skinning(path)
    np.testing.assert_allclose(
        model.transforms[[24, 25, 49, 61], 0, :2, 3], [[1, 0], [0, 0], [2, 2], [3, 2]]
    )
    assert ssdr.load(path, clip="walk_1", fps=48).n_frames == 73
    still = FbxText()
    sheet(still)
    (clip,) = ssdr.list_clips(still.save(tmp_path / "still.fbx"))
    assert (clip.name, clip.n_frames) == ("still", 1)


def test_keys_between_frames_set_the_rate_or_are_said(tmp_path):
    for times, fps in ([0, 1 / 48, 2 / 48, 1], 48.0), ([0, 0.2317, 0.6119, 1], None):
        file = FbxText()
        node, _ = sheet(file)
        file.stack("go", 0, 1, {(node, MOVES, "X"): [(t, (-1) ** k) for k, t in enumerate(times)]})
        path = file.save(tmp_path / "a.fbx")
        if fps:
            assert ssdr.load(path).fps == fps
        else:
            with pytest.warns(ssdr.SsdrWarning, match="2 keys of the clip go lie between"):
                assert ssdr.load(path).fps == 24
            ssdr.load(path, fps=24)


def test_a_mirrored_mesh_keeps_its_outside_and_one_that_grows_its_size(tmp_path):
    file = FbxText()
    node, _ = sheet(file, s=(0, 0, 0))
    size = {(node, "Lcl Scaling", axis): [(0, 0), (1, -2 if axis == "X" else 2)] for axis in "XYZ"}
    file.stack("grow", 0, 1, size)
    path = file.save(tmp_path / "a.fbx")
    model = ssdr.load_skinning(path)
    for thing, points in ((ssdr.load(path), None), (model, model.skin())):
        last = (thing.vertices if points is None else points)[-1]
        np.testing.assert_allclose(last, np.multiply(SQUARE, [-2, 2, 2]), atol=1e-5)
        p = last[thing.faces]
        across = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        assert ((across[:, None] * thing.surface.normals).sum(axis=-1) > 0).all()


def test_joints_without_a_mesh(tmp_path):
    file = FbxText()
    lower, _ = chain(file, t=(2, 0, 0))
    file.stack("go", 0, 1, {(lower, MOVES, "X"): [(0, 2), (1, 3)]})
    path = file.save(tmp_path / "a.fbx")
    for read in (ssdr.load, ssdr.load_skinning):
        with pytest.raises(ssdr.FormatError, match="no mesh"):
            read(path)
    bare = ssdr.load_skinning(path, joints_alone=True)
    assert (bare.names(), bare.parents.tolist()) == (("lower", "upper"), [-1, 0])
    np.testing.assert_allclose(
        bare.skin()[[0, -1]], [[[2, 0, 0], [2, 1, 0]], [[3, 0, 0], [3, 1, 0]]]
    )


def test_caches_are_read_from_its_folder_alone(tmp_path):
    inside, cache = tmp_path / "in", np.stack([np.add(SQUARE, [0, 0, t]) for t in range(4)])
    inside.mkdir()
    for folder in (inside, tmp_path):
        ssdr.save(ssdr.MeshSequence(cache, [[0, 1, 2]], 24.0), folder / "wave.pc2")
    for name in "wave.pc2", "../wave.pc2", str(tmp_path / "wave.pc2"), "missing.pc2":
        file = FbxText()
        _, mesh = sheet(file)
        file.cache(mesh, name, "")
        path = file.save(inside / "b.fbx")
        if name == "wave.pc2":
            found = ssdr.load(path)
            assert len(found) == 4
            np.testing.assert_allclose(found.vertices, cache, atol=1e-6)
            with pytest.raises(
                ssdr.FormatError, match=r"sheet: a geometry cache, .*ssdr\.load bakes"
            ):
                ssdr.load_skinning(path)
            continue
        with pytest.raises(
            ssdr.FormatError, match=r"geometry cache (is missing: |.* lies outside its folder)"
        ):
            ssdr.load(path)
        if "missing" not in name:
            assert len(ssdr.load(path, folder=tmp_path)) == 4


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"PK\x03\x04" * 9, "not an .fbx file: it looks like a zip archive"),
        (b"", "the file is empty"),
        (b"Kaydara FBX Binary  \x00\x1a\x00" + b"\xff" * 200, "truncated or damaged"),
        (b"; FBX 7.4\n", "truncated or damaged|no mesh"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not an .fbx file: it looks like text"),
    ],
)
def test_what_is_no_fbx_is_refused(tmp_path, content, words):
    path = tmp_path / "a.fbx"
    path.write_bytes(content)
    with pytest.raises(ssdr.FormatError, match=rf"a\.fbx: .*({words})"):
        ssdr.load(path)


def test_memory_is_bounded(tmp_path):
    file = FbxText()
    node, _ = sheet(file)
    file.stack("long", 0, 1e7, {(node, MOVES, "X"): [(0, 0), (1, 1)]})
    with pytest.raises(ssdr.FormatError, match=r"240000001 frames .* above the limit"):
        ssdr.load(file.save(tmp_path / "a.fbx"))
