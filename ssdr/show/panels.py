"""Panels: frames in several styles with one camera, one light and one scale of the error."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
from PIL import Image, ImageDraw

from ..common.checks import check_frames
from ..common.errors import InputError, is_whole
from .camera import Camera, Float, Size, up_axes
from .light import Drawer, cloud_drawer, mesh_drawer
from .palette import heat, srgb_from_linear
from .skeleton import draw_bones
from .subject import Scene, Style, evenly

INK, QUIET = "#20242c", "#6b7280"
Unit = tuple[str, float]
_SIZES = (16, 8192)  # smallest and largest side in pixels; larger ones take gigabytes
_SIDES = (25, -25, 40, -40, 60, -60, 10, -10)  # azimuths to choose from, in degrees
_EVEN = 0.45  # share of the light without direction on colours that show values
_GHOST = 0.55  # opacity of a surface that shows its bones


@dataclasses.dataclass(frozen=True, eq=False)
class Panels:
    """Scenes with their styles (rows of a sheet, panels of a film), and the frames to draw.

    Attributes
    ----------
    rows : tuple of (Scene, Style)
    frames : tuple of int
    camera : Camera
    size : (int, int)
        Width and height of a panel in pixels.
    shift : dict of int to (3,) float64
        Vector subtracted from the points of each frame, to keep a travelling subject in view.
    scale : (float, bool), optional
        Where a row shows the error, that with the last colour, in the mesh's units, and whether a
        frame has a larger one.
    """

    rows: tuple[tuple[Scene, Style], ...]
    frames: tuple[int, ...]
    camera: Camera
    size: Size
    shift: dict[int, Float]
    scale: tuple[float, bool] | None

    @classmethod
    def of(
        cls,
        scene: Scene,
        styles: Sequence[Style | None],
        frames: Sequence[int],
        size: Any = None,
        *,
        width: int = 0,
        with_reference: bool = True,
        scale: float | None = None,
        up: str = "y",
        azimuth: float | None = None,
        elevation: float = 12.0,
    ) -> Panels:
        """Check the arguments and return the panels of a figure; the camera follows far travel.

        Parameters
        ----------
        scene : Scene
        styles : sequence of Style
            None means "weights", or "plain" for a subject without bones.
        frames : sequence of int
        size : (int, int), optional
            Size of a panel in pixels, for a view of the whole motion.
        width : int
            Width of a panel instead of its size.  The height and the view fit the frames to be
            drawn, each centred if the motion travels.
        with_reference : bool
            Whether the reference, if any, is the first row.
        scale, up, azimuth, elevation
            As in :func:`render_frame`.
        """
        rows = [(scene, _checked_style(style, scene)) for style in styles]
        if with_reference and scene.reference is not None:
            rows.insert(0, (scene.truth(), "plain"))
        every = np.arange(scene.subject.n_frames)
        order = every[check_frames(frames, len(every))].tolist()
        if not order:
            raise InputError("frames", "at least one frame", "none")
        size = (width, width) if width else size
        pair = isinstance(size, (tuple, list, np.ndarray)) and len(size) == 2
        if not pair or not all(is_whole(n) and _SIZES[0] <= n <= _SIZES[1] for n in size):
            expected = f"width and height of {_SIZES[0]} to {_SIZES[1]} pixels"
            raise InputError("size", expected, repr(size))
        some = sorted({*order, *(() if width else evenly(scene.subject.n_frames))})
        points = [scene.positions(t)[scene.vertex] for t in some]
        vertical = up_axes(up)[0]
        boxes = np.array([[p.min(axis=0), p.max(axis=0)] for p in points])
        middle = boxes.mean(axis=1)
        moved = middle - middle[0]
        moved -= np.outer(moved @ vertical, vertical)
        body = float(np.median(np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)))
        moved *= np.linalg.norm(np.ptp(moved, axis=0)) > (0.1 if width else 0.8) * body
        points = [p - d for p, d in zip(points, moved, strict=True)]
        look = functools.partial(Camera.fit, np.concatenate(points), up=up, elevation=elevation)
        look = functools.partial(look, azimuth=_best(look, points) if azimuth is None else azimuth)
        if width:
            extent = np.ptp(np.concatenate(points) @ look().axes.T, axis=0)
            extent = np.maximum(extent[:2], 0.05 * extent.max() + 1e-30)
            size = width, round(width / np.clip(extent[0] / extent[1], 0.7, 1.7))
        shown = None
        if "error" in (style for _, style in rows):
            high, largest = scene.error_range(order)
            end = scale or _round_up(high)
            shown = end, largest > end
        return cls(
            tuple(rows),
            tuple(order),
            look(aspect=size[0] / size[1]),
            (int(size[0]), int(size[1])),
            dict(zip(some, moved, strict=True)),
            shown,
        )

    def draw(self, frame: int) -> list[Image.Image]:
        """Draw one frame in the style of each row, and return one picture per row."""
        drawers: dict[int, Drawer] = {}  # by scene, since all its rows share one
        pictures = []
        for scene, style in self.rows:
            if id(scene) not in drawers:
                drawers[id(scene)] = self._drawer(scene, frame)
            top, _ = self.scale or (1.0, False)
            even = _EVEN if style in ("weights", "error") else 0.0
            colors = scene.colors_of(style, frame, top)[scene.vertex]
            opacity = _GHOST if style == "bones" else 1.0
            picture, nearness = drawers[id(scene)](colors, even, opacity)
            if style == "bones":
                draw_bones(picture, nearness, self.camera, scene, frame, self.shift[frame])
            rows = picture[::2] + picture[1::2]  # two samples per pixel along each axis
            pixels = 255 * srgb_from_linear((rows[:, ::2] + rows[:, 1::2]) / 4)
            pictures.append(Image.fromarray(pixels.round().astype(np.uint8)))
        return pictures

    def _drawer(self, scene: Scene, frame: int) -> Drawer:
        size = 2 * self.size[0], 2 * self.size[1]
        points = scene.positions(frame)[scene.vertex] - self.shift[frame]
        if not len(scene.faces):
            return cloud_drawer(self.camera, size, points, scene.ball_radius)
        mesh = points, scene.faces, scene.normals(frame)
        return mesh_drawer(self.camera, size, *mesh, creases=not scene.has_bones)

    def draw_scale(
        self,
        page: Image.Image,
        unit: Unit,
        bar: tuple[int, int, int],
        font: Any,
        ticks: str = "lmmmr",
    ) -> None:
        """Draw the colours of an error from left to right, with their values above.

        `bar` is the left, the top and the width, and `ticks` the horizontal anchors of the values.
        """
        left, y, width = bar
        assert self.scale is not None
        height, (top, exceeded) = round(font.size * 0.8), self.scale
        colors = (255 * srgb_from_linear(heat(np.linspace(0, 1, width)))).round().astype(np.uint8)
        page.paste(Image.fromarray(np.tile(colors, (height, 1, 1))), (left, y))
        draw = ImageDraw.Draw(page)
        draw.rectangle((left, y, left + width - 1, y + height - 1), outline="#c4c9d2")
        for share, anchor in zip(np.linspace(0, 1, len(ticks)), ticks, strict=True):
            x = left + (width - 1) * share
            draw.line((x, y - height / 4, x, y), fill=QUIET)
            text = f"{'> ' if share == 1 and exceeded else ''}{number(top * share, unit)}"
            draw.text((x, y - 0.4 * height), text, INK, font, anchor + "s")


def number(value: float, unit: Unit) -> str:
    """Text of a number in a unit, with three digits."""
    name, factor = unit
    return f"{factor * value:.3g} {name}".rstrip()


def as_many(name: str, texts: Sequence[str], things: Sequence[Any]) -> list[str]:
    """Check that there are as many texts as `things`, and return them as a list."""
    if isinstance(texts, str) or len(texts) != len(things):
        raise InputError(name, f"{len(things)} texts", texts)
    return [str(t) for t in texts]


def _checked_style(style: Style | None, scene: Scene) -> Style:
    if style is None:
        return "weights" if scene.has_bones else "plain"
    if style not in get_args(Style):
        raise InputError("style", f"one of {', '.join(get_args(Style))}", repr(style))
    if style in ("weights", "bones") and not scene.has_bones:
        expected = "plain or error for a sequence, which has no bones"
        raise InputError("style", expected, repr(style))
    if style == "error" and scene.reference is None:
        raise InputError("reference", "a MeshSequence to measure the error against", None)
    return style


def _round_up(value: float) -> float:
    """Round up to 1, 1.5, 2, 3, 4, 5, 6 or 8 times a power of ten.

    A value up to 0.1 % above such a number is rounded down to it.
    """
    power = 10.0 ** math.floor(math.log10(value))
    return next(s * power for s in (1, 1.5, 2, 3, 4, 5, 6, 8, 10, 15) if s * power >= value * 0.999)


def _best(look: Any, points: list[Float]) -> float:
    """Azimuth at which the motion covers most of the picture, with a preference for the front."""
    some = points[:: max(1, len(points) // 6)]
    sample = np.concatenate([p[:: max(1, len(p) // 1500)] for p in some])
    cell = np.ptp(sample, axis=0).max() / 40 or 1.0
    best, chosen = -1.0, 30.0
    for side in _SIDES:
        flat = np.floor(sample @ look(azimuth=side).axes[:2].T / cell).astype(np.int64)
        score = len(np.unique(flat, axis=0)) * (1.0 + 0.35 * math.cos(math.radians(side)))
        if score > best * 1.02:
            best, chosen = score, float(side)
    return chosen
