"""Sheets of cloth against statics, a pendulum, a slope: answers that need no simulator."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from benchmarks.garment.scenes.cloth import Cloth, Solver
from garmentnet.data.parameters import SimulationParameters
from helpers.cloth_scenes import ball, garment, sheet, slope, still

G = 9.81
FAR = ball(0.1, (0, -50, 0))


def solver(**changes):
    return Solver(**({"approach": 0, "settle": 0, "drag": 0.0} | changes))


def test_a_hanging_strip_stretches_as_statics_say():
    columns, rows, stiffness, density = 8, 11, 5.0, 0.2
    rest, faces = sheet(columns, rows, 0.025)
    length = -rest[-1, 1]
    strip = garment(rest, faces, range(columns))
    cloth = Cloth(FAR, strip, solver(stretch=stiffness, bending=1e-4, substeps=80, drag=6.0))
    parameters = SimulationParameters(bending=1.0, density=density)
    made = cloth.simulate(still(120).joints, 30.0, parameters)[-1]
    longer = -made[-columns:, 1].mean() - length
    # Between that of a strip that may contract and of one that may not; Poisson's ratio of a
    # lattice of equal springs is 1/3, Young's modulus 2 / √3 of their stiffness.
    free = density * G * length**2 / 2 / (2 / math.sqrt(3) * stiffness)
    assert (1 - 1 / 9) * free < longer < free
    # The springs' equilibrium, found by minimising their energy.
    edges = strip.edges()
    lengths = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    a, b, c = rest[faces].swapaxes(0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    weight = G * density * np.bincount(faces.ravel(), np.repeat(area / 3, 3))

    def energy(x):
        p = rest.copy()
        p[columns:] = x.reshape(-1, 3)
        d = p[edges[:, 0]] - p[edges[:, 1]]
        now = np.linalg.norm(d, axis=1)
        pull = (stiffness * (now - lengths) / now)[:, None] * d
        slope_ = np.zeros_like(p)
        np.add.at(slope_, edges[:, 0], pull)
        np.add.at(slope_, edges[:, 1], -pull)
        slope_[:, 1] += weight
        value = stiffness / 2 * ((now - lengths) ** 2).sum() + weight @ p[:, 1]
        return value, slope_[columns:].ravel()

    best = minimize(energy, rest[columns:].ravel(), jac=True, method="L-BFGS-B", tol=1e-14)
    true = -best.x.reshape(-1, 3)[-columns:, 1].mean() - length
    assert longer == pytest.approx(true, rel=0.03)


def test_a_stiff_sheet_swings_like_a_compound_pendulum():
    columns, fps, frames = 6, 60.0, 240
    rest, faces = sheet(columns, 24, 0.05)
    turned = rest @ Rotation.from_euler("x", 0.1).as_matrix().T
    sheet_ = garment(turned, faces, range(columns))
    cloth = Cloth(FAR, sheet_, solver(bending=50.0, bending_damping=0.0))
    made = cloth.simulate(still(frames).joints, fps, SimulationParameters())
    z = made[:, -columns:, 2].mean(axis=1)
    k = np.flatnonzero((z[:-1] < 0) != (z[1:] < 0))
    crossings = (k - z[k] / (z[k + 1] - z[k])) / fps
    period = np.diff(crossings[::2]).mean()
    a, b, c = rest[faces].swapaxes(0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    mass = np.bincount(faces.ravel(), np.repeat(area, 3))
    moment = (mass * rest[:, 1] ** 2).sum() / (mass * -rest[:, 1]).sum()
    assert period == pytest.approx(2 * math.pi * math.sqrt(moment / G), rel=0.02)
    # Without drag and damping the swing keeps its height.
    assert np.abs(z[-120:]).max() > 0.97 * np.abs(z[:120]).max()


def test_a_draped_square_converges_with_the_step():
    rest, faces = sheet(14, 16, 0.025)
    flat = np.stack([rest[:, 0], 0 * rest[:, 0] + 0.161, rest[:, 1] - rest[:, 1].mean()], axis=1)
    square = garment(flat, faces[:, ::-1].copy())
    made = {}
    for substeps in (20, 40, 80):
        how = solver(
            substeps=substeps,
            stretch=10.0,
            friction=0.3,
            bending=1e-3,
            bending_damping=0.0,
            drag=5.0,
        )
        made[substeps] = Cloth(ball(0.15, (0, 0, 0)), square, how).simulate(
            still(150).joints, 30.0, SimulationParameters(bending=1.0)
        )[-2:]
    coarse, fine = (
        1e3 * np.sqrt(((made[2 * s][1] - made[s][1]) ** 2).sum(axis=1).mean()) for s in (20, 40)
    )
    assert fine < 1.2
    assert coarse > 2.5 * fine
    assert 1e3 * np.linalg.norm(made[40][1] - made[40][0], axis=1).max() < 0.05
    assert np.linalg.norm(made[40][1], axis=1).min() > 0.159


@pytest.mark.parametrize("degrees", [20, 25, 28, 35])
def test_friction_on_a_slope(degrees):
    """Cloth sticks below atan μ and slides above it with the acceleration of a block."""
    rest, faces = sheet(8, 8, 0.03)
    body, turn = slope(degrees)
    flat = np.stack([rest[:, 0], 0 * rest[:, 0] + 0.01, -rest[:, 1]], axis=1)
    cloth = Cloth(body, garment((flat - [0, 0, 0.1]) @ turn.T, faces), solver(friction=0.5))
    made = cloth.simulate(still(31).joints, 30.0, SimulationParameters())
    angle = math.radians(degrees)
    pull = max(0.0, math.sin(angle) - 0.5 * math.cos(angle))
    way = ((made[-1] - made[0]) @ turn[:, 0]).mean()
    assert way == pytest.approx(G / 2 * pull, abs=1e-3)
    np.testing.assert_allclose(made[-1] @ turn[:, 1], 0.01, atol=1e-4)


def test_free_fall_with_drag_and_slow_time():
    rest, faces = sheet(4, 4, 0.05)
    drag, density, scale = 2.0, 0.1, 0.7
    cloth = Cloth(FAR, garment(rest, faces), solver(drag=drag))
    parameters = SimulationParameters(density=density, time_scale=scale)
    made = cloth.simulate(still(31).joints, 30.0, parameters)
    rate, time = drag * 0.2 / density, scale * 1.0
    fallen = G / rate * (time - (1 - math.exp(-rate * time)) / rate)
    assert (made[0] - made[-1])[:, 1].mean() == pytest.approx(fallen, rel=0.01)
