"""The simulator: the same bits twice, cloth that hangs, a gate that rejects, runs that resume."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip("zarr")
pytest.importorskip("newton")

from garmentnet.data.motion import Motion
from garmentnet.data.parameters import SimulationParameters
from garmentnet.scenes.body import default_body
from garmentnet.scenes.cloth import Solver
from garmentnet.scenes.dance.choreography import dance
from garmentnet.scenes.garments import Dress, cut_dress
from garmentnet.scenes.quality import Depth, Gate, judge
from garmentnet.scenes.simulator import _unrest, simulate
from ssdr.errors import InputError
from ssdr.skinning import skin

# Warnings of the simulator's own modules are its authors' to mend.
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning"),
]


BODY = default_body()
DRESS = cut_dress(BODY, Dress(vertices=400))
QUICK = Solver(substeps=20, approach=3, settle=4)


def still(frames: int) -> Motion:
    joints = np.broadcast_to(np.eye(3, 4), (frames, BODY.skeleton.n_joints, 3, 4))
    return Motion(joints, np.zeros(frames, dtype=np.int8))


@pytest.fixture(scope="module")
def spin() -> Motion:
    return dance(BODY.skeleton, seed=2, frames=12, classes=["spin"])


def test_the_same_bits_twice(spin: Motion) -> None:
    a, b = (simulate(BODY, DRESS, spin, SimulationParameters(), solver=QUICK) for _ in range(2))
    np.testing.assert_array_equal(a.vertices, b.vertices)
    assert a.quality == b.quality
    assert a.quality.accepted, a.quality.reason


def test_pins_follow_the_body_and_the_rest_moves(spin: Motion) -> None:
    made = simulate(BODY, DRESS, spin, SimulationParameters(), solver=QUICK).vertices
    p = DRESS.pinned
    joints = spin.joints.astype(np.float32)
    held = skin(DRESS.rest[p], DRESS.indices[p], DRESS.weights[p], joints)
    np.testing.assert_allclose(made[:, p], held, atol=1e-5)
    # Relative to the pelvis the hem moves: not frozen.
    root = spin.joints[:, 0]
    local = np.einsum("fba,fvb->fva", root[:, :, :3], made - root[:, None, :, 3])
    assert np.ptp(local[:, ~p], axis=0).max() > 0.05


def test_parameters_matter(spin: Motion) -> None:
    def run(**changes: float) -> np.ndarray:
        parameters = SimulationParameters(**changes)
        return simulate(BODY, DRESS, spin, parameters, solver=QUICK).vertices

    base = run()
    for changes in ({"bending": 2.0}, {"density": 0.1}, {"time_scale": 1.3}):
        assert np.linalg.norm(run(**changes) - base, axis=2).max() > 2e-3


def test_cloth_hangs_and_stays_off_the_skin() -> None:
    solver = Solver(substeps=20, approach=0, settle=30)
    made = simulate(BODY, DRESS, still(3), SimulationParameters(), solver=solver)
    q = made.quality
    assert q.accepted, q.reason
    assert q.inside_fraction < 0.005
    assert 0.98 < q.stretch_p50 < 1.02
    # Gravity pulls the flared skirt together.
    hem = DRESS.rest[:, 1] < DRESS.rest[:, 1].min() + 1e-4
    spread = np.linalg.norm(made.vertices[-1, hem][:, [0, 2]], axis=1).mean()
    assert spread < 0.9 * np.linalg.norm(DRESS.rest[hem][:, [0, 2]], axis=1).mean()
    # All but at rest after a second.
    assert np.linalg.norm(made.vertices[-1] - made.vertices[-2], axis=1).mean() < 4e-3


def test_place_and_heading_do_not_matter() -> None:
    motion = dance(BODY.skeleton, seed=3, frames=4, classes=["sway"])
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    joints = turn @ motion.joints
    joints[..., 3] += [2.0, 0.0, -1.0]
    moved = Motion(joints, motion.classes)
    a = simulate(BODY, DRESS, motion, SimulationParameters(), solver=QUICK).vertices
    b = simulate(BODY, DRESS, moved, SimulationParameters(), solver=QUICK).vertices
    np.testing.assert_allclose(b, a @ turn.T.astype(np.float32) + [2, 0, -1], atol=5e-3)


def test_perturbation_has_its_size_and_is_smooth() -> None:
    by = _unrest(DRESS, 1e-3, 1)
    free = ~DRESS.pinned
    assert np.sqrt((by[free] ** 2).sum(axis=1).mean()) == pytest.approx(1e-3, rel=1e-5)
    assert not by[DRESS.pinned].any()
    e = DRESS.edges()
    assert np.linalg.norm(by[e[:, 0]] - by[e[:, 1]], axis=1).mean() < 6e-4
    np.testing.assert_array_equal(by, _unrest(DRESS, 1e-3, 1))
    a, b = (
        simulate(BODY, DRESS, still(2), SimulationParameters(), solver=QUICK, perturbation=p)
        for p in (0.0, 1e-3)
    )
    apart = np.linalg.norm(a.vertices - b.vertices, axis=2)
    assert 1e-5 < apart.max() < 2e-2


def test_depth_is_that_of_a_sphere(rng: np.random.Generator) -> None:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    points = ball.vertices.astype(np.float32)
    measure = Depth(points, ball.faces.astype(np.int32))
    at = rng.normal(size=(200, 3)).astype(np.float32) * 0.4
    for shift in (0.0, 1.0):
        depth = measure(points + np.float32(shift), at + np.float32(shift))
        np.testing.assert_allclose(depth, 0.5 - np.linalg.norm(at, axis=1), atol=2e-3)


def test_depth_has_the_sign_of_the_winding_number(rng: np.random.Generator) -> None:
    # A dancing body, whose limbs overlap, and points all about and within it.
    rig = BODY.skinning
    pose = dance(BODY.skeleton, seed=2000, frames=120).joints[102].astype(np.float32)
    skin_ = skin(rig.rest, rig.indices, rig.weights, pose)
    pick = rng.integers(0, len(skin_), (2, 300))
    at = (skin_[pick[0]] + skin_[pick[1]]) / 2
    a, b, c = (skin_[rig.faces[:, k]][None].astype(float) - at[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    above = (a * np.cross(b, c)).sum(axis=-1)
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    number = (2 * np.arctan2(above, below)).sum(axis=1) / (4 * np.pi)
    depth = Depth(rig.rest, rig.faces)(skin_, at)
    clear = np.abs(depth) > 1e-4
    assert (number > 0.5).sum() > 30
    np.testing.assert_array_equal((depth > 0)[clear], (number > 0.5)[clear])


def test_the_gate_says_why(spin: Motion) -> None:
    made = simulate(BODY, DRESS, spin, SimulationParameters(), solver=QUICK).vertices
    strict = judge(BODY, DRESS, spin, made, Gate(stretch_p99=1.0, speed=0.0))
    assert not strict.accepted
    assert "stretch_p99" in strict.reason
    assert "speed" in strict.reason
    broken = made.copy()
    broken[5:, 0] = np.nan
    assert judge(BODY, DRESS, spin, broken).reason == "NaN from frame 5 on"
    # A vertex held at the pelvis is inside the body.
    broken = made.copy()
    free = int(np.flatnonzero(~DRESS.pinned)[0])
    broken[:, free] = BODY.skeleton.positions(spin.joints)[:, 0]
    found = judge(BODY, DRESS, spin, broken)
    assert not found.accepted
    assert found.depth_max > 0.05
    assert found.inside_fraction >= 1 / DRESS.n_vertices


def test_exploding_cloth_is_rejected(spin: Motion) -> None:
    wild = dataclasses.replace(QUICK, substeps=1, stretch=1e8, contact=1e8)
    made = simulate(BODY, DRESS, spin, SimulationParameters(bending=1e7), solver=wild)
    assert not made.quality.accepted
    assert made.quality.reason


@pytest.mark.parametrize("change", [{"substeps": 0}, {"friction": -1.0}, {"drag": np.nan}])
def test_solver_refuses(change: dict[str, float]) -> None:
    with pytest.raises(InputError):
        Solver(**change)  # type: ignore[arg-type]


def test_motion_of_another_skeleton() -> None:
    other = Motion(np.broadcast_to(np.eye(3, 4), (2, 3, 3, 4)), np.zeros(2, dtype=np.int8))
    with pytest.raises(InputError, match="20 joints"):
        simulate(BODY, DRESS, other, SimulationParameters())
