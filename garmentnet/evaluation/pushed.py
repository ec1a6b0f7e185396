"""A method's prediction with the vertices that lie inside the body moved out of it."""

from __future__ import annotations

import numpy as np

from ..collision.push_out import MARGIN, PushOut
from ..data.clip import Clip
from ..data.outfit import Outfit
from .clip_scores import Method
from .scores import Answer

__all__ = ["pushed_method"]


def pushed_method(method: Method, outfit: Outfit, *, margin: float = MARGIN) -> Method:
    """The same method with its vertices pushed out; the low part is unchanged.

    Pinned vertices stay.  What is moved counts as detail: the high part becomes the pushed-out
    vertices minus the low part.

    Parameters
    ----------
    method : callable
        From a clip to its prediction.
    outfit : Outfit
        Garment and body, such as a store.
    margin : float
        Metres above the skin.

    Raises
    ------
    InputError
        If the body is not closed, or when called, if the prediction is not finite.
    """
    push = PushOut(
        outfit.body,
        outfit.faces,
        margin=margin,
        pinned=outfit.pinned,
        n_vertices=len(outfit.rest),
    )

    def answer(clip: Clip) -> Answer:
        got = method(clip)
        out = push(np.asarray(got.low + got.high), clip.joints).vertices
        return Answer(got.low, np.asarray(out - got.low, np.float32))

    return answer
