# ruff: noqa: E402
import copy

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import toy_store as toy

import ssdr
from garmentnet.data.parameters import SimulationParameters
from garmentnet.networks.checkpoint import Checkpoint
from garmentnet.networks.ensemble import Kernel
from garmentnet.prediction.motion_file import read_joints
from garmentnet.prediction.output import save_prediction
from garmentnet.prediction.prediction import predict, trained_range
from ssdr.errors import FormatError, InputError, SsdrWarning


@pytest.fixture(scope="module")
def pair(toy_network):
    network = toy_network.networks[0]
    other = copy.deepcopy(network)
    with torch.no_grad():
        other.low.out.bias.add_(0.2)
    stiff = SimulationParameters(bending=2.0)
    return Checkpoint((network, other), (toy.BASE, stiff), Kernel())


@pytest.fixture(scope="module")
def joints(toy_store):
    return toy_store.clip("base-test-0").joints[:12]


def test_a_single_network(toy_network, joints, toy_store):
    p = predict(toy_network, joints)
    assert np.array_equal(p.cloth.vertices, toy_network.predict(joints))
    assert np.abs(p.body.vertices - toy_store.clip("base-test-0").body(slice(0, 12))).max() < 1e-5
    assert p.extrapolated == ()
    assert predict(toy_network, joints, toy.BASE).extrapolated == ()
    with pytest.raises(InputError, match="single network"):
        predict(toy_network, joints, SimulationParameters(bending=1.0))


def test_nan_poses(toy_network, joints):
    broken = joints.copy()
    broken[2] = np.nan
    with pytest.raises(InputError, match="frame 2"):
        predict(toy_network, broken)


def test_extrapolation_is_stated(pair, joints):
    assert trained_range(pair)["bending"] == (0.5, 2.0)
    assert predict(pair, joints, SimulationParameters(bending=1.0)).extrapolated == ()
    with pytest.warns(SsdrWarning, match=r"bending 3, trained from 0\.5 to 2"):
        p = predict(pair, joints, SimulationParameters(bending=3.0))
    assert len(p.extrapolated) == 1
    with pytest.raises(InputError, match="parameters"):
        predict(pair, joints)


def test_skinning_is_the_low_part(pair, joints):
    p = predict(pair, joints, SimulationParameters(bending=1.0), detail=False)
    assert np.abs(p.skinning.skin() - p.cloth.vertices).max() < 1e-5


@pytest.mark.parametrize("suffix", ["npz", "pc2", "obj"])
def test_vertices_survive(toy_network, joints, tmp_path, suffix):
    p = predict(toy_network, joints)
    path = tmp_path / ("cloth%04d.obj" if suffix == "obj" else f"cloth.{suffix}")
    save_prediction(p, path)
    read = ssdr.load(path, **({"mesh": p.cloth.faces} if suffix == "pc2" else {}))
    assert np.abs(np.asarray(read.vertices) - p.cloth.vertices).max() < 1e-5


@pytest.mark.parametrize("kind", ["toy_network", "pair"])
def test_glb_holds_rigid_bones(kind, request, joints, tmp_path):
    checkpoint = request.getfixturevalue(kind)
    parameters = SimulationParameters(bending=1.0) if kind == "pair" else None
    p = predict(checkpoint, joints, parameters)
    text = save_prediction(p, tmp_path / "cloth.glb")
    read = ssdr.load_skinning(tmp_path / "cloth.glb")
    assert "virtual bones" in text
    low = np.concatenate([m.to_world(m.low) for m in checkpoint.motions(joints, parameters)])
    gap = float(np.sqrt(((read.skin() - low) ** 2).sum(-1).mean()))
    # The mixture of two networks is not rigid; what comes close is written.
    assert gap < (1e-4 if kind == "toy_network" else 2e-2)


def test_usd(toy_network, joints, tmp_path):
    pytest.importorskip("pxr")
    p = predict(toy_network, joints)
    save_prediction(p, tmp_path / "cloth.usda")
    read = ssdr.load(tmp_path / "cloth.usda")
    assert np.abs(np.asarray(read.vertices) - p.cloth.vertices).max() < 1e-5


def test_pictures_and_films(toy_network, joints, tmp_path):
    p = predict(toy_network, joints[:4])
    seen = []
    save_prediction(p, tmp_path / "a.png", frames=2)
    save_prediction(p, tmp_path / "a.gif", size=64, progress=seen.append)
    assert seen[-1] == 1
    from PIL import Image

    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 4


def test_mp4(toy_network, joints, tmp_path):
    av = pytest.importorskip("av")
    p = predict(toy_network, joints[:5])
    save_prediction(p, tmp_path / "a.mp4", size=97)
    with av.open(str(tmp_path / "a.mp4")) as film:
        frames = [f.to_ndarray(format="rgb24") for f in film.decode(video=0)]
    assert len(frames) == 5
    assert frames[0].shape == (96, 96, 3)
    assert frames[0].std() > 5


def test_the_camera_walks_along(toy_network, joints):
    p = predict(toy_network, joints)
    still = p.scene().vertices
    place = still[:, : p.body.n_vertices].mean(axis=1)
    assert np.abs(place[:, [0, 2]]).max() < 0.2
    assert p.scene().n_vertices == p.body.n_vertices + p.cloth.n_vertices


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


def test_motion_capture_of_another_skeleton(toy_network, tmp_path):
    # The toy has joints that no motion capture knows: said, not guessed.
    (tmp_path / "m.bvh").write_text(
        "HIERARCHY\nROOT Hips\n{\n OFFSET 0 0 0\n CHANNELS 6 Xposition Yposition Zposition "
        "Zrotation Yrotation Xrotation\n End Site\n {\n  OFFSET 0 1 0\n }\n}\nMOTION\n"
        "Frames: 2\nFrame Time: 0.0333333\n0 0 0 0 0 0\n0 0 0 0 0 0\n"
    )
    with pytest.raises((InputError, FormatError)):
        read_joints(tmp_path / "m.bvh", toy_network)
