"""Motions from files."""

import dataclasses

import numpy as np
import pytest

import ssdr
from garmentnet.prediction.motion_file import read_motion
from ssdr.common.errors import FormatError, InputError


def test_motion_files(toy_network, toy_store, joints, tmp_path):
    np.savez(tmp_path / "m.npz", joints=joints)
    found, clip = read_motion(tmp_path / "m.npz", toy_network.subject)
    assert np.array_equal(found, joints)
    assert clip is None
    found, clip = read_motion(toy_store.clip("base-test-0").path, toy_network.subject)
    assert (len(found), clip.name) == (90, "base-test-0")
    np.savez(tmp_path / "few.npz", joints=joints[:, :2])
    np.savez(tmp_path / "none.npz", other=joints)
    np.savez(tmp_path / "fast.npz", joints=joints, fps=2 * toy_network.subject.fps)
    np.savez(tmp_path / "pickled.npz", joints=np.array([{}, 1], dtype=object))
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 no")
    for name in ("m.c3d", "m.glb"):
        (tmp_path / name).write_bytes(b"x")
    for name in ("few.npz", "none.npz", "fast.npz", "pickled.npz", "broken.npz", "m.c3d", "m.glb"):
        with pytest.raises(FormatError, match=name):
            read_motion(tmp_path / name, toy_network.subject)
    with pytest.raises(InputError, match="motion"):
        read_motion(tmp_path / "nothing.npz", toy_network.subject)


def test_the_motion_of_a_rig_with_the_same_joints(toy_network, joints, tmp_path):
    """Whatever the order of the joints, as glTF files have another."""
    subject = toy_network.subject
    tree = subject.skeleton
    fields = {"parents": tree.parents, "joint_positions": tree.rest, "fps": subject.fps}
    moving = dataclasses.replace(subject.body, transforms=joints, bone_names=tree.names, **fields)
    ssdr.save(moving, tmp_path / "m.glb")
    found, clip = read_motion(tmp_path / "m.glb", subject)
    np.testing.assert_allclose(found, joints, atol=1e-5)
    assert clip is None
    names = ("other", *tree.names[1:])
    ssdr.save(dataclasses.replace(moving, bone_names=names), tmp_path / "o.glb")
    with pytest.raises(InputError, match=r"motion: .*none such: .*root \(o\.glb\)"):
        read_motion(tmp_path / "o.glb", subject)
