"""Common view of all panels: a camera that may follow the subject."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import InputError, is_whole
from .raster import Camera, Float, up_axes
from .scene import Scene, evenly

_SIZES = (16, 8192)  # smallest and largest side in pixels; larger ones take gigabytes
_SIDES = (25, -25, 40, -40, 60, -60, 10, -10)  # azimuths to choose from, in degrees


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """Camera of all panels, and the shift that keeps a travelling subject in view.

    Attributes
    ----------
    camera : Camera
    size : (int, int)
        Width and height of a panel in pixels.
    ground : float
        Height of the lowest point along the camera's vertical.
    shift : dict of int to (3,) float64
        Vector subtracted from the points of each frame, by frame index.
    """

    camera: Camera
    size: tuple[int, int]
    ground: float
    shift: dict[int, Float]

    @classmethod
    def of(
        cls,
        scene: Scene,
        frames: Sequence[int],
        size: tuple[int, int] | None,
        *,
        width: int | None = None,
        camera: Camera | None = None,
        up: str = "y",
        azimuth: float | None = None,
        elevation: float = 12.0,
        perspective: bool = True,
        track: Float | None = None,
    ) -> View:
        """View of the motion; the camera follows a subject that travels far.

        Parameters
        ----------
        scene : Scene
        frames : sequence of int
            Frames to be drawn.
        size : (int, int) or None
            Width and height of a panel in pixels, for a view of the whole motion.
        width : int, optional
            Width of a panel instead of its size.  The height and the view fit the frames to be
            drawn, each centred if the motion travels.
        camera, up, azimuth, elevation, perspective
            As in :func:`render_frame`.
        track : (F, 3) float64, optional
            Path of the camera, instead of following the subject.
        """
        if not -90 <= elevation <= 90:
            raise InputError("elevation", "-90 to 90 degrees", elevation)
        if azimuth is not None and not math.isfinite(azimuth):
            raise InputError("azimuth", "degrees", azimuth)
        fixed = _checked_size(size) if width is None else (1, 1)
        some = sorted({*frames, *(evenly(scene.subject.n_frames) if width is None else ())})
        points = [scene.visible(t) for t in some]
        vertical = camera.vertical if camera else up_axes(up)[0]
        boxes = np.array([[p.min(axis=0), p.max(axis=0)] for p in points])
        if track is not None:
            moved = track[some]
        else:
            middle = boxes.mean(axis=1)
            moved = middle - middle[0]
            moved -= np.outer(moved @ vertical, vertical)
            body = float(np.median(np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)))
            least = (0.8 if width is None else 0.1) * body
            far = float(np.linalg.norm(np.ptp(moved, axis=0))) > least
            moved = moved * (camera is None and far)
        points = [p - d for p, d in zip(points, moved, strict=True)]
        ground = min(float((p @ vertical).min()) for p in points)
        turn = _best_azimuth(points, up, elevation) if azimuth is None else azimuth
        everything = np.concatenate(points)
        fit = functools.partial(Camera.fit, everything, azimuth=turn, elevation=elevation, up=up)
        if width is not None:
            extent = np.ptp(everything @ fit().axes.T, axis=0)
            extent = np.maximum(extent[:2], 0.05 * extent.max() + 1e-30)
            fixed = _checked_size((width, round(width / np.clip(extent[0] / extent[1], 0.7, 1.7))))
        camera = camera or fit(aspect=fixed[0] / fixed[1], perspective=perspective)
        return cls(camera, fixed, ground, dict(zip(some, moved, strict=True)))


def _checked_size(size: Any) -> tuple[int, int]:
    pair = isinstance(size, (tuple, list, np.ndarray)) and len(size) == 2
    if not pair or not all(is_whole(n) and _SIZES[0] <= n <= _SIZES[1] for n in size):
        expected = f"width and height of {_SIZES[0]} to {_SIZES[1]} pixels"
        raise InputError("size", expected, repr(size))
    return int(size[0]), int(size[1])


def _best_azimuth(points: list[Float], up: str, elevation: float) -> float:
    """Azimuth at which the motion covers most of the picture, with a preference for the front."""
    sample = np.concatenate(
        [p[:: max(1, len(p) // 1500)] for p in points[:: max(1, len(points) // 6)]]
    )
    cell = np.ptp(sample, axis=0).max() / 40 or 1.0
    best, chosen = -1.0, 30.0
    for azimuth in _SIDES:
        camera = Camera.fit(sample, azimuth=azimuth, elevation=elevation, up=up, perspective=False)
        flat = sample @ camera.axes[:2].T
        covered = len(np.unique(np.floor(flat / cell).astype(np.int64), axis=0))
        score = covered * (1.0 + 0.35 * math.cos(math.radians(azimuth)))
        if score > best * 1.02:
            best, chosen = score, float(azimuth)
    return chosen
