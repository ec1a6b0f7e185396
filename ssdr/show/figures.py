"""Pictures of one frame and contact sheets of sequences and skinnings, and how they are written."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

from ..common.errors import InputError, is_whole
from ..io.atomic import atomic_path
from ..mesh.sequence import MeshSequence
from .camera import Size
from .panels import INK, QUIET, Panels, Unit, as_many, number
from .subject import Scene, Style

_ROWS: dict[Style, str] = {
    "plain": "shape",
    "weights": "skin weights",
    "bones": "bones",
    "error": "error",
}


def render_frame(
    subject: Any,
    frame: int = 0,
    *,
    reference: MeshSequence | None = None,
    style: Style | None = None,
    size: Size = (800, 800),
    scale: float | None = None,
    colors: ArrayLike | None = None,
    measured: ArrayLike | None = None,
    up: str = "y",
    azimuth: float | None = None,
    elevation: float = 12.0,
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
        The true animation, from which the error is measured.  It has the vertices of the subject,
        or those before the subject's welding.
    style : {"plain", "weights", "bones", "error"}, optional
        "plain" shows the shape, "weights" colours it by skin weights, "error" by the distance to
        the reference.  "bones" draws bones from joint to joint or, without a hierarchy, as balls
        with axes at the posed centroids of the vertices that they move.  By default "weights" for a
        skinning and "plain" for a sequence.
    size : (int, int)
        Width and height in pixels.
    scale : float, optional
        Error with the darkest colour, in the mesh's units; by default a round number above nearly
        all errors of this frame.
    colors : (3,) or (V, 3) array, optional
        sRGB from 0 to 1 of the subject or of each vertex, for "plain" and "bones"; clay by default.
    measured : (V,) bool array or indices, optional
        Vertices whose error is measured; the others are grey.
    up : {"x", "y", "z", "-x", "-y", "-z"}
    azimuth, elevation : float
        Degrees, as in :meth:`Camera.fit`.  By default the azimuth that shows most of the subject.

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
    >>> from ssdr.show import render_frame
    >>> render_frame(dancer, 3, size=(64, 48)).size
    (64, 48)
    """
    panels = Panels.of(
        Scene.of(subject, reference, colors, measured),
        [style],
        [frame],
        size,
        with_reference=False,
        scale=scale,
        up=up,
        azimuth=azimuth,
        elevation=elevation,
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
    subtitle: str | None = None,
    row_names: Sequence[str] | None = None,
    captions: Sequence[str] | None = None,
    unit: Unit = ("", 1.0),
    colors: ArrayLike | None = None,
    measured: ArrayLike | None = None,
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
        Rows below the reference; by default all that apply to the subject.
    title, subtitle : str, optional
        By default the subject's name, and its size and its error (of the measured vertices).
    row_names : sequence of str, optional
        Names of the rows, from the top.
    captions : sequence of str, optional
        Headings of the columns.
    unit : (str, float)
        Unit of the stated errors, and how many of it make one of the mesh's units: ``("mm", 1000)``
        for a mesh in metres.
    colors, measured
        As in :func:`render_frame`.
    **look
        `scale`, `up`, `azimuth` and `elevation` of :func:`render_frame`.

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
    >>> from ssdr.show import contact_sheet
    >>> contact_sheet(dancer, frames=2, width=320).width
    320
    """
    scene = Scene.of(subject, reference, colors, measured)
    columns = _spread(frames, scene.subject.n_frames)
    if not 200 <= width <= 20000:
        raise InputError("width", "200 to 20000 pixels", width)
    if styles is None:
        styles = ["weights", "bones"] if scene.has_bones else ["plain"]
        styles += ["error"] if reference is not None else []
    k = width / 1600
    edge, gap, label = round(36 * k), round(10 * k), round(44 * k)
    cell = (width - 2 * edge - label - gap * (len(columns) - 1)) // max(1, len(columns))
    panels = Panels.of(scene, styles, columns, width=cell, **look)
    names = ["input"] * (reference is not None) + [_ROWS[style] for style in styles]
    if row_names is not None:
        names = as_many("row_names", row_names, names)
    heads = as_many("captions", captions or [f"frame {t}" for t in panels.frames], columns)
    height, head, foot = panels.size[1], round(160 * k), round((104 if panels.scale else 24) * k)
    page = Image.new("RGB", (width, head + len(names) * (height + gap) + foot), "white")
    draw = ImageDraw.Draw(page)
    small, medium, large = (ImageFont.load_default(max(8, s * k)) for s in (19, 23, 42))
    name = scene.subject.name or (scene.reference.name if scene.reference else "") or "untitled"
    draw.text((edge, 24 * k), title or name, INK, large)
    text = _summary(scene, panels, unit) if subtitle is None else subtitle
    draw.text((edge, 76 * k), text, QUIET, medium)
    for row, name in enumerate(names):
        top = head + row * (height + gap)
        upright = Image.new("RGB", (height, label), "white")
        ImageDraw.Draw(upright).text((height / 2, label / 2 - 4), name, INK, medium, "mm")
        page.paste(upright.rotate(90, expand=True), (edge, top))
    for column, (frame, caption) in enumerate(zip(panels.frames, heads, strict=True)):
        x = edge + label + column * (cell + gap)
        draw.text((x + 2 * k, head - 12 * k), caption, INK, medium, "ls")
        for row, picture in enumerate(panels.draw(frame)):
            y = head + row * (height + gap)
            page.paste(picture, (x, y))
            if panels.rows[row][1] == "error":
                text = f"RMSE {number(scene.distances.per_frame[frame], unit)}"
                draw.text((x + 12 * k, y + height - 9 * k), text, QUIET, small, "ls")
    if panels.scale:
        left, wide = edge + label, min(width - 2 * (edge + label), round(700 * k))
        top = page.height - foot + round(34 * k)
        panels.draw_scale(page, unit, (left, top, wide), small)
        share = 100 * panels.scale[0] / scene.diagonal
        text = f"distance to the input, up to {share:.3g} % of the diagonal"
        draw.text((left + wide + 24 * k, top + 16 * k), text, INK, small, "ls")
    return page


def _summary(scene: Scene, panels: Panels, unit: Unit) -> str:
    """Line of text: numbers of vertices, frames and bones and, if it is shown, the error."""
    texts = [f"{scene.subject.n_vertices:,} vertices", f"{scene.subject.n_frames:,} frames"]
    if scene.has_bones:
        texts += [f"{scene.model.n_bones} bones", f"{scene.model.n_influences} influences"]
    if panels.scale:
        found = scene.distances
        share = 100 * found.rmse / scene.diagonal
        texts.append(f"RMSE {number(found.rmse, unit)} ({share:.3g} % of the diagonal)")
        texts.append(f"E = {found.E:.3g}")
    return "  ·  ".join(texts)


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
    InputError
        If Pillow cannot write the format of the suffix, or the folder does not exist.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from ssdr.show import render_frame, write_picture
    >>> picture = render_frame(ssdr.samples.load("dancer_small"), size=(64, 64))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_picture(picture, f"{folder}/dancer.png")
    ...     pathlib.Path(folder, "dancer.png").exists()
    True
    """
    options.setdefault("format", picture_format(Path(path)))
    with atomic_path(Path(path)) as temporary:
        picture.save(temporary, **options)


def picture_format(path: Path) -> str:
    """Pillow's name for the format of a picture file.

    Raises
    ------
    InputError
        If Pillow cannot write the format of the suffix.
    """
    name = Image.registered_extensions().get(path.suffix.lower())
    if name is None or name not in Image.SAVE:
        raise InputError("path", "a picture: .png, .jpg or .webp", str(path))
    return name


def _spread(frames: int | Sequence[int], n_frames: int) -> Sequence[int]:
    if not is_whole(frames):
        return frames  # type: ignore[return-value]
    if not 1 <= frames <= 100:
        raise InputError("frames", "1 to 100, or a sequence of indices", frames)
    # Without the last frame, which equals the first in a cycle.
    count = min(int(frames), n_frames)
    return [int(t) for t in (np.arange(count) + 0.5) * n_frames / count]
