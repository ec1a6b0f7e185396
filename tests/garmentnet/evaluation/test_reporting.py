"""Reports of checkpoints."""

import json
import shutil
import types

import numpy as np
import pytest

from garmentnet.configs.config import override
from garmentnet.data.clip import CLASSES
from garmentnet.data.parameters import SimulationParameters
from garmentnet.evaluation.reporting import group_of, report
from garmentnet.networks.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from garmentnet.paper.ensemble import Kernel
from helpers import toy_store as toy
from ssdr.common.errors import InputError


@pytest.fixture(scope="session")
def checkpoint(toy_run):
    return toy_run / "checkpoint.safetensors"


def test_rows_and_clips(checkpoint, toy_store, tmp_path):
    (tmp_path / "second").mkdir()
    second = shutil.copy(checkpoint, tmp_path / "second" / "checkpoint.safetensors")
    options = {"baselines": False, "pictures": 1}
    text = report([checkpoint, second], toy_store, tmp_path, **options)
    assert "| chaos of the cloth " in text
    assert "| RMSE by mode " in text
    assert (tmp_path / "report.md").read_text("utf-8") == text
    assert len(list(tmp_path.glob("*.png"))) == 2
    document = json.loads((tmp_path / "report.json").read_text())
    (group,) = document["groups"].values()
    bones, first, other, chaos = group["rows"]
    assert chaos["name"] == "chaos of the cloth"
    assert bones["name"] == "bones themselves"
    assert [c["name"] for c in bones["clips"]] == ["base-test-0", "base-test-1"]
    assert first["all"] == other["all"]
    assert sum(e["frames"] for e in first["clips"][0]["per_class"].values()) == 90

    text = report([checkpoint], toy_store, tmp_path, clips=["*-test-1"], **options)
    assert "1 clips, 90 frames" in text
    with pytest.raises(InputError, match=r"clips: .*base-test-0.*'base-dance-\*'"):
        report([checkpoint], toy_store, tmp_path, clips=["base-dance-*"], **options)


def test_clips_that_were_left_out_are_scored_and_settings_must_agree(
    checkpoint, toy_store, tmp_path
):
    def changed(name, setting):
        model = load_checkpoint(checkpoint)
        model.networks[0].config = override(model.networks[0].config, [setting])
        return save_checkpoint(model, tmp_path / name)

    options = {"baselines": False, "pictures": 0}
    path = changed("left.safetensors", "data.leave_out=" + toy_store.clip("base-train-0").motion)
    report([path], toy_store, tmp_path, **options)
    (group,) = json.loads((tmp_path / "report.json").read_text())["groups"].values()
    assert [c["name"] for c in group["rows"][0]["clips"]] == ["base-train-0"]
    other = changed("other.safetensors", "bones.length=0.05")
    with pytest.raises(InputError, match=r"checkpoints.*bones\.length 0\.03.*0\.05"):
        report([checkpoint, other], toy_store, tmp_path, **options)


def test_unseen_parameters(checkpoint, toy_store, tmp_path):
    (network,) = load_checkpoint(checkpoint).networks
    # The bones are the network's own: their clips need not be in the store.
    network.config = override(network.config, ["bones.motions=elsewhere-*"])
    pivots = (toy.BASE, SimulationParameters(bending=2.0))
    path = save_checkpoint(
        Checkpoint((network, network), pivots, Kernel()), tmp_path / "pair.safetensors"
    )
    options = {"baselines": False, "pictures": 0}
    text = report([path], toy_store, tmp_path / "e", **options)
    assert "## unseen parameters train: 1 clips" in text
    document = json.loads((tmp_path / "e" / "report.json").read_text())
    assert document["groups"]["unseen parameters test"]["rows"][0]["name"] == "bones themselves"
    # None of the base's clips: only that part is in the report.
    text = report([path], toy_store, tmp_path / "e", clips=["set4-test-*"], **options)
    assert "## unseen parameters test" in text
    assert "unseen motions" not in text


def test_motions_are_grouped_by_name_or_source(toy_store):
    def clip(motion, *, file="", label="walk"):
        classes = np.full(5, CLASSES.index(label))
        source = {"motion": {"file": file}}
        return types.SimpleNamespace(motion=motion, classes=classes, provenance=source)

    assert group_of(clip("dance-22000")) == "dance"
    assert group_of(clip("60_01_00")) == "60_01"  # by name alone
    assert group_of(clip("60_01_00", label="recorded")) == "recorded"
    assert group_of(clip("60_01_00", file="60_01.bvh")) == "recorded"
    assert group_of(clip("still")) == "still"
    assert group_of(toy_store.clip("base-test-0")) == "test"
