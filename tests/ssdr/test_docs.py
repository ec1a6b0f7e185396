"""The pages are true: links lead somewhere, snippets run, every public name is described."""

from __future__ import annotations

import contextlib
import inspect
import math
import os
import posixpath
import re
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from docs import snippets

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
SITE = sorted(
    [
        *DOCS.glob("**/*.md"),
        ROOT / "CHANGELOG.md",
        ROOT / "ssdr" / "io" / "samples" / "ORIGIN.md",
    ]
)
PAGES = sorted({*ROOT.glob("*.md"), *SITE})
_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
_NUMBER = re.compile(r"\d+\.\d+(?:e[-+]?\d+)?")
_SIZE = re.compile(r"(\d+\.\d+) [kM]B\b")
# Every figure of these is what a command beside it prints.  Where the processor rounds differently
# a search may end elsewhere: only `make docs`, run where the pages are written, wants them exact.
FIRST_PAGES = [ROOT / "README.md", DOCS / "getting-started.md", *snippets.GALLERY]
EXACT = bool(os.environ.get("SSDR_EXACT_DOCS"))


def _name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def _text(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def _prose(page: Path) -> str:
    return snippets.FENCE.sub("", _text(page))


def _links(page: Path) -> list[str]:
    return [x for x in _LINK.findall(_prose(page)) if not re.match(r"(https?|mailto):", x)]


def _target(page: Path, link: str) -> Path:
    name = link.partition("#")[0]
    return (page.parent / name).resolve() if name else page


def _anchor(heading: str) -> str:
    text = re.sub(r"[^\w\- ]", "", heading.replace("`", "").strip().lower())
    return text.replace(" ", "-")


def _anchors(page: Path) -> set[str]:
    return {_anchor(h) for h in re.findall(r"^#+ (.*)$", _prose(page), re.MULTILINE)}


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_links_lead_somewhere(page: Path) -> None:
    for link in _links(page):
        target, fragment = _target(page, link), link.partition("#")[2]
        assert target.exists(), f"{page.name}: {link}"
        assert ROOT in target.parents, f"{page.name}: {link} leaves the repository"
        if fragment and target.suffix == ".md":
            assert fragment in _anchors(target), f"{page.name}: {link}"


def _entries(page: Path) -> list[str]:
    """Pages in a page's tables of contents, from the repository's root, without suffix."""
    folder = posixpath.dirname(_name(page))
    return [
        posixpath.normpath(posixpath.join(folder, line))
        for language, text in snippets.FENCE.findall(_text(page))
        if language == "{toctree}"
        for line in text.split("\n\n", 1)[1].split()
    ]


def test_every_page_is_in_the_table_of_contents() -> None:
    named = {_name(page).removesuffix(".md"): page for page in SITE}
    seen, new = set(), {"docs/index"}
    while new:
        seen |= new
        new = {entry for name in new for entry in _entries(named[name])} - seen
        assert new <= set(named)
    assert seen == set(named)


@pytest.mark.parametrize("page", [p for p in SITE if _entries(p)], ids=_name)
def test_what_the_contents_list_is_linked_in_the_text(page: Path) -> None:
    """Who reads the page itself, and not the site, finds the way as well."""
    linked = {_name(_target(page, link)).removesuffix(".md") for link in _links(page)}
    assert set(_entries(page)) <= linked


@pytest.mark.parametrize("page", SITE, ids=_name)
def test_files_that_are_named_exist(page: Path) -> None:
    named = set(
        re.findall(r"\b(?:benchmarks|docs|tests)/[\w/.-]+\.(?:py|md|json|csv)\b", _text(page))
    )
    assert {name for name in named if not (ROOT / name).exists()} == set()


def test_every_picture_is_shown() -> None:
    shown = {_target(page, link) for page in PAGES for link in _links(page)}
    assert {p for p in (DOCS / "images").iterdir() if p not in shown} == set()


def _same_line(said: str, printed: str, tolerance: float, sizes: float) -> bool:
    """Words and whole numbers alike, numbers with a decimal point to a relative tolerance.

    `sizes` is that of a number of kB or MB, beside half of its last digit.
    """
    words = [" ".join(_NUMBER.sub("#", text).split()) for text in (said, printed)]
    numbers, bytes_ = (
        [[float(x) for x in pattern.findall(text)] for text in (said, printed)]
        for pattern in (_NUMBER, _SIZE)
    )
    return (
        words[0] == words[1]
        and all(math.isclose(a, b, rel_tol=tolerance) for a, b in zip(*numbers, strict=True))
        and all(
            math.isclose(a, b, rel_tol=sizes, abs_tol=0.05) for a, b in zip(*bytes_, strict=True)
        )
    )


def _same_output(said: str, printed: str, tolerance: float, sizes: float = 0.5) -> bool:
    """The same lines in the same order; a line ``...`` says that some are left out."""
    lines = [line for line in said.splitlines() if line != "..."]
    rest = iter(printed.splitlines())
    found = all(any(_same_line(line, other, tolerance, sizes) for other in rest) for line in lines)
    return found and ("..." in said.splitlines() or len(lines) == len(printed.splitlines()))


def test_output_is_compared_line_by_line() -> None:
    printed = "model  24 bones\nRMSE   0.514 mm\n"
    assert _same_output("model 24 bones\nRMSE 0.513 mm\n", printed, 0.02)
    assert _same_output("...\nRMSE 0.51 mm\n", printed, 0.02)
    assert not _same_output("RMSE 0.51 mm\n", printed, 0.02)
    assert not _same_output("...\nRMSE 0.46 mm\n", printed, 0.02)
    assert not _same_output("...\nRMSE 0.51 mm\nmodel 24 bones\n", printed, 0.02)
    assert not _same_output("model 23 bones\n...\n", printed, 0.02)
    assert _same_output("a.glb, 315.2 kB\n", "a.glb, 316.0 kB\n", 0.5, 0.02)
    assert _same_output("a.glb, 315.2 kB\n", "a.glb, 330.1 kB\n", 0.5)
    assert not _same_output("a.glb, 315.2 kB\n", "a.glb, 330.1 kB\n", 0.5, 0.02)


@pytest.mark.parametrize("page", FIRST_PAGES, ids=_name)
def test_every_figure_is_an_output_or_comes_from_a_record(page: Path) -> None:
    recorded = r"<!-- (\w+) -->.*?<!-- end \1 -->|<!--\w[\w ]*-->.*?<!--/-->"
    text = re.sub(recorded, "", _prose(page), flags=re.DOTALL)
    text = re.sub(r"`[^`]*`|\bdoi:\S+|\(http[^)]*\)|Python 3\.11(?: to 3\.13)?", "", text)
    assert _NUMBER.findall(text) == []


@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in PAGES if snippets.runs(p)], ids=_name)
def test_snippets_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python blocks share their names, from top to bottom; lines that call ``ssdr`` run as well.

    A text block is what the block before it prints.
    """
    monkeypatch.chdir(tmp_path)
    snippets.prepare(page, tmp_path)
    for said, printed in snippets.run(page):
        tolerance = 0.02 if EXACT and page in FIRST_PAGES else 0.5
        # The bytes of README's model follow from its counts, wherever the search ends.
        sizes = 0.02 if page == ROOT / "README.md" else tolerance
        assert _same_output(said, printed, tolerance, sizes), f"{said}\nis now\n{printed}"
    if page in snippets.GALLERY:
        shown = snippets.STILL.search(_text(page))
        assert shown is not None
        assert (tmp_path / f"{shown['name']}.html").exists()


def _cluster(stack: contextlib.ExitStack) -> tuple[dict[str, object], dict[str, str]]:
    zarr = pytest.importorskip("zarr", reason="zarr is missing: pip install zarr")
    distributed = pytest.importorskip(
        "distributed", reason='Dask is missing: pip install ".[dask]"', exc_type=ImportError
    )
    made = distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, silence_logs=50
    )
    stack.enter_context(made)
    stack.callback(lambda: distributed.default_client().close())
    zarr.create_array("dance.zarr", data=SAMPLE.vertices, chunks=(8, *SAMPLE.vertices.shape[1:]))
    words = {"tcp://scheduler:8786": made.scheduler_address, "/shared/": "", "bones=80": "bones=8"}
    return {"faces": SAMPLE.faces}, words


def _mask(_: contextlib.ExitStack) -> tuple[dict[str, object], dict[str, str]]:
    lips = np.arange(SAMPLE.n_vertices) < 9
    return {"face": SAMPLE, "lips": lips}, {"bones=16": 'bones=4, effort="fast"'}


def _template(_: contextlib.ExitStack) -> tuple[dict[str, object], dict[str, str]]:
    result = ssdr.initialize(SAMPLE, bones=4)
    ssdr.save(result, "in.glb")
    return {"result": result}, {}


def _expressions(_: contextlib.ExitStack) -> tuple[dict[str, object], dict[str, str]]:
    rest = SAMPLE.vertices[0]
    ssdr.save(ssdr.decompose_expressions(rest, [rest + 1, 2 * rest], bones=2), "face.npz")
    return {}, {}


def _torch(_: contextlib.ExitStack) -> tuple[dict[str, object], dict[str, str]]:
    pytest.importorskip("torch", reason="torch is not installed")
    return {}, {}


SAMPLE = ssdr.samples.load("dancer_small")
# What blocks need that do not run by themselves, made small: names, and words to replace.
NEEDS = {
    "a Dask cluster": _cluster,
    "a mask of your own": _mask,
    "the file in.glb that the result was made from": _template,
    "a face as face.npz": _expressions,
    "torch": _torch,
}
# Those of garmentnet's own pages run in its tests.
NEEDING = [
    pytest.param(need, text, id=f"{page.stem}-{need.split(',')[0]}")
    for page in PAGES
    if not page.name.startswith("garmentnet")
    for need, text in snippets.needing(page)
]


@pytest.mark.slow
@pytest.mark.parametrize(("need", "text"), NEEDING)
@pytest.mark.filterwarnings("ignore::ResourceWarning")  # of Dask's event loops
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_blocks_run_where_what_they_need_is_there(
    need: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with contextlib.ExitStack() as stack:
        snippets.run_needing(text, *NEEDS[need](stack))


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_no_python_block_is_hidden_from_these_tests(page: Path) -> None:
    """One in a list is indented, and runs only as one that needs something."""
    indented = re.findall(r"^ +```python\n(?! *# needs: )", _text(page), re.MULTILINE)
    assert not indented
    said = re.findall(r"^ *# needs: ", _text(page), re.MULTILINE)
    assert len(snippets.needing(page)) == len(said)


MODULES = [m for n in ssdr.__all__ if inspect.ismodule(m := getattr(ssdr, n))]


def _described() -> tuple[set[str], set[str]]:
    """Modules described as a whole, and single names, in the pages of the API."""
    text = "\n".join(map(_text, DOCS.glob("api/*.md")))
    single = re.findall(r"^\.\. auto(?:function|class|data):: ([\w.]+)", text, re.M)
    data = re.findall(r"^\.\. py:data:: (\S+)\n +:module: (\S+)", text, re.M)
    modules = re.findall(r"^\.\. automodule:: (\S+)", text, re.M)
    return set(modules), {*single, *(f"{module}.{name}" for name, module in data)}


def _thing(path: str) -> Any:
    module, _, name = path.rpartition(".")
    return getattr(__import__(module, fromlist=[name]), name)


def test_every_public_name_is_in_the_api() -> None:
    modules, single = _described()
    assert modules == {m.__name__ for m in MODULES}
    things = [_thing(path) for path in single]
    for module in MODULES:
        for name in module.__all__:
            thing = getattr(module, name)
            if (inspect.isclass(thing) or inspect.isfunction(thing)) and inspect.getdoc(thing):
                things.append(thing)
            else:  # has no docstring of its own
                assert f"{module.__name__}.{name}" in single
    left = set(ssdr.__all__) - {"__version__"} - {m.__name__.rpartition(".")[2] for m in MODULES}
    assert [n for n in sorted(left) if not any(getattr(ssdr, n) is t for t in things)] == []


def test_each_part_of_the_api_is_one_page() -> None:
    linked = {_name(_target(DOCS / "api.md", link)) for link in _links(DOCS / "api.md")}
    assert linked >= {_name(p) for p in DOCS.glob("api/*.md")}


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_holds_all_that_it_needs(tmp_path: Path) -> None:
    for package in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(package, reason=f'{package} is missing: pip install ".[docs]"')
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "-c", "docs",
         "-D", "live_pages=0", "-d", str(tmp_path / "cache"), ".", str(tmp_path / "site")],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    fetched = re.compile(
        r"<(?:script|img|iframe|source)\b[^>]*\bsrc=\"(?:https?:)?//"
        r"|<link\b(?![^>]*rel=\"(?:canonical|next|prev)\")[^>]*\bhref=\"(?:https?:)?//"
    )
    pages = list((tmp_path / "site").glob("**/*.html"))
    assert len(pages) > len(SITE)
    for page in pages:
        assert not fetched.search(_text(page)), page
    for style in (tmp_path / "site").glob("**/*.css"):
        assert not re.search(r"@import|url\(\"?(?:https?:)?//", _text(style)), style
    listed = (tmp_path / "site" / "objects.inv").read_bytes().split(b"\n", 4)[4]
    names = {line.split()[0] for line in zlib.decompress(listed).decode().splitlines()}
    wanted = {f"{m.__name__}.{n}" for m in MODULES for n in m.__all__} | _described()[1]
    assert wanted <= names
