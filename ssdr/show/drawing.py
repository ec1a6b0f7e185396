"""One function that draws a film, a contact sheet or a frame, by the suffix of the file."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..common.errors import is_whole
from ..mesh.sequence import MeshSequence
from .figures import contact_sheet, picture_format, render_frame, write_picture
from .film import FILMS, Film
from .subject import Style


def draw(
    subject: Any,
    path: str | os.PathLike[str],
    *,
    reference: MeshSequence | None = None,
    frame: int | None = None,
    frames: int | Sequence[int] = 5,
    styles: Sequence[Style] | None = None,
    width: int | None = None,
    title: str | None = None,
    up: str = "y",
    azimuth: float | None = None,
    elevation: float = 12.0,
    callback: Callable[[float], object] | None = None,
) -> Path:
    """Draw a film (.gif, .webp), a contact sheet or, with `frame`, a single frame to a file.

    Parameters
    ----------
    subject : MeshSequence, Skinning or Decomposition
    path : path
        Its suffix determines the format.
    reference : MeshSequence, optional
        The true animation, from which the error is measured.
    frame : int, optional
        The frame that is drawn alone.
    frames : int or sequence of int
        Number of columns of a sheet, or indices of frames; of a film, a number means all frames.
    styles : sequence of Style, optional
        Rows of a sheet, panels of a film, or style of a single frame.
    width : int, optional
        Pixels; by default 1600, for a single frame 1000, for each panel of a film 480.
    title : str, optional
        Heading of a sheet.
    up : {"x", "y", "z", "-x", "-y", "-z"}
        The axis that points up.
    azimuth : float, optional
        Degrees around; by default those that show most of the subject.
    elevation : float
        Degrees above.
    callback : callable, optional
        Called with the fraction of a film that is done.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    InputError
        If Pillow cannot write the format of the suffix, and as :func:`render_frame`.

    Examples
    --------
    >>> import tempfile
    >>> from ssdr.show import draw
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     film = draw(dancer, f"{folder}/dancer.gif", width=64, frames=[0, 8, 16])
    ...     film.name
    'dancer.gif'
    """
    target = Path(path)
    picture_format(target)
    look: dict[str, Any] = {"reference": reference, "up": up}
    look |= {"azimuth": azimuth, "elevation": elevation}
    if frame is not None:
        style = styles[0] if styles else "error" if reference is not None else None
        size = (width or 1000,) * 2
        write_picture(render_frame(subject, frame, style=style, size=size, **look), target)
    elif target.suffix.lower() in FILMS:
        some: Any = None if is_whole(frames) else frames
        film = Film.of(subject, style=styles, size=(width or 480,) * 2, frames=some, **look)
        film.write(target, callback)
    else:
        look |= {"frames": frames, "styles": styles, "title": title, "width": width or 1600}
        write_picture(contact_sheet(subject, **look), target)
    return target
