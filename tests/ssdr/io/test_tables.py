"""Weights as CSV and JSON."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

import ssdr
from helpers.rig_tree import NAMES, PARENTS, creature, tree_of
from ssdr import FormatError, InputError
from ssdr.io import read_weights


@pytest.mark.parametrize("suffix", ["csv", "json"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_weights_go_round(tmp_path, skinned, suffix, dtype):
    names = ("hip", 'the "big", bone', "bone_10", "bone_9", "idle")
    given = dataclasses.replace(skinned, weights=skinned.weights.astype(dtype), bone_names=names)
    path = tmp_path / f"w.{suffix}"
    report = ssdr.save(given, path)
    assert (report.influences, report.bytes) == (3, path.stat().st_size)
    back = read_weights(path, bones=names)
    assert back.bone_names == names
    np.testing.assert_array_equal(back.indices, given.indices)
    np.testing.assert_array_equal(back.weights.astype(dtype), given.weights)
    in_file = read_weights(path).bone_names
    assert in_file == (names if suffix == "json" else tuple(sorted(names, key=_natural)))
    with pytest.raises(FormatError, match="bone 'hip' is none of the bones asked for"):
        read_weights(path, bones=names[1:])
    with pytest.raises(InputError, match="the same name twice"):
        read_weights(path, bones=["hip", "hip"])


def _natural(name):
    return (name.rstrip("0123456789"), int("0" + "".join(c for c in name if c.isdigit())))


def test_weights_are_what_they_say(tmp_path, skinned):
    ssdr.save(skinned, tmp_path / "w.csv")
    lines = (tmp_path / "w.csv").read_text().splitlines()
    assert lines[0] == "vertex,bone,weight"
    assert "0,bone_4,0" in lines
    dense = np.zeros((12, 5))
    for line in lines[1:]:
        vertex, bone, weight = line.split(",")
        dense[int(vertex), int(bone.removeprefix("bone_"))] += float(weight)
    np.testing.assert_array_equal(dense, skinned.dense_weights())
    ssdr.save(skinned, tmp_path / "w.json")
    table = json.loads((tmp_path / "w.json").read_text())
    assert table["bones"] == list(skinned.names())
    np.testing.assert_array_equal(table["joints"], skinned.indices)
    np.testing.assert_array_equal(table["weights"], skinned.weights)


@pytest.mark.parametrize("suffix", ["csv", "json"])
def test_weights_go_back_to_the_mesh_before_welding(tmp_path, skinned, suffix):
    index = np.array([3, 3, *range(12), 0])
    welded = dataclasses.replace(skinned, vertex_map=index)
    path = tmp_path / f"w.{suffix}"
    assert "12 welded vertices" in ssdr.save(welded, path).note
    ssdr.save(welded, path, unweld=True)
    back = read_weights(path, bones=skinned.names())
    np.testing.assert_array_equal(back.weights, skinned.weights[index])
    with pytest.raises(InputError, match=r"^unweld"):
        ssdr.save(skinned, path, unweld=True)


@pytest.mark.parametrize(
    "rows",
    [
        "",
        "vertex;bone;weight\n0;a;1\n",
        "vertex,bone,weight\n",
        "vertex,bone,weight\n0,a\n",
        "vertex,bone,weight\n0,a,half\n",
        "vertex,bone,weight\n0,a,nan\n",
        "vertex,bone,weight\n0,a,-0.5\n0,b,1.5\n",
        "vertex,bone,weight\n0,a,0.5\n",
        "vertex,bone,weight\n0,a,0.5\n0,a,0.5\n",
        "vertex,bone,weight\n1,a,1\n",
        "vertex,bone,weight\n-1,a,1\n",
        "vertex,bone,weight\n999999999999999999999,a,1\n",
        "vertex,bone,weight\n1e3,a,1\n",
        'vertex,bone,weight\n0,"a,1\n',
    ],
)
def test_tables_of_weights_are_checked(tmp_path, rows):
    (tmp_path / "w.csv").write_text(rows)
    with pytest.raises(FormatError, match=r"w\.csv"):
        read_weights(tmp_path / "w.csv")


TABLE = '{"format": "ssdr-weights", "version": 1, "bones": %s, "joints": %s, "weights": %s}'


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "[" * 100_000,
        '{"format": "ssdr-weights", "version": 2}',
        TABLE % ('"ab"', "[[0]]", "[[1]]"),
        TABLE % ('["a"]', "[[1]]", "[[1]]"),
        TABLE % ('["a"]', "[[0.0]]", "[[1]]"),
        TABLE % ('["a"]', "[[0]]", "[[NaN]]"),
        TABLE % ('["a"]', "[[0]]", '[["1"]]'),
        TABLE % ('["a"]', "[[0], []]", "[[1]]"),
        TABLE % ('["a", "a"]', "[[0]]", "[[1]]"),
        TABLE % ("[]", "[]", "[]"),
    ],
)
def test_json_weights_are_checked(tmp_path, text):
    (tmp_path / "w.json").write_text(text)
    with pytest.raises(FormatError, match=r"w\.json"):
        read_weights(tmp_path / "w.json")


def test_json_keeps_the_hierarchy_and_reorders_it(tmp_path):
    model = creature(frames=2)
    ssdr.save(model, tmp_path / "w.json")
    back = read_weights(tmp_path / "w.json")
    assert back.parents.tolist() == list(PARENTS)
    np.testing.assert_array_equal(back.joint_positions, model.joint_positions)
    names = tuple(reversed(NAMES))
    other = read_weights(tmp_path / "w.json", bones=names)
    above = [names[a] if a >= 0 else None for a in other.parents]
    assert dict(zip(names, above, strict=True)) == tree_of(model)
    np.testing.assert_array_equal(other.joint_positions, model.joint_positions[::-1])
    assert read_weights(tmp_path / "w.json", bones=(*NAMES, "more")).parents is None


def test_tables_without_a_hierarchy_have_none(tmp_path, skinned):
    for suffix in ("csv", "json"):
        ssdr.save(skinned, tmp_path / f"w.{suffix}")
        assert read_weights(tmp_path / f"w.{suffix}").parents is None
    assert "parents" not in (tmp_path / "w.json").read_text()


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("parents", [2, 0, 0, 0, 2, -1, 4], "cycle"),
        ("parents", [-1], "shape"),
        ("parents", None, "integers"),
        ("joint_positions", [[0, 0]] * 7, "three numbers for each bone"),
        ("joint_positions", [[0, 0, float("nan")]] * 7, "not finite"),
        ("joint_positions", "here", "three numbers for each bone"),
    ],
)
def test_damaged_hierarchies_are_refused(tmp_path, key, value, says):
    ssdr.save(creature(frames=1), tmp_path / "w.json")
    table = json.loads((tmp_path / "w.json").read_text())
    table[key] = value
    (tmp_path / "w.json").write_text(json.dumps(table))
    with pytest.raises(FormatError, match=says):
        read_weights(tmp_path / "w.json")
