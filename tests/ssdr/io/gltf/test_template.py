"""A glTF file with a new skin is the file that it was, but for the skin."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ssdr
from helpers.gltf_asset import make_asset
from helpers.gltf_difference import NEW_SKIN, difference, tree
from ssdr.io.gltf.document import Document

OURS = ["Body", "Coat"]


def model_for(sequence):
    """A rigid skinning of a sequence, with its surface and welding."""
    model = ssdr.initialize(sequence, bones=5)
    return dataclasses.replace(model, surface=sequence.surface, vertex_map=sequence.vertex_map)


def unexpected(before, after, *also):
    places = [p for p in difference(before, after) if not NEW_SKIN.match(p)]
    tracks = r"animations/[^/]+/channels/(\+/\S+_skeleton/.*|-/Root/(Body|Coat)Node:\w+)"
    allowed = re.compile("|".join([*also, tracks]))
    return [p for p in places if not allowed.match(p)]


@pytest.mark.parametrize("ending", ["gltf", "glb"])
@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_file_with_everything_comes_out_as_itself(tmp_path, ending, elsewhere):
    source = make_asset(tmp_path / "all.gltf")
    folder = tmp_path / "there" if elsewhere else tmp_path
    folder.mkdir(exist_ok=True)
    target = folder / f"out.{ending}"
    sequence = ssdr.load(source, meshes=OURS)
    model = model_for(sequence)
    report = ssdr.save(model, target, template=source, meshes=OURS)
    assert report.lost == ()
    found = difference(source, target)
    assert unexpected(source, target, r"animations/Dance/extras/\+ssdr") == []
    assert any("TANGENT" in place for place in found)
    assert any("tangents" in note for note in report.notes)
    again = ssdr.load(target, meshes=OURS)
    assert again.n_frames == model.n_frames
    error = np.abs(again.vertices - model.skin()).max() / sequence.diagonal()
    assert error < 1e-6
    # The clip starts where it did, so that the camera keeps its time.
    times = json.loads(json.dumps(tree(target)["animations"]["Dance"]["channels"]))
    starts = {c["input"]["min"][0] for c in times.values()}
    assert starts == {0.25}
    # What is not replaced is there to the last bit, in the other scene too.
    prop = ssdr.load(target, meshes="Prop", clip="Spin").vertices
    np.testing.assert_array_equal(prop, ssdr.load(source, meshes="Prop", clip="Spin").vertices)
    document = Document(target)
    names = [mesh["name"] for mesh in document.items("meshes")]
    assert names == ["Body", "Coat", "Prop", "Body"]
    # At the top of the scene: below another node, its transform would do nothing.
    nodes = document.items("nodes")
    skinned = [k for k, node in enumerate(nodes) if "skin" in node]
    assert len(skinned) == 2
    assert set(skinned) <= set(document.items("scenes")[0]["nodes"])
    for k in skinned:
        assert not nodes[k].keys() & {"translation", "rotation", "scale", "matrix"}
    if ending == "glb":
        assert not any(i.get("uri", "data:")[:5] != "data:" for i in document.items("images"))


def test_bytes_that_nothing_needs_are_left_out(tmp_path):
    source = make_asset(tmp_path / "all.gltf")
    sequence = ssdr.load(source)
    model = dataclasses.replace(model_for(sequence), name="all")
    with pytest.warns(ssdr.SsdrWarning, match="not kept: the clip Spin"):
        report = ssdr.save(model, tmp_path / "out.glb", template=source)
    # Not even the clip of the prop, which is one of the replaced meshes now.
    assert report.lost == ("the clip Spin, which the model does not have",)
    document = Document(tmp_path / "out.glb")
    assert [clip.name for clip in ssdr.list_clips(tmp_path / "out.glb")] == ["Dance"]
    names = {"Spin": None}  # left out on purpose
    assert ssdr.save(model, tmp_path / "o.glb", template=source, clip_names=names).lost == ()
    # The other scene still has its Body with morph targets.
    morphing = [m["name"] for m in document.items("meshes") if "targets" in m["primitives"][0]]
    assert morphing == ["Body"]


def test_normals_are_those_of_the_model(tmp_path):
    source = make_asset(tmp_path / "all.gltf")
    sequence = ssdr.load(source, meshes=OURS)
    model = model_for(sequence)
    turn = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    ours = Document(source)
    body = ours.items("meshes")[0]["primitives"][0]["attributes"]
    points = ours.accessor(body["POSITION"], "VEC3", "p")
    rest = np.asarray(model.rest).copy()
    rest[: len(points)] = points @ turn.T
    normals = np.array(model.surface.normals)
    own = (model.faces < len(points)).all(axis=1)
    normals[own] = normals[own] @ turn.T
    surface = dataclasses.replace(model.surface, normals=normals)
    model = dataclasses.replace(model, rest=rest, surface=surface)
    ssdr.save(model, tmp_path / "o.glb", template=source, meshes=OURS)
    new = Document(tmp_path / "o.glb")
    attributes = new.items("meshes")[3]["primitives"][0]["attributes"]
    if "JOINTS_0" not in attributes:
        attributes = new.items("meshes")[0]["primitives"][0]["attributes"]
    before, after = (
        file.accessor(held["NORMAL"], "VEC3", "NORMAL")
        for file, held in ((ours, body), (new, attributes))
    )
    np.testing.assert_allclose(after, before @ turn.T, atol=2e-6)
    assert "TANGENT" in body
    assert "TANGENT" not in attributes


def test_a_welded_model_is_written_at_the_seams_again(tmp_path):
    source = make_asset(tmp_path / "all.gltf")
    sequence = ssdr.load(source, meshes=OURS)
    doubled = sequence.vertices.copy()
    doubled[:, 7] = doubled[:, 3]
    welded, _ = dataclasses.replace(sequence, vertices=doubled).weld()
    assert welded.n_vertices == sequence.n_vertices - 1
    model = model_for(welded)
    ssdr.save(model, tmp_path / "out.glb", template=source, meshes=OURS)
    seen = ssdr.load(tmp_path / "out.glb", meshes=OURS).vertices
    expected = model.skin()[:, welded.vertex_map]
    assert np.abs(seen - expected).max() < 1e-6 * sequence.diagonal()


def test_a_mirrored_node_leaves_its_mirror(tmp_path):
    source = make_asset(tmp_path / "all.gltf")
    document = json.loads(source.read_text())
    document["nodes"][2]["scale"] = [-1, 1, 1]
    source.write_text(json.dumps(document))
    sequence = ssdr.load(source, meshes="Coat")
    ssdr.save(model_for(sequence), tmp_path / "out.glb", template=source, meshes="Coat")
    again = ssdr.load(tmp_path / "out.glb", meshes="Coat")
    np.testing.assert_array_equal(again.faces, sequence.faces)
    new = Document(tmp_path / "out.glb")
    (place,) = [k for k, n in enumerate(new.items("nodes")) if n.get("name") == "CoatNode"]
    assert place in new.items("scenes")[0]["nodes"]
    assert "scale" not in new.items("nodes")[place]


def test_an_unknown_extension_keeps_all_that_it_may_refer_to(tmp_path):
    source = make_asset(tmp_path / "all.gltf")
    document = json.loads(source.read_text())
    document["extensionsUsed"].append("ACME_hair")
    document["extensions"]["ACME_hair"] = {"node": 3, "accessor": 9}
    source.write_text(json.dumps(document))
    model = model_for(ssdr.load(source, meshes=OURS))
    report = ssdr.save(model, tmp_path / "out.glb", template=source, meshes=OURS)
    assert "ACME_hair" in str(report.notes)
    new = Document(tmp_path / "out.glb")
    assert new.items("nodes")[3]["name"] == "PropNode"
    before = Document(source).accessor(9, "VEC3", "x")
    np.testing.assert_array_equal(new.accessor(9, "VEC3", "x"), before)


def test_a_clip_that_nothing_else_keeps_up_with_begins_at_zero(tmp_path):
    """As it does in a file without a template."""
    source = make_asset(tmp_path / "all.gltf")
    document = json.loads(source.read_text())
    model = model_for(ssdr.load(source, meshes=OURS))
    report = ssdr.save(model, tmp_path / "out.glb", template=source, meshes=OURS)
    assert "the clip Dance begins at 0.25 s, as its other tracks do" in str(report.notes)
    (dance,) = [one for one in document["animations"] if one["name"] == "Dance"]
    ours = {k for k, n in enumerate(document["nodes"]) if n["name"] in ("BodyNode", "CoatNode")}
    dance["channels"] = [c for c in dance["channels"] if c["target"]["node"] in ours]
    source.write_text(json.dumps(document))
    report = ssdr.save(model, tmp_path / "out.glb", template=source, meshes=OURS)
    assert "begins" not in str(report.notes)
    new = Document(tmp_path / "out.glb")
    (dance,) = [one for one in new.items("animations") if one["name"] == "Dance"]
    starts = [new.accessor(s["input"], "SCALAR", "times")[0] for s in dance["samplers"]]
    assert set(starts) == {0}
    again = ssdr.load(tmp_path / "out.glb", meshes=OURS).vertices
    assert np.abs(again - model.skin()).max() < 1e-5
