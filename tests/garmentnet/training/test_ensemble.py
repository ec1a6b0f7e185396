"""An ensemble from a store."""

import dataclasses

import numpy as np
import pytest

from garmentnet.networks.checkpoint import load_checkpoint
from garmentnet.paper.train import train_ensemble
from ssdr.common.errors import InputError


@pytest.mark.slow
def test_from_store_to_ensemble(short_store, toy_config, tmp_path):

    config = toy_config(epochs=1, high_epochs=1)
    small = dataclasses.replace(config.ensemble, pivots=4, steps=80, frames=20)
    config = dataclasses.replace(config, ensemble=small)
    path = train_ensemble(short_store, config, tmp_path)
    loaded = load_checkpoint(path)
    sets = [load_checkpoint(p).parameters[0] for p in tmp_path.glob("set-*/checkpoint.safetensors")]
    assert len(sets) == 5
    assert len(set(loaded.parameters)) == 4
    assert set(loaded.parameters) < set(sets)
    clip = short_store.clip("set4-test-0")
    answer = loaded.predict(clip.joints[:10], clip.parameters)
    assert np.isfinite(answer).all()
    with pytest.raises(InputError, match="parameters"):
        loaded.predict(clip.joints[:10])
    first = path.read_bytes()
    assert train_ensemble(short_store, config, tmp_path).read_bytes() == first


def test_settings_that_do_not_fit_are_refused_before_any_training(toy_store, toy_config, tmp_path):
    config = toy_config()
    for setting in ({"condition": True}, {"parameters": "2,0.2,1"}):
        own = dataclasses.replace(config, data=dataclasses.replace(config.data, **setting))
        with pytest.raises(InputError, match=r"data\.condition, data\.parameters"):
            train_ensemble(toy_store, own, tmp_path)
    many = dataclasses.replace(config, ensemble=dataclasses.replace(config.ensemble, pivots=6))
    with pytest.raises(InputError, match=r"ensemble\.pivots: .*at most 5"):
        train_ensemble(toy_store, many, tmp_path)
    assert not list(tmp_path.iterdir())
