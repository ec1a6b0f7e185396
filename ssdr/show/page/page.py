"""A model and its input as one HTML file."""

from __future__ import annotations

import base64
import dataclasses
import html
import json
import tempfile
import webbrowser
from collections.abc import Sequence
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from ...io.atomic import atomic_path
from .payload import MAX_BYTES, Payload, payload

WEB = files(__package__) / "web"
# Joined into one script in this order: each may use the names of those before it.
PARTS = tuple(
    WEB / f"{name}.js"
    for name in (
        "data",
        "linear",
        "shaders",
        "renderer",
        "camera",
        "overlay",
        "strip",
        "panel",
        "keys",
    )
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Page:
    """A page that was written.

    Attributes
    ----------
    path : Path
    bytes : int
        Size of the file.
    frames : int
        Number of frames that the page holds.
    notes : tuple of str
        What was left out or made smaller, in words.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> page = ssdr.view(dancer, path="dancer.html")
    >>> page.frames, page.notes
    (24, ())
    """

    path: Path
    bytes: int
    frames: int
    notes: tuple[str, ...]


def view(
    model: Any,
    reference: Any = None,
    path: Path | str | None = None,
    *,
    title: str | None = None,
    up: str = "y",
    file: Path | str | None = None,
    reference_name: str = "",
    max_bytes: int = MAX_BYTES,
) -> Page:
    """Write a page that shows a model or a sequence beside a reference; open it in the browser.

    The page is one HTML file with everything in it. It needs no network and can be sent by mail.
    It plays the animation, lights it as engines do, compares it with the input, colours it by
    texture, bone, weight, error or error of normals, and rotates the joints of a rigid hierarchy.

    Parameters
    ----------
    model : Skinning, Decomposition or MeshSequence
    reference : MeshSequence, a list of them, or (F, V, 3) array, optional
        The true animation: the error is measured against it, and the page shows it beside the
        model. It has the vertices of the model, or those before the model's welding.
    path : path, optional
        The file to write; by default a temporary file, which is opened in the browser.
    title : str, optional
        Heading of the page; the name of the model by default.
    up : {"x", "y", "z", "-x", "-y", "-z"}
        The axis that points up.
    file : path, optional
        File of the model, whose size the page states.
    reference_name : str
        Where `reference` comes from, in words.
    max_bytes : int
        Largest size of the page. Frames are left out of a model that needs more.

    Returns
    -------
    Page

    Raises
    ------
    InputError
        If the reference does not match the model, an argument is not valid, or `max_bytes` is
        too little for a single frame.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> result = ssdr.decompose(dancer, bones=4, effort="fast")
    >>> page = ssdr.view(result, dancer, "result.html")
    >>> page.path.name, page.frames
    ('result.html', 24)
    """
    text, content = page_text(
        model,
        reference,
        title=title,
        up=up,
        file=file,
        reference_name=reference_name,
        max_bytes=max_bytes,
    )
    shown = path is None
    if path is None:
        path = Path(tempfile.mkdtemp(prefix="ssdr-")) / "page.html"
    target = Path(path)
    with atomic_path(target) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    if shown:
        webbrowser.open(target.resolve().as_uri())
    return Page(
        path=target,
        bytes=target.stat().st_size,
        frames=content.document["frames"],
        notes=content.notes,
    )


def page_text(model: Any, reference: Any = None, **options: Any) -> tuple[str, Payload]:
    """HTML text of a page, and its Payload; parameters and errors are those of :func:`payload`."""
    content = payload(model, reference, **options)
    scripts = (*PARTS, WEB / "main.js", WEB / "pair.js")
    return assembled(content.document, content.blocks, scripts), content


def assembled(
    document: dict[str, Any],
    blocks: Sequence[bytes],
    scripts: Sequence[Traversable],
    *,
    styles: Sequence[Traversable] = (WEB / "page.css",),
    panel: Traversable | None = None,
) -> str:
    """HTML of a page: the template with style, script and data inserted.

    `panel` is a file with an ``<aside>`` that replaces the template's.
    """

    def read(parts: Sequence[Traversable]) -> str:
        return "\n".join(part.read_text(encoding="utf-8") for part in parts)

    # Without "<", no name in the document can end the element or open a comment in it.
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    kind = "application/octet-stream;base64"
    data = "\n".join(
        f'<script type="{kind}" id="block{k}">{base64.b64encode(block).decode()}</script>'
        for k, block in enumerate(blocks)
    )
    parts = {
        "title": html.escape(document["title"].encode("utf-8", "replace").decode()),
        "style": f"<style>\n{read(styles)}</style>",
        "data": f'<script type="application/json" id="document">{text}</script>\n{data}',
        "script": f'<script>\n(() => {{\n"use strict";\n{read(scripts)}\n}})();\n</script>',
    }
    template = read([WEB / "page.html"])
    if panel is not None:
        before, _, rest = template.partition("<aside")
        template = before + read([panel]) + rest.partition("</aside>")[2]
    pieces = template.split("<!-- ssdr: ")
    return pieces[0] + "".join(
        parts[name] + rest for name, _, rest in (piece.partition(" -->") for piece in pieces[1:])
    )
