"""Drawn normals of the smallest model: at no more bytes, and within a tolerance of their own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

import ssdr
from helpers import motions, normal_angles
from helpers.measures import rmse_of
from ssdr.parsimony import pruning

DANCER = ssdr.samples.load("dancer_small")


def tube() -> ssdr.MeshSequence:
    """A chain of five bones: two hold its positions to 4 %, but not its normals."""
    rig = motions.chain(bones=5, rows=14, frames=15)
    return ssdr.MeshSequence(rig.frames, rig.faces)


def against(points: Any, faces: Any) -> Any:
    """Mask of triangles that point against the normals at their corners."""
    a, b, c = points[faces].astype(float).transpose(1, 0, 2)
    around = normal_angles.surface_normals(points, faces).sum(axis=1)
    return (np.cross(b - a, c - a) * around).sum(axis=1) < 0


def test_normals_take_more_bones_than_positions() -> None:
    loose = ssdr.smallest(tube(), tolerance="4%", effort="fast")
    assert loose.parsimony.bones == 2
    assert loose.parsimony.normals_tolerance is None
    assert normal_angles.errors(tube(), loose.skinning).mean > 4
    found = ssdr.smallest(tube(), tolerance="4%", normals_tolerance=4.0, effort="fast")
    assert found.parsimony.held
    assert found.parsimony.bones == 3
    assert found.parsimony.normals_tolerance == 4.0
    mean = normal_angles.errors(tube(), found.skinning).mean
    assert mean <= 4
    assert found.normals is not None
    assert found.normals.mean == pytest.approx(mean, rel=1e-4)
    assert rmse_of(found.skinning, tube().vertices) <= found.parsimony.tolerance
    # each attempt with two bones held positions, and none normals
    short = [a.error for a in found.parsimony.attempts if a.bones == 2]
    assert min(short) > 2 * found.parsimony.tolerance
    influences = found.parsimony.prunings[1]
    assert influences.after < influences.before


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", [{}, {"measure": "max", "tolerance": "3%"}, {"influences": (4, "uint8")}]
)
def test_both_tolerances_are_held(kind: dict[str, Any]) -> None:
    asked = {"tolerance": "0.8%", "normals_tolerance": 6.0, "effort": "fast", **kind}
    found = ssdr.smallest(DANCER, **asked)
    assert found.stop_reason == "tolerance held"
    assert found.parsimony.held
    assert normal_angles.errors(DANCER, found.skinning).mean <= 6
    assert found.parsimony.error <= found.parsimony.tolerance


@pytest.mark.parametrize("compression", ["quantized", "meshopt"])
def test_the_file_as_decoded_holds_them(tmp_path: Path, compression: str) -> None:
    if compression == "meshopt":
        pytest.importorskip("meshoptimizer")
    file, path = {"compression": compression, "tolerance": "2%", "name": "tube"}, tmp_path / "a.glb"
    given = {"tolerance": "4%", "normals_tolerance": 4.0, "effort": "fast", "file": file}
    found = ssdr.smallest(tube(), **given)
    small, whole = found.parsimony.file, found.normals
    assert small is not None
    assert whole is not None
    assert small.normals is not None
    ssdr.save(found, path, **file)
    assert small.bytes == len(path.read_bytes())
    back = ssdr.load_skinning(path)
    rows = (np.concatenate(list(x), axis=1) for x in (found.skinning.skin(), back.skin()))
    here, there = rows
    near = cKDTree(here).query(there)[1]
    assert sorted(near) == list(range(84))
    order = ssdr.MeshSequence(tube().vertices[:, near], back.faces)
    assert small.normals == pytest.approx(normal_angles.errors(order, back).mean, rel=1e-3)
    assert small.normals != pytest.approx(whole.mean, rel=2e-3)
    assert max(small.normals, whole.mean) <= 4
    assert found.parsimony.held


@pytest.mark.slow
def test_normals_are_better_at_no_more_bytes() -> None:
    plain = ssdr.smallest(DANCER, tolerance="0.5%", effort="fast", normals=False)
    found = ssdr.smallest(DANCER, tolerance="0.5%", effort="fast")
    assert found.parsimony.held
    assert found.parsimony.bones == plain.parsimony.bones
    assert found.parsimony.size.total <= 1.005 * plain.parsimony.size.total
    means = [normal_angles.errors(DANCER, r.skinning).mean for r in (found, plain)]
    assert means[0] < 0.93 * means[1]


@pytest.mark.slow
def test_the_rest_pose_is_unfolded(monkeypatch: pytest.MonkeyPatch) -> None:
    faces = DANCER.faces
    own = np.any([against(points, faces) for points in DANCER.vertices], axis=0)

    def turned_over() -> int:
        found = ssdr.smallest(DANCER, tolerance="0.5%", effort="fast", rng=1)
        return int((against(found.skinning.rest, faces) & ~own).sum())

    assert turned_over() == 0
    monkeypatch.setattr(pruning, "unfold", lambda d: None)
    assert turned_over() > 0


def test_out_of_reach_is_said() -> None:
    with pytest.warns(ssdr.SsdrWarning, match=r"and 4° of normals is out of reach: 2 bones.*° of"):
        found = ssdr.smallest(tube(), tolerance="4%", normals_tolerance=4.0, bones=2, effort="fast")
    assert not found.parsimony.held
    assert found.parsimony.error <= found.parsimony.tolerance
    assert found.stop_reason == "tolerance out of reach"
