"""Films of sequences and skinnings."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

from ..common.errors import InputError
from ..mesh.clips import one_rate
from ..mesh.sequence import MeshSequence
from .camera import Size
from .figures import write_picture
from .panels import INK, Panels, Unit, as_many
from .subject import Scene, Style, evenly

FILMS = (".gif", ".webp")


@dataclasses.dataclass(frozen=True, eq=False)
class Film:
    """Film with panels side by side, titles, and captions.

    Use :meth:`of` to make one, or :func:`draw` to make and write one.

    Attributes
    ----------
    panels : Panels
    fps : float
        Frames per second.
    titles, captions : tuple of str
        Title of each panel, and caption of each frame shown; empty without titles or captions.
    unit : (str, float)
        Unit of the error's scale, as in :func:`contact_sheet`.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> from ssdr.show import Film
    >>> film = Film.of(dancer, size=(64, 48), frames=[0, 8, 16])
    >>> film.panels.frames, [picture.size for picture in film.pictures()]
    ((0, 8, 16), [(64, 48), (64, 48), (64, 48)])
    """

    panels: Panels
    fps: float
    titles: tuple[str, ...]
    captions: tuple[str, ...]
    unit: Unit

    @classmethod
    def of(
        cls,
        subject: Any,
        *,
        reference: MeshSequence | None = None,
        style: Style | Sequence[Style] | None = None,
        size: Size = (480, 480),
        frames: Sequence[int] | None = None,
        fps: float | None = None,
        titles: Sequence[str] | None = None,
        captions: Sequence[str] | None = None,
        unit: Unit = ("", 1.0),
        colors: ArrayLike | None = None,
        measured: ArrayLike | None = None,
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
        titles : sequence of str, optional
            Names of the panels, drawn above them.
        captions : sequence of str, optional
            Texts drawn below the frames.
        unit, colors, measured
            As in :func:`contact_sheet`.
        **look
            `scale`, `up`, `azimuth` and `elevation` of :func:`render_frame`.

        Raises
        ------
        InputError
            As :func:`render_frame`.
        """
        scene = Scene.of(subject, reference, colors, measured)
        clips = scene.model.clips if scene.has_bones else ()
        if clips and not one_rate(clips):
            rates = ", ".join(f"{clip.name} at {clip.fps:g}" for clip in clips)
            raise InputError("subject", "clips of one frame rate, for a film", rates)
        step = cls.step(scene.subject.fps) if frames is None else 1
        speed = fps or scene.subject.fps / step
        if not (math.isfinite(speed) and speed > 0):
            raise InputError("fps", "a positive number", fps)
        styles = [style] if isinstance(style, str) or style is None else list(style)
        order = range(0, scene.subject.n_frames, step) if frames is None else frames
        panels = Panels.of(scene, styles, order, size, **look)
        names = () if titles is None else as_many("titles", titles, panels.rows)
        texts = () if captions is None else as_many("captions", captions, panels.frames)
        return cls(panels, speed, tuple(names), tuple(texts), unit)

    @staticmethod
    def step(fps: float) -> int:
        """Step from one drawn frame to the next, so that a film has at most 30 frames a second.

        Viewers slow down faster ones.
        """
        return max(1, math.ceil(fps / 30 - 1e-9))

    def pictures(self, callback: Callable[[float], object] | None = None) -> Iterator[Image.Image]:
        """Draw the frames, one after the other; `callback` is called with the fraction done."""
        for k in range(len(self.panels.frames)):
            yield self._picture(k)
            if callback is not None:
                callback((k + 1) / len(self.panels.frames))

    def write(
        self, path: str | os.PathLike[str], callback: Callable[[float], object] | None = None
    ) -> Path:
        """Write the looping film and return its path; `callback` is that of :meth:`pictures`."""
        target = Path(path)
        if target.suffix.lower() not in FILMS:
            raise InputError("path", "a film: .gif or .webp", str(path))
        drawn, gif = self.pictures(callback), target.suffix.lower() == ".gif"
        if gif:
            # One palette for all frames, since the background flickers otherwise.
            some = [np.asarray(self._picture(k)) for k in evenly(len(self.panels.frames), 4)]
            palette = Image.fromarray(np.concatenate(some)).quantize()
            drawn = (picture.quantize(palette=palette) for picture in drawn)
        first, *others = drawn
        # A GIF counts hundredths of a second: rounded one by one, frames would take another time.
        tick = 10 if gif else 1
        times = np.round(np.arange(len(self.panels.frames) + 1) * 1000 / (tick * self.fps))
        shown = np.maximum(20, tick * np.diff(times)).astype(int).tolist()
        # Method 4 makes a WebP a third smaller and takes less time than drawing.
        options = {"duration": shown, "loop": 0, "method": 4}
        write_picture(first, target, save_all=True, append_images=others, disposal=1, **options)
        return target

    def _picture(self, k: int) -> Image.Image:
        """Panels of the k-th frame shown, with their titles, scales of the error, and caption."""
        panels, (width, height) = self.panels, self.panels.size
        head, gap = (round(0.1 * height), 2 * round(0.008 * height)) if self.titles else (0, 0)
        foot = round(0.1 * height) if self.captions else 0
        total = (width + gap) * len(panels.rows) - gap, head + height + foot
        page = Image.new("RGB", (total[0], total[1] + total[1] % 2 * bool(head or foot)), "white")
        draw, edge = ImageDraw.Draw(page), 18 * height / 640
        small, large = (ImageFont.load_default(max(8, s * height / 640)) for s in (20, 28))
        for n, picture in enumerate(panels.draw(panels.frames[k])):
            left = n * (width + gap)
            page.paste(picture, (left, head))
            for title in self.titles[n : n + 1]:
                draw.text((left + edge, head / 2), title, INK, large, "lm")
                if panels.rows[n][1] == "error":
                    bar = round(left + width - 8 * edge), round(0.56 * head), round(7 * edge)
                    panels.draw_scale(page, self.unit, bar, small, "lr")
        for text in self.captions[k : k + 1]:
            draw.text((edge, head + height + foot / 2), text, INK, small, "lm")
        return page
