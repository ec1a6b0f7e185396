"""The blocks of a page, run from top to bottom as a reader would run them."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import textwrap
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

import ssdr
from docs.gallery import made
from ssdr.cli import main

__all__ = ["FENCE", "GALLERY", "STILL", "needing", "prepare", "run", "run_needing", "runs"]

ROOT = Path(__file__).resolve().parents[1]
GALLERY = sorted((ROOT / "docs" / "gallery").glob("*.md"))
FENCE = re.compile(r"^```(\S*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# The picture that stands for the live page ``name``.html, which the commands of its page write.
STILL = re.compile(r"!\[(?P<title>[^\]]*)\]\(\.\./images/gallery_(?P<name>\w+)\.webp\)")
_NEEDS = "# needs: "
_NEEDING = re.compile(
    rf"^( *)```python\n\1{_NEEDS}([^\n]*)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL
)


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of each fenced block of a page."""
    return FENCE.findall(page.read_text(encoding="utf-8"))


def runs(page: Path) -> bool:
    """Whether anything on a page runs."""
    return any(
        (language == "python" and not text.startswith(_NEEDS))
        or (language == "sh" and re.search(r"^ssdr ", text, re.MULTILINE))
        for language, text in blocks(page)
    )


def needing(page: Path) -> list[tuple[str, str]]:
    """What each block of a page needs that does not run by itself, and its text."""
    found = _NEEDING.findall(page.read_text(encoding="utf-8"))
    return [(need, textwrap.dedent(text)) for _, need, text in found]


def run_needing(text: str, names: Mapping[str, object], replaced: Mapping[str, str]) -> None:
    """Run a block in the working directory, with `names` and some words replaced by others."""
    for old, new in replaced.items():
        if old not in text:
            raise ValueError(f"{old} is not in the block")
        text = text.replace(old, new)
    exec(compile(text, "block", "exec"), {"__name__": "__main__", "np": np, "ssdr": ssdr, **names})


def prepare(page: Path, folder: Path) -> None:
    """Write the files that a page works on."""
    if page in GALLERY:
        made.write(folder)
        return
    sample = ssdr.samples.load("dancer_small")
    ssdr.save(sample, folder / "dance.npz")
    np.save(folder / "dance.npy", sample.vertices)
    np.save(folder / "faces.npy", sample.faces)
    (folder / "clips").mkdir()
    for k, part in enumerate((slice(0, 12), slice(12, 24))):
        np.save(folder / f"clips/{k}.npy", sample.vertices[part])


def run(page: Path) -> Iterator[tuple[str, str]]:
    """Run a page in the working directory; each text block, and what was printed before it.

    Python blocks share their names, from top to bottom; of ``sh`` blocks the lines run that call
    ``ssdr``.
    """
    names: dict[str, object] = {"__name__": "__main__"}
    printed = ""
    try:
        for language, text in blocks(page):
            if language == "python" and not text.startswith(_NEEDS):
                out = io.StringIO()
                with warnings.catch_warnings(), contextlib.redirect_stdout(out):
                    warnings.simplefilter("error")
                    exec(compile(text, page.name, "exec"), names)
                printed = out.getvalue()
            elif language == "text":
                yield text, printed
            elif language == "sh":
                printed = "".join(map(_command, text.replace("\\\n", " ").splitlines()))
    finally:
        ssdr.set_threads(None)


def _command(line: str) -> str:
    """What a line prints that calls ``ssdr``; others are not run."""
    words = shlex.split(line, comments=True)
    if words[:1] != ["ssdr"]:
        return ""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(words[1:])
    if code:
        raise RuntimeError(f"{line}\n{out.getvalue()}\n{err.getvalue()}")
    return out.getvalue()
