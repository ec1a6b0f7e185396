"""Sphinx's settings for the site that ``make docs`` builds into out/docs.

The source folder is the root of the repository: links between docs/ and the other pages then
hold on the site as they do in a checkout.  Nothing is fetched while it builds or while it is read.
"""

from __future__ import annotations

import contextlib
import html
import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from sphinx.domains.python import PyObject  # noqa: E402

import ssdr  # noqa: E402
from docs import snippets  # noqa: E402

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
    "ssdr/io/samples/ORIGIN.md",
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


# Where the page of docs/gallery/live stands; without what that needs there is none.
DRESS = "<!-- live: dress -->"
_HAS_GARMENTNET = all(importlib.util.find_spec(name) for name in ("safetensors", "typer"))


def live_page(page: str, title: str) -> str:
    return (
        f'<iframe class="live" src="{page}" title="{html.escape(title)}" loading="lazy"></iframe>\n'
        f'<p class="live"><a href="{page}" target="_blank">This page alone</a></p>\n'
    )


def show_live_page(app: Any, name: str, source: list[str]) -> None:
    """On the site a live page takes the place of its picture or comment."""

    def frame(still: re.Match[str]) -> str:
        return live_page(f"{still['name']}.html", still["title"])

    if name.startswith("docs/gallery/"):
        source[0] = snippets.STILL.sub(frame, source[0], count=1)
    elif _HAS_GARMENTNET:
        source[0] = source[0].replace(DRESS, live_page("dress.html", "A dress that dances"))


def write_live_pages(app: Any, error: Exception | None) -> None:
    """The live pages are what the commands of the gallery write: these are run."""
    if error or app.builder.name != "html" or not app.config.live_pages:
        return
    for page in snippets.GALLERY:
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            snippets.prepare(page, Path(folder))
            for _ in snippets.run(page):
                pass
            still = snippets.STILL.search(page.read_text(encoding="utf-8"))
            assert still is not None, page
            shutil.copy(f"{still['name']}.html", Path(app.outdir, "docs", "gallery"))
    if _HAS_GARMENTNET:
        command = [sys.executable, "docs/gallery/live/page.py", "dress", "-o"]
        target = str(Path(app.outdir, "docs", "dress.html"))
        subprocess.run([*command, target], cwd=ROOT, check=True)


def setup(app: Any) -> None:
    app.add_config_value("live_pages", True, "", bool)
    app.connect("autodoc-process-docstring", fit_to_restructuredtext)
    app.connect("source-read", show_live_page)
    app.connect("build-finished", write_live_pages)
