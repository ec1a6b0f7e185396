"""The plane of symmetry of a rest pose, partners of bones, mirrored joints."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import ssdr
from ssdr.model.tree import Tree
from ssdr.search.trees.mirror import Mirror, edges_with_image, find_mirror
from ssdr.search.trees.tree_moves import mirror_edge
from ssdr.solver.model import Constraints, Model
from ssdr.solver.trajectories import gather

# A trunk, two arms of two bones, a head; bones of the right (x < 0) come first.
_LIMBS = {
    "trunk": ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), -1),
    "arm_r": ((-0.1, 0.9, 0.0), (-0.8, 1.0, 0.1), 0),
    "hand_r": ((-0.8, 1.0, 0.1), (-1.5, 0.9, 0.3), 1),
    "head": ((0.0, 1.0, 0.0), (0.0, 1.5, 0.2), 0),
    "hand_l": ((0.8, 1.0, 0.1), (1.5, 0.9, 0.3), 5),
    "arm_l": ((0.1, 0.9, 0.0), (0.8, 1.0, 0.1), 0),
}
_PARTNERS = [0, 5, 4, 3, 2, 1]


def _figure(frames: int = 20, seed: int = 0) -> ssdr.Skinning:
    """Points around sticks that mirror each other, each stick a bone, in motion."""
    rng = np.random.default_rng(seed)
    starts, ends = (np.array([limb[k] for limb in _LIMBS.values()]) for k in (0, 1))
    spread = 0.05 * rng.normal(size=(30, 3))
    along = np.linspace(0.05, 0.95, 30)[:, None]
    rest, bone = [], []
    for b, (start, end) in enumerate(zip(starts, ends, strict=True)):
        if b > _PARTNERS[b]:
            points = rest[_PARTNERS[b]] * (-1.0, 1.0, 1.0)
        else:
            points = start + along * (end - start) + spread
            if b == _PARTNERS[b]:
                points = np.concatenate([points, points * (-1.0, 1.0, 1.0)])
        rest.append(points)
        bone += [b] * len(points)
    parents = np.array([limb[2] for limb in _LIMBS.values()])
    still = np.broadcast_to(np.eye(3, 4), (1, 6, 3, 4))
    indices = np.array(bone)[:, None]
    model = ssdr.Skinning(
        np.concatenate(rest),
        indices,
        np.ones(indices.shape),
        still,
        parents=parents,
        joint_positions=starts,
    )
    turns = np.cumsum(0.1 * rng.normal(size=(frames, 6, 3)), axis=0)
    turns[0] = 0.0
    local = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(frames, 6, 3, 3)
    return model.pose(local)


def _mirror(model: ssdr.Skinning) -> Mirror | None:
    return find_mirror(model.rest, model.indices, model.weights, model.n_bones)


def _turned(skinning: ssdr.Skinning, seed: int) -> tuple[ssdr.Skinning, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    return dataclasses.replace(skinning, rest=skinning.rest @ turn.T + shift), turn, shift


@pytest.mark.parametrize("seed", range(4))
def test_plane_and_partners_wherever_the_body_stands(seed):
    figure, turn, shift = _turned(_figure(), seed)
    mirror = _mirror(figure)
    assert mirror is not None
    normal = turn[:, 0] * np.sign(turn[:, 0][np.abs(turn[:, 0]).argmax()])
    assert_allclose(mirror.normal, normal, atol=1e-6)
    assert_allclose(mirror.offset, normal @ shift, atol=1e-6)
    assert_array_equal(mirror.partners, _PARTNERS)


def test_some_noise_is_borne_and_much_is_not():
    figure = _figure()
    noise = np.random.default_rng(1).normal(size=figure.rest.shape)
    size = np.linalg.norm(np.ptp(figure.rest, axis=0))
    little = dataclasses.replace(figure, rest=figure.rest + 5e-4 * size * noise)
    assert_array_equal(_mirror(little).partners, _PARTNERS)
    assert _mirror(dataclasses.replace(figure, rest=figure.rest + 0.05 * size * noise)) is None


def test_a_bent_arm_has_no_mirror_image():
    figure = _figure()
    bent = figure.rest.copy()
    bent[figure.indices[:, 0] == 4] += (0.0, 0.6, 0.0)
    assert _mirror(dataclasses.replace(figure, rest=bent)) is None


def test_points_in_one_place_and_a_single_vertex():
    still = np.broadcast_to(np.eye(3, 4), (2, 1, 3, 4))
    rest, indices = np.ones((4, 3)), np.zeros((4, 1), int)
    assert _mirror(ssdr.Skinning(rest, indices, np.ones((4, 1)), still)) is None
    assert _mirror(ssdr.Skinning(rest[:1], indices[:1], np.ones((1, 1)), still)) is None


@pytest.mark.filterwarnings("ignore::ssdr.SsdrWarning")
@pytest.mark.parametrize("rig", ["loose", "rigid"])
def test_a_vertex_alone_is_decomposed_all_the_same(rig):
    frames = np.random.default_rng(0).normal(size=(5, 1, 3))
    found = ssdr.decompose(frames, bones=1, rig=rig, effort="fast").skinning
    assert found.names() == ("joint_0",)


def test_a_bone_without_vertices_has_no_partner():
    figure = _figure()
    grown = np.concatenate([figure.transforms, figure.transforms[:, :1]], axis=1)
    idle = ssdr.Skinning(figure.rest, figure.indices, figure.weights, grown)
    assert_array_equal(_mirror(idle).partners, [*_PARTNERS, -1])


def test_edges_whose_image_is_an_edge():
    figure = _figure()
    mirror = _mirror(figure)
    assert edges_with_image(mirror, figure.parents) == dict.fromkeys(range(1, 6), True)
    wrong = figure.parents.copy()
    wrong[4] = 0
    there = edges_with_image(mirror, wrong)
    assert [bone for bone, has_image in there.items() if not has_image] == [2, 4]


def test_a_joint_of_one_side_gets_its_image_on_the_other():
    figure = _figure()
    data = gather([ssdr.MeshSequence(figure.skin())], bones=6)
    transforms = np.asarray(figure.transforms, np.float64).copy()
    model = Model.with_weights(
        transforms, data.frame(0), figure.indices.astype(np.int32), figure.weights, 2
    )
    size = np.linalg.norm(np.ptp(data.frame(0), axis=0))
    scale = size / np.linalg.norm(np.ptp(figure.rest, axis=0))
    wrong = figure.parents.astype(np.int64).copy()
    wrong[4] = 0  # the left hand hangs on the trunk
    model.tree = Tree(wrong, scale * np.asarray(figure.joint_positions, np.float64), rigid=False)
    tried = [
        mirror_edge(data, model, np.random.default_rng(k), Constraints()).tree.parents
        for k in range(6)
    ]
    good = [
        {frozenset(e) for e in enumerate(p.tolist()) if e[1] >= 0}
        == {frozenset(e) for e in enumerate(figure.parents.tolist()) if e[1] >= 0}
        for p in tried
    ]
    assert any(good)
