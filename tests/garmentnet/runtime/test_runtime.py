"""Networks as .onnx files, played by onnxruntime, beside torch."""

# ruff: noqa: E402

import json
import subprocess
import sys

import numpy as np
import pytest

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

from garmentnet.cli import main
from garmentnet.data.parameters import SimulationParameters as P
from garmentnet.networks.checkpoint import Checkpoint
from garmentnet.paper.ensemble import Kernel
from garmentnet.runtime import LiveGarment
from garmentnet.runtime.onnx_file import export_onnx
from helpers import live_garment as made
from ssdr.common.errors import FormatError, InputError, SsdrWarning

APART = {"low": {"relative_to": "joints"}, "features": {"frame": "world"}, "bound": False}


def test_it_needs_no_torch():
    code = "import sys, garmentnet.runtime; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("change", [*made.CHANGES, APART], ids=str)
def test_numbers_are_those_of_torch(change, tmp_path):
    network, joints = made.network(**change), made.motion(3.0, seed=3)
    joints[..., 3] += [4.0, 0.0, -2.5]
    theta = P(bending=1.3, density=0.15) if network.condition else None
    expected = network.predict(joints, parameters=theta and theta.normalised())
    got = made.play(made.ready(network, tmp_path), joints, theta)
    assert np.abs(got - expected).max() < 1e-4
    assert np.ptp(got[..., 1].mean(axis=1)) > 0.01  # it moves


def test_it_does_not_drift(tmp_path):
    network, joints = made.network(vertices=40), made.motion(10_000 / made.FPS, seed=4)
    got = made.play(made.ready(network, tmp_path), joints)
    assert np.abs(got - network.predict(joints)).max() < 1e-4


def test_the_command_and_what_the_file_says_of_itself(tmp_path, capsys):
    path, target = made.saved(tmp_path / "one.safetensors", condition=True), tmp_path / "dress.onnx"
    assert main(["export", str(path), "-o", str(target)]) == 0
    assert " MB" in capsys.readouterr().out
    model = onnx.load(target)
    onnx.checker.check_model(model, full_check=True)
    assert {n.domain for n in model.graph.node} == {""}  # standard operators alone
    said = json.loads({p.key: p.value for p in model.metadata_props}["garmentnet"])
    assert (said["fps"], said["joints"]) == (made.FPS, list(made.skeleton().names))
    garment = LiveGarment(target)
    assert garment.faces.tolist() == said["faces"]
    assert list(said["parameters"]) == ["bending", "density", "time_scale"]
    assert main(["export", str(path), "-o", str(tmp_path / "dress.txt")]) == 2
    two = Checkpoint((made.network(),) * 2, (P(bending=0.2), P(bending=2.0)), Kernel())
    with pytest.raises(InputError, match="ensemble"):
        export_onnx(two, target)


POSE = made.motion(0.1)[0]
BROKEN = POSE.copy()
BROKEN[2, 0, 3] = np.nan


def test_what_is_refused_and_what_is_warned_of(tmp_path):
    garment = made.live(tmp_path, condition=True)
    for pose, parameters, text in (
        (POSE[:5], P(), "shape"),
        (BROKEN, P(), "joint 2"),
        (POSE * [[[2, 2, 2, 1]]], P(), "rigid transforms.*joint 0"),
        (POSE, None, "parameters"),
        (POSE, (0.5, 0.2, 1.0), "parameters: expected Sim"),
    ):
        with pytest.raises(InputError, match=text):
            garment.step(None, pose, parameters)
    with pytest.warns(SsdrWarning, match=r"extrapolated: .* meant for"):
        state, vertices = garment.step(None, POSE, P(bending=1e-9))
    for _ in range(20):
        state, vertices = garment.step(state, POSE, P(bending=1e-9))  # a second one is an error
    assert np.abs(vertices).max() < 10
    with pytest.raises(InputError, match="path"):
        LiveGarment(tmp_path / "none.onnx")
    (tmp_path / "cut.onnx").write_bytes((tmp_path / "one.onnx").read_bytes()[:5000])
    with pytest.raises(FormatError, match=r"cut\.onnx"):
        LiveGarment(tmp_path / "cut.onnx")


def test_a_reset_forgets_whatever_the_states_hold(tmp_path):
    network, joints = made.network(), made.motion(1.0, seed=5).astype(np.float32)
    garment = made.ready(network, tmp_path)
    session = onnxruntime.InferenceSession(str(export_onnx(made.one(network), tmp_path / "a.onnx")))
    given = {i.name: np.full(i.shape, np.nan, np.float32) for i in session.get_inputs()}
    given |= {"pose": joints[0], "reset": np.ones(1, np.float32)}
    (vertices,) = session.run(["vertices"], given)
    np.testing.assert_allclose(vertices, garment.step(None, joints[0])[1], atol=1e-5)
