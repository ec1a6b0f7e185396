"""The line with which training ends."""

import re

import pytest
import torch

from garmentnet.evaluation.baselines import BodySkinned, MeanShape, Ridge
from garmentnet.evaluation.scores import evaluate
from garmentnet.evaluation.verdict import ADVICE, verdict
from garmentnet.networks.checkpoint import Checkpoint, load_checkpoint, save_checkpoint


def test_errors_are_those_of_evaluate_and_a_loss_is_said(toy_run, toy_store, toy_bones, tmp_path):
    file = toy_run / "checkpoint.safetensors"
    text = verdict(file, toy_store)
    found = {m[1]: float(m[2]) for m in re.finditer(r"(?:: |, )([a-z -]+) ([0-9.]+) mm", text)}
    assert list(found) == ["network", MeanShape.name, BodySkinned.name, Ridge.name]
    held = toy_store.names("validation")
    held = [n for n in held if toy_store.clip(n).parameters == toy_store.parameters()[0]]
    (row,) = evaluate(toy_bones, [BodySkinned(toy_store)], held[:8])
    assert found[BodySkinned.name] == pytest.approx(row.all.overall.rmse, abs=0.06)
    # Weights that are zero predict nothing: some plain method is better, and it says what to do.
    broken = load_checkpoint(file)
    with torch.no_grad():
        broken.networks[0].low.out.weight.zero_()
        broken.networks[0].low.out.bias.fill_(3.0)
    bad = save_checkpoint(
        Checkpoint(broken.networks, broken.parameters, None), tmp_path / "bad.safetensors"
    )
    said = verdict(bad, toy_store)
    best = min(list(found)[1:], key=found.__getitem__)
    assert f"the network errs more than {best}: {ADVICE[best]}" in said
