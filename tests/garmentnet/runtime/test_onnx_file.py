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
from garmentnet.runtime.onnx_file import export_onnx
from helpers import live_garment as made
from ssdr.common.errors import InputError


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


APART = {"low": {"relative_to": "joints"}, "features": {"frame": "world"}, "bound": False}


@pytest.mark.parametrize("change", [*made.CHANGES, APART], ids=str)
def test_onnxruntime_says_what_the_runtime_says(change, tmp_path):
    garment, joints = made.live(tmp_path, **change), made.motion(3.0, seed=3)
    theta = P(bending=1.3, density=0.15) if garment.reads_parameters else None
    path = tmp_path / "dress.onnx"
    if change.get("features", {}).get("rotation") == "vector":
        with pytest.raises(InputError, match="sixd"):
            export_onnx(garment, path)
        assert not path.exists()
        return
    gap = run(export_onnx(garment, path), joints, theta) - made.play(garment, joints, theta)
    assert np.abs(gap).max() < 1e-4


def test_it_does_not_drift(tmp_path):
    garment = made.live(tmp_path, vertices=40)
    joints = made.motion(10_000 / made.FPS, seed=4)
    path = export_onnx(garment, tmp_path / "dress.onnx")
    assert np.abs(run(path, joints) - made.play(garment, joints)).max() < 1e-4


def test_fewer_bits(tmp_path):
    size = {"low": {"hidden": 100}, "high": {"hidden": 64, "rank": 24}}
    garment = made.live(tmp_path, vertices=600, bones=20, **size)
    joints = made.motion(4.0, seed=3)
    expected = made.play(garment, joints)
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
    path, target = tmp_path / "one.safetensors", tmp_path / "dress.onnx"
    garment = made.live(tmp_path, condition=True)
    assert main(["export", str(path), "-o", str(target), "--bits", "16"]) == 0
    assert "16-bit" in capsys.readouterr().out
    model = onnx.load(target)
    onnx.checker.check_model(model, full_check=True)
    assert {n.domain for n in model.graph.node} == {""}  # standard operators alone
    said = json.loads({p.key: p.value for p in model.metadata_props}["garmentnet"])
    assert (said["fps"], said["joints"]) == (made.FPS, list(made.skeleton().names))
    assert said["faces"] == garment.subject.garment.faces.tolist()
    assert list(said["parameters"]) == ["bending", "density", "time_scale"]
    assert main(["export", str(path), "-o", str(tmp_path / "dress.txt")]) == 2
    assert main(["export", str(path), "-o", str(target), "--bits", "4"]) == 2
