"""`ssdr decompose --skeleton`: a rig that is handed over, bones more, a rest pose from a file."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers import trees

NAMES = ("hips", "chest", "arm", "leg")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig")
    made = trees.skeleton(4, 16, seed=3)
    rig = ssdr.Skinning(
        made.rest,
        made.indices,
        made.weights,
        np.broadcast_to(np.eye(3, 4), (1, 4, 3, 4)),
        parents=made.parents,
        joint_positions=made.points,
        bone_names=NAMES,
    )
    ssdr.save(rig, folder / "rig.npz")
    wavy = made.frames + 0.02 * np.sin(4 * made.frames[..., [1, 2, 0]])
    ssdr.save(ssdr.MeshSequence(wavy), folder / "walk.npz")
    ssdr.save(ssdr.MeshSequence(made.rest[None]), folder / "rest.npz")
    ssdr.save(ssdr.MeshSequence(made.rest[None, :-1]), folder / "other.npz")
    return folder, made


def _decompose(run, files, out, *more):
    folder, _ = files
    given = ("--skeleton", folder / "rig.npz") if "--bones" not in more else ()
    return run("decompose", folder / "walk.npz", "-o", out, "-e", "fast", "-k", 2, *given, *more)


def test_bones_more_below_named_ones(run, files, tmp_path):
    out = tmp_path / "out.npz"
    code, _, err = _decompose(run, files, out, "--extra-bones", "chest=1,arm=2")
    assert code == 0, err
    model = ssdr.load_skinning(out)
    assert model.joint_names[:4] == NAMES
    assert model.parents[4:].tolist() == [1, 2, 2]


def test_a_rest_pose_from_a_file_is_kept(run, files, tmp_path):
    out = tmp_path / "out.npz"
    code, _, err = _decompose(run, files, out, "--rest", files[0] / "rest.npz")
    assert code == 0, err
    np.testing.assert_allclose(ssdr.load_skinning(out).rest, files[1].rest, atol=1e-6)
    flat = tmp_path / "flat.npz"
    code, _, err = _decompose(
        run, files, flat, "--rest", files[0] / "rest.npz", "--bones", 3, "--force"
    )
    assert code == 0, err
    model = ssdr.load_skinning(flat)
    np.testing.assert_allclose(model.rest, files[1].rest, atol=1e-6)
    assert model.parents is None


def test_loose_joints_of_a_rig(run, files, tmp_path):
    out = tmp_path / "out.npz"
    code, _, err = _decompose(run, files, out, "--hierarchy", "loose")
    assert code == 0, err
    assert np.array_equal(ssdr.load_skinning(out).parents, files[1].parents)


def test_a_tolerance_of_a_rig_that_can_be_posed(run, files, tmp_path):
    out = tmp_path / "out.npz"
    code, _, err = run(
        "decompose", files[0] / "walk.npz", "-o", out, "-e", "fast", "-k", 2,
        "--hierarchy", "rigid", "--tolerance", "2%",
    )  # fmt: skip
    assert code == 0, err
    model = ssdr.load_skinning(out)
    assert model.parents is not None
    assert model.joint_gaps().max() < 1e-6
    assert dataclasses.replace(model, keyframes=None).n_bones <= 4


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--extra-bones", "tail=1"), "tail"),
        (("--extra-bones", "chest=x"), "--extra-bones"),
        (("--extra-bones", "-1"), "--extra-bones"),
        (("--rest", "other.npz"), "--rest"),
        (("--rest", "rest.npz", "--keep-weights"), "--keep-weights"),
        (("--bones", "3", "--extra-bones", "1"), "--skeleton"),
    ],
)
def test_what_does_not_fit_is_refused_before_the_work(run, files, tmp_path, more, said):
    there = [files[0] / part if part.endswith(".npz") else part for part in more]
    code, out, err = _decompose(run, files, tmp_path / "out.npz", *there)
    assert (code, out) == (2, "")
    assert said in err
    assert not list(tmp_path.iterdir())
