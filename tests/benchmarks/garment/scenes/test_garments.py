"""The dress and garments of files: sound meshes, exact symmetry, bodies of any build."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import ssdr
from benchmarks.garment.scenes.body import Body, default_body
from benchmarks.garment.scenes.cut import Cut, cut_garment
from benchmarks.garment.scenes.garments import garment_from_mesh, mirror_permutation
from garmentnet.collision.body_tree import BodyTree
from ssdr.common.errors import InputError

BODY = default_body()


def test_mirror_is_exact() -> None:
    dress = cut_garment(BODY)
    assert dress.mirror is not None
    turned = np.sort(np.sort(dress.mirror[dress.faces], axis=1).view("i4,i4,i4"), axis=0)
    own = np.sort(np.sort(dress.faces, axis=1).view("i4,i4,i4"), axis=0)
    np.testing.assert_array_equal(turned, own)
    np.testing.assert_array_equal(dress.pinned[dress.mirror], dress.pinned)
    weights = np.zeros((dress.n_vertices, BODY.skeleton.n_joints))
    np.add.at(weights, (np.arange(dress.n_vertices)[:, None], dress.indices), dress.weights)
    np.testing.assert_allclose(weights[dress.mirror][:, BODY.skeleton.mirror()], weights, atol=1e-6)
    np.testing.assert_array_equal(mirror_permutation(dress.rest, dress.faces), dress.mirror)


def test_no_mirror_where_there_is_none() -> None:
    dress = cut_garment(BODY, Cut(vertices=300))
    bent = dress.rest.copy()
    bent[3, 1] += 0.01
    assert mirror_permutation(bent, dress.faces) is None
    assert mirror_permutation(dress.rest, dress.faces[1:]) is None


def test_pleats_and_flare() -> None:
    plain = cut_garment(BODY, Cut(pleats=0, pleat_depth=0.0))
    hem = plain.rest[plain.rest[:, 1] < plain.rest[:, 1].min() + 1e-6]
    waist_height, height = Cut().waist * BODY.height(), BODY.height()
    ring = plain.rest[np.abs(plain.rest[:, 1] - waist_height) < 1e-4]
    grown = np.ptp(hem[:, 0]) / 2 - np.ptp(ring[:, 0]) / 2
    drop = (Cut().waist - Cut().hem) * height
    assert grown == pytest.approx(Cut().flare * drop, rel=0.01)
    pleated = cut_garment(BODY)
    hem = pleated.rest[pleated.rest[:, 1] < pleated.rest[:, 1].min() + 1e-6]
    centre = np.array([0, 0, (hem[:, 2].max() + hem[:, 2].min()) / 2])
    radius = np.linalg.norm(hem - centre * [1, 0, 1] - [0, hem[0, 1], 0], axis=1)
    order = np.argsort(np.arctan2(hem[:, 0], hem[:, 2] - centre[2]))
    wave = (
        radius[order]
        - np.convolve(np.tile(radius[order], 3), np.ones(11) / 11, "same")[len(hem) : 2 * len(hem)]
    )
    assert ((wave > 0) & (np.roll(wave, 1) <= 0)).sum() == 8


def test_garment_from_a_file(tmp_path: Path) -> None:
    dress = cut_garment(BODY, Cut(vertices=300))
    ssdr.save(ssdr.MeshSequence(dress.rest[None], dress.faces), tmp_path / "d.npz")
    level = Cut().waist * BODY.height() - 1e-6
    read = garment_from_mesh(BODY, tmp_path / "d.npz", pinned_above=level)
    np.testing.assert_array_equal(read.rest, dress.rest)
    np.testing.assert_array_equal(read.pinned, dress.pinned)
    np.testing.assert_array_equal(read.mirror, dress.mirror)
    np.testing.assert_allclose(read.weights, dress.weights, atol=1e-6)
    for level in (0.0, 9.0):
        with pytest.raises(InputError, match="pinned_above"):
            garment_from_mesh(BODY, tmp_path / "d.npz", pinned_above=level)


def test_bodies_of_other_builds_can_be_dressed() -> None:
    wide = BODY.skinning.rest * np.array([1.2, 1.05, 1.15], dtype=np.float32)
    rig = dataclasses.replace(BODY.skinning, rest=wide)
    tree = BODY.skeleton
    other = Body(rig, type(tree)(tree.names, tree.parents, tree.rest * [1.2, 1.05, 1.15]))
    dress = cut_garment(other, Cut(vertices=500))
    skirt = dress.rest[None, ~dress.pinned]
    assert BodyTree(rig).signed_distance(skirt, rig.transforms).min() > 0
