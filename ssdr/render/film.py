"""Films of sequences and skinnings, with one or more panels side by side."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ..errors import FormatError, InputError
from ..sequence import MeshSequence
from .figures import write_picture
from .panels import DEGREES, INK, QUIET, Panels, as_many, draw_scale
from .parts import Part
from .scene import Scene, Style, Unit, evenly

_PAPER, _MARK = "#ffffff", "#c93559"
_PALETTE_FRAMES = 4  # frames from which the colours of a GIF are chosen
# Pillow's options by suffix; method 4 makes a WebP a third smaller and takes less time than drawing
_KINDS: dict[str, dict[str, Any]] = {
    ".gif": {"format": "GIF", "disposal": 1},
    ".webp": {"format": "WEBP", "method": 4},
    ".png": {"format": "PNG"},
}


@dataclasses.dataclass(frozen=True, eq=False)
class Film:
    """Film with panels side by side, titles, and captions.

    Use :meth:`of` to make one, or :func:`animate` to make and write one.

    Attributes
    ----------
    panels : Panels
    fps : float
        Frames per second.
    titles : tuple of str or None
        Title of each panel.
    captions : tuple of str or None
        Caption of each frame shown.
    unit : (str, float)
        Unit of the stated errors, as in :func:`contact_sheet`.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> from ssdr.render import Film
    >>> film = Film.of(dancer, size=(64, 48), frames=[0, 8, 16])
    >>> film.order, [picture.size for picture in film.pictures()]
    ((0, 8, 16), [(64, 48), (64, 48), (64, 48)])
    """

    panels: Panels
    fps: float
    titles: tuple[str, ...] | None
    captions: tuple[str, ...] | None
    unit: Unit

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
        parts: Sequence[Part] = (),
        regions: Mapping[str, Any] | None = None,
        titles: Sequence[str] | None = None,
        captions: Sequence[str] | None = None,
        unit: Unit | None = None,
        track: Any = None,
        **look: Any,
    ) -> Film:
        """Film of a subject.

        Parameters
        ----------
        subject : MeshSequence, Skinning or Decomposition
        reference : MeshSequence, optional
            The true animation, shown to the left of the subject.
        style : Style or sequence of Style, optional
            Style of each panel.
        size : (int, int)
            Width and height of a panel in pixels.
        frames : sequence of int, optional
            Indices; by default all frames, thinned to at most 30 per second.
        fps : float, optional
            Frames shown per second; by default real time.
        parts, regions, unit
            As in :func:`contact_sheet`.
        titles : sequence of str, optional
            Names of the panels, drawn above them.
        captions : sequence of str, optional
            Texts drawn below the frames.  With a reference the RMSE of the frame and the curve of
            the RMSE over the film are added.
        track : (F, 3) array, optional
            Path of the camera; by default it follows a subject that travels far.
        **look
            `camera`, `up`, `azimuth`, `elevation` and `perspective` of :func:`render_frame`.

        Raises
        ------
        InputError
            As :func:`render_frame`.
        """
        scene = Scene.of(subject, reference, parts, regions)
        step = max(1, math.ceil(scene.subject.fps / 30 - 1e-9)) if frames is None else 1
        speed = fps or scene.subject.fps / step
        if not (math.isfinite(speed) and speed > 0):
            raise InputError("fps", "a positive number", fps)
        path = None
        if track is not None:
            path = np.asarray(track, dtype=np.float64)
            if path.shape != (scene.subject.n_frames, 3) or not np.isfinite(path).all():
                expected = f"({scene.subject.n_frames}, 3) positions"
                raise InputError("track", expected, f"shape {path.shape}")
        panels = Panels.of(
            scene,
            [style] if isinstance(style, str) or style is None else list(style),
            range(0, scene.subject.n_frames, step) if frames is None else frames,
            size,
            track=path,
            **look,
        )
        return cls(
            panels,
            speed,
            None if titles is None else tuple(as_many("titles", titles, panels.rows)),
            None if captions is None else tuple(as_many("captions", captions, panels.frames)),
            unit or ("", 1.0),
        )

    @property
    def order(self) -> tuple[int, ...]:
        """Indices of the frames shown."""
        return self.panels.frames

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the film in pixels."""
        (width, height), (head, foot, gap) = self.panels.view.size, self._paper
        return (width + gap) * len(self.panels.rows) - gap, head + height + foot

    @property
    def _paper(self) -> tuple[int, int, int]:
        """Heights of the margins above and below the panels, and width of the gaps between them."""
        height = self.panels.view.size[1]
        head, gap = (round(0.1 * height), 2 * round(0.008 * height)) if self.titles else (0, 0)
        if self.captions is None:
            return head, 0, gap
        foot = round((0.1 if self.panels.scene.reference is None else 0.22) * height)
        # Some film formats need an even height.
        return head, foot + (head + foot + height) % 2, gap

    def pictures(
        self,
        callback: Callable[[float], object] | None = None,
        chosen: Sequence[int] | None = None,
    ) -> Iterator[Image.Image]:
        """Draw the frames, one after the other.

        Parameters
        ----------
        callback : callable, optional
            Called with the fraction done.
        chosen : sequence of int, optional
            Positions in :attr:`order`; by default all.
        """
        scene, curve = self.panels.scene, None
        if self.captions is not None and scene.reference is not None:
            curve = np.array([scene.rmse([t]) for t in self.order])
        chosen = range(len(self.order)) if chosen is None else chosen
        head, _, gap = self._paper
        for done, k in enumerate(chosen, 1):
            picture = Image.new("RGB", self.size, _PAPER)
            for n, panel in enumerate(self.panels.draw(self.order[k])):
                picture.paste(panel, (n * (panel.width + gap), head))
            self._annotate(picture, k, curve)
            yield picture
            if callback is not None:
                callback(done / len(chosen))

    def write(
        self, path: str | os.PathLike[str], callback: Callable[[float], object] | None = None
    ) -> Path:
        """Write the looping film and return its path; arguments as for :func:`animate`."""
        path, options = Path(path), _options(Path(path))
        drawn = self.pictures(callback)
        if options["format"] == "GIF":
            palette = self._palette()
            drawn = (picture.quantize(palette=palette) for picture in drawn)
        first, *others = drawn
        duration = max(20, round(1000 / self.fps))
        write_picture(first, path, append_images=others, duration=duration, loop=0, **options)
        return path

    def _palette(self) -> Image.Image:
        """Picture whose palette is the 256 colours of the GIF, chosen from some of the frames.

        All frames share one palette, since the background flickers otherwise.
        """
        width, height = self.size
        chosen = evenly(len(self.order), _PALETTE_FRAMES)
        strip = Image.new("RGB", (width, height * len(chosen)))
        for k, picture in enumerate(self.pictures(chosen=chosen)):
            strip.paste(picture, (0, k * height))
        return strip.quantize(method=Image.Quantize.MEDIANCUT)

    def _annotate(self, picture: Image.Image, k: int, curve: NDArray[np.float64] | None) -> None:
        """Draw the titles, the scale of the error, the caption of frame `k`, and the RMSE curve."""
        (width, height), (head, _, gap) = self.panels.view.size, self._paper
        scale = height / 640
        draw = ImageDraw.Draw(picture)
        small, large = (ImageFont.load_default(max(8, s * scale)) for s in (20, 28))
        edge = 18 * scale
        for n, title in enumerate(self.titles or ()):
            left = n * (width + gap)
            draw.text((left + edge, head / 2), title, INK, large, "lm")
            style = self.panels.rows[n][1]
            if style in self.panels.scales:
                shown, unit = (
                    self.panels.scales[style],
                    DEGREES if style == "normals" else self.unit,
                )
                long = 130 * scale
                bar = (round(left + width - edge - long), round(head - 28 * scale), round(long))
                draw_scale(picture, shown, unit, bar, scale, small, ticks="lr")
        if self.captions is None:
            return
        line, right = head + height + 32 * scale, picture.width - edge
        draw.text((edge, line), self.captions[k], INK, small, "lm")
        if curve is None:
            return
        text = "RMSE " + self.panels.scene.figures([self.order[k]], self.unit)
        draw.text((right, line), text, INK, small, "rm")
        top, bottom = line + 28 * scale, picture.height - 16 * scale
        x = np.linspace(edge, right, len(curve))
        y = bottom - (bottom - top) * curve / max(float(curve.max()), 1e-30)
        points = [(float(a), float(b)) for a, b in zip(x, y, strict=True)]
        thick, r = max(1, round(2 * scale)), 4.5 * scale
        draw.line((edge, bottom, right, bottom), fill="#d7dae0")
        draw.line(points, fill="#c3c7cf", width=thick)
        draw.line(points[: k + 1], fill=QUIET, width=thick)
        a, b = points[k]
        draw.ellipse((a - r, b - r, a + r, b + r), fill=_MARK)


def animate(
    subject: Any,
    path: str | os.PathLike[str],
    *,
    callback: Callable[[float], object] | None = None,
    **options: Any,
) -> Path:
    """Write a looping film as GIF, WebP or animated PNG.

    Parameters
    ----------
    subject : MeshSequence, Skinning or Decomposition
    path : path
        Its suffix is ``.gif``, ``.webp`` or ``.png``.
    callback : callable, optional
        Called with the fraction done.
    **options
        Options of :meth:`Film.of`.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    FormatError
        If the suffix is another one.
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
    _options(Path(path))
    return Film.of(subject, **options).write(path, callback)


def _options(path: Path) -> dict[str, Any]:
    options = _KINDS.get(path.suffix.lower())
    if options is None:
        raise FormatError(f"{path}: a film is written as .gif, .webp or .png")
    return options
