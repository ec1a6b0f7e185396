"""Weights as CSV."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from ssdr import FormatError, InputError
from ssdr.io import read_weights


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_weights_go_round(tmp_path, skinned, dtype):
    names = ("hip", 'the "big", bone', "bone_10", "bone_9", "idle")
    given = dataclasses.replace(skinned, weights=skinned.weights.astype(dtype), bone_names=names)
    path = tmp_path / "w.csv"
    report = ssdr.save(given, path)
    assert (report.influences, report.bytes) == (3, path.stat().st_size)
    back = read_weights(path, bones=names, n_vertices=12)
    assert back.bone_names == names
    np.testing.assert_array_equal(back.indices, given.indices)
    np.testing.assert_array_equal(back.weights.astype(dtype), given.weights)
    by_number = ("bone_9", "bone_10", "hip", "idle", 'the "big", bone')
    assert read_weights(path).bone_names == by_number
    with pytest.raises(FormatError, match=r"w\.csv: bone 'hip' is none of the bones asked for"):
        read_weights(path, bones=names[1:])
    with pytest.raises(FormatError, match=r"w\.csv: 12 vertices, expected 13"):
        read_weights(path, n_vertices=13)
    with pytest.raises(InputError, match="the same name twice"):
        read_weights(path, bones=["hip", "hip"])
    with pytest.raises(InputError, match=r"path: expected a \.csv file"):
        read_weights(tmp_path / "w.json")


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


def test_weights_go_back_to_the_mesh_before_welding(tmp_path, skinned):
    index = np.array([3, 3, *range(12), 0])
    welded = dataclasses.replace(skinned, vertex_map=index)
    path = tmp_path / "w.csv"
    assert "12 welded vertices" in ssdr.save(welded, path).note
    ssdr.save(welded, path, unweld=True)
    back = read_weights(path, bones=skinned.names())
    np.testing.assert_array_equal(back.weights, skinned.weights[index])
    with pytest.raises(InputError, match=r"^unweld"):
        ssdr.save(skinned, path, unweld=True)


HEAD = "vertex,bone,weight\n"


@pytest.mark.parametrize(
    "rows",
    [
        "",
        "vertex;bone;weight\n0;a;1\n",
        HEAD,
        HEAD + "0,a\n",
        HEAD + "0,a,half\n",
        HEAD + "0,a,nan\n",
        HEAD + "0,a,-0.5\n0,b,1.5\n",
        HEAD + "0,a,0.5\n",
        HEAD + "0,a,0.5\n0,a,0.5\n",
        HEAD + "1,a,1\n",
        HEAD + "-1,a,1\n",
        HEAD + "999999999999999999999,a,1\n",
        HEAD + "1e3,a,1\n",
        HEAD + '0,"a,1\n',
    ],
)
def test_tables_of_weights_are_checked(tmp_path, rows):
    (tmp_path / "w.csv").write_text(rows)
    with pytest.raises(FormatError, match=r"w\.csv"):
        read_weights(tmp_path / "w.csv")


def test_a_table_that_needs_more_memory_than_it_may_is_refused(tmp_path):
    """One vertex of many bones makes all of them wide."""
    n = 50_000
    rows = [f"0,{k},{1 / n}" for k in range(n)] + [f"{k},0,1" for k in range(1, n)]
    (tmp_path / "w.csv").write_text(HEAD + "\n".join(rows))
    with pytest.raises(FormatError, match="50000 times 50000 weights needs 30000000000 bytes"):
        read_weights(tmp_path / "w.csv")
