"""An ensemble from a store."""

# ruff: noqa: E402
import dataclasses
import json
import shutil

import numpy as np
import pytest

torch = pytest.importorskip("torch")


from garmentnet.networks.checkpoint import load_checkpoint
from garmentnet.training.ensemble import train_ensemble
from ssdr.errors import InputError


@pytest.mark.slow
def test_from_store_to_ensemble(toy_store, toy_config, tmp_path):

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


def test_pivots_do_not_read_parameters(toy_store, toy_config, tmp_path):
    config = toy_config()
    reading = dataclasses.replace(config, data=dataclasses.replace(config.data, condition=True))
    with pytest.raises(InputError, match=r"data\.condition"):
        train_ensemble(toy_store, reading, tmp_path)
