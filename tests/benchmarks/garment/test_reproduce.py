"""The paper's tables on a toy store: every row is there, and nothing is trained twice."""

import json

import numpy as np
import pytest

from benchmarks.garment import reproduce, reproduction
from benchmarks.garment.published import BASELINES
from benchmarks.garment.reproduction import Reproduction
from garmentnet.evaluation.reporting import RECORDED
from garmentnet.networks.checkpoint import load_checkpoint
from garmentnet.paper.bones import parameter_roles
from ssdr.common.errors import InputError

SETTINGS = (
    "bones.motions=*",
    "bones.length=0.03",
    "bones.influences=4",
    "bones.effort=fast",
    "bones.frames=100",
    "features.joints=[]",
    "low.hidden=16",
    "high.hidden=16",
    "train.epochs=2",
    "train.high_epochs=2",
    "train.threads=1",
)


@pytest.fixture
def run(short_store, tmp_path, monkeypatch):
    for name in ("large", "parameters"):
        (tmp_path / f"{name}.clips").symlink_to(short_store.path, target_is_directory=True)
    monkeypatch.setattr(reproduce, "_DRESSES", ("large",))
    monkeypatch.setattr(reproduce, "_TIGHT", ("large",))
    monkeypatch.setattr(reproduce, "_EQUAL", "data.frames=80")
    monkeypatch.setattr(reproduce, "_BONES", (2, 10))
    monkeypatch.setattr(reproduction, "_TESTED", "")
    return Reproduction(tmp_path, tmp_path / "out", settings=(*SETTINGS, "bones.count=8"))


def test_table_2_has_every_method(run, monkeypatch):
    text = reproduce.table(run, "table2")
    for name in (
        "rooted",
        "faithful",
        "Chen 2021",
        "no local stream",
        "mean shape",
        "bones themselves",
    ):
        assert text.count(f"| {name} ") == 3, name
    assert all(f"| {v.name}" in text for v in BASELINES)
    hours = json.loads((run.folder / "hours.json").read_text("utf-8"))
    assert "large/tailornet" in hours
    monkeypatch.setattr(reproduction, "train", None)  # nothing is trained again
    (run.folder / "table2.md").unlink()
    assert reproduce.table(run, "table2") == text


def test_more_bones_are_nearer(run):
    run.settings = SETTINGS
    rows = [line.split("|") for line in reproduce.table(run, "bones").splitlines()[2:]]
    errors = [float(r[5]) for r in rows[:2]]
    assert errors[1] < errors[0]  # more bones, nearer


def test_table_4_scores_every_rule_on_the_same_clips(run):
    text = reproduce.table(run, "table4")
    record = json.loads((run.folder / "parameters" / "table4.json").read_text("utf-8"))
    pivots = ["pivots, RBF", "pivots, inverse distance", "pivots, nearest"]
    large = ["large network", "large network, frames of a pivot"]
    names = [*pivots, *large, "mean shape", "bones themselves"]
    assert [r["name"] for r in record["rows"]] == names
    assert all(text.count(f"| {name} ") == 3 for name in names)
    store = run.store("parameters")
    learned = [
        json.loads((run.folder / "parameters" / n / "run.json").read_text("utf-8"))["clips"]
        for n in large
    ]
    every, some = ({store.clip(n).parameters for n in clips} for clips in learned)
    assert some == every  # of each set a part
    assert set(learned[1]) < set(learned[0])
    # The nearest pivot's network alone, scored by the naive formula.
    pivots = load_checkpoint(run.folder / "parameters" / "ensemble" / "ensemble.safetensors")
    unseen = [c for c in store.clips("test") if parameter_roles(store)[c.parameters] == "test"]
    theta = unseen[0].parameters.normalised()
    gap = [np.linalg.norm(p.normalised() - theta) for p in pivots.parameters]
    network = pivots.networks[int(np.argmin(gap))]
    squares = [np.square(network.predict(c.joints) - c.sequence.vertices).sum(-1) for c in unseen]
    twin = 1e3 * np.sqrt(np.concatenate(squares).mean())
    assert record["rows"][2]["all"]["overall"]["rmse"] == pytest.approx(twin, rel=1e-3)


def test_an_unknown_table(run):
    with pytest.raises(InputError, match=r"only.*capture.*table9"):
        reproduce.table(run, "table9")


def test_every_recording_is_left_out(run, short_store, toy_run, monkeypatch):
    (run.data / "dress.clips").symlink_to(short_store.path, target_is_directory=True)
    monkeypatch.setattr(reproduce, "group_of", lambda clip: RECORDED)
    monkeypatch.setattr(reproduce, "_PART", "???")
    monkeypatch.setattr(reproduce, "_TUNED", ("train.high_epochs=0",))
    # Widths of the network that stands for the one that ships.
    run.settings += ("low.hidden=64", "train.epochs=1", "train.high_epochs=1", "data.frames=100")
    load = reproduce.load_checkpoint
    shipped = toy_run / "checkpoint.safetensors"
    monkeypatch.setattr(
        reproduce, "load_checkpoint", lambda p: load(shipped if p == "dress" else p)
    )
    head, _, *rows = reproduce.table(run, "capture").splitlines()
    # "test-0" and "test-1" are of one recording, as are "dance_00" and "dance_01".
    assert head.replace("|", " ").split()[-4:] == ["tes", "trai", "validatio", "mean"]
    names = [r.split("|")[1].split()[0] for r in rows]
    assert names == ["the", "rooted", "Santesteban", "mean", "bones"]
    for row in rows:
        *each, mean = (float(x) for x in row.split("|")[2:6])
        assert mean == pytest.approx(sum(each) / 3, abs=0.1)
    learned = json.loads((run.folder / "dress" / "rooted-tes" / "run.json").read_text("utf-8"))
    assert not any("test" in name for name in learned["clips"])
