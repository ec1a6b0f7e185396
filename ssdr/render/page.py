"""What pictures and films share: checked arguments, round numbers, text, the scale of the error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
from PIL import Image, ImageDraw

from ..errors import InputError, is_whole
from .palette import heat, srgb_from_linear
from .scene import Scene, Style

__all__ = [
    "INK",
    "QUIET",
    "as_many",
    "check_picture",
    "checked_frames",
    "checked_style",
    "color_bar",
    "nice",
    "rounded",
    "small_color_bar",
    "spread",
    "upright_text",
]

INK, QUIET = "#20242c", "#6b7280"
_SIZES = (16, 8192)  # smallest and largest side in pixels: larger needs gigabytes of samples


def as_many(name: str, texts: Sequence[str], things: Sequence[Any]) -> list[str]:
    """Texts, one for each thing; InputError if they are fewer or more."""
    if isinstance(texts, str) or len(texts) != len(things):
        raise InputError(name, f"{len(things)} texts", texts)
    return [str(t) for t in texts]


def nice(value: float) -> float:
    """The next 1, 1.5, 2, 3, 4, 5, 6 or 8 times a power of ten."""
    if not value > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(s * power for s in (1, 1.5, 2, 3, 4, 5, 6, 8, 10, 15) if s * power >= value * 0.999)


def checked_style(style: Style | None, scene: Scene) -> Style:
    if style is None:
        return "plain" if scene.skinning is None else "weights"
    if style not in get_args(Style):
        raise InputError("style", f"one of {', '.join(get_args(Style))}", repr(style))
    if style in ("weights", "bones") and scene.skinning is None:
        raise InputError("style", "plain or error for a sequence, which has no bones", repr(style))
    if style == "error" and scene.reference is None:
        raise InputError("reference", "a MeshSequence to measure the error against", None)
    return style


def checked_frames(frames: Any, n_frames: int) -> list[int]:
    order = [int(t) for t in frames]
    if not order:
        raise InputError("frames", "at least one frame", "none")
    for t in order:
        if not -n_frames <= t < n_frames:
            raise InputError("frames", f"indices from 0 to {n_frames - 1}", t)
    return [t % n_frames for t in order]


def spread(frames: int | Sequence[int], n_frames: int) -> list[int]:
    if not isinstance(frames, (int, np.integer)):
        return checked_frames(frames, n_frames)
    if isinstance(frames, bool) or not 1 <= frames <= 100:
        raise InputError("frames", "1 to 100, or a sequence of indices", frames)
    # Not the last frame: in a cycle it is the first again.
    count = min(int(frames), n_frames)
    return [int(t) for t in (np.arange(count) + 0.5) * n_frames / count]


def check_picture(size: tuple[int, int], supersample: int) -> None:
    pair = isinstance(size, (tuple, list, np.ndarray)) and len(size) == 2
    if not pair or not all(is_whole(n) and _SIZES[0] <= n <= _SIZES[1] for n in size):
        expected = f"width and height of {_SIZES[0]} to {_SIZES[1]} pixels"
        raise InputError("size", expected, repr(size))
    if not is_whole(supersample) or supersample not in (1, 2, 3, 4):
        raise InputError("supersample", "1, 2, 3 or 4", repr(supersample))


def rounded(size: tuple[int, int], radius: int) -> Image.Image:
    large = Image.new("L", (size[0] * 4, size[1] * 4), 0)
    box = (0, 0, large.width - 1, large.height - 1)
    ImageDraw.Draw(large).rounded_rectangle(box, radius * 4, fill=255)
    return large.resize(size, Image.Resampling.LANCZOS)


def upright_text(
    page: Image.Image, text: str, corner: tuple[int, int], size: tuple[int, int], font: Any
) -> None:
    strip = Image.new("RGB", (size[1], size[0]), "white")
    ImageDraw.Draw(strip).text((size[1] / 2, size[0] / 2 - 4), text, INK, font, "mm")
    page.paste(strip.rotate(90, expand=True), corner)


def color_bar(
    draw: ImageDraw.ImageDraw,
    page: Image.Image,
    box: tuple[int, int, int],
    scale: float,
    scene: Scene,
    beyond: bool,
    top: float,
    font: Any,
    unit: tuple[str, float] | None = None,
) -> None:
    """Scale of the error: ticks in the mesh's units above, in % of the diagonal below.

    `beyond`: errors exceed the last tick.
    """
    left, y, width = box
    height = round(18 * scale)
    _bar(draw, page, (left, y, width, height))
    name, factor = unit or ("", 1.0)
    for k in range(5):
        x = left + (width - 1) * k / 4
        sign = "> " if k == 4 and beyond else ""
        draw.line((x, y - 4 * scale, x, y), fill=QUIET)
        anchor = "l" if k == 0 else "r" if k == 4 else "m"
        text = f"{sign}{factor * top * k / 4:.3g} {name}".rstrip()
        draw.text((x, y - 6 * scale), text, INK, font, anchor + "s")
        draw.line((x, y + height, x, y + height + 4 * scale), fill=QUIET)
        share = 100 * top * k / 4 / scene.diagonal
        draw.text((x, y + height + 6 * scale), f"{share:.3g} %", QUIET, font, anchor + "a")
    x = left + width + 24 * scale
    if scene.parts:
        shown = " and ".join(p.name for p in scene.parts if p.measured)
        text = f"distance of the {shown} to the truth"
    else:
        text = "distance to the input, in the mesh's units"
    draw.text((x, y - 6 * scale), text, INK, font, "ls")
    draw.text((x, y + height + 6 * scale), "in % of the diagonal", QUIET, font, "la")


def small_color_bar(
    draw: ImageDraw.ImageDraw,
    page: Image.Image,
    right: int,
    middle: int,
    scale: float,
    beyond: bool,
    top: float,
    font: Any,
    unit: tuple[str, float],
) -> None:
    """Scale of the error on one line that ends at the right; arguments as :func:`color_bar`."""
    name, factor = unit
    text = f"{'> ' if beyond else ''}{factor * top:.3g} {name}".rstrip()
    width, height = round(130 * scale), round(14 * scale)
    left = round(right - draw.textlength(text, font) - width - 10 * scale)
    _bar(draw, page, (left, middle - height // 2, width, height))
    draw.text((left - 8 * scale, middle), "0", INK, font, "rm")
    draw.text((right, middle), text, INK, font, "rm")


def _bar(draw: ImageDraw.ImageDraw, page: Image.Image, box: tuple[int, int, int, int]) -> None:
    left, y, width, height = box
    bar = (255 * srgb_from_linear(heat(np.linspace(0, 1, width)))).round().astype(np.uint8)
    page.paste(Image.fromarray(np.repeat(bar[None], height, axis=0)), (left, y))
    draw.rectangle((left, y, left + width - 1, y + height - 1), outline="#c4c9d2")
