"""An ensemble from a store."""

import dataclasses
import json

import numpy as np
import pytest

from garmentnet.networks.checkpoint import load_checkpoint
from garmentnet.paper.train import train_ensemble
from ssdr.common.errors import InputError


@pytest.mark.slow
def test_from_store_to_ensemble(short_store, toy_config, tmp_path):

    config = toy_config(epochs=1, high_epochs=1)
    small = dataclasses.replace(config.ensemble, pivots=3, steps=80, frames=20)
    config = dataclasses.replace(config, ensemble=small)
    path = train_ensemble(short_store, config, tmp_path)
    report = json.loads((tmp_path / "ensemble.json").read_text())
    assert len(report["pivots"]) == 3
    assert len(report["sets"]) == 5
    loaded = load_checkpoint(path)
    assert [dataclasses.asdict(p) for p in loaded.parameters] == [
        report["sets"][i] for i in report["pivots"]
    ]
    clip = short_store.clip("set4-test-0")
    answer = loaded.predict(clip.joints[:10], clip.parameters)
    assert np.isfinite(answer).all()
    with pytest.raises(InputError, match="parameters"):
        loaded.predict(clip.joints[:10])
    first = path.read_bytes()
    assert train_ensemble(short_store, config, tmp_path).read_bytes() == first


def test_pivots_do_not_read_parameters(toy_store, toy_config, tmp_path):
    config = toy_config()
    reading = dataclasses.replace(config, data=dataclasses.replace(config.data, condition=True))
    with pytest.raises(InputError, match=r"data\.condition"):
        train_ensemble(toy_store, reading, tmp_path)
