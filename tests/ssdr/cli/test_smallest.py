"""`ssdr smallest`."""

from __future__ import annotations

import pytest

import ssdr
from helpers.rig_model import tube
from ssdr import parsimony


@pytest.fixture
def source(tmp_path):
    model = tube(bones=3, frames=12, rings=7, sides=6)
    ssdr.save(ssdr.MeshSequence(model.skin(), model.faces), tmp_path / "in.npz")
    return tmp_path / "in.npz"


@pytest.mark.filterwarnings("default")
def test_smallest(run, done, source, tmp_path):
    target = tmp_path / "out.npz"
    line = ("smallest", source, "-o", target, "--effort", "fast", "--tolerance")
    document = done(*line, "0.8%")
    found, model = document["parsimony"], ssdr.load_skinning(target)
    assert found["held"] is True
    assert document["bones"] == model.n_bones <= 3
    assert document["rmse"] <= found["tolerance"]
    assert found["bytes"] == parsimony.size(model).total
    assert [p["what"] for p in found["prunings"]] == ["bones", "influences", "keyframes"]
    # A length; with too few bones, the closest model comes with a warning.
    code, out, err = run(*line, str(found["tolerance"] / 100), "--bones", 1)
    assert code == 0
    assert "1 bones of at most 4 influences reach" in err
    assert "held: no" in out
    # The file is larger than the model in an engine, and the table says why.
    assert "bytes in an engine" in out
    assert "files hold more" in out


@pytest.mark.parametrize(
    ("flags", "text"),
    [
        ((), "--tolerance"),
        (("--tolerance", "half"), "such as"),
        (("--tolerance", "-1"), "such as"),
        (("--tolerance", "1%", "--measure", "mean"), "'rmse'"),
        (("--tolerance", "1%", "--rig", "rig.npz"), "'loose'"),
    ],
)
def test_refused_before_the_work(refused, source, tmp_path, flags, text):
    assert text in refused("smallest", source, "-o", tmp_path / "out.npz", *flags)
    assert not (tmp_path / "out.npz").exists()
