"""FBX that Blender writes, our models and others', read back by ufbx."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

import ssdr
from helpers.blender_scene import export, needs_blender
from helpers.rig_model import largest_distance, tube
from ssdr.io.played_model import as_played

pytest.importorskip("ufbx", reason="ufbx is not installed")
pytestmark = [pytest.mark.slow, needs_blender]


@pytest.mark.parametrize("options", [{}, {"scaled": True}, {"bones": 9, "influences": 7}])
@pytest.mark.parametrize("centimetres", [False, True])
def test_our_own_fbx_comes_back(tmp_path, options, centimetres):
    model = dataclasses.replace(
        tube(**options),
        clips=(
            ssdr.Clip("walk", 0, 9, 30.0),
            ssdr.Clip("jump/high", 9, 19, 30.0),
            ssdr.Clip("death", 19, 20, 30.0),
        ),
        fps=None,
    )
    report = ssdr.save(model, tmp_path / "a.fbx", centimetres=centimetres)
    back = ssdr.load_skinning(tmp_path / "a.fbx")
    assert report.max_error < 6e-6
    names = [material.name for material in model.surface.materials]
    assert [material.name for material in back.surface.materials] == names
    assert len(back.faces) == len(model.faces)
    assert ssdr.load(tmp_path / "a.fbx", clip="walk", fps=60).n_frames == 17
    assert (back.clips, back.names(), back.name) == (model.clips, model.names(), "tube")
    assert back.bone_model == model.bone_model
    assert (back.n_vertices, back.n_influences) == (model.n_vertices, model.n_influences)
    rig = as_played(model)
    as_stored = dataclasses.replace(model, indices=rig.indices, weights=rig.weights)
    np.testing.assert_allclose(back.dense_weights(), as_stored.dense_weights(), atol=6e-8)
    diagonal = np.linalg.norm(np.ptp(model.skin().reshape(-1, 3), axis=0))
    assert largest_distance(back.rest, model.rest) < 1e-6 * diagonal
    assert largest_distance(back.skin(), model.skin()) < 1e-6 * diagonal
    # once more: nothing wears off
    ssdr.save(back, tmp_path / "b.fbx")
    again = ssdr.load_skinning(tmp_path / "b.fbx")
    np.testing.assert_allclose(again.dense_weights(), back.dense_weights(), rtol=0, atol=6e-8)
    assert largest_distance(again.skin(), back.skin()) < 1e-6 * diagonal


def test_seams_need_no_second_vertex_in_fbx(tmp_path):
    model = tube(frames=2)
    ssdr.save(model, tmp_path / "a.fbx")
    back = ssdr.load(tmp_path / "a.fbx")
    assert back.n_vertices == model.n_vertices
    np.testing.assert_array_equal(
        np.sort(back.faces, axis=1)[np.lexsort(np.sort(back.faces, axis=1).T)],
        np.sort(model.faces, axis=1)[np.lexsort(np.sort(model.faces, axis=1).T)],
    )
    corners = {tuple(row) for row in np.round(model.surface.uv.reshape(-1, 2), 5)}
    assert {tuple(row) for row in np.round(back.surface.uv.reshape(-1, 2), 5)} == corners
    ours = {tuple(row) for row in np.round(model.surface.normals.reshape(-1, 3), 3) + 0.0}
    theirs = back.surface.normals.reshape(-1, 3)
    nearest = np.abs(np.array(sorted(ours))[:, None] - theirs[None]).max(axis=2)
    assert max(nearest.min(axis=0).max(), nearest.min(axis=1).max()) < 2e-3


def test_both_sides_of_a_sheet_stay(tmp_path):
    model = tube(frames=2)
    both = np.concatenate([model.faces, model.faces[:, ::-1]])
    normals = np.concatenate([model.surface.normals, -model.surface.normals[:, ::-1]])
    sheet = dataclasses.replace(model, faces=both, surface=ssdr.Surface(normals=normals))
    report = ssdr.save(sheet, tmp_path / "a.fbx")
    assert (report.lost, report.max_error < 1e-6 * 6) == ((), True)
    back = ssdr.load_skinning(tmp_path / "a.fbx")
    np.testing.assert_allclose(back.rest[: model.n_vertices], model.rest, atol=1e-6)
    corners = np.sort(back.rest[back.faces].reshape(-1, 9), axis=1)
    expected = np.sort(model.rest[both].reshape(-1, 9), axis=1)
    np.testing.assert_allclose(np.sort(corners, axis=0), np.sort(expected, axis=0), atol=1e-6)


def test_triangles_that_blender_drops_are_counted(tmp_path):
    model = tube(frames=2)
    more = np.concatenate([model.faces, model.faces[:5], [[3, 3, 4], [7, 8, 7]]])
    flat = dataclasses.replace(model, faces=more, surface=None)
    with pytest.warns(ssdr.SsdrWarning, match=r"a\.fbx: not kept: 7 triangles"):
        report = ssdr.save(flat, tmp_path / "a.fbx")
    assert len(report.lost) == 1
    assert len(ssdr.load(tmp_path / "a.fbx").faces) == len(model.faces)


@pytest.mark.parametrize("fps", [0.4, 7.3, 12.5, 24000 / 1001, 29.97, 240.0])
def test_any_frame_rate_of_our_own(tmp_path, fps):
    model = dataclasses.replace(tube(frames=9), clips=None, fps=fps)
    report = ssdr.save(model, tmp_path / "a.fbx")
    assert report.max_error < 1e-6 * 6
    back = ssdr.load_skinning(tmp_path / "a.fbx")
    assert (back.fps, back.n_frames) == (fps, 9)
    assert largest_distance(back.skin(), model.skin()) < 1e-6 * 6


FOREIGN = """
bpy.ops.import_scene.gltf(filepath={source!r})
save(add_leaf_bones={leaves})
"""


@pytest.mark.filterwarnings("ignore:.*lie between its frames:ssdr.SsdrWarning")
@pytest.mark.parametrize(
    ("name", "rig", "leaves"), [("Llama.gltf", "Armature", True), ("Fox.glb", "root", False)]
)
def test_an_animal_that_blender_has_exported(tmp_path, data_dir, name, rig, leaves):
    source = data_dir / "gltf" / name
    path = export(tmp_path / "a.fbx", FOREIGN.format(source=str(source), leaves=leaves))
    shown = [n for n in ssdr.io.list_meshes(path) if not n.startswith("Icosphere")]
    model = ssdr.load_skinning(path, meshes=shown)  # without the ball that draws bones
    truth = ssdr.load_skinning(source)
    assert (model.n_vertices, model.n_bones) == (truth.n_vertices, truth.n_bones)
    assert set(model.names()) == set(truth.names())
    same = None
    for clip in truth.clips:
        known = {f"{rig}|{clip.name}", f"{rig}|{clip.name}_{rig}"}  # differs between releases
        theirs = model.select(*known.intersection(c.name for c in model.clips))
        assert theirs.fps == clip.fps
        # Of the fox's Run some keys lie between frames. There Blender interpolates quaternions
        # component by component, and it leaves out the last frame, which ends after the last key.
        count = theirs.n_frames if theirs.n_frames == clip.n_frames else 17
        seen, meant = theirs.skin()[:count], truth.skin(clip.frames)[:count]
        if same is None:
            poses = np.linspace(0, count - 1, 4).astype(int)
            tree = cKDTree(np.concatenate(list(meant[poses]), axis=1))
            same = tree.query(np.concatenate(list(seen[poses]), axis=1))[1]
        diagonal = np.linalg.norm(np.ptp(meant, axis=1), axis=1).max()
        assert largest_distance(seen, meant[:, same]) < 2e-6 * diagonal  # Euler angles in float32
    assert same is not None
