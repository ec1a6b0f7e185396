"""The exported graph, run by onnxruntime, beside the runtime."""

# ruff: noqa: E402

import json

import numpy as np
import pytest

pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")
ort = pytest.importorskip("onnxruntime")

from garmentnet.cli import main
from garmentnet.data.parameters import SimulationParameters as P
from garmentnet.networks.checkpoint import Checkpoint, save_checkpoint
from garmentnet.runtime import load_live
from garmentnet.runtime.onnx_file import export_onnx
from helpers import live_garment as made
from ssdr.common.errors import InputError


def checkpoint(network, folder):
    parameters = None if network.condition else P()
    return save_checkpoint(Checkpoint((network,), (parameters,), None), folder / "one.safetensors")


def run(path, joints, theta=None):
    """Vertices (F, V, 3) of a model of which only its own metadata and shapes are known."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    feed = {i.name: np.full(i.shape, 7, np.float32) for i in session.get_inputs()}
    names, frames = [o.name for o in session.get_outputs()], []
    feed["reset"][:] = 1
    if theta is not None:
        feed["parameters"] = np.array([theta.bending, theta.density, theta.time_scale], np.float32)
    for pose in joints:
        feed["pose"] = pose.astype(np.float32)
        out = dict(zip(names, session.run(names, feed), strict=True))
        frames.append(out.pop("vertices"))
        feed |= {k.removesuffix("_out"): v for k, v in out.items()}
        feed["reset"] = np.zeros(1, np.float32)
    return np.stack(frames)


def play(garment, joints, theta=None):
    state, frames = None, []
    for pose in joints:
        state, vertices = garment.step(state, pose, theta)
        frames.append(vertices)
    return np.stack(frames)


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"bound": False, "condition": True},
        {"detail": False, "features": {"frame": "world", "translation": True}},
        {"high": {"source": "body"}, "condition": True, "features": {"joints": ("shin_l",)}},
        {"features": {"heading_free": False, "frame": "root", "clamp": 0.0}},
        {"low": {"relative_to": "joints"}},
        {"low": {"relative_to": "joints"}, "features": {"frame": "world"}, "bound": False},
    ],
    ids=str,
)
def test_onnxruntime_says_what_the_runtime_says(change, tmp_path):
    network = made.network(**change)
    garment, joints = load_live(checkpoint(network, tmp_path)), made.motion(3.0, seed=3)
    theta = P(bending=1.3, density=0.15) if network.condition else None
    path = export_onnx(garment, tmp_path / "dress.onnx")
    gap = np.abs(run(path, joints, theta) - play(garment, joints, theta))
    assert gap.max() < 1e-4


def test_it_does_not_drift(tmp_path):
    garment = load_live(checkpoint(made.network(vertices=40), tmp_path))
    joints = made.motion(10_000 / made.FPS, seed=4)
    path = export_onnx(garment, tmp_path / "dress.onnx")
    assert np.abs(run(path, joints) - play(garment, joints)).max() < 1e-4


def test_fewer_bits(tmp_path):
    size = {"low": {"hidden": 100}, "high": {"hidden": 64, "rank": 24}}
    garment = load_live(checkpoint(made.network(vertices=600, bones=20, **size), tmp_path))
    joints = made.motion(4.0, seed=3)
    expected = play(garment, joints)
    bytes_, errors = [], []
    for bits in (32, 16, 8):
        path = export_onnx(garment, tmp_path / f"{bits}.onnx", bits=bits)
        bytes_.append(path.stat().st_size)
        gap = np.linalg.norm(run(path, joints) - expected, axis=2)
        errors.append(float(np.sqrt((gap**2).mean())))
    assert errors[0] < 1e-5
    assert errors[1] < 3e-4
    assert errors[2] < 5e-3
    assert bytes_[1] < 0.65 * bytes_[0]
    assert bytes_[2] < 0.65 * bytes_[1]


def test_the_command_and_what_the_file_says_of_itself(tmp_path, capsys):
    network = made.network(condition=True)
    path, target = checkpoint(network, tmp_path), tmp_path / "dress.onnx"
    assert main(["export", str(path), "-o", str(target), "--bits", "16"]) == 0
    assert "16-bit" in capsys.readouterr().out
    model = onnx.load(target)
    onnx.checker.check_model(model, full_check=True)
    assert {n.domain for n in model.graph.node} == {""}  # standard operators alone
    said = json.loads({p.key: p.value for p in model.metadata_props}["garmentnet"])
    assert (said["fps"], said["joints"]) == (made.FPS, list(made.skeleton().names))
    assert said["faces"] == network.subject.garment.faces.tolist()
    assert list(said["parameters"]) == ["bending", "density", "time_scale"]
    assert main(["export", str(path), "-o", str(tmp_path / "dress.txt")]) == 2
    assert main(["export", str(path), "-o", str(target), "--bits", "4"]) == 2


def test_what_is_not_exported(tmp_path):
    network = made.network(features={"rotation": "vector"})
    with pytest.raises(InputError, match="sixd"):
        export_onnx(load_live(checkpoint(network, tmp_path)), tmp_path / "dress.onnx")
    assert not (tmp_path / "dress.onnx").exists()
