import dataclasses
import json

import numpy as np
import pytest
import torch

from garmentnet.evaluation.baselines import MeanShape, Ridge
from garmentnet.evaluation.methods import Network
from garmentnet.evaluation.scores import evaluate
from garmentnet.networks.checkpoint import load_checkpoint
from garmentnet.paper.train import choose_clips, train
from helpers import toy_store as toy
from ssdr.common.errors import FormatError, InputError


def test_learns_what_a_pose_does_not_tell(toy_store, toy_bones, toy_network):

    names = [n for n in toy_store.names("train") if n.startswith("base")]
    held = [n for n in toy_store.names("validation") if n.startswith("base")]
    mean = MeanShape(toy_bones, names)
    others = [mean, Ridge(toy_bones, names, held, mean.high)]
    methods = [Network("network", toy_network), *others]
    rows = {r.name: r for r in evaluate(toy_bones, methods, ["base-test-0", "base-test-1"])}
    for other in others:
        assert rows["network"].all.overall.rmse < 0.7 * rows[other.name].all.overall.rmse


def test_a_seed_decides_all_weights_but_not_the_bones(short_store, toy_config, tmp_path):
    def run(name, seed):
        config = toy_config(epochs=1, high_epochs=1, seed=seed)
        return train(short_store, config, tmp_path / name).read_bytes()

    def homes():
        return set(short_store.path.with_name(short_store.path.name + ".bones").iterdir())

    first = run("a", 0)
    after_first = homes()
    torch.manual_seed(99)
    np.random.seed(99)  # noqa: NPY002
    assert run("b", 0) == first
    assert run("c", 1) != first
    # The bones have a seed of their own: networks of all seeds share them.
    assert homes() == after_first


def test_history_progress_and_early_stop(short_store, toy_config, tmp_path):
    seen = []
    # A rate of nothing: validation cannot improve after the first time.
    config = toy_config(epochs=50, high_epochs=1, validate_every=1, patience=3, learning_rate=1e-12)
    train(short_store, config, tmp_path, progress=lambda *said: seen.append(said))
    seen = [(text, fraction) for text, fraction in seen if text.startswith(("low ", "high "))]
    low = [text for text, _ in seen if text.startswith("low ")]
    assert len(low) <= 8
    assert all(0 < fraction <= 1 for _, fraction in seen)

    history = json.loads((tmp_path / "history.json").read_text())
    assert len(history["low"]) == len(low)
    assert history["low"][-1]["learning_rate"] < history["low"][0]["learning_rate"]


def test_a_damaged_state_and_another_configuration(short_store, toy_config, tmp_path):
    config = toy_config(epochs=2, high_epochs=1)
    train(short_store, config, tmp_path)
    with pytest.raises(InputError, match="folder"):
        train(short_store, toy_config(epochs=1, high_epochs=1, window=20), tmp_path)
    file = tmp_path / "low.state.safetensors"
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(FormatError, match=r"low\.state\.safetensors"):
        train(short_store, config, tmp_path)


def test_a_start_is_where_it_starts(short_store, toy_config, toy_network, tmp_path):
    config = toy_config(epochs=1, high_epochs=1, learning_rate=1e-12, high_learning_rate=1e-12)

    path = train(short_store, config, tmp_path, start=toy_network)
    joints = short_store.clip("base-test-0").joints[:10]
    gap = load_checkpoint(path).predict(joints) - toy_network.predict(joints)
    assert np.abs(gap).max() < 1e-5

    # A detail module that does not fit is found before anything is trained.
    other = dataclasses.replace(config, high=dataclasses.replace(config.high, hidden=8))
    with pytest.raises(InputError, match="start"):
        train(short_store, other, tmp_path / "other", start=toy_network)
    assert not list((tmp_path / "other").glob("*.state.*"))


def test_clips_are_chosen_by_parameters_and_motions(toy_store, toy_config):
    config = toy_config()

    def names(split="train", **data):
        data = dataclasses.replace(config.data, **data)
        return choose_clips(toy_store, dataclasses.replace(config, data=data), split)[0]

    every = names()
    assert choose_clips(toy_store, config) == (every, toy.BASE)
    assert len(every) == 8
    assert names(parameters="2.0, 0.2, 1") == ["set1-train-0"]
    assert names("validation", parameters="2.0, 0.2, 1") == []
    for wrong in ("2.0,0.2", "a,b,c", "-1,1,1"):
        with pytest.raises(InputError):
            names(parameters=wrong)
    one = toy_store.clip(every[0]).motion
    assert {toy_store.clip(n).motion for n in names(motions=one)} == {one}
    with pytest.raises(InputError, match="no-such"):
        names(motions="no-such-*")
    assert names(frames=1) == every[:1]
    assert names(frames=toy_store.clip(every[0]).n_frames + 1) == every[:2]
    assert names("validation", frames=1) == names("validation")
    # of every parameter set as many
    of_sets = [toy_store.clip(n).parameters for n in names(frames=1, condition=True)]
    assert len(set(of_sets)) == len(of_sets) > 1
    # With a motion left out, those of the other splits are learned too.
    held = names("test")
    left = toy_store.clip(held[0]).motion
    assert set(every) | set(held[1:]) <= set(names(leave_out=left))
    assert held[0] not in names(leave_out=left)
    assert names("test", leave_out=left) == [n for n in held if toy_store.clip(n).motion == left]
    assert names("validation", leave_out=left) == []
