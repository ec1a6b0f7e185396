"""A toy store and networks trained on it, made once for all tests."""

from __future__ import annotations

import dataclasses

import pytest


@pytest.fixture(scope="session")
def toy_config():
    pytest.importorskip("torch")
    from garmentnet.configs.config import BoneOptions, load_config

    def make(preset="rooted", **train):
        c = load_config(preset)
        defaults = {
            "epochs": 50,
            "high_epochs": 12,
            "learning_rate": 3e-3,
            "window": 30,
            "threads": 1,
            "tensorboard": False,
            "device": "cpu",
        }
        # The paper's high module; that of the preset has tests of its own.
        paper = {
            "kind": "vertices",
            "edge_features": (8, 8, 16),
            "mlp": (32,),
            "activation": "relu",
            "batch_norm": False,
            "edge_dropout": 0.0,
            "collision": 0.1,
            "dropout": 0.0,
        }
        if preset == "faithful":
            paper = {}
        return dataclasses.replace(
            c,
            bones=BoneOptions(length=0.03, count=10, influences=4, effort="fast", frames=160),
            # The toy body has other joints.
            features=dataclasses.replace(c.features, joints=()),
            low=dataclasses.replace(c.low, hidden=64),
            high=dataclasses.replace(c.high, hidden=32, **paper),
            train=dataclasses.replace(c.train, **(defaults | train)),
        )

    return make


@pytest.fixture(scope="session")
def toy_store(tmp_path_factory):
    pytest.importorskip("torch")
    pytest.importorskip("zarr")
    from garmentnet.data.parameters import SimulationParameters as P
    from helpers import toy_store as toy

    others = [
        (P(0.2, 0.2, 1.0), "train"),
        (P(2.0, 0.2, 1.0), "train"),
        (P(0.5, 0.2, 0.7), "train"),
        (P(0.5, 0.2, 1.3), "train"),
        (P(0.8, 0.2, 0.9), "test"),
    ]
    return toy.make_store(tmp_path_factory.mktemp("toy") / "store", others=others)


@pytest.fixture(scope="session")
def toy_bones(toy_store, toy_config):
    from garmentnet.paper.bones import virtual_bones

    return virtual_bones(toy_store, toy_config().bones)


@pytest.fixture(scope="session")
def toy_run(toy_store, toy_config, toy_bones, tmp_path_factory):
    """Folder of a finished run of the rooted configuration."""
    from garmentnet.paper.train import train

    folder = tmp_path_factory.mktemp("run")
    train(toy_store, toy_config(), folder)
    return folder


@pytest.fixture(scope="session")
def toy_network(toy_run):
    from garmentnet.networks.checkpoint import load_checkpoint

    return load_checkpoint(toy_run / "checkpoint.safetensors")


@pytest.fixture(scope="session")
def toy_faithful(toy_store, toy_config, toy_bones, tmp_path_factory):
    """A network of the faithful configuration, hardly trained."""
    from garmentnet.networks.checkpoint import load_checkpoint
    from garmentnet.paper.train import train

    folder = tmp_path_factory.mktemp("faithful")
    return load_checkpoint(
        train(toy_store, toy_config("faithful", epochs=2, high_epochs=1), folder)
    )


@pytest.fixture(scope="session")
def toy_basis(toy_store, toy_config, toy_bones, tmp_path_factory):
    """A network whose detail is a mixture of components."""
    from garmentnet.configs.config import HighOptions
    from garmentnet.networks.checkpoint import load_checkpoint
    from garmentnet.paper.train import train

    high = HighOptions(
        kind="basis", target="detail", hidden=32, rank=12, collision=0.0, dropout=0.1
    )
    config = dataclasses.replace(toy_config(epochs=6, high_epochs=35), high=high)
    return load_checkpoint(train(toy_store, config, tmp_path_factory.mktemp("basis")))
