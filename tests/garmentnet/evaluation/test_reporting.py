"""Reports of checkpoints."""

# ruff: noqa: E402
import pytest

torch = pytest.importorskip("torch")

from garmentnet.evaluation.reporting import report
from ssdr.errors import InputError


def test_report(toy_run, toy_store, tmp_path):
    text = report(
        [toy_run / "checkpoint.safetensors"], toy_store, tmp_path, baselines=False, pictures=1
    )
    assert "bones themselves" in text
    assert "chaos floor, all" in text
    assert (tmp_path / "report.json").is_file()
    assert len(list(tmp_path.glob("*.png"))) == 2  # a clip, and the hard moments


def test_report_refuses_another_garment(toy_run, tmp_path):
    from helpers import toy_store as toy

    rest, faces, _ = toy.skirt(columns=18)
    rig, skeleton = toy.body()
    from garmentnet.data.store import ClipStore

    other = ClipStore.create(
        tmp_path / "s", rest=rest, faces=faces, body=rig, skeleton=skeleton, fps=toy.FPS
    )
    with pytest.raises(InputError, match="garment"):
        report([toy_run / "checkpoint.safetensors"], other, tmp_path / "r")
