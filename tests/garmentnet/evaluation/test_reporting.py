"""Reports of checkpoints."""

# ruff: noqa: E402
import dataclasses
import json

import pytest

torch = pytest.importorskip("torch")

import garmentnet.evaluation.entrants as entrants
import garmentnet.evaluation.reporting as reporting
from garmentnet.data.parameters import SimulationParameters
from garmentnet.evaluation.reporting import report
from garmentnet.networks.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from garmentnet.networks.ensemble import Kernel
from helpers import toy_store as toy
from ssdr.errors import InputError


@pytest.fixture(scope="session")
def second_seed(toy_run, tmp_path_factory):
    """The toy's checkpoint with other weights, as if from another seed."""
    model = load_checkpoint(toy_run / "checkpoint.safetensors")
    (network,) = model.networks
    with torch.no_grad():
        for weight in network.low.parameters():
            weight.mul_(1.001)
    changed = dataclasses.replace(network.config.train, seed=network.config.train.seed + 1)
    network.config = dataclasses.replace(network.config, train=changed)
    folder = tmp_path_factory.mktemp("second")
    return save_checkpoint(
        Checkpoint((network,), model.parameters, None), folder / "checkpoint.safetensors"
    )


def test_a_report_has_scores_the_chaos_floor_and_pictures(toy_run, toy_store, tmp_path):
    text = report(
        [toy_run / "checkpoint.safetensors"], toy_store, tmp_path, baselines=False, pictures=1
    )
    assert "bones themselves" in text
    assert "chaos floor, all" in text
    assert (tmp_path / "report.json").is_file()
    assert len(list(tmp_path.glob("*.png"))) == 2  # a clip, and the hard moments


def test_seeds_ratios_and_clips(toy_run, second_seed, toy_store, tmp_path, monkeypatch):
    first = toy_run / "checkpoint.safetensors"
    options = {"baselines": False, "pictures": 0, "per_clip": True}
    text = report([first, second_seed], toy_store, tmp_path, **options)
    assert "seeds 0, 1: RMSE" in text
    assert "2 clips are few: the intervals are rough" in text
    assert "clip base-test-1, 90 frames" in text
    assert "scored now: 6, scored before: 0" in text
    document = json.loads((tmp_path / "report.json").read_text())
    (group,) = document["groups"].values()
    assert group["clips"] == ["base-test-0", "base-test-1"]
    reference = document["ratios"]["reference"]
    assert reference.startswith(toy_run.name)
    own = document["ratios"]["methods"][reference]["free"]["overall"]
    assert own["rmse"] == {"ratio": 1.0, "low": 1.0, "high": 1.0}
    assert own["pooled_rmse"]["low"] <= own["pooled_rmse"]["value"] <= own["pooled_rmse"]["high"]
    clips = document["unseen_motions"][1]["clips"]
    assert {"low", "high", "overall"} == set(clips[0]["free"])
    assert sum(c["frames"] for c in clips[0]["classes"]) == 90

    # One clip of the same checkpoint: known, and without an interval.
    def never(model):
        def answer(clip):
            raise AssertionError(clip.name)

        return answer

    monkeypatch.setattr(reporting, "network_method", never)
    options = {"baselines": False, "pictures": 0, "against": "bones themselves"}
    text = report([first], toy_store, tmp_path, clips=["*-test-1"], **options)
    assert "clips: 1, frames: 90" in text
    assert "one clip says nothing about others" in text
    assert "scored now: 0, scored before: 2" in text
    with pytest.raises(InputError, match=r"clips: .*base-test-0.*'base-dance-\*'"):
        report([first], toy_store, tmp_path, clips=["base-dance-*"], **options)
    with pytest.raises(InputError, match=r"against: .*bones themselves.*'ridge'"):
        report([first], toy_store, tmp_path, **(options | {"against": "ridge"}))


def test_baselines_that_are_scored_are_not_fitted_again(toy_run, toy_store, tmp_path, monkeypatch):

    fitted = []

    def stand_in(name):
        class Fitted:
            def __init__(self, bones, *args, **options):
                fitted.append(name)
                self.shape = entrants.BodySkinned(toy_store)

            def predict(self, joints):
                return self.shape.predict(joints)

        return Fitted

    for name in ("MeanShape", "Ridge", "train_santesteban"):
        monkeypatch.setattr(entrants, name, stand_in(name))
    checkpoint = toy_run / "checkpoint.safetensors"
    text = report([checkpoint], toy_store, tmp_path, pictures=0)
    assert fitted == ["MeanShape", "Ridge", "train_santesteban"]
    assert "divided by that of Santesteban 2019" in text
    fitted.clear()
    again = report([checkpoint], toy_store, tmp_path, pictures=0)
    assert fitted == []
    assert "scored now: 0, scored before: 12" in again
    assert again.partition("scored now")[0] == text.partition("scored now")[0]


def test_unseen_parameters(toy_run, toy_store, tmp_path):

    (network,) = load_checkpoint(toy_run / "checkpoint.safetensors").networks
    pivots = (toy.BASE, SimulationParameters(bending=2.0))
    path = save_checkpoint(
        Checkpoint((network, network), pivots, Kernel()), tmp_path / "pair.safetensors"
    )
    options = {"baselines": False, "pictures": 0}
    text = report([path], toy_store, tmp_path / "e", **options)
    assert "unseen parameters, train motions, clips: 1" in text
    document = json.loads((tmp_path / "e" / "report.json").read_text())
    assert document["unseen_parameters_test"][0]["name"] == "bones themselves"
    assert document["unseen_parameters_test_ratios"]["n_clips"] == 1
    # None of the base's clips: only that part is in the report.
    text = report([path], toy_store, tmp_path / "e", clips=["set5-test-*"], **options)
    assert text.startswith("unseen parameters, test motions")
    assert "unseen motions" not in text
    assert "scored now: 0, scored before: 2" in text
