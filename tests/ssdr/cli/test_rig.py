"""`--rig` and the options beside it: kinds of joints, and a rig that is kept."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import trees

NAMES = ("hips", "chest", "arm", "leg")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig")
    made = trees.skeleton(4, 16, seed=3)
    ssdr.save(made.skinning(bone_names=NAMES), folder / "rig.npz")
    ssdr.save(ssdr.MeshSequence(made.wavy), folder / "walk.npz")
    ssdr.save(ssdr.MeshSequence(made.rest[None]), folder / "rest.npz")
    ssdr.save(ssdr.MeshSequence(made.rest[None, :-1]), folder / "other.npz")
    return folder, made


@pytest.fixture
def line(files, tmp_path):
    return ("decompose", files[0] / "walk.npz", "-o", tmp_path / "out.npz", "-e", "fast", "-k", 2)


@pytest.fixture
def fitted(done, line, tmp_path):
    def call(*more):
        done(*line, *more)
        return ssdr.load_skinning(tmp_path / "out.npz")

    return call


def test_bones_to_add_below_named_ones(files, fitted):
    model = fitted("--rig", files[0] / "rig.npz", "--extra-bones", "chest=1,arm=2")
    assert model.joint_names[:4] == NAMES
    assert model.parents[4:].tolist() == [1, 2, 2]


def test_a_rest_pose_from_a_file_is_kept(files, fitted):
    rest = ("--start", files[0] / "rest.npz")
    model = fitted("--rig", files[0] / "rig.npz", *rest)
    np.testing.assert_allclose(model.rest, files[1].rest, atol=1e-6)
    model = fitted("--bones", 3, *rest)
    np.testing.assert_allclose(model.rest, files[1].rest, atol=1e-6)
    assert model.parents is None


def test_weights_of_a_rig_are_kept(files, fitted):
    model = fitted("--rig", files[0] / "rig.npz", "--keep-weights")
    np.testing.assert_allclose(model.rest, files[1].rest, atol=1e-6)
    kept = ssdr.load_skinning(files[0] / "rig.npz").dense_weights()
    np.testing.assert_allclose(model.dense_weights(), kept, atol=1e-6)


def test_joints_that_come_apart_and_joints_that_are_found(files, fitted):
    model = fitted("--rig", f"loose={files[0] / 'rig.npz'}")
    assert np.array_equal(model.parents, files[1].parents)
    model = fitted("--rig", "rigid", "--bones", 4)
    assert model.joint_gaps().max() < 1e-6


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--rig", "rig.npz", "--extra-bones", "tail=1"), "tail"),
        (("--rig", "rig.npz", "--extra-bones", "chest=x"), "--extra-bones"),
        (("--rig", "rig.npz", "--extra-bones", "-1"), "extra_bones"),
        (("--rig", "rig.npz", "--start", "other.npz"), "rest"),
        (("--rig", "rig.npz", "--start", "rest.npz", "--keep-weights"), "--keep-weights"),
        (("--bones", "3", "--extra-bones", "1"), "--rig FILE"),
        (("--rig", "loose"), "--bones"),
        ((), "--bones"),
    ],
)
def test_what_does_not_fit_is_refused_before_the_work(refused, files, line, tmp_path, more, said):
    there = [files[0] / part if part.endswith(".npz") else part for part in more]
    assert said in refused(*line, *there)
    assert not list(tmp_path.iterdir())
