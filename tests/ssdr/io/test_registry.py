"""The table of formats."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
import tomllib
from pathlib import Path

import pytest

import ssdr
from ssdr.io import FORMATS
from ssdr.io.optional import PACKAGES


def test_every_row_of_the_table_says_what_it_can():
    for suffix, row in FORMATS.items():
        assert suffix == suffix.lower()
        with contextlib.suppress(ssdr.MissingDependencyError):
            for name, stated in (
                ("read", True),
                ("read_skinning", row.reads_skinnings),
                ("list_clips", row.reads_skinnings or suffix == ".abc"),
                ("write_sequence", row.writes_sequences),
                ("write_skinning", row.writes_skinnings),
            ):
                assert (row.function(name) is not None) == stated


def test_the_page_on_formats_names_them_all():
    page = (Path(__file__).parents[3] / "docs" / "io.md").read_text(encoding="utf-8")
    table = page[page.index("| suffix") : page.index("Options of every format")]
    for suffix, row in FORMATS.items():
        line = next(line for line in table.splitlines() if f"`{suffix}`" in line)
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        able = [True, row.reads_skinnings, row.writes_sequences]
        assert [cell == "yes" for cell in cells[2:5]] == able
        assert cells[5]
        assert cells[6].startswith("" if row.extra is None else f"`ssdr[{row.extra}]`")


def test_a_missing_package_says_what_to_install(tmp_path, wave, monkeypatch):
    monkeypatch.setitem(sys.modules, "alembic3d", None)
    (tmp_path / "a.abc").write_bytes(b"Ogawa")
    for act in (lambda p: ssdr.load(p), lambda p: ssdr.save(wave, p)):
        with pytest.raises(ssdr.MissingDependencyError, match=r'pip install "alembic3d>=1\.8'):
            act(tmp_path / "a.abc")


def test_the_packages_to_install_are_those_of_the_extras():
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    for extra, (_, package) in PACKAGES.items():
        assert project["optional-dependencies"][extra] == [package]


def test_a_format_that_is_only_read_is_refused_before_the_work(tmp_path, wave, monkeypatch):
    only_read = dataclasses.replace(FORMATS[".npy"], writes_sequences=False)
    monkeypatch.setitem(FORMATS, ".rig", only_read)
    for act in (lambda p: ssdr.save(wave, p), lambda p: ssdr.io.check_outputs([p])):
        with pytest.raises(ssdr.InputError, match=r"expected a suffix of \.abc, .*, got .*a\.rig"):
            act(tmp_path / "a.rig")
