"""Other frame rates, teleports and pauses."""

import numpy as np
import pytest

pytest.importorskip("torch")

from garmentnet.runtime import Player
from helpers import live_garment as made
from helpers.toy_store import random_pose
from ssdr.common.errors import InputError


@pytest.fixture(scope="module")
def garment(tmp_path_factory):
    return made.live(tmp_path_factory.mktemp("live"))


def play(garment, joints, fps):
    player = Player(garment, dt=1 / fps)
    return np.stack([player(pose) for pose in joints])


@pytest.mark.parametrize("times", [1, 2, 4])
def test_at_the_networks_frames_it_is_the_network(garment, times):
    fine = made.motion(4.0, seed=3, fps=times * made.FPS)
    got = play(garment, fine, times * made.FPS)
    expected = made.play(garment, fine[::times])
    assert np.abs(got[::times] - expected).max() < 1e-6


def test_between_them_it_follows_the_motion(garment):
    """A network of twice the rate in time, but for what it looks ahead, has no jumps."""
    fine = made.motion(4.0, seed=3, fps=240)
    steps = np.abs(np.diff(play(garment, fine, 240.0), axis=0)).max(axis=(1, 2))
    coarse = np.abs(np.diff(made.play(garment, fine[::8]), axis=0)).max(axis=(1, 2))
    assert steps.max() < 0.5 * coarse.max()


def test_slower_and_uneven_frames(garment):
    expected = made.play(garment, made.motion(6.0, seed=3))
    slow = play(garment, made.motion(6.0, seed=3, fps=24), 24.0)
    together = slow[::4] - expected[::5]  # every sixth of a second
    moved = np.abs(expected[5::5] - expected[:-5:5])
    assert np.sqrt((together**2).mean()) < 0.1 * np.sqrt((moved**2).mean())
    # Frames of 1/60 and 1/30 s in turn, at whose ends the network's frames lie.
    fine, player = made.motion(3.0, seed=3, fps=60), Player(garment)
    at, out = 0, {0: player(fine[0])}
    for k in (1, 1, 2) * 20:
        at += k
        out[at] = player(fine[at], dt=k / 60)
    worst = max(np.abs(v - expected[f // 2]).max() for f, v in out.items() if f % 2 == 0)
    assert worst < 1e-6


def test_teleports_and_pauses_start_anew(garment):
    joints = made.motion(2.0, seed=3, fps=60)
    there = joints.copy()
    there[..., 3] += [0.0, 0.0, 9.0]
    turn = np.diag([-1.0, 1.0, -1.0])
    about = turn @ joints
    new = Player(garment)(there[40])
    for other, options in ((there, {}), (about, {}), (joints, {"dt": 60.0})):
        player = Player(garment)
        for pose in joints[:40]:
            player(pose)
        got, fresh = player(other[40], **options), Player(garment)(other[40])
        assert np.array_equal(got, fresh)
        assert np.abs(player(other[41]) - got).max() < 0.3
    assert np.isfinite(new).all()


def test_a_body_that_stands_still_for_a_minute(garment):
    pose, player = made.motion(0.1)[0], Player(garment)
    frames = [player(pose) for _ in range(3600)]
    assert np.abs(frames[-1] - frames[-600]).max() < 1e-4


def test_unrelated_poses_do_not_blow_it_up(garment):
    rng, body, player = np.random.default_rng(0), made.skeleton(), Player(garment)
    for pose in random_pose(rng, body, 2000):
        v = player(pose)
        away = np.linalg.norm(v - body.positions(pose[None])[0, 0], axis=1)
        assert away.max() < 3.0


def test_what_is_refused_leaves_it_as_it_was(garment):
    joints = made.motion(1.0, seed=3, fps=60)
    one, other = Player(garment), Player(garment)
    for f, pose in enumerate(joints):
        if f == 20:
            with pytest.raises(InputError, match="finite"):
                one(np.full_like(pose, np.nan))
            with pytest.raises(InputError, match="dt"):
                one(pose, dt=-1.0)
        assert np.array_equal(one(pose), other(pose))
    with pytest.raises(InputError, match="fastest"):
        Player(garment, fastest=float("nan"))
