"""Films of sequences and skinnings, panel beside panel."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont

from ..errors import FormatError, InputError
from ..sequence import MeshSequence
from .figures import write_picture
from .materials import Part
from .page import (
    INK,
    QUIET,
    as_many,
    check_picture,
    checked_frames,
    checked_style,
    nice,
    small_color_bar,
)
from .palette import heat, srgb_from_linear
from .panel import draw_panel
from .raster import Camera
from .scene import Scene, Style, View

__all__ = ["Film", "animate"]

_PAPER, _MARK = "#ffffff", "#c93559"
_PALETTE_FRAMES = 6  # frames that the colours of a GIF are chosen from
_SCALE_COLORS = 24  # colours of a GIF that are those of the error's scale
_KINDS = {".gif": "GIF", ".webp": "WEBP", ".png": "PNG"}


@dataclasses.dataclass(frozen=True, eq=False)
class Film:
    """A film before it is drawn: what its panels show, which frames, and how fast.

    Made by :meth:`of`; :meth:`pictures` draws it.

    Attributes
    ----------
    panels : tuple of (Scene, Style)
    view : View
    order : tuple of int
        Frames.
    fps : float
    panel_size : (int, int)
    top : float
        Error that gets the last colour.
    titles, captions : tuple of str or None
        Of the panels, and of the frames.
    unit : (str, float)
    supersample : int
    """

    panels: tuple[tuple[Scene, Style], ...]
    view: View
    order: tuple[int, ...]
    fps: float
    panel_size: tuple[int, int]
    top: float
    titles: tuple[str, ...] | None
    captions: tuple[str, ...] | None
    unit: tuple[str, float]
    supersample: int

    @classmethod
    def of(
        cls,
        subject: Any,
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
        parts: Sequence[Part] = (),
        regions: Mapping[str, Any] | None = None,
        titles: Sequence[str] | None = None,
        captions: Sequence[str] | None = None,
        unit: tuple[str, float] | None = None,
        track: Any = None,
    ) -> Film:
        """Check the arguments, which are those of :func:`animate`."""
        scene = Scene.of(subject, reference, parts, regions)
        chosen = [style] if isinstance(style, str) or style is None else list(style)
        panels = [(scene, checked_style(s, scene)) for s in chosen]
        if reference is not None:
            panels.insert(0, (Scene.of(reference, None, parts), "plain"))
        check_picture(size, supersample)
        step = max(1, math.ceil(scene.fps / 30 - 1e-9))
        every = range(0, scene.n_frames, step)
        order = checked_frames(every if frames is None else frames, scene.n_frames)
        speed = fps or scene.fps / (step if frames is None else 1)
        if not (math.isfinite(speed) and speed > 0):
            raise InputError("fps", "a positive number", fps)
        path = None
        if track is not None:
            path = np.asarray(track, dtype=np.float64)
            if path.shape != (scene.n_frames, 3) or not np.isfinite(path).all():
                raise InputError("track", f"({scene.n_frames}, 3) places", f"shape {path.shape}")
        view = View.of(scene, order, size, camera, up, azimuth, elevation, perspective, path)
        with_error = any(s == "error" for _, s in panels)
        return cls(
            tuple(panels),
            view,
            tuple(order),
            speed,
            size,
            nice(scene.high_error(order)) if with_error else 1.0,
            None if titles is None else tuple(as_many("titles", titles, panels)),
            None if captions is None else tuple(as_many("captions", captions, order)),
            unit or ("", 1.0),
            supersample,
        )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its pictures."""
        width, height = self.panel_size
        count = len(self.panels)
        return width * count + self._gap * (count - 1), height + self._head + self._foot

    @property
    def _gap(self) -> int:
        """Paper between panels, even, where these have titles."""
        return 0 if self.titles is None else 2 * round(0.008 * self.panel_size[1])

    @property
    def _head(self) -> int:
        return 0 if self.titles is None else round(0.1 * self.panel_size[1])

    @property
    def _foot(self) -> int:
        if self.captions is None:
            return 0
        share = 0.22 if self._measured is not None else 0.1
        # Films of some formats have an even height.
        foot = round(share * self.panel_size[1])
        return foot + (self._head + foot + self.panel_size[1]) % 2

    @property
    def _measured(self) -> Scene | None:
        shown = self.panels[-1][0]
        return shown if shown.reference is not None else None

    def pictures(self, callback: Callable[[float], object] | None = None) -> Iterator[Image.Image]:
        """Draw the frames, one after the other; `callback` is called with the fraction done."""
        curve = None
        beyond = any(
            s == "error" and p.largest_error(self.order) > self.top for p, s in self.panels
        )
        if self.captions is not None and self._measured is not None:
            curve = np.array([self._measured.rmse([t]) for t in self.order])
        for done, frame in enumerate(self.order):
            picture = Image.new("RGB", self.size, _PAPER)
            for k, (shown, style) in enumerate(self.panels):
                tile = draw_panel(
                    shown, self.view, frame, style, self.panel_size, self.top, self.supersample
                )
                picture.paste(tile, (k * (self.panel_size[0] + self._gap), self._head))
            self._annotate(picture, done, curve, beyond)
            yield picture
            if callback is not None:
                callback((done + 1) / len(self.order))

    def write(
        self, path: str | os.PathLike[str], callback: Callable[[float], object] | None = None
    ) -> Path:
        """Write the film, looping; arguments and errors as :func:`animate`."""
        path = Path(path)
        kind = _kind(path)
        options: dict[str, Any] = {"duration": max(20, round(1000 / self.fps)), "loop": 0}
        with_parts = bool(self.panels[0][0].parts)
        if kind == "WEBP" and with_parts:
            options["method"] = 4  # a third smaller, and still quicker than drawing
        if kind != "GIF":
            frames = list(self.pictures(callback))
        elif with_parts:
            options["disposal"] = 1
            frames = self._reduced(callback)
        else:
            options["disposal"] = 1
            drawn = list(self.pictures(callback))
            # One palette for all frames, else the background flickers.
            palette = _palette([drawn[k] for k in {0, len(drawn) // 2, len(drawn) - 1}])
            frames = [p.quantize(palette=palette) for p in drawn]
        write_picture(frames[0], path, format=kind, append_images=frames[1:], **options)
        return path

    def _reduced(self, callback: Callable[[float], object] | None) -> list[Image.Image]:
        """Frames with the 256 colours that a GIF can hold, and dots of two where one lies between.

        The colours are chosen first, from some of the frames, so that only one is held in full.
        """
        count = len(self.order)
        chosen = sorted({round(k) for k in np.linspace(0, count - 1, _PALETTE_FRAMES)})
        some = dataclasses.replace(
            self,
            order=tuple(self.order[k] for k in chosen),
            captions=None if self.captions is None else tuple(self.captions[k] for k in chosen),
        )
        # Text and marks are few pixels, which a choice by frequency forgets.
        marks = [c for name in (_PAPER, INK, QUIET, _MARK) for c in ImageColor.getrgb(name)]
        if any(style == "error" for _, style in self.panels):
            scale = srgb_from_linear(heat(np.linspace(0, 1, _SCALE_COLORS)))
            marks += (255 * scale).round().astype(int).ravel().tolist()
        palette = _palette(list(some.pictures()), 256 - len(marks) // 3)
        colors = palette.getpalette() or []
        palette.putpalette(colors[: 768 - len(marks)] + marks)
        return [p.quantize(palette=palette) for p in self.pictures(callback)]

    def _annotate(
        self, picture: Image.Image, k: int, curve: NDArray[np.float64] | None, beyond: bool
    ) -> None:
        width, height = self.panel_size
        step = width + self._gap
        scale = height / 640
        draw = ImageDraw.Draw(picture)
        small, large = (ImageFont.load_default(max(8, s * scale)) for s in (20, 28))
        edge = 18 * scale
        for n, title in enumerate(self.titles or ()):
            draw.text((n * step + edge, self._head / 2), title, INK, large, "lm")
            if self.panels[n][1] == "error":
                right = round(n * step + width - edge)
                middle = self._head // 2
                args = (beyond, self.top, small, self.unit)
                small_color_bar(draw, picture, right, middle, scale, *args)
        if self.captions is None:
            return
        top = self._head + height
        line = top + 32 * scale
        draw.text((edge, line), self.captions[k], INK, small, "lm")
        if curve is None or self._measured is None:
            return
        text = "RMSE " + self._measured.figures([self.order[k]], self.unit)
        draw.text((picture.width - edge, line), text, INK, small, "rm")
        self._plot(draw, curve, k, (edge, top + 60 * scale, picture.width - edge), scale)

    def _plot(
        self,
        draw: ImageDraw.ImageDraw,
        curve: NDArray[np.float64],
        k: int,
        box: tuple[float, float, float],
        scale: float,
    ) -> None:
        """The error over time, up to now in ink."""
        left, top, right = box
        bottom = self.size[1] - 16 * scale
        x = np.linspace(left, right, len(curve)) if len(curve) > 1 else np.array([left])
        y = bottom - (bottom - top) * curve / max(float(curve.max()), 1e-30)
        line = [(float(a), float(b)) for a, b in zip(x, y, strict=True)]
        draw.line((left, bottom, right, bottom), fill="#d7dae0")
        draw.line(line, fill="#c3c7cf", width=max(1, round(2 * scale)))
        draw.line(line[: k + 1], fill=QUIET, width=max(1, round(2 * scale)))
        r = 4.5 * scale
        a, b = line[k]
        draw.ellipse((a - r, b - r, a + r, b + r), fill=_MARK)


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
    parts: Sequence[Part] = (),
    regions: Mapping[str, Any] | None = None,
    titles: Sequence[str] | None = None,
    captions: Sequence[str] | None = None,
    unit: tuple[str, float] | None = None,
    track: Any = None,
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
    parts, regions, unit
        As in :func:`contact_sheet`.
    titles : sequence of str, optional
        Names of the panels, drawn above them.
    captions : sequence of str, optional
        Texts of the frames, drawn below them; with a reference the RMSE stands beside it, with
        its course.
    track : (F, 3) array, optional
        Place that the camera moves along with; by default it follows a subject that travels far.
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
    _kind(path)
    film = Film.of(
        subject,
        reference=reference,
        style=style,
        size=size,
        frames=frames,
        fps=fps,
        camera=camera,
        up=up,
        azimuth=azimuth,
        elevation=elevation,
        perspective=perspective,
        supersample=supersample,
        parts=parts,
        regions=regions,
        titles=titles,
        captions=captions,
        unit=unit,
        track=track,
    )
    return film.write(path, callback)


def _palette(pictures: Sequence[Image.Image], colors: int = 256) -> Image.Image:
    """Picture with a palette of the most frequent colours."""
    strip = Image.new("RGB", (pictures[0].width, pictures[0].height * len(pictures)))
    for k, picture in enumerate(pictures):
        strip.paste(picture, (0, k * picture.height))
    return strip.quantize(colors, method=Image.Quantize.MEDIANCUT)


def _kind(path: Path) -> str:
    kind = _KINDS.get(path.suffix.lower())
    if kind is None:
        raise FormatError(f"{path}: a film is written as .gif, .webp or .png")
    return kind
