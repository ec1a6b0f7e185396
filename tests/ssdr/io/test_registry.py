"""The table of formats."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import ssdr
from ssdr import FormatError, InputError
from ssdr.io import FORMATS
from ssdr.io.formats import option_names
from ssdr.io.optional import PACKAGES


def test_every_row_of_the_table_says_what_it_can():
    for suffix, row in FORMATS.items():
        assert suffix == suffix.lower()
        with contextlib.suppress(ssdr.MissingDependencyError):
            functions = row.functions()
            assert (functions.write_sequence is not None) == row.sequences
            assert (functions.write_skinning is not None) == row.skinnings
            assert (functions.read_skinning is not None) == row.skinnings
            assert (functions.list_clips is not None) == (row.skinnings or suffix == ".abc")
            read = set(option_names(functions.read))
            assert ("clip" in read, "meshes" in read) == (
                functions.list_clips is not None,
                functions.list_meshes is not None,
            )
    assert {s for s, row in FORMATS.items() if row.extra == "blender"} == {".fbx"}


def test_importing_the_package_imports_no_format():

    code = (
        "import ssdr, ssdr.io, sys; ssdr.io.load; "
        "print([m for m in ('trimesh', 'pxr', 'bpy', 'zarr', 'numba', 'alembic3d') "
        "if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_unknown_suffixes_name_those_that_are_known(tmp_path, wave):
    (tmp_path / "a.xyz").write_text("1 2 3")
    (tmp_path / "a").write_text("1 2 3")
    with pytest.raises(FormatError, match=r"a\.xyz: the suffix '\.xyz' is none of \.abc, .*\.zarr"):
        ssdr.load(tmp_path / "a.xyz")
    with pytest.raises(FormatError, match="a name without suffix"):
        ssdr.load(tmp_path / "a")
    with pytest.raises(InputError, match="path: expected a suffix of"):
        ssdr.save(wave, tmp_path / "b.xyz")
    with pytest.raises(InputError, match=r"path: expected a suffix of .* for a MeshSequence"):
        ssdr.save(wave, tmp_path / "b.glb")
    with pytest.raises(FormatError, match="no skinning can be read from"):
        ssdr.load_skinning(tmp_path / "a.obj")
    with pytest.raises(InputError, match="thing: expected a MeshSequence"):
        ssdr.save(wave.vertices, tmp_path / "b.npz")


def test_the_page_on_formats_names_them_all():
    page = (Path(__file__).parents[3] / "docs" / "io.md").read_text(encoding="utf-8")
    table = page[page.index("| suffix") : page.index("Options of every format")]
    for suffix, row in FORMATS.items():
        line = next(line for line in table.splitlines() if f"`{suffix}`" in line)
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        able = [True, row.skinnings, row.sequences]
        assert [cell == "yes" for cell in cells[2:5]] == able
        assert cells[5]
        needs = {None: "", "blender": "[Blender](#blender)"}
        assert cells[6].startswith(needs.get(row.extra, f"`ssdr[{row.extra}]`"))


def test_a_missing_package_says_what_to_install(tmp_path, wave, monkeypatch):
    monkeypatch.setitem(sys.modules, "zarr", None)
    (tmp_path / "a.zarr").mkdir()
    for act in (lambda p: ssdr.load(p), lambda p: ssdr.save(wave, p)):
        with pytest.raises(ssdr.MissingDependencyError, match=r'pip install "zarr>=3\.0"'):
            act(tmp_path / "a.zarr")


def test_the_packages_to_install_are_those_of_the_extras():
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    for extra, (_, package) in PACKAGES.items():
        assert project["optional-dependencies"][extra] == [package]


@pytest.mark.parametrize(
    ("name", "option", "words"),
    [
        ("a.glb", "influences", "an integer"),
        ("a.usda", "units", "metres in a unit"),
        ("a.pc2", "unweld", "true or false"),
    ],
)
@pytest.mark.parametrize("value", ["", "nan", "٣", "true", [], True], ids=str)
def test_an_option_is_of_the_kind_that_is_stated(name, option, words, value, skinned, tmp_path):
    """Text from a command line became an error of Python's."""
    if name == "a.usda":
        pytest.importorskip("pxr.UsdSkel")
    if (option, value) == ("unweld", True):
        value = 1
    with pytest.raises(InputError, match=f"{option}: expected"):
        ssdr.save(skinned, tmp_path / name, **{option: value})
    sample = ssdr.samples.path("dancer_small")
    with pytest.raises(InputError, match="max_bytes: expected an integer"):
        ssdr.load(sample, max_bytes=str(value))
    for other in (str(value), 1, 0, 1.0, None):
        with pytest.raises(InputError, match="mmap: expected true or false"):
            ssdr.load(sample, mmap=other)
