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


def test_a_tolerance_of_normals(run, done, source, tmp_path):
    line = ("smallest", source, "-o", tmp_path / "out.npz", "--effort", "fast", "--force")
    line += ("--tolerance", "5%", "--normals-tolerance")
    document = done(*line, "6")
    assert document["parsimony"]["normals_tolerance"] == 6
    assert document["normals"]["mean"] <= 6
    assert document["parsimony"]["held"] is True
    _, out, _ = run(*line, "6")
    assert "6° in the mean" in out
    assert done(*line[:-1], "--no-normals")["parsimony"]["normals_tolerance"] is None


def test_bytes_of_a_compact_file(run, done, source, tmp_path):
    target, other = tmp_path / "out.glb", tmp_path / "out.npz"
    line = ["smallest", source, "-o", other, "--effort", "fast", "--tolerance", "0.8%"]
    compact = ["-o", target, "--write", "glb:compression=quantized", "--write", "glb:tolerance=1%"]
    found = done(*line, *compact)["parsimony"]
    assert found["file"]["bytes"] == len(target.read_bytes())
    assert found["error"] < found["file"]["error"] <= found["tolerance"]
    _, out, _ = run(*line, *compact)
    assert f"{target.stat().st_size:,} bytes, all it holds" in out
    assert done(*line)["parsimony"]["file"] is None
    # another compression, or none, is not counted
    assert done(*line, "-o", target)["parsimony"]["file"] is None


@pytest.mark.parametrize(
    ("flags", "text"),
    [
        ((), "--tolerance"),
        (("--tolerance", "half"), "such as"),
        (("--tolerance", "-1"), "such as"),
        (("--tolerance", "1%", "--measure", "mean"), "'rmse'"),
        (("--tolerance", "1%", "--rig", "rig.npz"), "'loose'"),
        (("--tolerance", "1%", "--normals-tolerance", "0"), "degrees"),
    ],
)
def test_refused_before_the_work(refused, source, tmp_path, flags, text):
    assert text in refused("smallest", source, "-o", tmp_path / "out.npz", *flags)
    assert not (tmp_path / "out.npz").exists()
