"""The runtime beside the networks in torch, whose numbers it must have."""

# ruff: noqa: E402

import copy
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from garmentnet.data.parameters import SimulationParameters as P
from garmentnet.io.tensors import load_arrays, save_arrays
from garmentnet.networks.checkpoint import Checkpoint, save_checkpoint
from garmentnet.networks.ensemble import Kernel
from garmentnet.runtime import load_live
from helpers import live_garment as made
from ssdr.common.errors import FormatError, InputError, SsdrWarning

CLOSE = 1e-5  # metres; a tenth of what is promised


def test_what_only_torch_runs_is_refused_with_what_to_train_instead(
    toy_run, toy_faithful, tmp_path
):
    with pytest.raises(FormatError, match=r"--set high\.kind=basis --set high\.collision=0"):
        load_live(toy_run / "checkpoint.safetensors")
    save_checkpoint(toy_faithful, tmp_path / "f.safetensors")
    with pytest.raises(FormatError, match=r"--set low\.rotation=sixd"):
        load_live(tmp_path / "f.safetensors")


def test_it_needs_no_torch():
    code = "import sys, garmentnet.runtime; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("change", made.CHANGES, ids=str)
def test_numbers_are_those_of_torch(change, tmp_path):
    network = made.network(**change)
    joints = made.motion(2.0, seed=3)
    joints[..., 3] += [40.0, 0.0, -25.0]  # far from the origin
    theta = P(bending=1.3, density=0.15) if network.condition else None
    expected = network.predict(joints, parameters=theta and theta.normalised())
    got = made.play(made.ready(network, tmp_path), joints, theta)
    assert np.abs(got - expected).max() < CLOSE
    assert np.ptp(got[..., 1].mean(axis=1)) > 0.01  # it moves


def test_no_drift_and_constant_memory_over_10000_frames(tmp_path):
    network = made.network(vertices=40)
    garment = made.ready(network, tmp_path)
    joints = made.motion(10_000 / made.FPS, seed=4)
    expected = network.predict(joints)
    state, worst = None, 0.0
    for f, pose in enumerate(joints):
        if f == 100:
            tracemalloc.start()
            before = tracemalloc.get_traced_memory()[0]
        state, vertices = garment.step(state, pose)
        worst = max(worst, float(np.abs(vertices - expected[f]).max()))
    more = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert worst < CLOSE
    assert more < 50_000


def test_a_garment_of_real_size_whose_parameters_change(tmp_path):
    size = {"low": {"hidden": 600}, "high": {"hidden": 256, "rank": 64}}
    network = made.network(vertices=12_273, bones=80, condition=True, **size)
    garment, states = made.ready(network, tmp_path), (None, None)
    for f, pose in enumerate(made.motion(0.5, seed=5)):
        theta = P(bending=0.2 + 0.1 * f)
        state, got = garment.step(states[0], pose, theta)
        other, expected = network.step(states[1], pose, parameters=theta.normalised())
        states = state, other
        assert np.abs(got - expected).max() < CLOSE


@pytest.fixture(scope="module")
def pivots():
    """Two pivots, 0.1 m apart, and a kernel."""
    ways = ("frame", "joints")
    networks = tuple(made.network(seed=s, low={"relative_to": w}) for s, w in enumerate(ways, 1))
    torch.manual_seed(0)
    return Checkpoint(networks, (P(bending=0.2), P(bending=2.0)), Kernel())


def test_pivots_are_mixed_as_in_torch(pivots, tmp_path):
    garment = made.ready(pivots, tmp_path)
    joints = made.motion(1.0, seed=6)
    for bending in (0.2, 0.6, 1.5):
        theta = P(bending=bending)
        weights = pivots.weights(theta)
        np.testing.assert_allclose(garment.mixture(theta.normalised()), weights, atol=1e-12)
        # Detail is mixed in the surface's frame and turns with the mixed bones; in torch each
        # pivot's turns with its own.
        parts, free = [n.run(joints)[0] for n in pivots.networks], pivots.networks[0].free
        moved = sum(float(w) * p.transforms for w, p in zip(weights, parts, strict=True))
        local = sum(
            float(w) * n.turns(p.transforms).mT @ p.high[:, free, :, None]
            for w, n, p in zip(weights, pivots.networks, parts, strict=True)
        )
        turned = pivots.networks[0].turns(moved) @ local
        expected = pivots.networks[0].lbs(moved)[:, free] + turned[..., 0]
        gap = made.play(garment, joints, theta)[:, free] - parts[0].to_world(expected)
        assert np.abs(gap).max() < CLOSE
        gap = made.play(garment, joints, theta) - pivots.predict(joints, theta)
        assert np.sqrt((gap**2).sum(-1).mean()) < 5e-3
    smooth = tuple(made.network(seed=s, detail=False) for s in (1, 2))
    low = Checkpoint(smooth, pivots.parameters, pivots.kernel)
    garment = made.ready(low, tmp_path)
    gap = np.abs(made.play(garment, joints, theta) - low.predict(joints, theta))
    assert gap.max() < CLOSE
    # Two that are alike, and one alone.
    for count in (2, 1):
        alike = Checkpoint((pivots.networks[0],) * count, pivots.parameters[:count], pivots.kernel)
        got = made.play(made.ready(alike, tmp_path), joints, P(bending=0.2))
        assert np.abs(got - pivots.networks[0].predict(joints)).max() < CLOSE


def test_pivots_without_weight_are_not_run(pivots, tmp_path):
    narrow = copy.deepcopy(pivots.kernel)
    with torch.no_grad():
        narrow.g[2].weight.mul_(1000)
    lone = Checkpoint(pivots.networks, pivots.parameters, narrow)
    garment = made.ready(lone, tmp_path)
    joints = made.motion(0.3)
    state, _ = garment.step(None, joints[0], P(bending=0.2))
    assert not state.hidden[1][0].any()
    assert state.hidden[0][0].any()
    expected = pivots.networks[0].predict(joints)
    assert np.abs(made.play(garment, joints, P(bending=0.2)) - expected).max() < CLOSE


def test_files_that_are_not_run(tmp_path):
    one = made.saved(tmp_path / "one.safetensors")
    with pytest.raises(InputError, match="a file"):
        load_live(tmp_path / "none.safetensors")
    (tmp_path / "cut.safetensors").write_bytes(one.read_bytes()[:5000])
    with pytest.raises(FormatError):
        load_live(tmp_path / "cut.safetensors")
    arrays, document = load_arrays(one, "checkpoint")
    for key in ("network.0.low.gru.weight_hh_l0", "network.0.high.basis", "skeleton.parents"):
        cut = arrays | {key: arrays[key][:-1]}
        bad = save_arrays(tmp_path / "bad.safetensors", cut, "checkpoint", document)
        with pytest.raises(FormatError):
            load_live(bad)
    other = made.network(low={"rotation": "euler"}, detail=False)
    with pytest.raises(FormatError, match="sixd"):
        made.ready(other, tmp_path)


@pytest.mark.parametrize("far", [P(bending=1e-9), P(density=1e9), P(1e300, 1e-300, 1e300)], ids=str)
def test_far_parameters_are_warned_of_once_and_give_numbers(tmp_path, far):
    garment, pose = made.live(tmp_path, condition=True), made.motion(0.1)[0]
    with pytest.warns(SsdrWarning, match=r"extrapolated: .* meant for"):
        state, vertices = garment.step(None, pose, far)
    for _ in range(100):
        state, vertices = garment.step(state, pose, far)  # a second warning would be an error
    assert np.isfinite(vertices).all()
    assert np.abs(vertices).max() < 10


POSE = made.motion(0.1)[0]
BROKEN = POSE.copy()
BROKEN[2, 0, 3] = np.nan
REFUSED = [
    *((bad, P(), "pose") for bad in ("pose", None, [[1, 2], [3]], object())),
    (POSE[:5], P(), r"pose: expected shape \(6, 3, 4\)"),
    (BROKEN, P(), "joint 2"),
    (POSE * [[[2, 2, 2, 1]]], P(), "rigid transforms.*joint 0"),
    (POSE * [[[-1, 1, 1, 1]]], P(), "rigid transforms"),
    (POSE, None, "parameters"),
    *(
        (POSE, bad, "parameters: expected Sim")
        for bad in ((0.5, 0.2, 1.0), [0.5, 0.2, 1.0], "soft")
    ),
]


def test_poses_parameters_and_states_that_are_none(tmp_path):
    garment = made.live(tmp_path, condition=True)
    for pose, parameters, text in REFUSED:
        with pytest.raises(InputError, match=text):
            garment.step(None, pose, parameters)
    other = made.live(tmp_path, low={"hidden": 32}, condition=True)
    with pytest.raises(InputError, match="state: expected one of this garment"):
        garment.step(other.step(None, POSE, P())[0], POSE, P())


def test_damaged_files_say_so(tmp_path):
    """Cut anywhere, or with bytes that are others: refused in words, or a garment all the same."""
    one = made.saved(tmp_path / "one.safetensors")
    rng, whole, bad = np.random.default_rng(0), one.read_bytes(), tmp_path / "bad.safetensors"
    refused = 0
    for k in range(60):
        data = bytearray(whole)
        if k < 20:
            data = data[: int(rng.integers(len(data)))]
        else:
            # Most of what can break lies in front: sizes, names and the document.
            for at in rng.integers(12_000 if k < 50 else len(data), size=3):
                data[at] = rng.integers(256)
        bad.write_bytes(data)
        try:
            load_live(bad).step(None, made.motion(0.1)[0])
        except (FormatError, InputError):
            refused += 1
    assert refused >= 20
