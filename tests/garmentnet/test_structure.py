"""The package's tree: imports run one way, folders and modules stay small."""

from __future__ import annotations

import ast
import graphlib
from pathlib import Path

import garmentnet

ROOT = Path(garmentnet.__path__[0])
# Lower folders know nothing of higher ones; "" is the root, which only starts the command.
LAYERS = (
    ("io",),
    ("configs",),
    ("data",),
    ("collision", "drawing"),
    ("networks", "paper", "training"),  # what learns; no module of them imports itself by others
    ("importing", "runtime"),
    ("evaluation", "prediction"),
    ("cli",),
    ("",),
)


def name_of(path: Path) -> str:
    parts = ["garmentnet", *path.relative_to(ROOT).with_suffix("").parts]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in sorted(ROOT.rglob("*.py"))}


def imports(name: str) -> set[str]:
    """Modules of the package that one imports, inside functions too."""
    path, found = MODULES[name], set()
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1]
            start = [*above] if node.level else []
            base = ".".join([*start, *([node.module] if node.module else [])])
            found |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
    return {m for m in found if m in MODULES and m not in (name, package)}


def test_no_module_imports_itself_by_way_of_others() -> None:
    arrows = {name: imports(name) for name in MODULES}
    tuple(graphlib.TopologicalSorter(arrows).static_order())  # raises CycleError, which names it


def test_folders_import_lower_folders_only() -> None:
    level = {folder: k for k, layer in enumerate(LAYERS) for folder in layer}
    for name, path in MODULES.items():
        folder = path.parent.relative_to(ROOT).as_posix().replace(".", "")
        for other in imports(name):
            target = MODULES[other].parent.relative_to(ROOT).as_posix().replace(".", "")
            fits = level[target] <= level[folder] == level["paper"] or level[target] < level[folder]
            assert fits or target == folder, f"{name} imports {other}"


def test_folders_and_modules_stay_small() -> None:
    for folder in {path.parent for path in MODULES.values()}:
        files = [p for p in folder.iterdir() if p.is_file()]
        assert len(files) <= 13, folder
    for path in MODULES.values():
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 420, path
