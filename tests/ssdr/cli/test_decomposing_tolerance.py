"""`ssdr decompose --tolerance`."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import ssdr
from helpers.command import model_of
from helpers.measures import small, wavy
from ssdr import cli, parsimony
from ssdr.cli.decomposing import _pruned_rows


def run(capsys: pytest.CaptureFixture[str], *arguments: Any) -> tuple[int, str, str]:
    code = cli.main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return code, out, err


@pytest.mark.filterwarnings("default")
def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, target = tmp_path / "in.npz", tmp_path / "out.npz"
    ssdr.save(ssdr.MeshSequence(wavy()), source)
    flags = ("--tolerance", "0.8%", "--effort", "fast")
    code, out, err = run(capsys, "decompose", source, "-o", target, *flags, "--json")
    assert (code, err) == (0, "")
    document = json.loads(out)
    assert document["held"] is True
    assert document["bones"] == small().skinning.n_bones
    assert document["rmse"] <= document["tolerance"]
    assert document["bytes"] == parsimony.size(ssdr.load_skinning(target)).total
    assert [p["what"] for p in document["prunings"]] == ["bones", "influences", "keyframes"]
    code, out, _ = run(capsys, "decompose", source, "-o", target, *flags, "-q", "--force")
    assert code == 0
    code, out, err = run(
        capsys,
        "decompose",
        source,
        "-o",
        target,
        "--tolerance",
        "0.01",
        "--bones",
        2,
        "--force",
        "--effort",
        "fast",
    )
    assert code == 0
    assert "2 bones of at most 4 influences reach a RMSE of" in err
    assert "not held" in out


@pytest.mark.parametrize(
    ("flags", "text"),
    [((), "--bones"), (("--tolerance", "half"), "such as"), (("--tolerance", "-1"), "such as")],
)
def test_command_refuses(
    flags: tuple[str, ...], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "in.npz"
    ssdr.save(ssdr.MeshSequence(wavy()), source)
    code, _, err = run(capsys, "decompose", source, "-o", tmp_path / "out.npz", *flags)
    assert code == 2
    assert text in err
    assert not (tmp_path / "out.npz").exists()


def test_the_size_says_what_it_is_of(wave: ssdr.MeshSequence) -> None:
    # "size 49,875 bytes" stood above "wrote 183 kB" without a word
    model = model_of(wave)
    found = SimpleNamespace(
        held=True,
        tolerance_of="rmse",
        error=0.1,
        tolerance=0.2,
        size=parsimony.size(model),
        prunings=[],
    )
    text = dict(_pruned_rows(SimpleNamespace(parsimony=found), 1.0))["size"]
    numbers = [int(n.replace(",", "")) for n in re.findall(r"[0-9][0-9,]*[0-9]", text)]
    assert numbers[0] == sum(numbers[1:]) == found.size.total
    assert "in an engine" in text
    assert "files hold more" in text
