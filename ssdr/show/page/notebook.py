"""Display of a sequence or a model in a notebook: its page in a frame."""

from __future__ import annotations

import html
import logging
from typing import Any

from ...mesh.sequence import MeshSequence
from ...model.shapes import Skinned
from ...model.skinning import skinning_in

_PAGE_BYTES = 3_000_000  # of a page in a frame: the notebook keeps it in its file
_PAGE_VERTICES = 2_000_000  # of all frames; more would let the reader wait for seconds
_HEIGHT = 480
_log = logging.getLogger(__name__)


def notebook_html(thing: Any) -> str:
    """HTML of a ``MeshSequence``, ``Skinning`` or ``Decomposition`` for a notebook; never raises.

    The page of :func:`ssdr.view` in a frame if it has at most 3 MB and all frames together have at
    most 2 million vertices.  Below it stands the text that ``repr`` gives and, where there is no
    page, how to get one.
    """
    subject = skinning_in(thing)
    shown = ""
    try:
        shown = _frame(subject)
    except Exception:  # a cell that shows its value must not fail
        _log.debug("the page of a notebook", exc_info=True)
    words = html.escape(repr(thing))
    if not shown:
        words += "<br>Its page would be large here: <code>ssdr.view(...)</code> opens it by itself."
    return f'<div style="max-width:1100px">{shown}<div>{words}</div></div>'


def _frame(subject: MeshSequence | Skinned) -> str:
    """An ``<iframe>`` that holds the page; empty if the page is too large."""
    from .page import page_text

    if subject.n_frames * subject.n_vertices > _PAGE_VERTICES:
        return ""
    text, _ = page_text(subject)
    if len(text) > _PAGE_BYTES:
        return ""
    # The frame has an origin of its own, so that it reads nothing of the notebook.
    return (
        f'<iframe sandbox="allow-scripts" loading="lazy" title="{html.escape(repr(subject))}" '
        f'style="width:100%;height:{_HEIGHT}px;border:0" srcdoc="{html.escape(text)}"></iframe>'
    )
