"""glTF: joints are nodes that hang on each other, and come back as they were."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers.rig_tree import NAMES, PARENTS, creature, differences, flat, tree_of
from ssdr.errors import FormatError
from ssdr.io.gltf.writer import write_along_bones

DATA = Path(os.environ.get("SSDR_TEST_DATA", "missing")) / "gltf"


def _json(path):
    return json.loads(path.read_text())


def _number(nodes, name):
    return next(k for k, node in enumerate(nodes) if node.get("name") == name)


def _write(path, document):
    path.write_text(json.dumps(document))


@pytest.mark.parametrize("kind", [{}, {"loose": True}, {"scaled": True}])
def test_the_tree_comes_back(tmp_path, kind):
    model = creature(**kind)
    report = ssdr.save(model, tmp_path / "a.glb")
    back = ssdr.load_skinning(tmp_path / "a.glb")
    assert back.names() == NAMES
    assert back.parents.tolist() == list(PARENTS)
    assert max(differences(model, back).values()) < 1e-6
    assert report.max_error < 1e-6 * 3.2


def test_nodes_hang_on_each_other_and_rigid_joints_turn_alone(tmp_path):
    ssdr.save(creature(), tmp_path / "a.gltf")
    document = _json(tmp_path / "a.gltf")
    nodes, skin = document["nodes"], document["skins"][0]
    above = {c: k for k, node in enumerate(nodes) for c in node.get("children", [])}
    top = skin["skeleton"]
    for joint, parent in zip(skin["joints"], PARENTS, strict=True):
        assert above[joint] == (skin["joints"][parent] if parent >= 0 else top)
    assert top in document["scenes"][0]["nodes"]
    moved = {
        c["target"]["node"]
        for c in document["animations"][0]["channels"]
        if c["target"]["path"] == "translation"
    }
    assert {nodes[k]["name"] for k in moved} == {"hip", "ball"}
    turned = [c for c in document["animations"][0]["channels"] if c["target"]["path"] == "rotation"]
    assert len(turned) == len(PARENTS)


def test_a_flat_model_has_no_hierarchy_when_it_comes_back(tmp_path):
    ssdr.save(flat(creature()), tmp_path / "a.glb")
    assert ssdr.load_skinning(tmp_path / "a.glb").parents is None


def test_clips_and_keyframes_of_a_tree(tmp_path):
    walk, jump = ssdr.Clip("walk", 0, 6, 24), ssdr.Clip("jump", 6, 10, 30)
    model = creature(clips=(walk, jump))
    ssdr.save(model, tmp_path / "a.glb")
    back = ssdr.load_skinning(tmp_path / "a.glb")
    assert back.clips == model.clips
    assert max(differences(model, back).values()) < 1e-6


def test_a_node_between_joints_is_passed_over_and_its_motion_kept(tmp_path):
    """The forearm hangs on a moving helper node, and that on the arm."""
    ssdr.save(creature(loose=True), tmp_path / "a.gltf")
    truth = ssdr.load_skinning(tmp_path / "a.gltf")
    document = _json(tmp_path / "a.gltf")
    nodes = document["nodes"]
    leg, foot = (
        next(k for k, n in enumerate(nodes) if n.get("name") == x) for x in ("leg", "foot")
    )
    nodes[leg]["children"] = [len(nodes)]
    nodes.append({"name": "twist", "children": [foot]})
    # the translation of the foot moves on to the node between
    for channel in document["animations"][0]["channels"]:
        if channel["target"] == {"node": foot, "path": "translation"}:
            channel["target"]["node"] = len(nodes) - 1
    nodes[-1]["translation"] = nodes[foot].pop("translation")
    _write(tmp_path / "a.gltf", document)
    back = ssdr.load_skinning(tmp_path / "a.gltf")
    assert tree_of(back) == tree_of(truth)
    assert max(differences(truth, back).values()) < 1e-7


def test_a_skeleton_below_another_node_follows_it(tmp_path):
    ssdr.save(creature(), tmp_path / "a.gltf")
    truth = ssdr.load_skinning(tmp_path / "a.gltf")
    document = _json(tmp_path / "a.gltf")
    top = document["skins"][0]["skeleton"]
    document["nodes"][top] |= {"translation": [0, 5, 0], "scale": [2, 2, 2]}
    _write(tmp_path / "a.gltf", document)
    back = ssdr.load_skinning(tmp_path / "a.gltf")
    assert tree_of(back) == tree_of(truth)
    np.testing.assert_allclose(back.joint_positions, truth.joint_positions, atol=1e-6)
    np.testing.assert_allclose(back.skin(), 2 * truth.skin() + [0, 5, 0], atol=1e-5)
    ssdr.save(back, tmp_path / "b.glb")  # bones twice as large as the rest pose
    again = ssdr.load_skinning(tmp_path / "b.glb")
    assert max(differences(back, again).values()) < 2e-6


def test_a_rig_of_which_a_joint_was_renamed_and_one_turned_comes_back(tmp_path):
    ssdr.save(creature(), tmp_path / "a.gltf")
    document = _json(tmp_path / "a.gltf")
    nodes = document["nodes"]
    next(n for n in nodes if n.get("name") == "foot")["name"] = "paw"
    _write(tmp_path / "a.gltf", document)
    names = ssdr.load_skinning(tmp_path / "a.gltf").names()
    assert names == tuple("paw" if n == "foot" else n for n in NAMES)


def test_names_that_repeat_are_made_different(tmp_path):
    model = dataclasses.replace(creature(), bone_names=("a",) * len(NAMES))
    ssdr.save(model, tmp_path / "a.glb")
    back = ssdr.load_skinning(tmp_path / "a.glb")
    assert len(set(back.names())) == len(NAMES)
    assert back.parents.tolist() == list(PARENTS)


def test_joints_in_a_circle_are_refused(tmp_path):
    ssdr.save(creature(), tmp_path / "a.gltf")
    document = _json(tmp_path / "a.gltf")
    nodes = document["nodes"]
    hip, foot = (
        next(k for k, n in enumerate(nodes) if n.get("name") == x) for x in ("hip", "foot")
    )
    nodes[foot]["children"] = [hip]
    document["nodes"][document["skins"][0]["skeleton"]]["children"].remove(hip)
    _write(tmp_path / "a.gltf", document)
    with pytest.raises(FormatError, match="its own ancestor"):
        ssdr.load_skinning(tmp_path / "a.gltf")


def test_into_a_template_the_tree_goes_too(tmp_path):
    model = creature()
    ssdr.save(model, tmp_path / "a.glb")
    read = ssdr.load_skinning(tmp_path / "a.glb")
    ssdr.save(read, tmp_path / "b.glb", template=tmp_path / "a.glb")
    back = ssdr.load_skinning(tmp_path / "b.glb")
    assert tree_of(back) == tree_of(model)
    assert max(differences(model, back).values()) < 1e-6


@pytest.mark.parametrize("name", ["Fox.glb", "Llama.gltf"])
def test_animals_are_read_and_written_again(tmp_path, name):
    if not (DATA / name).is_file():
        pytest.skip(f"{name} is not here")
    model = ssdr.load_skinning(DATA / name)
    assert model.parents is not None
    ssdr.save(model, tmp_path / "a.glb")
    back = ssdr.load_skinning(tmp_path / "a.glb")
    assert tree_of(back) == tree_of(model)
    assert max(differences(model, back).values()) < 1e-6


def test_joints_scaled_unevenly_are_read_and_refused_where_no_node_holds_them(tmp_path):
    ssdr.save(creature(), tmp_path / "a.gltf")
    document = _json(tmp_path / "a.gltf")
    nodes = document["nodes"]
    nodes[_number(nodes, "leg")]["scale"] = [1, 2, 1]
    _write(tmp_path / "a.gltf", document)
    back = ssdr.load_skinning(tmp_path / "a.gltf")
    assert back.bone_model == "affine"
    assert tree_of(back) == tree_of(creature())
    assert np.isfinite(back.local_transforms()).all()
    ssdr.save(back, tmp_path / "b.npz")
    with pytest.raises(ssdr.InputError, match="scaled rotations"):
        ssdr.save(back, tmp_path / "b.glb")


def test_bones_without_length_and_joints_without_size(tmp_path):
    model = creature()
    at = model.joint_positions.copy()
    at[4] = at[2]  # the leg begins where the hip does
    model = dataclasses.replace(model, joint_positions=at)
    ssdr.save(model, tmp_path / "a.glb")
    back = ssdr.load_skinning(tmp_path / "a.glb")
    assert max(differences(model, back).values()) < 1e-6
    ssdr.save(model, tmp_path / "a.gltf")
    document = _json(tmp_path / "a.gltf")
    del document["skins"][0]["inverseBindMatrices"]  # all of them are then the identity
    _write(tmp_path / "a.gltf", document)
    bare = ssdr.load_skinning(tmp_path / "a.gltf")
    assert (bare.joint_positions == 0).all()
    assert tree_of(bare) == tree_of(model)
    document["nodes"][_number(document["nodes"], "leg")]["scale"] = [0, 0, 0]
    _write(tmp_path / "a.gltf", document)
    assert np.isfinite(ssdr.load_skinning(tmp_path / "a.gltf").joint_gaps()).all()


def test_a_joint_that_is_not_a_number_is_refused(tmp_path):
    ssdr.save(creature(), tmp_path / "a.gltf")
    text = (tmp_path / "a.gltf").read_text()
    document = json.loads(text)
    document["nodes"][_number(document["nodes"], "foot")]["translation"] = [0, float("nan"), 0]
    _write(tmp_path / "a.gltf", document)
    with pytest.raises(FormatError):
        ssdr.load_skinning(tmp_path / "a.gltf")


def test_what_is_left_out_are_orientations(tmp_path):
    ssdr.save(creature(), tmp_path / "a.glb")
    assert ssdr.io.left_out(tmp_path / "a.glb") == ()
    write_along_bones(creature(), tmp_path / "b.glb")
    assert ssdr.io.left_out(tmp_path / "b.glb") == ("orientations of the joints",)
    back = ssdr.load_skinning(tmp_path / "b.glb")
    assert tree_of(back) == tree_of(creature())
    assert max(differences(creature(), back).values()) < 1e-6
