"""The training loop on a module of one number."""

from types import SimpleNamespace

import pytest
import torch

from garmentnet.configs.config import TrainOptions
from garmentnet.training import loop
from ssdr.common.errors import InputError

NAN = float("nan")


class OneNumber(loop.TrainingObjective):
    """It is drawn away from 0; validation says what the test gives."""

    def __init__(self, validation, slope=1.0):
        self.module = torch.nn.Linear(1, 1, bias=False)
        self.tracks, self.said = [], iter(validation)
        self.validation = [v for v in validation if v == v]
        self.slope, self.after = slope, []

    def loss(self, batch, state, rng):
        return -self.slope * self.module.weight.sum(), torch.zeros(1)

    def squared_error(self, track):
        raise AssertionError("there are no tracks")

    def validate(self):
        self.after.append(float(self.module.weight.detach()))
        return next(self.said)

    def trained(self):
        return 0.0


def run(objective, folder, monkeypatch, epochs=3):
    monkeypatch.setattr(loop, "batches", lambda *_: [SimpleNamespace(forget=lambda state: state)])
    options = TrainOptions(validate_every=1)
    given = {"name": "low", "epochs": epochs, "learning_rate": 0.1, "folder": folder}
    return loop.fit(objective, options, **given), float(objective.module.weight.detach())


def test_it_ends_with_the_weights_of_the_best_epoch(tmp_path, monkeypatch):
    objective = OneNumber([3.0, 1.0, 2.0])
    history, weight = run(objective, tmp_path, monkeypatch)
    assert weight == objective.after[1] != objective.after[2]
    # half a cosine from the first epoch's rate down
    rates = [epoch["learning_rate"] for epoch in history]
    assert rates == pytest.approx([0.1, 0.075, 0.025])


def test_without_validation_it_ends_with_the_last_weights(tmp_path, monkeypatch):
    objective = OneNumber([NAN, NAN, NAN])
    history, weight = run(objective, tmp_path, monkeypatch)
    assert weight == objective.after[2]
    assert [epoch["rmse"] for epoch in history] == [None] * 3


def test_a_loss_that_is_not_finite_is_an_error(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="learning_rate"):
        run(OneNumber([1.0], slope=NAN), tmp_path, monkeypatch)


def test_a_gradient_that_is_not_finite_leaves_the_state_of_before(tmp_path, monkeypatch):
    objective = OneNumber([NAN, NAN, NAN])
    run(objective, tmp_path, monkeypatch, epochs=1)
    state = (tmp_path / "low.state.safetensors").read_bytes()
    # A loss of 0, whose slope is none.
    objective.loss = lambda *_: ((0 * objective.module.weight).sqrt().sum(), torch.zeros(1))
    with pytest.raises(InputError, match="learning_rate"):
        run(objective, tmp_path, monkeypatch)
    assert (tmp_path / "low.state.safetensors").read_bytes() == state
