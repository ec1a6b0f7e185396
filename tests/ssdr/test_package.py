"""What a user meets before any computation: the import, the names, the wheel."""

from __future__ import annotations

import inspect
import itertools
import json
import pkgutil
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

import ssdr
from ssdr import InputError
from ssdr.io import samples

ROOT = Path(__file__).resolve().parents[2]
HEAVY = {
    "bpy",
    "garmentnet",
    "matplotlib",
    "numba",
    "numpy",
    "pxr",
    "scipy",
    "torch",
    "trimesh",
    "viser",
}
NEEDED = {"numba", "numpy", "scipy", "trimesh"}  # once something is computed or read


def _run(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=600
    )
    return done.stdout


def _project(folder: str = ".") -> dict[str, Any]:
    return tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"]


def test_import_is_light_and_the_solver_needs_no_viewer_nor_torch() -> None:
    light, whole = json.loads(
        _run(
            "import json, sys\n"
            "before = {*sys.modules}\n"
            "import ssdr\n"
            "light = {*sys.modules} - before\n"
            "ssdr.skin, ssdr.MeshSequence, ssdr.decompose, ssdr.metrics, ssdr.load\n"
            "print(json.dumps([[*light], [*sys.modules]]))"
        )
    )
    assert {name.split(".")[0] for name in light} - sys.stdlib_module_names == {"ssdr"}
    assert not HEAVY - NEEDED & {name.split(".")[0] for name in whole}


def test_version_agrees_everywhere() -> None:
    project = _project()
    assert ssdr.__version__ == project["version"]
    assert f"version: {ssdr.__version__}" in (ROOT / "CITATION.cff").read_text()
    assert f"## [{ssdr.__version__}]" in (ROOT / "CHANGELOG.md").read_text()
    second = _project("garmentnet")
    assert second["version"] == project["version"]
    (needs,) = (r for r in map(Requirement, second["dependencies"]) if r.name == "ssdr")
    assert ssdr.__version__ in needs.specifier


def test_public_names_resolve_and_are_listed_once_and_sorted() -> None:
    assert all(getattr(ssdr, name) is not None for name in ssdr.__all__)
    assert ssdr.__all__ == sorted(ssdr.__all__)
    assert len(set(ssdr.__all__)) == len(ssdr.__all__)
    assert dir(ssdr) == ssdr.__all__


def test_the_readme_and_the_page_on_installing_name_the_extras() -> None:
    extras = set(_project()["optional-dependencies"])
    page, readme = ((ROOT / name).read_text() for name in ("docs/install.md", "README.md"))
    assert {name for name in extras if f"| `{name}` |" in page} == extras
    for_users = extras - {"bench", "docs", "dev"}
    assert {name for name in for_users if f"`{name}`" in readme} == for_users


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = ssdr.no_such_name


def test_no_module_has_the_name_of_a_public_function() -> None:
    modules = {module.name for module in pkgutil.iter_modules(ssdr.__path__)}
    functions = {n for n in ssdr.__all__ if inspect.isfunction(getattr(ssdr, n))}
    assert functions
    assert not modules & functions


def test_optional_packages_are_not_required() -> None:
    required = _project()["dependencies"]
    for package in ("garmentnet", "torch", "bpy", "usd-core", "scikit-sparse", "zarr"):
        assert not any(text.startswith(package) for text in required)


@pytest.mark.parametrize(("name", "shape"), [("dancer", (72, 4202)), ("dancer_small", (24, 799))])
def test_a_sample_is_a_closed_mesh(name: str, shape: tuple[int, int]) -> None:
    sequence = samples.load(name)
    assert (sequence.n_frames, sequence.n_vertices) == shape
    assert sequence.vertices.dtype == np.float32
    faces = sequence.faces
    assert np.unique(faces).size == sequence.n_vertices
    # Closed and consistently wound: each edge once in each direction.
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert np.unique(directed, axis=0).shape == directed.shape
    assert {tuple(e) for e in directed} == {tuple(e[::-1]) for e in directed}


def test_samples_are_small_and_named() -> None:
    assert samples.names() == ("dancer", "dancer_small")
    assert sum(samples.path(name).stat().st_size for name in samples.names()) < 3_000_000
    with pytest.raises(InputError, match=r"dancer_small.*'tube'"):
        samples.path("tube")
    origin = samples.path().with_name("ORIGIN.md").read_text()
    for name in samples.names():
        assert name in origin


def test_constraints_agree_with_the_package() -> None:
    """Each pin names a package that the project asks for, within the range that it asks for."""
    asked: dict[str, list[SpecifierSet]] = {}
    for project in (_project(), _project("garmentnet")):
        extras = project["optional-dependencies"].values()
        for text in itertools.chain(project["dependencies"], *extras):
            requirement = Requirement(text)
            asked.setdefault(requirement.name, []).append(requirement.specifier)
    for line in (ROOT / ".ci" / "constraints.txt").read_text().splitlines():
        if not line or line.startswith("#"):
            continue
        name, version = line.split("==")
        assert name in asked, f"{name} is pinned but never asked for"
        assert all(version in specifier for specifier in asked[name])


def test_garmentnet_names_each_of_its_packages() -> None:
    """Its pyproject.toml lies in the package itself, where none is found by searching."""
    setup = tomllib.loads((ROOT / "garmentnet" / "pyproject.toml").read_text())["tool"][
        "setuptools"
    ]
    inside = ROOT / "garmentnet"  # folders of settings and models count, too: else setuptools warns
    files = [f for end in ("toml", "safetensors") for f in inside.glob(f"*/**/*.{end}")]
    files += inside.rglob("__init__.py")
    folders = {path.parent.relative_to(ROOT) for path in files}
    assert setup["packages"] == sorted(".".join(f.parts) for f in folders if "build" not in f.parts)
    assert (ROOT / "garmentnet" / "LICENSE").read_text() == (ROOT / "LICENSE").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("package", ["ssdr", "garmentnet"])
def test_wheel_holds_the_package_and_nothing_else(package: str, tmp_path: Path) -> None:
    tree, out = tmp_path / "tree", tmp_path / "out"
    tree.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    clean = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
    for name in ("ssdr", "garmentnet"):
        shutil.copytree(ROOT / name, tree / name, ignore=clean)
    place = tree if package == "ssdr" else tree / package
    done = subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(out), str(place)],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    if done.returncode and "No matching distribution found for setuptools" in done.stderr:
        pytest.skip("no network to fetch the build backend")
    assert done.returncode == 0, done.stderr
    (wheel,) = out.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
    tops = {name.split("/")[0] for name in held}
    info = f"{package}-{ssdr.__version__}.dist-info"
    assert tops == {package, info}
    sources = {str(path.relative_to(tree)) for path in (tree / package).rglob("*.py")}
    assert {name for name in sources if "/build/" not in name} == {
        name for name in held if name.endswith(".py")
    }
    data = {
        "ssdr": ("py.typed", "__init__.pyi", "io/samples/dancer.npz", "io/samples/ORIGIN.md"),
        "garmentnet": (
            "py.typed",
            "configs/tiny.toml",
            "models/dance.npz",
        ),
    }
    for name in data[package]:
        assert f"{package}/{name}" in held
    assert f"{info}/licenses/LICENSE" in held
    assert not [name for name in held if name.endswith((".pyc", ".nbi", ".nbc"))]


def test_setup_looks_for_the_pythons_of_the_classifiers() -> None:
    named = re.compile(r"Programming Language :: Python :: (3\.\d+)")
    classified = [m[1] for text in _project()["classifiers"] if (m := named.fullmatch(text))]
    setup = (ROOT / ".ci" / "setup.sh").read_text()
    candidates = re.search(r"for candidate in (.*) python3 python;", setup)
    assert candidates is not None
    assert candidates[1].split() == [f"python{version}" for version in reversed(classified)]
