# ruff: noqa: E402
import dataclasses
import json
import shutil

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from hypothesis import given, settings
from hypothesis import strategies as st

from garmentnet.networks.ensemble import Ensemble, Kernel
from garmentnet.training.pivots import (
    convex_fit,
    error_of,
    extremes,
    fit_kernel,
    gram,
    inverse_distance,
    left_out_errors,
    nearest,
    select_pivots,
    smallest_good,
)
from ssdr.errors import InputError


def test_gram_is_the_error_of_a_mixture():
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(4, 7, 3))
    answers = [truth + rng.normal(size=truth.shape) for _ in range(3)]
    w = np.array([0.2, 0.5, 0.3])
    mixed = sum(a * g for a, g in zip(w, answers, strict=True))
    expected = np.sqrt(((mixed - truth) ** 2).sum(-1).mean())
    assert np.isclose(error_of(gram(answers, truth), w), expected)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_convex_fit_beats_a_grid(seed):
    rng = np.random.default_rng(seed)
    r = rng.normal(size=(3, 8)) + rng.normal(size=8)
    q = r @ r.T
    w, error = convex_fit(q)
    assert w.min() >= 0
    assert np.isclose(w.sum(), 1)
    a, b = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    grid = np.stack([a.ravel(), b.ravel(), 1 - a.ravel() - b.ravel()], axis=1)
    grid = grid[grid[:, 2] >= -1e-12]
    best = np.sqrt(np.einsum("ni,ij,nj->n", grid, q, grid).clip(0).min())
    assert error <= best + 1e-9


def line(n=6, noise=0.0, seed=0):
    """Sets along one parameter that matters and one that does not; linear answers."""
    rng = np.random.default_rng(seed)
    theta = np.stack([np.linspace(-1, 1, n), rng.uniform(-1, 1, n)], axis=1)
    shape = rng.normal(size=(2, 5, 3))
    truths = [t[0] * shape for t in theta]
    nets = [t + noise * rng.normal(size=shape.shape) for t in truths]
    return theta, nets, truths, [gram(nets, t) for t in truths], shape


def test_extremes_and_pivots():
    theta, _, _, grams, _ = line()
    assert {0, 5} <= set(extremes(theta))
    assert extremes(np.zeros((4, 3))) == [0]
    own = theta.copy()
    own[:, 1] = 0  # one parameter: both ends, and every other set lies between
    assert extremes(own) == [0, 5]
    assert select_pivots(grams, own, 2) == [0, 5]
    assert len(select_pivots(grams, own, 1)) == 1
    six = select_pivots(grams, own, 6)
    assert sorted(six) == [0, 1, 2, 3, 4, 5]
    with pytest.raises(InputError, match="count"):
        select_pivots(grams, own, 7)


def test_worst_fitted_set_is_next():
    rng = np.random.default_rng(0)
    theta = np.array([[-1.0], [0.2], [0.4], [1.0]])
    shape, odd = rng.normal(size=(2, 4, 3)), rng.normal(size=(2, 4, 3))
    nets = [-shape, 0.2 * shape, 0.4 * shape + odd, shape]  # the third leaves the line
    grams = [gram(nets, n) for n in nets]
    assert select_pivots(grams, theta, 3) == [0, 3, 2]


def test_weights_are_convex_and_smooth():
    kernel = Kernel(2, sigma=0.5)
    pivots = np.array([[-1.0, 0], [0, 0.5], [1, 0]])
    sweep = np.stack([np.linspace(-1.5, 1.5, 61), np.zeros(61)], axis=1)
    w = np.stack([kernel.weights(pivots, t) for t in sweep])
    assert w.min() >= 0
    assert np.allclose(w.sum(axis=1), 1)
    assert np.abs(np.diff(w, axis=0)).max() < 0.1
    # The formula itself.
    g = kernel.g(torch.from_numpy(pivots)).detach().numpy()
    at = kernel.g(torch.from_numpy(sweep[7])).detach().numpy()
    psi = np.exp(-((g - at) ** 2).sum(axis=1) / (2 * 0.5**2))
    assert np.allclose(w[7], psi / psi.sum())


def test_far_away_weights_do_not_underflow():
    kernel = Kernel(1, sigma=1e-4)
    w = kernel.weights(np.array([[-1.0], [1.0]]), np.array([0.9]))
    assert np.allclose(w, [0, 1])


def test_alternatives():
    pivots = np.array([[0.0], [1.0], [3.0]])
    assert np.allclose(inverse_distance(pivots, [1.0]), [0, 1, 0])
    w = inverse_distance(pivots, [2.0])
    assert np.allclose(w, np.array([0.5, 1, 1]) / 2.5)
    assert np.allclose(nearest(pivots, [1.9]), [0, 1, 0])


def test_g_learns_which_parameter_matters():
    theta, _, truths, grams, shape = line(n=8)
    kernel, _ = fit_kernel(grams, theta, range(8), sigma=0.5, steps=400)
    learned = left_out_errors(kernel, grams, theta, range(8))
    plain = [
        error_of(
            np.delete(np.delete(q, s, 0), s, 1),
            inverse_distance(np.delete(theta, s, 0), theta[s]),
        )
        for s, q in enumerate(grams)
    ]
    # The ends cannot be reached from inside by any convex mixture; the rest can.
    assert np.mean(learned[1:-1]) < 0.6 * np.mean(plain[1:-1])
    place = np.array([0.1, -0.9])
    w = kernel.weights(theta, place)
    gap = sum(a * t for a, t in zip(w, truths, strict=True)) - 0.1 * shape
    other = inverse_distance(theta, place) @ theta[:, 0] - 0.1
    assert np.abs(gap).max() < max(0.1, abs(other)) * np.abs(shape).max()


def test_validation_chooses_the_step():
    theta, nets, _, grams, shape = line(noise=0.2)
    check = (gram(nets, 0.3 * shape), np.array([0.3, 0.0]))
    _, value = fit_kernel(grams, theta, range(6), validation=[check], steps=100)
    kernel, _ = fit_kernel(grams, theta, range(6), validation=[check], steps=0)
    start = error_of(check[0], kernel.weights(theta, check[1]))
    assert value <= start


def test_fit_does_not_disturb_other_randomness():
    theta, _, _, grams, _ = line()
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    fit_kernel(grams, theta, range(6), steps=1)
    assert torch.equal(torch.rand(3), expected)


def test_smallest_good():
    assert smallest_good([5.0, 2.01, 2.0, 1.99]) == 2
    assert smallest_good([5.0, 3.0, 2.0, 1.99]) == 3
    assert smallest_good([1.0, 3.0]) == 1


def test_mixed_bones_are_mixed_meshes(toy_network, toy_store):
    network = toy_network.networks[0]
    import copy

    other = copy.deepcopy(network)
    with torch.no_grad():
        for p in other.low.parameters():
            p.add_(0.02 * torch.randn(p.shape, generator=torch.Generator().manual_seed(1)))
    theta = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    ensemble = Ensemble((network, other), theta, Kernel())
    joints = toy_store.clip("base-test-0").joints[:20]
    w = ensemble.weights([0.3, 0.0, 0.0])
    mixed = sum(
        a * n.predict(joints, detail=False) for a, n in zip(w, ensemble.networks, strict=True)
    )
    assert np.abs(ensemble.predict(joints, [0.3, 0, 0], detail=False) - mixed).max() < 2e-6
    full = sum(a * n.predict(joints) for a, n in zip(w, ensemble.networks, strict=True))
    whole = ensemble.predict(joints, [0.3, 0, 0])
    assert np.abs(whole - full).max() < 2e-6
    state, steps = None, []
    for pose in joints:
        state, vertices = ensemble.step(state, pose, [0.3, 0, 0])
        steps.append(vertices)
    assert np.abs(np.stack(steps) - whole).max() < 3e-6


def test_pivots_must_share_their_bones(toy_network):
    import copy

    network = toy_network.networks[0]
    other = copy.deepcopy(network)
    g = network.subject.garment
    moved = dataclasses.replace(g, rest=g.rest + np.float32(0.1))
    other.subject = dataclasses.replace(network.subject, garment=moved)
    with pytest.raises(InputError, match="rest pose"):
        Ensemble((network, other), np.zeros((2, 3)), Kernel())


@pytest.mark.slow
def test_from_store_to_ensemble(toy_store, toy_config, tmp_path):
    from garmentnet.networks.checkpoint import load_checkpoint
    from garmentnet.training.ensemble import train_ensemble

    config = toy_config(epochs=16, high_epochs=2)
    config = dataclasses.replace(
        config,
        ensemble=dataclasses.replace(
            config.ensemble, epochs=4, high_epochs=1, steps=80, sigmas=(0.5, 1.0), frames=20
        ),
    )
    path = train_ensemble(toy_store, config, tmp_path)
    report = json.loads((tmp_path / "ensemble.json").read_text())
    assert [s["count"] for s in report["sweep"]] == [1, 2, 3, 4, 5]
    assert all(set(s["test_mm"]["rbf"]) == {"train", "test"} for s in report["sweep"])
    assert set(report["smallest_within_2_percent"]) == {"train", "test"}
    loaded = load_checkpoint(path)
    assert [dataclasses.asdict(p) for p in loaded.parameters] == [
        report["sets"][i] for i in report["pivots"]
    ]
    clip = toy_store.clip("set5-test-0")
    answer = loaded.predict(clip.joints[:10], clip.parameters)
    assert np.isfinite(answer).all()
    with pytest.raises(InputError, match="parameters"):
        loaded.predict(clip.joints[:10])
    first = path.read_bytes()
    assert train_ensemble(toy_store, config, tmp_path).read_bytes() == first
    # A base that is trained already is taken as it is.
    base = load_checkpoint(tmp_path / "base" / "checkpoint.safetensors")
    for place in tmp_path.glob("set-*"):
        shutil.copytree(place, tmp_path / "again" / place.name)
    again = train_ensemble(toy_store, config, tmp_path / "again", base=base)
    assert again.read_bytes() == first
    assert not (tmp_path / "again" / "base").exists()
    with pytest.raises(InputError, match="base"):
        train_ensemble(toy_store, config, tmp_path / "again", base=loaded)
