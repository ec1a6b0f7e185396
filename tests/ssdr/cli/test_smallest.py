"""`ssdr smallest`."""

from __future__ import annotations

import pytest

import ssdr
from helpers.measures import small, wavy
from ssdr import parsimony


@pytest.fixture
def source(tmp_path):
    ssdr.save(ssdr.MeshSequence(wavy()), tmp_path / "in.npz")
    return tmp_path / "in.npz"


@pytest.mark.filterwarnings("default")
def test_smallest(run, done, source, tmp_path):
    target = tmp_path / "out.npz"
    line = ("smallest", source, "-o", target, "--effort", "fast", "--force", "--tolerance")
    document = done(*line, "0.8%")
    found = document["parsimony"]
    assert found["held"] is True
    assert document["bones"] == small().skinning.n_bones
    assert document["rmse"] <= found["tolerance"]
    assert found["bytes"] == parsimony.size(ssdr.load_skinning(target)).total
    assert [p["what"] for p in found["prunings"]] == ["bones", "influences", "keyframes"]
    code, out, err = run(*line, "0.01", "--bones", 2)
    assert code == 0
    assert "2 bones of at most 4 influences reach" in err
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
    ],
)
def test_refused_before_the_work(refused, source, tmp_path, flags, text):
    assert text in refused("smallest", source, "-o", tmp_path / "out.npz", *flags)
    assert not (tmp_path / "out.npz").exists()
