"""Files of predictions."""

# ruff: noqa: E402

import numpy as np
import pytest

torch = pytest.importorskip("torch")


import ssdr
from garmentnet.data.parameters import SimulationParameters
from garmentnet.prediction.output import save_prediction
from garmentnet.prediction.prediction import predict


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
