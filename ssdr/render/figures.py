"""Pictures of sequences and skinnings, without a display: one frame, a contact sheet, a film.

Everything is drawn on the processor, by :mod:`ssdr.render.scene` and
:mod:`ssdr.render.raster`; text is
Pillow's.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..errors import FormatError, InputError, is_whole
from ..io.atomic import atomic_path
from ..sequence import MeshSequence
from .palette import heat, srgb_from_linear
from .raster import Camera
from .scene import Scene, Style, View, draw_panel

__all__ = ["Camera", "Style", "animate", "contact_sheet", "render_frame", "write_picture"]

_INK, _QUIET = "#20242c", "#6b7280"
_SIZES = (16, 8192)  # smallest and largest side in pixels: larger needs gigabytes of samples


def render_frame(
    subject: Any,
    frame: int = 0,
    *,
    reference: MeshSequence | None = None,
    style: Style | None = None,
    size: tuple[int, int] = (800, 800),
    camera: Camera | None = None,
    scale: float | None = None,
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
        Clay; coloured by bone weights; bones as balls at the posed centroids of
        what they move, with their axes; distance to the reference.  By default
        `weights` for a skinning and `plain` for a sequence.
    size : (int, int)
        Width and height in pixels.
    camera : Camera, optional
        Else one that sees the whole motion from `azimuth` and `elevation`
        (degrees); without an azimuth the side that shows most is chosen.
    scale : float, optional
        Error that gets the darkest colour, in the mesh's units; a high
        percentile of this frame's errors by default.
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
    scene = Scene.of(subject, reference)
    chosen = _checked_style(style, scene)
    _check_picture(size, supersample)
    (frame,) = _checked_frames([frame], scene.n_frames)
    view = View.of(scene, [frame], size, camera, up, azimuth, elevation, perspective)
    top = scale or _nice(scene.high_error([frame])) if chosen == "error" else 1.0
    return draw_panel(scene, view, frame, chosen, size, top, supersample)


def contact_sheet(
    subject: Any,
    *,
    reference: MeshSequence | None = None,
    frames: int | Sequence[int] = 5,
    width: int = 1600,
    styles: Sequence[Style] | None = None,
    title: str | None = None,
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
    scene = Scene.of(subject, reference)
    columns = _spread(frames, scene.n_frames)
    if not 200 <= width <= 20000:
        raise InputError("width", "200 to 20000 pixels", width)
    rows: list[tuple[str, Scene, Style]] = []
    if reference is not None:
        rows.append(("input", Scene.of(reference, None), "plain"))
    wanted: list[Style] = list(styles or ())
    if styles is None:
        wanted = ["weights", "bones"] if scene.skinning is not None else ["plain"]
        wanted += ["error"] if reference is not None else []
    names = {"plain": "shape", "weights": "skin weights", "bones": "bones", "error": "error"}
    rows += [(names[s], scene, s) for s in (_checked_style(s, scene) for s in wanted)]

    unit = width / 1600
    edge, gap, label = round(36 * unit), round(10 * unit), round(44 * unit)
    cell = (width - 2 * edge - label - gap * (len(columns) - 1)) // len(columns)
    view = View.of(scene, columns, None, camera, up, azimuth, elevation, perspective)
    size = (cell, round(cell / view.aspect))
    _check_picture(size, supersample)
    with_error = any(style == "error" for _, _, style in rows)
    top = _nice(scene.high_error(columns)) if with_error else 1.0
    head, foot = round(118 * unit), round((104 if with_error else 24) * unit)
    page = Image.new("RGB", (width, head + len(rows) * (size[1] + gap) + foot), "white")
    draw = ImageDraw.Draw(page)
    small, medium, large = (ImageFont.load_default(max(8, s * unit)) for s in (19, 23, 42))
    draw.text((edge, 24 * unit), title or scene.name, _INK, large)
    draw.text((edge, 76 * unit), scene.summary(with_error), _QUIET, medium)
    for r, (name, shown, style) in enumerate(rows):
        y = head + r * (size[1] + gap)
        _upright_text(page, name, (edge, y), (label, size[1]), medium)
        for c, frame in enumerate(columns):
            x = edge + label + c * (cell + gap)
            tile = draw_panel(shown, view, frame, style, size, top, supersample)
            page.paste(tile, (x, y), _rounded(size, round(10 * unit)))
            draw.text(
                (x + 12 * unit, y + size[1] - 9 * unit), f"frame {frame}", _QUIET, small, "ls"
            )
    if with_error:
        left = edge + label
        box = (left, page.height - round(70 * unit), min(width - 2 * left, round(700 * unit)))
        _color_bar(draw, page, box, unit, scene, columns, top, small)
    return page


def animate(
    subject: Any,
    path: str | os.PathLike[str],
    *,
    reference: MeshSequence | None = None,
    style: Style | Sequence[Style] | None = None,
    size: tuple[int, int] = (480, 480),
    frames: Sequence[int] | None = None,
    fps: float | None = None,
    camera: Camera | None = None,
    up: str = "y",
    azimuth: float | None = None,
    elevation: float = 12.0,
    perspective: bool = True,
    supersample: int = 2,
    callback: Callable[[float], object] | None = None,
) -> Path:
    """Write a looping film: GIF, WebP or animated PNG, by the suffix.

    Parameters
    ----------
    path : path
        Ends in ``.gif``, ``.webp`` or ``.png``; written at once when all is drawn.
    style : Style or sequence of Style, optional
        Several are drawn side by side; with a reference its own picture stands
        to their left.
    frames : sequence of int, optional
        Which; by default all, thinned to at most 30 a second.
    fps : float, optional
        Frames shown per second; real time by default.
    callback : callable, optional
        Called with the fraction done.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    FormatError
        If the suffix is none of the three.
    InputError
        As :func:`render_frame`.

    Examples
    --------
    >>> import tempfile
    >>> from ssdr.render import animate
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     film = animate(dancer, f"{folder}/dancer.gif", size=(64, 64), frames=[0, 8, 16])
    ...     film.name
    'dancer.gif'
    """
    path = Path(path)
    kind = {".gif": "GIF", ".webp": "WEBP", ".png": "PNG"}.get(path.suffix.lower())
    if kind is None:
        raise FormatError(f"{path}: a film is written as .gif, .webp or .png")
    scene = Scene.of(subject, reference)
    chosen = [style] if isinstance(style, str) or style is None else list(style)
    panels = [(scene, _checked_style(s, scene)) for s in chosen]
    if reference is not None:
        panels.insert(0, (Scene.of(reference, None), "plain"))
    _check_picture(size, supersample)
    step = max(1, math.ceil(scene.fps / 30 - 1e-9))
    every = range(0, scene.n_frames, step)
    order = _checked_frames(every if frames is None else frames, scene.n_frames)
    speed = fps or scene.fps / (step if frames is None else 1)
    if not (math.isfinite(speed) and speed > 0):
        raise InputError("fps", "a positive number", fps)
    view = View.of(scene, order, size, camera, up, azimuth, elevation, perspective)
    top = _nice(scene.high_error(order)) if any(s == "error" for _, s in panels) else 1.0
    pictures = []
    for done, frame in enumerate(order):
        picture = Image.new("RGB", (size[0] * len(panels), size[1]))
        for k, (shown, s) in enumerate(panels):
            tile = draw_panel(shown, view, frame, s, size, top, supersample)
            picture.paste(tile, (k * size[0], 0))
        pictures.append(picture)
        if callback is not None:
            callback((done + 1) / len(order))
    options: dict[str, Any] = {"duration": max(20, round(1000 / speed)), "loop": 0}
    if kind == "GIF":
        # One palette for all frames, else the background flickers.
        few = [pictures[k] for k in {0, len(pictures) // 2, len(pictures) - 1}]
        strip = Image.new("RGB", (few[0].width, few[0].height * len(few)))
        for k, picture in enumerate(few):
            strip.paste(picture, (0, k * picture.height))
        palette = strip.quantize(256, method=Image.Quantize.MEDIANCUT)
        pictures = [p.quantize(palette=palette) for p in pictures]
        options["disposal"] = 1
    write_picture(pictures[0], path, format=kind, append_images=pictures[1:], **options)
    return path


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


def _nice(value: float) -> float:
    """The next 1, 1.5, 2, 3, 4, 5, 6 or 8 times a power of ten."""
    if not value > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(s * power for s in (1, 1.5, 2, 3, 4, 5, 6, 8, 10, 15) if s * power >= value * 0.999)


def _checked_style(style: Style | None, scene: Scene) -> Style:
    if style is None:
        return "plain" if scene.skinning is None else "weights"
    if style not in get_args(Style):
        raise InputError("style", f"one of {', '.join(get_args(Style))}", repr(style))
    if style in ("weights", "bones") and scene.skinning is None:
        raise InputError("style", "plain or error for a sequence, which has no bones", repr(style))
    if style == "error" and scene.reference is None:
        raise InputError("reference", "a MeshSequence to measure the error against", None)
    return style


def _checked_frames(frames: Any, n_frames: int) -> list[int]:
    order = [int(t) for t in frames]
    if not order:
        raise InputError("frames", "at least one frame", "none")
    for t in order:
        if not -n_frames <= t < n_frames:
            raise InputError("frames", f"indices from 0 to {n_frames - 1}", t)
    return [t % n_frames for t in order]


def _spread(frames: int | Sequence[int], n_frames: int) -> list[int]:
    if not isinstance(frames, (int, np.integer)):
        return _checked_frames(frames, n_frames)
    if isinstance(frames, bool) or not 1 <= frames <= 100:
        raise InputError("frames", "1 to 100, or a sequence of indices", frames)
    # Not the last frame: in a cycle it is the first again.
    count = min(int(frames), n_frames)
    return [int(t) for t in (np.arange(count) + 0.5) * n_frames / count]


def _check_picture(size: tuple[int, int], supersample: int) -> None:
    pair = isinstance(size, (tuple, list, np.ndarray)) and len(size) == 2
    if not pair or not all(is_whole(n) and _SIZES[0] <= n <= _SIZES[1] for n in size):
        expected = f"width and height of {_SIZES[0]} to {_SIZES[1]} pixels"
        raise InputError("size", expected, repr(size))
    if not is_whole(supersample) or supersample not in (1, 2, 3, 4):
        raise InputError("supersample", "1, 2, 3 or 4", repr(supersample))


def _rounded(size: tuple[int, int], radius: int) -> Image.Image:
    large = Image.new("L", (size[0] * 4, size[1] * 4), 0)
    box = (0, 0, large.width - 1, large.height - 1)
    ImageDraw.Draw(large).rounded_rectangle(box, radius * 4, fill=255)
    return large.resize(size, Image.Resampling.LANCZOS)


def _upright_text(
    page: Image.Image, text: str, corner: tuple[int, int], size: tuple[int, int], font: Any
) -> None:
    strip = Image.new("RGB", (size[1], size[0]), "white")
    ImageDraw.Draw(strip).text((size[1] / 2, size[0] / 2 - 4), text, _INK, font, "mm")
    page.paste(strip.rotate(90, expand=True), corner)


def _color_bar(
    draw: ImageDraw.ImageDraw,
    page: Image.Image,
    box: tuple[int, int, int],
    unit: float,
    scene: Scene,
    columns: list[int],
    top: float,
    font: Any,
) -> None:
    """Scale of the error: ticks in the mesh's units above, in % of the diagonal below."""
    left, y, width = box
    height = round(18 * unit)
    bar = (255 * srgb_from_linear(heat(np.linspace(0, 1, width)))).round().astype(np.uint8)
    page.paste(Image.fromarray(np.repeat(bar[None], height, axis=0)), (left, y))
    draw.rectangle((left, y, left + width - 1, y + height - 1), outline="#c4c9d2")
    for k in range(5):
        x = left + (width - 1) * k / 4
        sign = "> " if k == 4 and scene.largest_error(columns) > top else ""
        draw.line((x, y - 4 * unit, x, y), fill=_QUIET)
        draw.line((x, y + height, x, y + height + 4 * unit), fill=_QUIET)
        share = 100 * top * k / 4 / scene.diagonal
        anchor = "l" if k == 0 else "r" if k == 4 else "m"
        draw.text((x, y - 6 * unit), f"{sign}{top * k / 4:.3g}", _INK, font, anchor + "s")
        draw.text((x, y + height + 6 * unit), f"{share:.3g} %", _QUIET, font, anchor + "a")
    x = left + width + 24 * unit
    draw.text((x, y - 6 * unit), "distance to the input, in the mesh's units", _INK, font, "ls")
    draw.text((x, y + height + 6 * unit), "in % of the diagonal", _QUIET, font, "la")
