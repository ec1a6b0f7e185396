"""Pictures of sequences and skinnings, without a display: one frame, a contact sheet.

Everything is drawn on the processor, by :mod:`ssdr.render.panel`; text is Pillow's.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw, ImageFont

from ..errors import FormatError, InputError
from ..io.atomic import atomic_path
from ..sequence import MeshSequence
from .materials import Part
from .page import (
    INK,
    QUIET,
    as_many,
    check_picture,
    checked_frames,
    checked_style,
    color_bar,
    nice,
    rounded,
    spread,
    upright_text,
)
from .panel import draw_panel
from .raster import Camera
from .scene import Scene, Style, View

__all__ = ["contact_sheet", "picture_format", "render_frame", "write_picture"]


def render_frame(
    subject: Any,
    frame: int = 0,
    *,
    reference: MeshSequence | None = None,
    style: Style | None = None,
    size: tuple[int, int] = (800, 800),
    camera: Camera | None = None,
    scale: float | None = None,
    parts: Sequence[Part] = (),
    up: str = "y",
    azimuth: float | None = None,
    elevation: float = 12.0,
    perspective: bool = True,
    supersample: int = 2,
) -> Image.Image:
    """Picture of one frame.

    Parameters
    ----------
    subject : MeshSequence, Skinning or Decomposition
    frame : int
        Negative counts from the end.
    reference : MeshSequence, optional
        What the subject should be; needed for the error.
    style : {"plain", "weights", "bones", "error"}, optional
        Clay; coloured by bone weights; bones from joint to joint or, without a
        hierarchy, as balls at the posed centroids of what they move, with their axes;
        distance to the reference.  By default `weights` for a skinning and `plain` for a sequence.
    size : (int, int)
        Width and height in pixels.
    camera : Camera, optional
        Else one that sees the whole motion from `azimuth` and `elevation`
        (degrees); without an azimuth the side that shows most is chosen.
    scale : float, optional
        Error that gets the darkest colour, in the mesh's units; a high
        percentile of this frame's errors by default.
    parts : sequence of Part, optional
        Parts of the subject with materials; `plain` shows these, `error` colours those that are
        measured.  Every vertex belongs to one part.
    up : {"x", "y", "z", "-x", "-y", "-z"}
    perspective : bool
        False: parallel projection.
    supersample : int
        Samples per pixel along each axis.

    Returns
    -------
    PIL.Image.Image
        RGB.

    Raises
    ------
    InputError
        If an option is out of range, the style needs what the subject lacks, or
        subject and reference do not match.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> from ssdr.render import render_frame
    >>> render_frame(dancer, 3, size=(64, 48)).size
    (64, 48)
    """
    scene = Scene.of(subject, reference, parts)
    chosen = checked_style(style, scene)
    check_picture(size, supersample)
    (frame,) = checked_frames([frame], scene.n_frames)
    view = View.of(scene, [frame], size, camera, up, azimuth, elevation, perspective)
    top = scale or nice(scene.high_error([frame])) if chosen == "error" else 1.0
    return draw_panel(scene, view, frame, chosen, size, top, supersample)


def contact_sheet(
    subject: Any,
    *,
    reference: MeshSequence | None = None,
    frames: int | Sequence[int] = 5,
    width: int = 1600,
    styles: Sequence[Style] | None = None,
    title: str | None = None,
    parts: Sequence[Part] = (),
    regions: Mapping[str, Any] | None = None,
    row_names: Sequence[str] | None = None,
    captions: Sequence[str] | None = None,
    unit: tuple[str, float] | None = None,
    camera: Camera | None = None,
    up: str = "y",
    azimuth: float | None = None,
    elevation: float = 12.0,
    perspective: bool = True,
    supersample: int = 2,
) -> Image.Image:
    """Figure with a row per style and a column per frame, labelled, with a scale of the error.

    Parameters
    ----------
    subject : MeshSequence, Skinning or Decomposition
    reference : MeshSequence, optional
        The input that a skinning was made from: adds its row and the error map.
    frames : int or sequence of int
        How many, evenly spread, or which.
    width : int
        Pixels; the height follows.
    styles : sequence of Style, optional
        Rows below the reference; all that the subject allows by default.
    title : str, optional
        The subject's name by default.
    parts : sequence of Part, optional
        As in :func:`render_frame`.  The scale of the error and all figures are those of the parts
        that are measured.
    regions : mapping of str to mask or indices, optional
        Sets of vertices whose RMSE is stated by name; by default that of all that is measured.
    row_names : sequence of str, optional
        Names of the rows, from the top.
    captions : sequence of str, optional
        Heads of the columns, of one line or two; the number of the frame by default.
    unit : (str, float), optional
        Name of the unit of the figures and its number in one of the mesh's, ``("mm", 1000)`` for
        a mesh in metres.
    camera, up, azimuth, elevation, perspective, supersample
        As in :func:`render_frame`.

    Returns
    -------
    PIL.Image.Image
        RGB.

    Raises
    ------
    InputError
        As :func:`render_frame`.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> from ssdr.render import contact_sheet
    >>> contact_sheet(dancer, frames=2, width=320).width
    320
    """
    scene = Scene.of(subject, reference, parts, regions)
    columns = spread(frames, scene.n_frames)
    if not 200 <= width <= 20000:
        raise InputError("width", "200 to 20000 pixels", width)
    rows: list[tuple[str, Scene, Style]] = []
    if reference is not None:
        rows.append(("input", Scene.of(reference, None, parts), "plain"))
    wanted: list[Style] = list(styles or ())
    if styles is None:
        wanted = ["weights", "bones"] if scene.skinning is not None else ["plain"]
        wanted += ["error"] if reference is not None else []
    names = {"plain": "shape", "weights": "skin weights", "bones": "bones", "error": "error"}
    rows += [(names[s], scene, s) for s in (checked_style(s, scene) for s in wanted)]
    if row_names is not None:
        names_of = as_many("row_names", row_names, rows)
        rows = [(n, *r[1:]) for n, r in zip(names_of, rows, strict=True)]
    heads = None if captions is None else as_many("captions", captions, columns)

    scale = width / 1600
    edge, gap, label = round(36 * scale), round(10 * scale), round(44 * scale)
    cell = (width - 2 * edge - label - gap * (len(columns) - 1)) // len(columns)
    view = View.of(scene, columns, None, camera, up, azimuth, elevation, perspective)
    size = (cell, round(cell / view.aspect))
    check_picture(size, supersample)
    with_error = any(style == "error" for _, _, style in rows)
    top = nice(scene.high_error(columns)) if with_error else 1.0
    lines = 0 if heads is None else 1 + any("\n" in h for h in heads)
    head = round((118, 160, 188)[lines] * scale)
    foot = round((104 if with_error else 24) * scale)
    page = Image.new("RGB", (width, head + len(rows) * (size[1] + gap) + foot), "white")
    draw = ImageDraw.Draw(page)
    small, medium, large = (ImageFont.load_default(max(8, s * scale)) for s in (19, 23, 42))
    draw.text((edge, 24 * scale), title or scene.name, INK, large)
    draw.text((edge, 76 * scale), scene.summary(with_error, unit), QUIET, medium)
    for r, (name, _, _) in enumerate(rows):
        at = (edge, head + r * (size[1] + gap))
        upright_text(page, name, at, (label, size[1]), medium)
    for c, frame in enumerate(columns):
        x = edge + label + c * (cell + gap)
        if heads is not None:
            first, _, second = heads[c].partition("\n")
            above = head - 26 * scale * (lines - 1) - 12 * scale
            draw.text((x + 2 * scale, above), first, INK, medium, "ls")
            draw.text((x + 2 * scale, head - 12 * scale), second, QUIET, small, "ls")
        # Rows of one column share the light on it.
        for r, (_, shown, style) in enumerate(rows):
            y = head + r * (size[1] + gap)
            tile = draw_panel(shown, view, frame, style, size, top, supersample)
            page.paste(tile, (x, y), rounded(size, round(10 * scale)))
            text = f"frame {frame}" if heads is None else ""
            if style == "error" and shown.parts:
                text = shown.figures([frame], unit or ("", 1.0))
            draw.text((x + 12 * scale, y + size[1] - 9 * scale), text, QUIET, small, "ls")
    if with_error:
        left = edge + label
        box = (left, page.height - round(70 * scale), min(width - 2 * left, round(700 * scale)))
        beyond = scene.largest_error(columns) > top
        color_bar(draw, page, box, scale, scene, beyond, top, small, unit)
    return page


def write_picture(picture: Image.Image, path: str | os.PathLike[str], **options: Any) -> None:
    """Save a picture; the file appears whole or not at all.

    Parameters
    ----------
    picture : PIL.Image.Image
    path : path
        The suffix chooses the format.
    **options
        Pillow's own.

    Raises
    ------
    FormatError
        If Pillow writes no such suffix.
    InputError
        If the folder does not exist.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from ssdr.render import render_frame, write_picture
    >>> picture = render_frame(ssdr.samples.load("dancer_small"), size=(64, 64))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_picture(picture, f"{folder}/dancer.png")
    ...     pathlib.Path(folder, "dancer.png").exists()
    True
    """
    path = Path(path)
    options.setdefault("format", picture_format(path))
    with atomic_path(path) as temporary:
        picture.save(temporary, **options)


def picture_format(path: Path) -> str:
    """Pillow's name of the format of a picture file.

    Raises
    ------
    FormatError
        If Pillow writes no such suffix.
    """
    name = Image.registered_extensions().get(path.suffix.lower())
    if name is None or name not in Image.SAVE:
        raise FormatError(f"{path}: not the name of a picture; .png, .jpg and .webp are")
    return name
