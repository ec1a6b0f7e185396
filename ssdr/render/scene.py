"""What a picture shows: positions, colours and errors of a subject, the view, one panel."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import cKDTree

from ..errors import InputError
from ..sequence import MeshSequence
from ..skinning import Skinning
from .palette import bone_colors, heat, linear_from_srgb, mix, srgb_from_linear
from .raster import Camera, Layer, backdrop, block_mean, draw_balls, draw_mesh, over, shadow

__all__ = ["Scene", "Style", "View", "draw_panel"]

Style = Literal["plain", "weights", "bones", "error"]
Float = NDArray[np.float64]

# sRGB, chosen by eye: a light warm grey on which shading shows
_CLAY = linear_from_srgb([0.84, 0.82, 0.79])
# sRGB of a bone's x, y and z axes: red, green, blue, as modelling programs draw them
_AXES = linear_from_srgb([[0.86, 0.27, 0.25], [0.30, 0.66, 0.31], [0.22, 0.45, 0.85]])
_FIT_FRAMES = 24  # frames that the camera is fitted to: more are slower, fewer may cut motion off


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A subject and what it should be, with one topology.

    A welded skinning is shown on the vertices of the unwelded reference.
    """

    sequence: MeshSequence | None
    skinning: Skinning | None
    reference: MeshSequence | None
    vertex_map: NDArray[np.int32] | None

    @classmethod
    def of(cls, subject: Any, reference: MeshSequence | None) -> Scene:
        """Check the arguments of a picture.

        Raises
        ------
        InputError
            If the subject is of no known kind or does not match the reference.
        """
        if not isinstance(subject, (MeshSequence, Skinning)):
            subject = getattr(subject, "skinning", subject)
        if not isinstance(subject, (MeshSequence, Skinning)):
            kind = type(subject).__name__
            raise InputError("subject", "a MeshSequence, Skinning or Decomposition", kind)
        sequence = subject if isinstance(subject, MeshSequence) else None
        skinning = subject if isinstance(subject, Skinning) else None
        vertex_map = None
        if reference is not None:
            if not isinstance(reference, MeshSequence):
                raise InputError("reference", "a MeshSequence", type(reference).__name__)
            n_vertices = subject.n_vertices
            if subject.vertex_map is not None and reference.n_vertices != n_vertices:
                vertex_map = np.asarray(subject.vertex_map)
                n_vertices = len(vertex_map)
            if (reference.n_frames, reference.n_vertices) != (subject.n_frames, n_vertices):
                raise InputError(
                    "reference",
                    f"{subject.n_frames} frames of {n_vertices} vertices, as the subject has",
                    f"{reference.n_frames} frames of {reference.n_vertices}",
                )
        return cls(sequence, skinning, reference, vertex_map)

    @property
    def _subject(self) -> MeshSequence | Skinning:
        subject = self.sequence or self.skinning
        assert subject is not None
        return subject

    @property
    def n_frames(self) -> int:
        return self._subject.n_frames

    @property
    def fps(self) -> float:
        return self._subject.fps

    @property
    def name(self) -> str:
        other = self.reference.name if self.reference is not None else ""
        return self._subject.name or other or "untitled"

    @property
    def faces(self) -> NDArray[np.int32]:
        of = self.reference if self.vertex_map is not None else self._subject
        assert of is not None
        return np.asarray(of.faces)

    @functools.cached_property
    def diagonal(self) -> float:
        if self.reference is not None:
            return self.reference.diagonal() or 1.0
        if self.sequence is not None:
            return self.sequence.diagonal() or 1.0
        some = [self.positions(t) for t in _thin(range(self.n_frames))]
        return max(float(np.linalg.norm(np.ptp(p, axis=0))) for p in some) or 1.0

    def positions(self, frame: int) -> Float:
        """Vertices of a frame, ``(V, 3)`` float64."""
        if self.sequence is not None:
            p: Any = self.sequence.frames(frame)
        else:
            assert self.skinning is not None
            p = self.skinning.skin(frame)[0]
        p = p.astype(np.float64)
        return np.asarray(p if self.vertex_map is None else p[self.vertex_map])

    def errors(self, frame: int) -> Float:
        """Distance of each vertex to the reference, ``(V,)``."""
        assert self.reference is not None
        truth = np.asarray(self.reference.frames(frame), dtype=np.float64)
        return np.asarray(np.linalg.norm(self.positions(frame) - truth, axis=1))

    def high_error(self, frames: Sequence[int]) -> float:
        """An error that few vertices of these frames exceed."""
        errors = np.stack([self.errors(t) for t in frames])
        # Never so small that rounding of float32 would look like an error.
        return max(float(np.quantile(errors, 0.995)), 1e-6 * self.diagonal)

    def largest_error(self, frames: Sequence[int]) -> float:
        return max(float(self.errors(t).max()) for t in frames)

    def rmse(self) -> float:
        """sqrt(Σ |d|² / (F V)) over all frames."""
        total = sum(float((self.errors(t) ** 2).sum()) for t in range(self.n_frames))
        assert self.reference is not None
        return math.sqrt(total / (self.n_frames * self.reference.n_vertices))

    def summary(self, with_error: bool) -> str:
        """Counts and error in one line."""
        shown = self._subject
        parts = [f"{shown.n_vertices:,} vertices", f"{shown.n_frames:,} frames"]
        if self.skinning is not None:
            parts += [f"{self.skinning.n_bones} bones", f"{self.skinning.n_influences} influences"]
        if with_error:
            rmse = self.rmse()
            parts.append(f"RMSE {rmse:.3g} ({100 * rmse / self.diagonal:.3g} % of the diagonal)")
            parts.append(f"E = {1000 * rmse / math.sqrt(3):.3g}")
        return "  ·  ".join(parts)

    @functools.cached_property
    def centroids(self) -> Float:
        assert self.skinning is not None
        return np.asarray(self.skinning.centroids(), dtype=np.float64)

    @functools.cached_property
    def palette(self) -> Float:
        return bone_colors(self.centroids)

    @functools.cached_property
    def weight_colors(self) -> Float:
        assert self.skinning is not None
        colors = mix(self.palette, self.skinning.weights, self.skinning.joints)
        return colors if self.vertex_map is None else colors[self.vertex_map]

    @functools.cached_property
    def disc_radius(self) -> float:
        """Radius at which the points of a cloud just about touch."""
        p = self.positions(0)
        if len(p) < 2:
            return 0.02 * self.diagonal
        gap = np.asarray(cKDTree(p).query(p, k=2)[0])[:, 1]
        gap = gap[gap > 0]
        return float(np.quantile(gap, 0.8)) * 0.75 if len(gap) else 0.01 * self.diagonal


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """A camera for all panels of a figure, and how far each frame is shifted into it."""

    camera: Camera
    aspect: float
    ground: float
    shift: dict[int, Float]

    @classmethod
    def of(
        cls,
        scene: Scene,
        frames: Sequence[int],
        size: tuple[int, int] | None,
        camera: Camera | None,
        up: str,
        azimuth: float | None,
        elevation: float,
        perspective: bool,
    ) -> View:
        """Frame the motion; where it travels far, walk with it.

        `size` fixes the aspect and the view is that of the whole motion;
        without it the frames alone decide on both, and each is centred.
        """
        if not -90 <= elevation <= 90:
            raise InputError("elevation", "-90 to 90 degrees", elevation)
        if azimuth is not None and not math.isfinite(azimuth):
            raise InputError("azimuth", "degrees", azimuth)
        some = sorted({*_thin(range(scene.n_frames)), *frames} if size else set(frames))
        points: list[Float] = [_without_strays(scene.positions(t), scene.faces) for t in some]
        fitted = camera or Camera.fit(points[0], up=up, perspective=perspective)
        vertical = fitted.vertical
        boxes = np.array([[p.min(axis=0), p.max(axis=0)] for p in points])
        middle = boxes.mean(axis=1)
        flat = middle - np.outer(middle @ vertical, vertical)
        flat -= flat[0]
        body = float(np.median(np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)))
        travel = float(np.linalg.norm(np.ptp(flat, axis=0)))
        follow = camera is None and travel > (0.8 if size else 0.1) * body
        shift = {t: np.zeros(3) for t in frames}
        if follow:
            points = [p - d for p, d in zip(points, flat, strict=True)]
            known = dict(zip(some, flat, strict=True))
            for t in frames:
                if t not in known:
                    p = _without_strays(scene.positions(t), scene.faces)
                    centre = (p.min(axis=0) + p.max(axis=0)) / 2
                    centre -= (centre @ vertical) * vertical
                    first = middle[0] - (middle[0] @ vertical) * vertical
                    known[t] = centre - first
                shift[t] = known[t]
        ground = min(float((p @ vertical).min()) for p in points)
        aspect = size[0] / size[1] if size else 1.0
        if camera is None:
            turn = _best_azimuth(points, up, elevation) if azimuth is None else azimuth
            everything = np.concatenate(points)
            if size is None:
                level = Camera.fit(
                    everything, azimuth=turn, elevation=elevation, up=up, perspective=False
                )
                extent = np.ptp(everything @ level.axes.T, axis=0)
                extent = np.maximum(extent[:2], 0.05 * extent.max() + 1e-30)
                aspect = float(np.clip(extent[0] / extent[1], 0.75, 1.7))
            fitted = Camera.fit(
                everything,
                azimuth=turn,
                elevation=elevation,
                up=up,
                aspect=aspect,
                perspective=perspective,
            )
        return cls(fitted, aspect, ground, shift)


def draw_panel(
    scene: Scene,
    view: View,
    frame: int,
    style: Style,
    size: tuple[int, int],
    top: float,
    supersample: int,
) -> Image.Image:
    """One frame in one style; `top` is the error that gets the last colour."""
    large = (size[0] * supersample, size[1] * supersample)
    shift = view.shift[frame]
    points = scene.positions(frame) - shift
    colors = np.broadcast_to(_CLAY, points.shape)
    if style == "weights":
        colors = scene.weight_colors
    elif style == "error":
        colors = heat(scene.errors(frame) / top)
    camera, faces = view.camera, scene.faces
    picture = backdrop(large)
    if len(faces):
        layer = draw_mesh(camera, large, points, faces, colors)
        # From below the ground would hide the mesh, so it is not there.
        if camera.eye @ camera.vertical > view.ground and camera.axes[2] @ camera.vertical > 0.02:
            soft = shadow(camera, size, points, faces, view.ground)
            picture *= np.kron(soft, np.ones((supersample, supersample)))[..., None]
    else:
        radii = np.full(len(points), scene.disc_radius)
        layer = draw_balls(camera, large, points, radii, colors)
    if style == "bones":
        picture = over(picture, layer, 0.55)
        balls = _draw_bones(scene, view, frame, large)
        # A ball behind the surface shines through it.
        behind = np.where(layer.nearness > balls.nearness, 0.82, 1.0)
        picture = over(picture, balls, behind)
    else:
        picture = over(picture, layer)
    if supersample > 1:
        picture = block_mean(picture, supersample)
    return Image.fromarray((255 * srgb_from_linear(picture)).round().astype(np.uint8))


def _draw_bones(scene: Scene, view: View, frame: int, size: tuple[int, int]) -> Layer:
    """Balls at the posed centroids; each axis of a bone is a row of small balls."""
    assert scene.skinning is not None
    transforms = scene.skinning.transforms[frame].astype(np.float64)
    turn = transforms[:, :, :3]
    at = np.einsum("brc,bc->br", turn, scene.centroids) + transforms[:, :, 3] - view.shift[frame]
    n_bones = len(at)
    radius = scene.diagonal * 0.022 * min(1.0, (20 / n_bones) ** 0.33)
    steps = np.linspace(1.0, 2.3, 14) * radius
    length = np.linalg.norm(turn, axis=1, keepdims=True)
    axes = np.swapaxes(turn / np.where(length > 0, length, 1.0), 1, 2)
    ticks = at[:, None, None] + steps[:, None] * axes[:, :, None]
    shape = (n_bones, 3, len(steps), 3)
    centers = np.concatenate([at, ticks.reshape(-1, 3)])
    radii = np.concatenate([np.full(n_bones, radius), np.full(ticks.size // 3, radius * 0.17)])
    tints = np.broadcast_to(_AXES[None, :, None], shape).reshape(-1, 3)
    return draw_balls(view.camera, size, centers, radii, np.concatenate([scene.palette, tints]))


def _best_azimuth(points: list[Float], up: str, elevation: float) -> float:
    """The side from which the motion covers most of its picture, the front preferred."""
    sample = np.concatenate(
        [p[:: max(1, len(p) // 1500)] for p in points[:: max(1, len(points) // 6)]]
    )
    best, chosen = -1.0, 30.0
    for azimuth in (25, -25, 40, -40, 60, -60, 10, -10):
        camera = Camera.fit(sample, azimuth=azimuth, elevation=elevation, up=up, perspective=False)
        flat = sample @ camera.axes[:2].T
        cell = np.ptp(sample, axis=0).max() / 40 or 1.0
        seen = len(np.unique(np.floor(flat / cell).astype(np.int64), axis=0))
        score = seen * (1.0 + 0.35 * math.cos(math.radians(azimuth)))
        if score > best * 1.02:
            best, chosen = score, float(azimuth)
    return chosen


def _without_strays(points: Float, faces: NDArray[np.int32]) -> Float:
    """Vertices that some triangle uses; the others are not seen."""
    return points[np.unique(faces)] if len(faces) else points


def _thin(frames: Sequence[int]) -> list[int]:
    count = min(len(frames), _FIT_FRAMES)
    return [frames[int(k)] for k in np.linspace(0, len(frames) - 1, count)]
