"""A minute of benchmarks/robustness/fuzz.py: damaged files are refused or give finite arrays."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import ssdr
from benchmarks.robustness import fuzz

pytest.importorskip("zarr")
pytest.importorskip("pxr")


@pytest.fixture(scope="module")
def kinds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, fuzz.Sample]:
    return fuzz.samples(tmp_path_factory.mktemp("samples"))


def test_samples_are_read_and_cover_the_formats(kinds: dict[str, fuzz.Sample]) -> None:
    for name, sample in kinds.items():
        assert fuzz.unsound(sample.read(sample.path)) == "", name
    # what is missing needs Blender; .usd is .usdc by another name
    suffixes = {part.suffix for sample in kinds.values() for part in [sample.path, *sample.parts]}
    assert set(ssdr.io.registry.FORMATS) - suffixes <= {".abc", ".fbx", ".usd"}


@pytest.mark.parametrize("first", range(0, 600, 100))
def test_damaged_files(first: int, kinds: dict[str, fuzz.Sample], tmp_path: Path) -> None:
    cases = [fuzz.try_case(first + k, kinds, tmp_path / "case") for k in range(100)]
    assert [case for case in cases if case["fault"]] == []
    outcomes = [case["outcome"] for case in cases]
    assert outcomes.count("refused") > 50
    assert outcomes.count("read") > 2
    assert len({case["format"] for case in cases}) > 10


def test_the_fuzz_can_fail(kinds: dict[str, fuzz.Sample], tmp_path: Path) -> None:
    def broken(path: Path) -> ssdr.MeshSequence:
        good = kinds["npy"].read(kinds["npy"].path)
        bad = np.array(good.vertices)
        bad[0, 0, 0] = np.nan
        object.__setattr__(good, "vertices", bad)
        return good

    def careless(path: Path) -> object:
        return json.loads(path.read_bytes())

    def nameless(path: Path) -> object:
        raise ssdr.FormatError("something is wrong")

    for read, says in ((broken, "not finite"), (careless, "Error"), (nameless, "does not name")):
        spoiled = {"npy": dataclasses.replace(kinds["npy"], read=read)}
        assert says in fuzz.try_case(0, spoiled, tmp_path / "case")["fault"]
