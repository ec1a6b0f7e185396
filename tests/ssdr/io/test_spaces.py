"""Units and up axes: what files state is kept, converted where a format has its own, and said."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.blender_scene import needs_blender
from helpers.rig_model import largest_distance, tube
from helpers.rig_tree import creature
from helpers.stages import mesh
from ssdr import Space
from ssdr.io import in_space
from ssdr.io.gltf.document import Document

METRES = Space(1.0, "y")
CENTIMETRES = Space(0.01, "z")


def lying(points):
    """Metres with y up as centimetres with z up, written down by hand."""
    return 100 * np.asarray(points)[..., [0, 2, 1]] * [1, -1, 1]


def standing(model=None):
    """A model in metres with y up, and the same in centimetres with z up."""
    model = dataclasses.replace(tube() if model is None else model, space=METRES)
    return model, in_space(model, CENTIMETRES)


def stage(path, **metadata):
    """A stage of one triangle, which states just this."""
    Usd = pytest.importorskip("pxr.Usd")
    made = Usd.Stage.CreateNew(str(path))
    mesh(made, "/Flag", [(0, 0, 0), (120, 0, 0), (0, 0, 200)])
    for key, value in metadata.items():
        made.SetMetadata(key, value)
    made.GetRootLayer().Save()
    return path


@pytest.mark.parametrize("model", [tube(), creature()], ids=["flat", "tree"])
def test_a_skinning_and_its_vertices_move_alike(model):
    there, back = standing(model)
    np.testing.assert_allclose(back.skin(), lying(there.skin()), atol=2e-4)
    assert back.space == CENTIMETRES
    again = in_space(back, METRES)
    assert largest_distance(again.skin(), there.skin()) < 1e-6
    if model.parents is not None:
        np.testing.assert_allclose(back.joint_gaps(), 100 * there.joint_gaps(), atol=2e-4)
    shown = ssdr.MeshSequence(there.skin(), there.faces, surface=there.surface, space=METRES)
    turned = in_space(shown, CENTIMETRES)
    np.testing.assert_allclose(turned.vertices, lying(shown.vertices), atol=1e-4)
    if turned.surface is not None and turned.surface.normals is not None:
        length = np.linalg.norm(turned.surface.normals, axis=-1)
        np.testing.assert_allclose(length, 1, atol=1e-5)


def test_nothing_is_guessed():
    points = np.arange(12.0).reshape(2, 2, 3)
    unknown, up = ssdr.MeshSequence(points), ssdr.MeshSequence(points, space=Space(up="z"))
    for space in (METRES, CENTIMETRES, Space()):
        same = in_space(unknown, space)
        assert same.space == Space()
        np.testing.assert_array_equal(same.vertices, points)
    turned = in_space(up, METRES)
    assert turned.space == Space(None, "y")
    np.testing.assert_array_equal(turned.vertices, points[..., [0, 2, 1]] * [1, 1, -1])
    np.testing.assert_array_equal(in_space(up, Space(0.01)).vertices, points)


def test_shots_that_disagree_have_no_common_space():
    points = np.random.default_rng(0).random((3, 9, 3))
    shots = [ssdr.MeshSequence(points, space=Space(0.01, up)) for up in ("y", "z")]
    assert ssdr.initialize(shots, bones=2).space == Space(0.01)
    assert ssdr.initialize(shots[0], bones=2).space == Space(0.01, "y")


@pytest.mark.parametrize(
    ("metadata", "space"),
    [
        ({"metersPerUnit": 0.01, "upAxis": "Z"}, CENTIMETRES),
        ({"metersPerUnit": 0.0254}, Space(0.0254)),
        ({"upAxis": "Y"}, Space(None, "y")),
        ({}, Space()),
    ],
)
def test_usd_states_what_is_written_in_it_alone(tmp_path, metadata, space):
    path = stage(tmp_path / "flag.usda", **metadata)
    assert ssdr.load(path).space == ssdr.load_skinning(path).space == space
    assert np.ptp(ssdr.load(path).vertices, axis=1).tolist() == [[120, 0, 200]]  # as they are


def test_a_flag_in_centimetres_with_z_up_stands_in_gltf(tmp_path):
    path = stage(tmp_path / "flag.usda", metersPerUnit=0.01, upAxis="Z")
    report = ssdr.save(ssdr.load_skinning(path), tmp_path / "flag.glb")
    assert "converted from 0.01 m a unit, z up to 1 m a unit, y up" in str(report.notes)
    document = Document(tmp_path / "flag.glb")
    (primitive,) = document.items("meshes")[0]["primitives"]
    item = document.items("accessors")[primitive["attributes"]["POSITION"]]
    np.testing.assert_allclose(item["min"], [0, 0, 0], atol=1e-7)
    np.testing.assert_allclose(item["max"], [1.2, 2, 0], atol=1e-6)
    # what is said of it beats what it states, and what is said to nobody is not turned
    for given, size in (
        ({"units": 1.0}, [120, 200, 0]),
        ({"up": "y"}, [1.2, 0, 2]),
        ({"units": 0.001, "up": "y"}, [0.12, 0, 0.2]),
    ):
        for model, options in (
            (ssdr.load_skinning(path, **given), {}),
            (ssdr.load_skinning(path), given),
        ):
            ssdr.save(model, tmp_path / "other.glb", **options)
            (frame,) = ssdr.load(tmp_path / "other.glb").vertices
            np.testing.assert_allclose(np.ptp(frame, axis=0), size, rtol=1e-6)


@pytest.mark.parametrize(
    "suffix", [".glb", ".usdc", ".npz", pytest.param(".fbx", marks=needs_blender)]
)
def test_there_and_back(tmp_path, suffix):
    """By a format with its own unit and axis, and to a stage in the old ones again."""
    pytest.importorskip("pxr.UsdSkel")
    there, model = standing(tube(frames=4))
    report = ssdr.save(model, tmp_path / f"a{suffix}")
    converts = suffix in (".glb", ".fbx")
    assert ("converted" in str(report.notes)) == converts
    back = ssdr.load_skinning(tmp_path / f"a{suffix}")
    assert back.space == (METRES if converts else CENTIMETRES)
    size = np.linalg.norm(np.ptp(model.rest, axis=0))
    assert largest_distance(in_space(back, CENTIMETRES).skin(), model.skin()) < 1e-6 * size
    assert largest_distance(in_space(back, METRES).skin(), there.skin()) < 1e-6 * size / 100
    # errors are in the unit of what was given
    if report.max_error:
        off = in_space(back, CENTIMETRES).skin(dtype=np.float64) - model.skin(dtype=np.float64)
        truth = np.linalg.norm(off, axis=-1).max()
        assert report.max_error == pytest.approx(truth, rel=0.5)


def test_formats_that_state_nothing_say_so(tmp_path):
    _, model = standing(tube(frames=2))
    report = ssdr.save(model, tmp_path / "a_%02d.ply")
    assert "numbered OBJ or PLY does not state 0.01 m a unit, z up" in str(report.notes)
    assert ssdr.load(tmp_path / "a_%02d.ply").space == Space()
    assert ssdr.load(tmp_path / "a_%02d.ply", units=0.01, up="z").space == CENTIMETRES


def test_a_factor_leaves_the_unit_open(tmp_path):
    """A model read at twice its size is written so, not halved again."""
    there, _ = standing(tube(frames=2))
    ssdr.save(there, tmp_path / "a.glb")
    twice = ssdr.load_skinning(tmp_path / "a.glb", scale=2)
    assert twice.space == Space(None, "y")
    ssdr.save(twice, tmp_path / "b.glb")
    again = ssdr.load(tmp_path / "b.glb").vertices
    assert largest_distance(again, 2 * there.skin()) < 1e-6


@needs_blender
def test_fbx_in_centimetres_has_no_scale_on_its_nodes(tmp_path):
    there, model = standing(tube(frames=2))
    import re

    sizes = {}
    for centimetres in (False, True):
        path = tmp_path / f"{centimetres}.fbx"
        ssdr.save(model, path, centimetres=centimetres)
        back = ssdr.load_skinning(path)
        assert largest_distance(back.skin(), there.skin()) < 2e-6
        data = path.read_bytes()
        # a property of three doubles, each after its type's letter
        found = [
            np.frombuffer(data[m.end() : m.end() + 27], dtype=np.uint8).reshape(3, 9)[:, 1:]
            for m in re.finditer(rb"Lcl ScalingS\x00\x00\x00\x00S\x01\x00\x00\x00A", data)
        ]
        sizes[centimetres] = {float(x) for one in found for x in one.copy().view("<f8").ravel()}
    assert max(sizes[False]) == pytest.approx(100)
    assert max(sizes[True]) == pytest.approx(1)
