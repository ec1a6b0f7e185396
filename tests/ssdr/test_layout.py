"""The tree of ssdr: few entries at its root, and no import that comes back to where it began."""

from __future__ import annotations

import ast
import graphlib
from pathlib import Path

import ssdr

ROOT = Path(ssdr.__file__).parent
MODULES = {
    ".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__"): path
    for path in ROOT.rglob("*.py")
}


def _imported(name: str, path: Path) -> set[str]:
    """Modules of ssdr that a module imports anywhere, in functions and for type checkers, too."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            above = package.split(".")[: package.count(".") + 2 - node.level] if node.level else []
            source = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                both = f"{source}.{alias.name}"
                found.add(both if both in MODULES else source)
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {module for module in found if module in MODULES and module != name}


def test_nothing_imports_in_a_circle() -> None:
    arrows = {name: _imported(name, path) for name, path in MODULES.items()}
    assert sum(map(len, arrows.values())) > len(MODULES)
    tuple(graphlib.TopologicalSorter(arrows).static_order())  # raises CycleError, which names it


def test_folders_point_downward_only() -> None:
    def top(name: str) -> str:
        return name.split(".")[1] if "." in name else ""

    arrows: dict[str, set[str]] = {}
    for name, path in MODULES.items():
        arrows.setdefault(top(name), set()).update(top(x) for x in _imported(name, path))
    for name, below in arrows.items():
        below -= {name, ""}
    tuple(graphlib.TopologicalSorter(arrows).static_order())


def test_the_root_has_few_entries() -> None:
    entries = {p.name for p in ROOT.iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()}
    assert len(entries) <= 16, sorted(entries)
