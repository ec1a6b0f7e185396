"""Panels: frames in several styles with the same camera, lighting and scale of the error."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
from PIL import Image, ImageDraw

from ..errors import InputError
from .palette import heat, linear_from_srgb, srgb_from_linear
from .parts import NEUTRAL
from .raster import Float, block_mean
from .scene import ERRORS, Scene, Style, Unit, number
from .skeleton import draw_bones
from .studio import Stage
from .view import View

INK, QUIET = "#20242c", "#6b7280"
DEGREES: Unit = ("°", 1.0)
_SAMPLES = 2  # per pixel along each axis
_EVEN = 0.45  # share of the light without direction on colours that show values
_GHOST = 0.55  # opacity of a surface that shows its bones


@dataclasses.dataclass(frozen=True)
class Scale:
    """Colour scale of an error, which begins at 0.

    Attributes
    ----------
    top : float
        Error that has the last colour, in the mesh's units or in degrees.
    exceeded : bool
        Whether a frame has a larger error.
    """

    top: float
    exceeded: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Panels:
    """Scenes with their styles (rows of a sheet, panels of a film), and the frames to draw.

    Attributes
    ----------
    rows : tuple of (Scene, Style)
    frames : tuple of int
    view : View
    scales : dict of Style to Scale
        Scale of each style of `rows` that shows an error.
    """

    rows: tuple[tuple[Scene, Style], ...]
    frames: tuple[int, ...]
    view: View
    scales: dict[Style, Scale]

    @classmethod
    def of(
        cls,
        scene: Scene,
        styles: Sequence[Style | None],
        frames: Sequence[int],
        size: tuple[int, int] | None,
        *,
        with_reference: bool = True,
        top: float | None = None,
        **look: Any,
    ) -> Panels:
        """Check the arguments and return the panels of a figure.

        Parameters
        ----------
        scene : Scene
        styles : sequence of Style
            None means "weights", or "plain" for a subject without bones.
        frames : sequence of int
        size : (int, int) or None
            Size of a panel in pixels.
        with_reference : bool
            Whether the reference, if any, is the first row.
        top : float, optional
            Error with the last colour, in the mesh's units or, for "normals", in degrees; by
            default a round number that few errors exceed.
        **look
            Options of :meth:`View.of`.
        """
        rows = [(scene, _checked_style(style, scene)) for style in styles]
        if with_reference and scene.reference is not None:
            parts = scene.parts if scene.has_parts else ()
            rows.insert(0, (Scene.of(scene.reference, None, parts), "plain"))
        order = checked_frames(frames, scene.subject.n_frames)
        view = View.of(scene, order, size, **look)
        scales: dict[Style, Scale] = {}
        for style in ERRORS:
            if any(shown == style for _, shown in rows):
                high, largest = scene.error_range(order, style)
                end = top or _round_up(high)
                scales[style] = Scale(end, largest > end)
        return cls(tuple(rows), tuple(order), view, scales)

    @property
    def scene(self) -> Scene:
        """Scene of the subject."""
        return self.rows[-1][0]

    def draw(self, frame: int) -> list[Image.Image]:
        """Draw one frame in the style of each row, and return one picture per row."""
        stages: dict[int, Stage] = {}  # by scene, since all its rows share one
        pictures = []
        for scene, style in self.rows:
            if id(scene) not in stages:
                stages[id(scene)] = self._stage(scene, frame)
            stage = stages[id(scene)]
            even = _EVEN if style == "weights" or style in ERRORS else 0.0
            opacity = _GHOST if style == "bones" else 1.0
            colors = self._colors(scene, style, frame)[scene.split.vertex]
            picture = stage.draw(colors, even, opacity)
            if style == "bones":
                camera, shift = self.view.camera, self.view.shift[frame]
                draw_bones(picture, stage.nearness, camera, scene, frame, shift)
            pixels = 255 * srgb_from_linear(block_mean(picture, _SAMPLES))
            pictures.append(Image.fromarray(pixels.round().astype(np.uint8)))
        return pictures

    def _stage(self, scene: Scene, frame: int) -> Stage:
        size = (self.view.size[0] * _SAMPLES, self.view.size[1] * _SAMPLES)
        split, camera = scene.split, self.view.camera
        points = scene.visible(frame)[split.vertex] - self.view.shift[frame]
        if not len(scene.faces):
            return Stage.of_cloud(camera, size, points, scene.ball_radius)
        normals = scene.drawn_normals(frame)
        return Stage.of_mesh(camera, size, points, split.faces, self.view.ground, normals)

    def _colors(self, scene: Scene, style: Style, frame: int) -> Float:
        """Linear RGB of each vertex, ``(V, 3)``."""
        if style == "weights":
            return scene.weight_colors
        colors = np.zeros((len(scene.measured), 3))
        for part in scene.parts:
            colors[part.vertices] = linear_from_srgb(NEUTRAL if style in ERRORS else part.color)
        if style in ERRORS:
            errors = scene.errors(frame, style)[scene.measured]
            colors[scene.measured] = heat(errors / self.scales[style].top)
        return colors


def as_many(name: str, texts: Sequence[str], things: Sequence[Any]) -> list[str]:
    """Check that there are as many texts as `things`, and return them as a list."""
    if isinstance(texts, str) or len(texts) != len(things):
        raise InputError(name, f"{len(things)} texts", texts)
    return [str(t) for t in texts]


def checked_frames(frames: Any, n_frames: int) -> list[int]:
    """Check frame indices and return them, counted from 0.

    Negative indices are counted from the end.
    """
    order = [int(t) for t in frames]
    if not order:
        raise InputError("frames", "at least one frame", "none")
    for t in order:
        if not -n_frames <= t < n_frames:
            raise InputError("frames", f"indices from 0 to {n_frames - 1}", t)
    return [t % n_frames for t in order]


def _checked_style(style: Style | None, scene: Scene) -> Style:
    if style is None:
        return "weights" if scene.has_bones else "plain"
    if style not in get_args(Style):
        raise InputError("style", f"one of {', '.join(get_args(Style))}", repr(style))
    if style in ("weights", "bones") and not scene.has_bones:
        expected = "plain, error or normals for a sequence, which has no bones"
        raise InputError("style", expected, repr(style))
    if style in ERRORS and scene.reference is None:
        raise InputError("reference", "a MeshSequence to measure the error against", None)
    if style == "normals" and not len(scene.faces):
        raise InputError("style", "plain, bones, weights or error for a cloud of points", style)
    return style


def _round_up(value: float) -> float:
    """Round up to 1, 1.5, 2, 3, 4, 5, 6 or 8 times a power of ten.

    A value up to 0.1 % above such a number is rounded down to it.  The result is 1 if the value is
    not positive.
    """
    if not value > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(s * power for s in (1, 1.5, 2, 3, 4, 5, 6, 8, 10, 15) if s * power >= value * 0.999)


def draw_scale(
    page: Image.Image,
    shown: Scale,
    unit: Unit,
    bar: tuple[int, int, int],
    scale: float,
    font: Any,
    ticks: str = "lmmmr",
) -> float:
    """Draw the colours of the error from left to right, with their values above.

    Parameters
    ----------
    page : PIL.Image.Image
        Updated in place.
    shown : Scale
    unit : (str, float)
    bar : (int, int, int)
        Left, top and width.
    scale : float
        Factor on all sizes.
    font
    ticks : str
        Horizontal anchor of the text at each tick.

    Returns
    -------
    float
        Height of the bar.
    """
    left, y, width = bar
    height = round(16 * scale)
    colors = (255 * srgb_from_linear(heat(np.linspace(0, 1, width)))).round().astype(np.uint8)
    page.paste(Image.fromarray(np.tile(colors, (height, 1, 1))), (left, y))
    draw = ImageDraw.Draw(page)
    draw.rectangle((left, y, left + width - 1, y + height - 1), outline="#c4c9d2")
    for share, anchor in zip(np.linspace(0, 1, len(ticks)), ticks, strict=True):
        x = left + (width - 1) * share
        text = f"{'> ' if share == 1 and shown.exceeded else ''}{number(shown.top * share, unit)}"
        draw.line((x, y - 4 * scale, x, y), fill=QUIET)
        draw.text((x, y - 6 * scale), text, INK, font, anchor + "s")
    return height
