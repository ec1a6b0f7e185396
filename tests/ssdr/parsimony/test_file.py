"""The smallest compact file for a tolerance: its bytes and its error, counted by reading it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

import ssdr
from helpers.measures import diagonal, small, wavy
from ssdr.space import UNKNOWN

FIND = "ssdr.parsimony.smallest.find_smallest"
QUANTIZED = {"compression": "quantized", "name": "wavy"}


def error_in(
    path: Path, model: ssdr.Skinning, measure: str = "rmse", space: Any = UNKNOWN
) -> float:
    """Error of the file's vertices, which come in another order, from those of `wavy`."""
    here = ssdr.io.in_space(ssdr.load_skinning(path), space).skin(dtype=np.float64)
    there = model.skin(dtype=np.float64)
    rows = [frames.transpose(1, 0, 2).reshape(frames.shape[1], -1) for frames in (there, here)]
    _, near = cKDTree(rows[0]).query(rows[1])
    assert sorted(near) == list(range(model.n_vertices))
    distance = np.linalg.norm(here - wavy()[:, near], axis=2)
    return float(distance.max() if measure == "max" else np.sqrt((distance**2).mean()))


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ({}, {}),
        ({}, {"tolerance": "1%", "weights": "uint16"}),
        ({"measure": "max"}, {"tolerance": "0.2%"}),
        ({"rig": "rigid"}, {"tolerance": "0.5%", "compression": "meshopt"}),
        ({"bone_model": "similarity"}, {"units": 0.01, "up": "z"}),
        ({"bone_model": "affine"}, {"tolerance": "0.5%"}),
    ],
)
def test_the_report_is_that_of_the_file(tmp_path: Path, kind: Any, options: Any) -> None:
    if "compression" in options:
        pytest.importorskip("meshoptimizer")
    file, path = {**QUANTIZED, **options}, tmp_path / "a.glb"
    tolerance = "3%" if "measure" in kind else "0.8%"
    result = ssdr.smallest(wavy(), tolerance=tolerance, effort="fast", file=file, **kind)
    found = result.parsimony
    assert found.file is not None
    ssdr.save(result, path, **file)
    assert found.file.bytes == len(path.read_bytes())
    space = ssdr.Space(options.get("units"), options.get("up"))
    read = error_in(path, result.skinning, found.measure, space)
    assert found.file.error == pytest.approx(read, rel=1e-4)
    assert found.held
    assert max(found.error, found.file.error) <= found.tolerance
    assert found.tolerance == pytest.approx(float(tolerance[:-1]) / 100 * diagonal(wavy()))
    assert found.size == ssdr.parsimony.size(result.skinning)


def test_without_a_file_a_coarse_one_misses_the_tolerance(tmp_path: Path) -> None:
    """The file's own tolerance comes on top of the model's error; with `file` both are one."""
    assert small().parsimony.file is None  # type: ignore[union-attr]
    file, path = {**QUANTIZED, "tolerance": "1.5%"}, tmp_path / "a.glb"
    limit = 0.008 * diagonal(wavy())
    ssdr.save(small(), path, **file)
    assert error_in(path, small().skinning) > limit
    result = ssdr.smallest(wavy(), tolerance="0.8%", effort="fast", file=file)
    ssdr.save(result, path, **file)
    assert error_in(path, result.skinning) <= limit


def test_the_smallest_file_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[tuple[int, float]] = []
    frames_file = ssdr.parsimony.solved_frames.SolvedFrames.file

    def spy(self: Any, skinning: ssdr.Skinning) -> Any:
        size = frames_file(self, skinning)
        written.append((size.bytes, size.error))
        return size

    monkeypatch.setattr(ssdr.parsimony.solved_frames.SolvedFrames, "file", spy)
    found = ssdr.smallest(wavy(), tolerance="0.8%", effort="fast", file=QUANTIZED).parsimony
    assert len(written) > 4
    assert found.file is not None
    assert found.file.bytes == min(size for size, error in written if error <= found.tolerance)
    assert found.file.bytes < max(size for size, _ in written)


def test_weights_too_coarse_for_the_file_are_said() -> None:
    file = {**QUANTIZED, "weights": "uint8", "tolerance": "0.0001%"}
    with pytest.warns(ssdr.SsdrWarning, match="too coarse"):
        result = ssdr.smallest(wavy(), tolerance="0.8%", effort="fast", file=file)
    found = result.parsimony
    assert found.file == ssdr.parsimony.FileSize(0, np.inf)
    assert not found.held
    assert found.error <= found.tolerance


@pytest.mark.parametrize(
    ("argument", "change"),
    [
        ("file", {"file": "a.glb"}),
        ("file", {"file": {"weights": "uint8"}}),
        ("compression", {"file": {"compression": "zip"}}),
        ("weights", {"file": {**QUANTIZED, "weights": "uint4"}}),
        ("options", {"file": {**QUANTIZED, "template": "a.glb"}}),
        ("influences", {"file": QUANTIZED, "influences": 9}),
    ],
)
def test_what_no_file_can_be_written_with_is_refused_before_the_work(
    monkeypatch: pytest.MonkeyPatch, argument: str, change: dict[str, Any]
) -> None:
    monkeypatch.setattr(FIND, lambda *_, **__: pytest.fail("the work has started"))
    with pytest.raises(ssdr.InputError) as caught:
        ssdr.smallest(wavy(), tolerance="1%", **change)
    assert caught.value.argument == argument


def test_a_missing_package_is_named_before_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "meshoptimizer", None)
    monkeypatch.setattr(FIND, lambda *_, **__: pytest.fail("the work has started"))
    with pytest.raises(ssdr.MissingDependencyError, match="meshoptimizer"):
        ssdr.smallest(wavy(), tolerance="1%", file={"compression": "meshopt"})
