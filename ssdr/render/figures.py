"""Pictures of sequences and skinnings: one frame, or a contact sheet."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..errors import FormatError, InputError
from ..io.atomic import atomic_path
from ..sequence import MeshSequence
from .panels import DEGREES, INK, QUIET, Panels, as_many, checked_frames, draw_scale
from .parts import Part
from .raster import Camera
from .scene import Scene, Style, Unit

_ROWS: dict[Style, str] = {
    "plain": "shape",
    "weights": "skin weights",
    "bones": "bones",
    "error": "error",
    "normals": "error of normals",
}


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
) -> Image.Image:
    """Picture of one frame, lit as engines light it.

    A skinning is lit by rest normals, transformed by the blended 3×3 blocks of its bones: its
    ``surface.normals`` or, without them, the normals of the rest surface. A sequence is lit by the
    normals of its surface.

    Parameters
    ----------
    subject : MeshSequence, Skinning or Decomposition
    frame : int
        Index; a negative one counts from the end.
    reference : MeshSequence, optional
        The true animation, from which the error is measured.
    style : {"plain", "weights", "bones", "error", "normals"}, optional
        "plain" shows the shape, "weights" colours it by skin weights, "error" by the distance to
        the reference, "normals" by the angle of the normals that light it to those of the
        reference's surface.  "bones" draws bones from joint to joint or, without a hierarchy, as
        balls with axes at the posed centroids of the vertices that they move.  By default "weights"
        for a skinning and "plain" for a sequence.
    size : (int, int)
        Width and height in pixels.
    camera : Camera, optional
        By default one that sees the whole motion.
    scale : float, optional
        Error with the darkest colour, in the mesh's units or, for "normals", in degrees; by default
        a round number above nearly all errors of this frame.
    parts : sequence of Part, optional
        Parts of the subject with colours of their own, for "plain" and "bones"; "error" and
        "normals" colour the measured ones.  Every vertex belongs to one part.
    up : {"x", "y", "z", "-x", "-y", "-z"}
    azimuth, elevation : float
        Degrees, as in :meth:`Camera.fit`.  By default the azimuth that shows most of the subject.
    perspective : bool
        Perspective or parallel projection.

    Returns
    -------
    PIL.Image.Image
        RGB.

    Raises
    ------
    InputError
        If an option is out of range, the style needs bones or a reference that are missing, or
        subject and reference do not match.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> from ssdr.render import render_frame
    >>> render_frame(dancer, 3, size=(64, 48)).size
    (64, 48)
    """
    panels = Panels.of(
        Scene.of(subject, reference, parts),
        [style],
        [frame],
        size,
        with_reference=False,
        top=scale,
        camera=camera,
        up=up,
        azimuth=azimuth,
        elevation=elevation,
        perspective=perspective,
    )
    return panels.draw(panels.frames[0])[0]


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
    unit: Unit | None = None,
    **look: Any,
) -> Image.Image:
    """Labelled figure with a row for each style and a column for each frame.

    Parameters
    ----------
    subject : MeshSequence, Skinning or Decomposition
    reference : MeshSequence, optional
        The true animation, such as the input of a decomposition: adds its row and the error.
    frames : int or sequence of int
        Number of frames, evenly spread, or their indices.
    width : int
        Pixels; the height follows from it.
    styles : sequence of Style, optional
        Rows below the reference; by default all that apply to the subject, except "normals".
    title : str, optional
        The subject's name by default.
    parts : sequence of Part, optional
        As in :func:`render_frame`.  Errors are those of the measured parts.
    regions : mapping of str to mask or indices, optional
        Named sets of vertices whose RMSE is stated; by default that of all measured vertices.
    row_names : sequence of str, optional
        Names of the rows, from the top.
    captions : sequence of str, optional
        Headings of the columns, one or two lines each; by default the frame index.
    unit : (str, float), optional
        Unit of the stated errors, and how many of it make one of the mesh's units: ``("mm", 1000)``
        for a mesh in metres.
    **look
        `camera`, `up`, `azimuth`, `elevation` and `perspective` of :func:`render_frame`.

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
    columns = _spread(frames, scene.subject.n_frames)
    if not 200 <= width <= 20000:
        raise InputError("width", "200 to 20000 pixels", width)
    if styles is None:
        styles = ["weights", "bones"] if scene.has_bones else ["plain"]
        styles += ["error"] if reference is not None else []
    scale = width / 1600
    edge, gap, label = round(36 * scale), round(10 * scale), round(44 * scale)
    panels = Panels.of(
        scene,
        styles,
        columns,
        None,
        width=(width - 2 * edge - label - gap * (len(columns) - 1)) // len(columns),
        **look,
    )
    names = ["input"] * (reference is not None) + [_ROWS[style] for style in styles]
    if row_names is not None:
        names = as_many("row_names", row_names, names)
    heads = None if captions is None else as_many("captions", captions, columns)
    unit = unit or ("", 1.0)
    cell, height = panels.view.size
    lines = 0 if heads is None else 1 + any("\n" in h for h in heads)
    head = round((118, 160, 188)[lines] * scale)
    foot = round((104 * len(panels.scales) or 24) * scale)
    page = Image.new("RGB", (width, head + len(names) * (height + gap) + foot), "white")
    draw = ImageDraw.Draw(page)
    small, medium, large = (ImageFont.load_default(max(8, s * scale)) for s in (19, 23, 42))
    draw.text((edge, 24 * scale), title or scene.name, INK, large)
    draw.text((edge, 76 * scale), scene.summary("error" in panels.scales, unit), QUIET, medium)
    tops = [head + r * (height + gap) for r in range(len(names))]
    for name, top in zip(names, tops, strict=True):
        upright_text(page, name, (edge, top), (label, height), medium)
    for c, frame in enumerate(panels.frames):
        x = edge + label + c * (cell + gap)
        if heads is not None:
            first, _, second = heads[c].partition("\n")
            above = head - 26 * scale * (lines - 1) - 12 * scale
            draw.text((x + 2 * scale, above), first, INK, medium, "ls")
            draw.text((x + 2 * scale, head - 12 * scale), second, QUIET, small, "ls")
        pictures = panels.draw(frame)
        for (shown, style), picture, top in zip(panels.rows, pictures, tops, strict=True):
            page.paste(picture, (x, top))
            text = f"frame {frame}" if heads is None else ""
            if style == "error" and shown.has_parts:
                text = shown.figures([frame], unit)
            draw.text((x + 12 * scale, top + height - 9 * scale), text, QUIET, small, "ls")
    left, top = edge + label, page.height - foot + round(34 * scale)
    wide = min(width - 2 * left, round(700 * scale))
    for style in panels.scales:
        _draw_scale(page, panels, style, unit, (left, top, wide), small)
        top += round(104 * scale)
    return page


def _draw_scale(
    page: Image.Image,
    panels: Panels,
    style: Style,
    unit: Unit,
    bar: tuple[int, int, int],
    font: Any,
) -> None:
    """Draw the colour bar of the error that a style shows, with its values above the bar.

    A label says what is measured.  If it is a distance, percentages of the bounding box's diagonal
    are written below the bar.
    """
    draw, scene, scale = ImageDraw.Draw(page), panels.scene, page.width / 1600
    shown, of_normals = panels.scales[style], style == "normals"
    left, top, width = bar
    above = top - 6 * scale
    height = draw_scale(page, shown, DEGREES if of_normals else unit, bar, scale, font)
    below = top + height + 6 * scale
    for share, anchor in () if of_normals else ((0.0, "la"), (0.5, "ma"), (1.0, "ra")):
        text = f"{100 * shown.top * share / scene.diagonal:.3g} %"
        draw.text((left + (width - 1) * share, below), text, QUIET, font, anchor)
    x = left + width + 24 * scale
    truth = f"of the {scene.measured_name} to the truth" if scene.has_parts else "to the input"
    what, how = "distance", "in % of the diagonal"
    if of_normals:
        what, how = "angle of normals", "as engines draw them" if scene.has_bones else ""
    draw.text((x, above), f"{what} {truth}", INK, font, "ls")
    draw.text((x, below), how, QUIET, font, "la")


def write_picture(picture: Image.Image, path: str | os.PathLike[str], **options: Any) -> None:
    """Write a picture to a file; an error leaves no partial file.

    Parameters
    ----------
    picture : PIL.Image.Image
    path : path
        Its suffix determines the format.
    **options
        Options of Pillow's ``Image.save``.

    Raises
    ------
    FormatError
        If Pillow cannot write the format of the suffix.
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
    """Pillow's name for the format of a picture file.

    Raises
    ------
    FormatError
        If Pillow cannot write the format of the suffix.
    """
    name = Image.registered_extensions().get(path.suffix.lower())
    if name is None or name not in Image.SAVE:
        raise FormatError(f"{path}: not the name of a picture; .png, .jpg and .webp are")
    return name


def upright_text(
    page: Image.Image, text: str, corner: tuple[int, int], size: tuple[int, int], font: Any
) -> None:
    """Draw text from bottom to top, centred in a box."""
    strip = Image.new("RGB", (size[1], size[0]), "white")
    ImageDraw.Draw(strip).text((size[1] / 2, size[0] / 2 - 4), text, INK, font, "mm")
    page.paste(strip.rotate(90, expand=True), corner)


def _spread(frames: int | Sequence[int], n_frames: int) -> Sequence[int]:
    if not isinstance(frames, (int, np.integer)):
        return checked_frames(frames, n_frames)
    if isinstance(frames, bool) or not 1 <= frames <= 100:
        raise InputError("frames", "1 to 100, or a sequence of indices", frames)
    # Without the last frame, which equals the first in a cycle.
    count = min(int(frames), n_frames)
    return [int(t) for t in (np.arange(count) + 0.5) * n_frames / count]
