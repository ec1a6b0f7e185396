"""glTF: joints are nodes that hang on each other, and nodes between them move them."""

from __future__ import annotations

import json

import numpy as np
import pytest

import ssdr
from helpers.rig_model import largest_distance
from helpers.rig_tree import PARENTS, creature, differences, tree_of


class Edited:
    """The creature's ``.gltf`` while it is edited: its JSON, its nodes by name."""

    def __init__(self, path, **kind):
        self.path = path
        ssdr.save(creature(**kind), path)
        self.json = json.loads(path.read_text())
        self.nodes = self.json["nodes"]
        self.top = self.nodes[self.json["skins"][0]["skeleton"]]

    def number(self, name):
        return next(k for k, node in enumerate(self.nodes) if node.get("name") == name)

    def __getitem__(self, name):
        return self.nodes[self.number(name)]

    def read(self):
        self.path.write_text(json.dumps(self.json))
        return ssdr.load_skinning(self.path)


@pytest.fixture
def edited(tmp_path):
    return Edited(tmp_path / "a.gltf")


def test_nodes_hang_on_each_other_and_rigid_joints_turn_alone(edited):
    nodes, skin = edited.nodes, edited.json["skins"][0]
    above = {c: k for k, node in enumerate(nodes) for c in node.get("children", [])}
    for joint, parent in zip(skin["joints"], PARENTS, strict=True):
        assert above[joint] == (skin["joints"][parent] if parent >= 0 else skin["skeleton"])
    assert skin["skeleton"] in edited.json["scenes"][0]["nodes"]
    targets = [c["target"] for c in edited.json["animations"][0]["channels"]]
    moved = {nodes[t["node"]]["name"] for t in targets if t["path"] == "translation"}
    assert moved == {"hip", "ball"}
    assert sum(t["path"] == "rotation" for t in targets) == len(PARENTS)


def test_a_node_between_joints_is_passed_over_and_its_motion_kept(tmp_path):
    """The foot hangs on a moving helper node, and that on the leg."""
    edited = Edited(tmp_path / "a.gltf", loose=True)
    truth = ssdr.load_skinning(edited.path)
    foot, twist = edited.number("foot"), len(edited.nodes)
    edited["leg"]["children"] = [twist]
    edited.nodes.append({"children": [foot], "translation": edited["foot"].pop("translation")})
    for channel in edited.json["animations"][0]["channels"]:
        if channel["target"] == {"node": foot, "path": "translation"}:
            channel["target"]["node"] = twist
    back = edited.read()
    assert tree_of(back) == tree_of(truth)
    assert max(differences(truth, back).values()) < 1e-7


def test_a_skeleton_below_another_node_follows_it(edited, tmp_path):
    truth = ssdr.load_skinning(edited.path)
    edited.top.update(translation=[0, 5, 0], scale=[2, 2, 2])
    back = edited.read()
    assert tree_of(back) == tree_of(truth)
    np.testing.assert_allclose(back.joint_positions, truth.joint_positions, atol=1e-6)
    np.testing.assert_allclose(back.skin(), 2 * truth.skin() + [0, 5, 0], atol=1e-5)
    ssdr.save(back, tmp_path / "b.glb")  # bones twice as large as the rest pose
    again = ssdr.load_skinning(tmp_path / "b.glb")
    assert max(differences(back, again).values()) < 2e-6


@pytest.mark.filterwarnings("ignore:.*lie between its frames:ssdr.SsdrWarning")
@pytest.mark.parametrize("name", ["Fox.glb", "Llama.gltf"])
def test_animals_are_read_and_written_again(tmp_path, data_dir, name):
    model = ssdr.load_skinning(data_dir / "gltf" / name)
    assert model.parents is not None
    ssdr.save(model, tmp_path / "a.glb")
    back = ssdr.load_skinning(tmp_path / "a.glb")
    assert tree_of(back) == tree_of(model)
    assert max(differences(model, back).values()) < 1e-6


def test_joints_scaled_unevenly_are_read_and_written_as_two_nodes_each(edited, tmp_path):
    edited["leg"]["scale"] = [1, 2, 1]
    back = edited.read()
    assert back.bone_model == "affine"
    assert tree_of(back) == tree_of(creature())
    assert np.isfinite(back.local_transforms()).all()
    ssdr.save(back, tmp_path / "b.npz")
    ssdr.save(back, tmp_path / "b.glb")
    again = ssdr.load_skinning(tmp_path / "b.glb")
    assert tree_of(again) == tree_of(back)
    assert largest_distance(again.skin(), back.skin()) < 1e-5


def test_joints_without_bind_matrices_and_without_size(edited):
    del edited.json["skins"][0]["inverseBindMatrices"]  # all of them are then the identity
    bare = edited.read()
    assert (bare.joint_positions == 0).all()
    assert tree_of(bare) == tree_of(creature())
    edited["leg"]["scale"] = [0, 0, 0]
    assert np.isfinite(edited.read().joint_gaps()).all()
