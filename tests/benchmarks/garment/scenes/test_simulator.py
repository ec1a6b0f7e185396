"""Clips of a dancing body: the same bits, cloth outside the body, a gate that rejects."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from benchmarks.garment.scenes.body import default_body
from benchmarks.garment.scenes.cloth import Cloth, Solver
from benchmarks.garment.scenes.cut import Cut, cut_garment
from benchmarks.garment.scenes.dance.choreography import dance
from benchmarks.garment.scenes.motion import Motion
from benchmarks.garment.scenes.simulator import outfit_of, perturbation_field, pins_of, simulate
from garmentnet.data.parameters import SimulationParameters
from garmentnet.importing.quality import LIMITS, judge
from helpers.cloth_scenes import still
from ssdr.model.skinning import skin

BODY = default_body()
DRESS = cut_garment(BODY, Cut(vertices=400))
QUICK = Solver(substeps=20, approach=3, settle=4)
CLOTH = Cloth(BODY, DRESS, QUICK)
BASE = SimulationParameters()


@pytest.fixture(scope="module")
def spin() -> Motion:
    return dance(BODY.skeleton, seed=2, frames=12, classes=["spin"])


def test_the_same_bits_whatever_the_threads(spin: Motion) -> None:
    one = simulate(CLOTH, spin, BASE, seed=3, perturbation=1e-3)
    assert one.quality["accepted"], one.quality["reason"]
    with ThreadPoolExecutor(2) as pool:
        for other in pool.map(
            lambda _: simulate(Cloth(BODY, DRESS, QUICK), spin, BASE, seed=3, perturbation=1e-3),
            range(2),
        ):
            np.testing.assert_array_equal(one.vertices, other.vertices)
            assert one.quality == other.quality


def test_pins_follow_the_body_and_the_rest_moves(spin: Motion) -> None:
    made = simulate(CLOTH, spin, BASE).vertices
    p = DRESS.pinned
    joints = spin.joints.astype(np.float32)
    held = skin(DRESS.rest[p], DRESS.indices[p], DRESS.weights[p], joints)
    np.testing.assert_allclose(made[:, p], held, atol=1e-5)
    # Relative to the pelvis the hem moves: not frozen.
    root = spin.joints[:, 0]
    local = np.einsum("fba,fvb->fva", root[:, :, :3], made - root[:, None, :, 3])
    assert np.ptp(local[:, ~p], axis=0).max() > 0.05


@pytest.mark.parametrize("change", [{"bending": 2.0}, {"density": 0.1}, {"time_scale": 1.3}])
def test_parameters_matter(spin: Motion, change: dict[str, float]) -> None:
    base, other = (simulate(CLOTH, spin, SimulationParameters(**c)) for c in ({}, change))
    assert np.linalg.norm(other.vertices - base.vertices, axis=2).max() > 2e-3


def test_cloth_hangs_and_comes_to_rest() -> None:
    cloth = Cloth(BODY, DRESS, Solver(approach=0, settle=90))
    made = simulate(cloth, still(30, BODY.skeleton.n_joints), BASE)
    q = made.quality
    assert q["accepted"], q["reason"]
    assert q["inside_fraction"] == 0
    assert q["stretch_p99"] < 1.1
    # Gravity pulls the flared skirt together.
    hem = DRESS.rest[:, 1] < DRESS.rest[:, 1].min() + 1e-4
    spread = np.linalg.norm(made.vertices[-1, hem][:, [0, 2]], axis=1).mean()
    assert spread < 0.9 * np.linalg.norm(DRESS.rest[hem][:, [0, 2]], axis=1).mean()
    step = np.diff(made.vertices[-10:], axis=0)
    assert 1e3 * np.sqrt((step**2).sum(axis=-1).mean()) <= 0.05  # mm a frame


def test_place_and_heading_do_not_matter() -> None:
    motion = dance(BODY.skeleton, seed=3, frames=4, classes=["sway"])
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    joints = turn @ motion.joints
    joints[..., 3] += [2.0, 0.0, -1.0]
    moved = Motion(joints, motion.classes)
    a, b = (simulate(CLOTH, m, BASE).vertices for m in (motion, moved))
    np.testing.assert_allclose(b, a @ turn.T.astype(np.float32) + [2, 0, -1], atol=5e-3)


def test_perturbation_has_its_size_and_is_smooth() -> None:
    by = perturbation_field(DRESS, 1e-3, 1)
    free = ~DRESS.pinned
    assert np.sqrt((by[free] ** 2).sum(axis=1).mean()) == pytest.approx(1e-3, rel=1e-5)
    assert not by[DRESS.pinned].any()
    e = DRESS.edges()
    assert np.linalg.norm(by[e[:, 0]] - by[e[:, 1]], axis=1).mean() < 6e-4
    motion = still(2, BODY.skeleton.n_joints)
    a, b = (simulate(CLOTH, motion, BASE, perturbation=p) for p in (0.0, 1e-3))
    apart = np.linalg.norm(a.vertices - b.vertices, axis=2)
    assert 1e-5 < apart.max() < 2e-2


def test_the_gate_says_why(spin: Motion) -> None:
    made, outfit = simulate(CLOTH, spin, BASE).vertices, outfit_of(BODY, DRESS, 30.0)
    free = np.flatnonzero(~DRESS.pinned)

    def reasons(v: np.ndarray, **limits: float) -> set[str]:
        found = judge(outfit, spin.joints, v, bound=pins_of(DRESS), limits=LIMITS | limits)
        assert found["accepted"] == (not found["reason"])
        return {part.split()[0] for part in found["reason"].split("; ") if part}

    assert reasons(made) == set()
    assert reasons(made, stretch_p99=1.0, speed_max=0.0) == {"stretch_p99", "speed_max"}
    broken = made.copy()
    broken[5:, 0] = np.nan
    assert judge(outfit, spin.joints, broken)["reason"] == "NaN from frame 5 on"
    # One vertex is pulled 20 cm away, for all of the clip, which is shorter than a second.
    caught = made.copy()
    caught[:, free[-1]] += np.float32([0.0, -0.2, 0.0])
    assert "stretch_held" in reasons(caught)
    once = made.copy()
    once[3, free[-1]] += np.float32([0.0, -0.05, 0.0])
    assert "stretch_held" not in reasons(once)
    away = made + np.float32([0.0, 0.0, 0.6])
    assert "pins_off" in reasons(away)
    # Cloth drawn to the middle of the body crosses it.
    middle = made[:, DRESS.pinned].mean(axis=1, keepdims=True) * [1, 0, 1]
    narrow = made.copy()
    narrow[:, free] = (0.3 * (made - middle) + middle * [1, 0, 1] + made * [0, 0.7, 0])[:, free]
    assert {"crossed", "inside_fraction"} <= reasons(narrow)


def test_a_hem_that_stays_folded_is_refused_where_the_garment_hangs() -> None:
    joints, limits = still(120, BODY.skeleton.n_joints).joints, LIMITS | {"folded": 100}
    outfit = outfit_of(BODY, DRESS, 30.0)
    worn = np.repeat(DRESS.rest[None], 120, axis=0)
    low = np.quantile(DRESS.rest[:, 1], 0.2)
    corner = (DRESS.rest[:, 1] < low) & (DRESS.rest[:, 0] > 0)
    for frames, most in ((0, 1.0), (75, 1.0), (110, 180.0)):
        v = worn.copy()
        v[:frames, corner, 1] = 2 * low - v[:frames, corner, 1]  # turned up
        found = judge(outfit, joints, v, limits=limits)
        assert most - 70 < found["folded"] <= most
        assert ("folded" in found["reason"]) == (most > 100)
        assert "folded" not in judge(outfit, joints, v)["reason"]  # sleeves fold at rest, too


def test_cloth_that_explodes_is_rejected(spin: Motion) -> None:
    cloth = Cloth(BODY, DRESS, dataclasses.replace(QUICK, substeps=1, blocks=1))
    made = simulate(cloth, spin, BASE)
    assert not made.quality["accepted"]
    assert made.quality["reason"]
