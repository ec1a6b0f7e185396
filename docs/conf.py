"""Sphinx's settings for the site that ``make docs`` builds into out/docs.

The source folder is the root of the repository: links between docs/, benchmarks/ and the
other pages then hold on the site as they do in a checkout.  Nothing is fetched while it builds
or while it is read.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from sphinx.domains.python import PyObject  # noqa: E402

import ssdr  # noqa: E402

project = "ssdr"
author = "The ssdr developers"
release = version = ssdr.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
]
root_doc = "docs/index"
include_patterns = [
    "docs/**.md",
    "benchmarks/README.md",
    "ssdr/samples/ORIGIN.md",
    "CHANGELOG.md",
]
exclude_patterns = ["out", "build", "dist", ".*", "tests"]

myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings state types, with their shapes
maximum_signature_line_length = 80
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"ssdr {release}"
html_static_path = ["site/style.css"]
html_css_files = ["style.css"]
html_extra_path = ["site/index.html"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False


for field in PyObject.doc_field_types:
    if field.name == "variable":
        field.label = "Attributes"


def fit_to_restructuredtext(
    app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    """Two things that the docstrings write mean something else in reStructuredText.

    A norm |d| is a substitution there, and ``:ivar a, b:`` an attribute b of type a.
    """
    example = False
    for k, line in enumerate(lines):
        example = line.lstrip().startswith(">>>") or (example and bool(line.strip()))
        if example:
            continue
        line = re.sub(r"^:(ivar|vartype) [\w, ]+:", lambda m: m[0].replace(", ", ","), line)
        pieces = re.split(r"(``.*?``)", line)
        pieces[::2] = [piece.replace("|", r"\|") for piece in pieces[::2]]
        lines[k] = "".join(pieces)


def setup(app: Any) -> None:
    app.connect("autodoc-process-docstring", fit_to_restructuredtext)
