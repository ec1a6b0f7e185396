import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from garmentnet.configs.config import FeatureOptions, load_config
from garmentnet.networks.features import Normaliser, PoseFeatures
from helpers import toy_store as toy
from ssdr.common.errors import InputError

FAITHFUL = load_config("faithful").features
# The toy body has other joints.
ROOTED = dataclasses.replace(load_config("rooted").features, joints=())


@pytest.fixture(scope="module")
def moved():
    _, skeleton = toy.body()
    joints, heading, _ = toy.motion(np.random.default_rng(0), 40, skeleton)
    return skeleton, joints, heading


@pytest.mark.parametrize("options", [FAITHFUL, ROOTED])
def test_pieces_give_the_same(moved, options):
    skeleton, joints, _ = moved
    features = PoseFeatures(skeleton, options, toy.FPS)
    whole, frame, _ = features(joints)
    assert whole.shape == (40, features.size)
    for size in (1, 7):
        state, parts, frames = None, [], []
        for i in range(0, 40, size):
            x, f, state = features(joints[i : i + size], state)
            parts.append(x)
            frames.append(f)
        assert np.array_equal(np.concatenate(parts), whole)
        assert np.array_equal(np.concatenate(frames), frame)


def naive(skeleton, options, joints):
    """Features and moving frame of a motion, frame by frame, with SciPy's rotations."""
    rows, frames, past = [], [], None
    for m in joints:
        world = [Rotation.from_matrix(x[:, :3]) for x in m]
        places = skeleton.positions(m[None])[0]
        root, place = world[0], places[0]
        _, y, _, w = root.as_quat()
        heading = Rotation.from_quat([0, y, 0, w])  # the twist of swing and twist
        local = [
            world[p].inv() * r if p >= 0 else heading.inv() * r if options.heading_free else r
            for p, r in zip(skeleton.parents, world, strict=True)
        ]
        if options.rotation == "vector":
            pose = np.concatenate([r.as_rotvec() for r in local])
        else:
            pose = np.concatenate([r.as_matrix()[:, :2].T.ravel() for r in local])
        first, *before = past or (place, places, 0 * places, root, pose)
        speeds = (places - before[0]) * toy.FPS
        changes = (speeds - before[1]) * toy.FPS
        turn = (root * before[2].inv()).as_rotvec() * toy.FPS
        row = [place - first] if options.translation else []
        row += [pose, (pose - before[3]) * toy.FPS] if options.velocities else [pose]
        if options.root_motion:
            moves = [heading.inv().apply(v) for v in (speeds[0], changes[0], turn)]
            row += [*moves, moves[2] ** 2]
        if options.joint_motion:
            row += [heading.inv().apply(x[1:]).ravel() for x in (places - place, speeds, changes)]
            row += [(heading.inv() * r).as_matrix()[:, :2].T.ravel() for r in world[1:]]
        past = first, places, speeds, root, pose
        rows.append(np.concatenate(row))
        of = {"root": root, "heading": heading, "world": Rotation.identity()}[options.frame]
        at = 0 * place if options.frame == "world" else place
        frames.append(np.column_stack([of.as_matrix(), at]))
    return np.array(rows), np.array(frames)


@pytest.mark.parametrize(
    "options",
    [
        FAITHFUL,
        ROOTED,
        dataclasses.replace(ROOTED, joint_motion=False),
        dataclasses.replace(ROOTED, frame="world", translation=True),
    ],
)
def test_features_are_those_of_a_naive_twin(moved, options):
    skeleton, joints, _ = moved
    x, frame, _ = PoseFeatures(skeleton, options, toy.FPS)(joints)
    expected, frames = naive(skeleton, options, joints)
    # Speeds and accelerations divide rounding by 1/30 s and by its square.
    assert np.abs(x - expected).max() < 1e-9
    assert np.abs(frame - frames).max() < 1e-12


def world(joints, angle, shift):
    """The same motion elsewhere on the floor and facing elsewhere."""
    turn = Rotation.from_euler("y", angle).as_matrix()
    out = turn @ joints
    out[..., 3] += shift
    return out, turn


@pytest.mark.parametrize("angle", [0.3, 2.0, -3.1])
def test_rooted_does_not_see_place_and_heading(moved, angle):
    skeleton, joints, _ = moved
    features = PoseFeatures(skeleton, ROOTED, toy.FPS)
    x, frame, _ = features(joints)
    shift = np.array([3.0, 0.0, -2.0])
    there, turn = world(joints, angle, shift)
    y, other, _ = features(there)
    # Speeds divide differences of rounding by 1/30 s, twice for acceleration.
    assert np.abs(x - y).max() < 1e-8
    assert np.allclose(other[..., :3], turn @ frame[..., :3], atol=1e-12)
    assert np.allclose(other[..., 3], frame[..., 3] @ turn.T + shift, atol=1e-12)


def test_faithful_sees_heading_but_not_where_it_starts(moved):
    skeleton, joints, _ = moved
    features = PoseFeatures(skeleton, FAITHFUL, toy.FPS)
    x, _, _ = features(joints)
    assert np.abs(features(world(joints, 0.0, [1.0, 2.0, 3.0])[0])[0] - x).max() < 1e-12
    assert np.abs(features(world(joints, 1.0, 0.0)[0])[0] - x).max() > 0.5


def test_root_motion_of_a_steady_spin():
    _, skeleton = toy.body()
    time = np.arange(20) / toy.FPS
    rotations = np.tile(np.eye(3), (20, 3, 1, 1))
    rotations[:, 0] = Rotation.from_euler("y", 2.0 * time[:, None]).as_matrix()
    place = np.stack([0.5 * time, 0 * time + 1, 0 * time], axis=1)
    options = FeatureOptions(
        rotation="sixd", heading_free=True, translation=False, root_motion=True, frame="heading"
    )
    x, _, _ = PoseFeatures(skeleton, options, toy.FPS)(skeleton.transforms(place, rotations))
    velocity, change, spin, square = (x[:, -12 + 3 * k :][:, :3] for k in range(4))
    assert np.allclose(np.linalg.norm(velocity[1:], axis=1), 0.5)
    assert np.allclose(change[2:], 0, atol=1e-9)
    assert np.allclose(spin[1:], [0, 2, 0], atol=1e-9)
    assert np.allclose(square[1:], [0, 4, 0], atol=1e-8)
    assert np.allclose(velocity[0], 0)
    assert np.allclose(spin[0], 0)


def test_normaliser_floors_and_clamps():
    rng = np.random.default_rng(0)
    x = np.stack([rng.normal(size=500) * 3 + 1, np.full(500, 2.0)], axis=1)
    n = Normaliser.fit([x[:200], x[200:]], floor=0.01, clamp=5.0)
    assert np.allclose(n.mean, x.mean(axis=0))
    assert np.allclose(n.deviation[0], x[:, 0].std())
    assert n.deviation[1] == 0.01
    assert np.allclose(n(np.array([[1e9, 3.0]])), [[5.0, 5.0]])
    plain = Normaliser.fit([x], floor=0.0, clamp=0.0)
    assert plain.deviation[1] == 1.0
    assert plain(np.array([[1e9, 3.0]]))[0, 0] > 1e8


def test_only_some_joints_are_read(moved):
    skeleton, joints, _ = moved
    some = dataclasses.replace(ROOTED, joints=("leg_l",))
    features, every = PoseFeatures(skeleton, some, toy.FPS), PoseFeatures(skeleton, ROOTED, toy.FPS)
    x, frame, _ = features(joints)
    y, same, _ = every(joints)
    assert x.shape[1] == features.size < every.size
    assert np.array_equal(frame, same)
    # The root is read in any case; the other leg is not.
    n = skeleton.n_joints
    assert np.array_equal(x[:, :12], y[:, :12])
    assert np.array_equal(x[:, 12:24], y[:, 6 * n : 6 * n + 12])
    assert np.array_equal(x[:, 24:36], y[:, 12 * n :][:, :12])
    # Position, velocity, acceleration and rotation, each of all joints but the root.
    others, leg = n - 1, features.read[1] - 1
    own, every = x[:, 36:], y[:, 12 * n + 12 :]
    for k in range(3):
        assert np.array_equal(own[:, 3 * k :][:, :3], every[:, 3 * (others * k + leg) :][:, :3])
    assert np.array_equal(own[:, 9:], every[:, 9 * others + 6 * leg :][:, :6])


def test_joints_that_do_not_exist(moved):
    skeleton, _, _ = moved
    with pytest.raises(InputError, match=r"features\.joints.*tail"):
        PoseFeatures(skeleton, dataclasses.replace(ROOTED, joints=("tail",)), toy.FPS)
