"""The garments that ship: their topology, clear of the body, and sane when they are simulated."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from benchmarks.garment.scenes.body import default_body
from benchmarks.garment.scenes.cloth import Cloth, Solver
from benchmarks.garment.scenes.cut import Cut, cut_garment
from benchmarks.garment.scenes.dance.choreography import dance
from benchmarks.garment.scenes.scene_file import load_data_set
from benchmarks.garment.scenes.simulator import simulate
from garmentnet.collision.body_tree import BodyTree
from garmentnet.data.parameters import SimulationParameters
from garmentnet.importing.quality import LIMITS

BODY = default_body()
# Edges of the cloth with an opening behind them: neck, hem, sleeves, legs, waist.
OPENINGS = {
    "dress": 2,
    "gown": 4,
    "a_line": 2,
    "soft_dress": 2,
    "t_shirt": 4,
    "trousers": 3,
    "skirt": 2,
}


def cut_of(name: str, vertices: int = 2100) -> Cut:
    cut = load_data_set(name).garment
    assert isinstance(cut, Cut)
    return dataclasses.replace(cut, vertices=vertices)


@pytest.mark.parametrize(
    ("name", "vertices"),
    [*itertools.product(OPENINGS, (700, 2100)), ("plain", 300), ("plain", 1900), ("plain", 6000)],
)
def test_topology(name: str, vertices: int) -> None:
    plain = name == "plain"
    garment = cut_garment(BODY, Cut(vertices=vertices) if plain else cut_of(name, vertices))
    assert abs(garment.n_vertices - vertices) < 0.06 * vertices
    mesh = trimesh.Trimesh(garment.rest, garment.faces, process=False)
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert len(np.unique(garment.faces)) == garment.n_vertices
    pairs = np.sort(garment.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, count = np.unique(pairs, axis=0, return_counts=True)
    assert count.max() == 2
    border, at = np.unique(edges[count == 1], return_inverse=True)
    a, b = at.reshape(-1, 2).T
    assert (np.bincount(at.ravel()) == 2).all()
    loops = coo_array((np.ones(len(a)), (a, b)), (len(border), len(border)))
    openings = connected_components(loops, directed=False)[0]
    assert openings == OPENINGS.get(name, 2)
    # A sphere with so many holes.
    assert garment.n_vertices - len(edges) + len(garment.faces) == 2 - openings
    if plain:  # triangles as good as equilateral, and all of them face away from the body's axis
        corner = garment.rest.astype(float)[garment.faces]
        assert np.degrees(trimesh.triangles.angles(corner)).min() > 30
        length = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2)
        assert length.max() / length.min() < 2.2
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert ((corner.mean(axis=1) * [1, 0, 1] * normal).sum(axis=1) > 0).all()


@pytest.mark.parametrize("name", OPENINGS)
def test_shape_at_rest(name: str) -> None:
    garment = cut_garment(BODY, cut_of(name))
    corner = garment.rest[garment.faces].astype(float)
    length = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2)
    assert np.median(length) / 3 < length.min() < length.max() < 3 * np.median(length)
    rig = BODY.skinning
    distance = BodyTree(rig).signed_distance(garment.rest[None], rig.transforms, limit=0.1)[0]
    assert distance.min() > 0.003
    # Outward: a step along the normal leads away from the body.
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    middle = corner.mean(axis=1)
    near = np.linalg.norm(middle[:, None] - rig.rest[None], axis=2).argmin(axis=1)
    close = np.linalg.norm(middle - rig.rest[near], axis=1) < 0.03
    assert ((middle - rig.rest[near]) * normal).sum(axis=1)[close].mean() > 0.01
    assert garment.mirror is not None
    assert garment.sides is not None
    np.testing.assert_array_equal(garment.rest[garment.mirror] * [-1, 1, 1], garment.rest)
    np.testing.assert_array_equal(garment.sides[garment.mirror], -garment.sides)
    assert (garment.sides != 0).any() == (name in ("gown", "t_shirt", "trousers"))
    assert (garment.sides * garment.rest[:, 0] >= 0).all()
    assert 0 < garment.pinned.mean() < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("name", OPENINGS)
def test_stays_on_in_a_spin_and_a_jump(name: str) -> None:
    garment = cut_garment(BODY, cut_of(name, 700))
    cloth = Cloth(BODY, garment, Solver(substeps=20, approach=6, settle=8))
    motion = dance(BODY.skeleton, seed=3, frames=30, classes=("spin", "jump"))
    limits = LIMITS | load_data_set(name).gate
    found = simulate(cloth, motion, SimulationParameters(), limits=limits)
    assert found.quality["accepted"], found.quality["reason"]
    assert found.quality["stretch_p99"] < 1.35
    assert found.quality["inside_fraction"] < 0.01
    # What is worn does not slip down the body: its middle keeps its height over the root.
    root = BODY.skeleton.positions(motion.joints)[:, 0, 1]
    fall = (found.vertices[..., 1].mean(axis=1) - root) - (
        garment.rest[:, 1].mean() - BODY.skeleton.rest[0, 1]
    )
    assert np.abs(fall).max() < 0.12


def test_a_trouser_leg_stays_on_its_leg_where_legs_cross() -> None:
    garment = cut_garment(BODY, cut_of("trousers", 700))
    assert garment.sides is not None
    # The legs swing through each other and back.
    count, skeleton = 41, BODY.skeleton
    angle = 0.6 * np.sin(np.linspace(0, np.pi, count))
    joints = np.tile(np.eye(3, 4), (count, skeleton.n_joints, 1, 1))
    for side, sign in (("l", -1.0), ("r", 1.0)):
        hip = skeleton.rest[skeleton.names.index(f"thigh_{side}")]
        turn = Rotation.from_euler("z", sign * angle[:, None]).as_matrix()
        for name in ("thigh", "shin", "foot"):
            j = skeleton.names.index(f"{name}_{side}")
            joints[:, j] = np.concatenate([turn, (hip - turn @ hip)[..., None]], axis=2)
    skin = BODY.skinning.rest
    skin = skin[(skin[:, 0] > 0) & (skin[:, 1] < 0.8)]

    def off(sides: np.ndarray | None) -> float:
        """How far from the left leg its cloth is in the end, metres."""
        worn = dataclasses.replace(garment, sides=sides)
        cloth = Cloth(BODY, worn, Solver(substeps=20, approach=0, settle=5))
        end = cloth.simulate(joints, 30.0, SimulationParameters())[-1]
        leg = end[garment.sides == 1]
        return float(np.linalg.norm(leg[:, None] - skin[None], axis=2).min(axis=1).max())

    assert off(garment.sides) < 0.08
    assert off(None) > 0.09
