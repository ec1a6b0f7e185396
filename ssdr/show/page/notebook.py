"""Display of a sequence or a model in a notebook: its page in a frame, or else a picture."""

from __future__ import annotations

import base64
import dataclasses
import html
import io
import logging
from typing import Any

from ...mesh.sequence import MeshSequence
from ...model.shapes import ShapedSkinning, Skinned
from ...model.skinning import Skinning, skinning_in

_PAGE_BYTES = 3_000_000  # of a page in a frame: the notebook keeps it in its file
_PAGE_VERTICES = 2_000_000  # of all frames; more would let the reader wait for seconds
_PICTURE_VERTICES = 50_000
_HEIGHT, _PICTURE = 480, (480, 360)
_log = logging.getLogger(__name__)


def notebook_html(thing: Any) -> str:
    """HTML of a ``MeshSequence``, ``Skinning`` or ``Decomposition`` for a notebook; never raises.

    The page of :func:`ssdr.view` in a frame if it has at most 3 MB and all frames together have at
    most 2 million vertices; else a picture of the middle frame, up to 50,000 vertices.  Below it
    stands the text that ``repr`` gives and, where there is no page, how to get one.
    """
    subject = skinning_in(thing)
    shown = ""
    for part in (_frame, _picture):
        try:
            shown = shown or part(subject)
        except Exception:  # a cell that shows its value must not fail
            _log.debug("%s of a notebook", part.__name__, exc_info=True)
    words = html.escape(repr(thing))
    if "<iframe" not in shown:
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


def _picture(subject: MeshSequence | Skinned) -> str:
    """An ``<img>`` of the middle frame; empty if drawing it would take long."""
    from .. import render_frame

    if subject.n_vertices > _PICTURE_VERTICES:
        return ""
    middle = subject.n_frames // 2
    # One frame alone, since the camera looks at all of a subject.
    if isinstance(subject, Skinning):
        one = {"transforms": subject.transforms[[middle]], "keyframes": None, "clips": None}
        still: Any = dataclasses.replace(subject, **one)
    elif isinstance(subject, ShapedSkinning):
        still = MeshSequence(subject.skin([middle]), subject.faces)
    else:
        still = MeshSequence(subject.frames([middle]), subject.faces)
    stored = io.BytesIO()
    render_frame(still, size=_PICTURE).save(stored, "PNG", optimize=True)
    data = base64.b64encode(stored.getvalue()).decode()
    return f'<img alt="frame {middle}" src="data:image/png;base64,{data}">'
