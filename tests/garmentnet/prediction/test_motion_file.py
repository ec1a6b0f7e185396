"""Motions from files."""

# ruff: noqa: E402

import numpy as np
import pytest

torch = pytest.importorskip("torch")


from garmentnet.prediction.motion_file import read_joints
from ssdr.errors import FormatError, InputError


def test_motion_files(toy_network, toy_store, joints, tmp_path):
    np.savez(tmp_path / "m.npz", joints=joints)
    assert np.array_equal(read_joints(tmp_path / "m.npz", toy_network), joints)
    clip = toy_store.path / "clips" / "base-test-0"
    assert len(read_joints(clip, toy_network)) == 90
    np.savez(tmp_path / "few.npz", joints=joints[:, :2])
    np.savez(tmp_path / "none.npz", other=joints)
    np.savez(tmp_path / "pickled.npz", joints=np.array([{}, 1], dtype=object))
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 no")
    (tmp_path / "m.fbx").write_bytes(b"x")
    for name in ("few.npz", "none.npz", "pickled.npz", "broken.npz", "m.fbx"):
        with pytest.raises(FormatError, match=name):
            read_joints(tmp_path / name, toy_network)
    with pytest.raises(InputError, match="motion"):
        read_joints(tmp_path / "nothing.bvh", toy_network)
