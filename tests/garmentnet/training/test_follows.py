"""Bones of a garment that lies close move relative to the joints of the body."""

import numpy as np
import pytest

from garmentnet.configs.config import load_config, override
from garmentnet.data.outfit import Outfit
from garmentnet.data.store import ClipStore
from garmentnet.networks.checkpoint import load_checkpoint
from garmentnet.paper.bones import virtual_bones
from garmentnet.paper.train import train
from helpers import live_garment as made
from helpers.cloth_scenes import tube
from ssdr import skin


@pytest.fixture(scope="module")
def sleeve(tmp_path_factory):
    """A tube close to a leg, in three clips, and its bones."""
    body = made.skeleton()
    rest, faces = tube(np.linspace(0.95, 0.1, 14), 0.06, 12)
    rest += [0.1, 0, 0]
    knee = np.clip((rest[:, 1] - 0.4) / 0.2, 0, 1)[:, None]
    legs = np.tile([[2, 3]], (len(rest), 1))
    rig = made.figure(body)
    path, outfit = tmp_path_factory.mktemp("sleeve") / "store", Outfit(rest, faces, rig, body, 30.0)
    store = ClipStore.create(path, outfit)
    for seed, split in enumerate(("train", "train", "validation")):
        m = made.motion(2.0, seed=seed)
        wave = 0.004 * np.sin(20 * rest[:, 1] + np.arange(len(m))[:, None] / 5)
        v = skin(rest, legs, np.concatenate([knee, 1 - knee], axis=1), m)
        v[..., 1] += wave
        store.add(
            f"clip-{seed}",
            vertices=v.astype(np.float32),
            joints=m.astype(np.float32),
            classes=np.zeros(len(m), int),
            split=split,
            motion=f"clip-{seed}",
            parameters=made.SimulationParameters(),
            seed=seed,
            quality={"accepted": True},
            provenance={},
        )
    changes = ("bones.count=5", "bones.frames=60", "high.rank=4", "high.hidden=8", "low.hidden=16")
    config = override(
        load_config("rooted"),
        [
            *changes,
            "bones.effort=fast",
            "features.joints=[]",
            "low.relative_to=joints",
        ],
    )
    return store, config, virtual_bones(store, config.bones)


def test_the_error_of_training_is_that_of_the_vertices(sleeve, tmp_path):
    store, config, bones = sleeve
    config = override(config, ["train.epochs=2", "train.high_epochs=1"])
    model = load_checkpoint(train(store, config, tmp_path))
    (network,), (name,) = model.networks, store.names("validation")
    assert network.config.low.relative_to == "joints"
    motions = model.motions(store.clip(name).joints, detail=False)
    low = np.concatenate([m.vertices() for m in motions])
    gap = (low - bones.split(name)[0])[:, network.free]
    rmse = np.sqrt((gap.astype(float) ** 2).sum(-1).mean())
    assert rmse == pytest.approx(model.errors["low, validation"], rel=0.02)
