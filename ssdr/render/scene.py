"""What a picture shows: positions, colours and errors of a subject, and the view of it."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..errors import InputError
from ..hierarchy.bone_ends import limb_ends
from ..sequence import MeshSequence
from ..skinning import Skinning
from .materials import Part, checked_parts, checked_regions
from .palette import bone_colors, mix
from .raster import Camera
from .studio import Stage

__all__ = ["Scene", "Style", "View"]

Style = Literal["plain", "weights", "bones", "error"]
Float = NDArray[np.float64]

_FIT_FRAMES = 24  # frames that the camera is fitted to: more are slower, fewer may cut motion off


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A subject and what it should be, with one topology.

    A welded skinning is shown on the vertices of the unwelded reference.  Errors are those of the
    parts that are measured; `regions` are sets of their vertices that have figures of their own.
    """

    sequence: MeshSequence | None
    skinning: Skinning | None
    reference: MeshSequence | None
    vertex_map: NDArray[np.int32] | None
    parts: tuple[Part, ...] = ()
    regions: dict[str, NDArray[np.bool_]] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(
        cls,
        subject: Any,
        reference: MeshSequence | None,
        parts: Sequence[Part] = (),
        regions: Mapping[str, Any] | None = None,
    ) -> Scene:
        """Check the arguments of a picture.

        Raises
        ------
        InputError
            If the subject is of no known kind or does not match the reference, or the parts or
            regions do not fit it.
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
        scene = cls(sequence, skinning, reference, vertex_map)
        if not parts and not regions:
            return scene
        count = len(scene.positions(0))
        if parts and not len(scene.faces):
            raise InputError("parts", "a subject with triangles", "a cloud of points")
        return dataclasses.replace(
            scene, parts=checked_parts(parts, count), regions=checked_regions(regions, count)
        )

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

    @functools.cached_property
    def measured(self) -> NDArray[np.bool_]:
        """Vertices whose error counts, ``(V,)``."""
        if not self.parts:
            return np.ones(len(self.positions(0)), dtype=bool)
        return np.asarray(np.any([p.vertices for p in self.parts if p.measured], axis=0))

    def high_error(self, frames: Sequence[int]) -> float:
        """An error that few vertices of these frames exceed."""
        errors = np.stack([self.errors(t)[self.measured] for t in frames])
        # Never so small that rounding of float32 would look like an error.
        return max(float(np.quantile(errors, 0.995)), 1e-6 * self.diagonal)

    def largest_error(self, frames: Sequence[int]) -> float:
        return max(float(self.errors(t)[self.measured].max()) for t in frames)

    def rmse(
        self, frames: Sequence[int] | None = None, where: NDArray[np.bool_] | None = None
    ) -> float:
        """sqrt(Σ |d|² / (F V)) over frames, all by default, and measured vertices."""
        chosen = self.measured if where is None else where
        order = range(self.n_frames) if frames is None else frames
        total = sum(float((self.errors(t)[chosen] ** 2).sum()) for t in order)
        return math.sqrt(total / (len(order) * int(chosen.sum())))

    def figures(self, frames: Sequence[int] | None, unit: tuple[str, float]) -> str:
        """RMSE over the measured vertices, or over each region, as text."""
        name, factor = unit
        several = self.regions or {"": self.measured}
        found = [
            f"{k} {three_digits(factor * self.rmse(frames, mask))} {name}".strip()
            for k, mask in several.items()
        ]
        return ", ".join(found)

    def summary(self, with_error: bool, unit: tuple[str, float] | None = None) -> str:
        """Counts and error in one line."""
        shown = self._subject
        if self.parts:
            name = " and ".join(p.name for p in self.parts if p.measured)
            parts = [f"{name}: {int(self.measured.sum()):,} vertices", f"{self.n_frames:,} frames"]
            if with_error:
                parts.append(f"RMSE: {self.figures(None, unit or ('', 1.0))}")
            return "  ·  ".join(parts)
        parts = [f"{shown.n_vertices:,} vertices", f"{shown.n_frames:,} frames"]
        if self.skinning is not None:
            parts += [f"{self.skinning.n_bones} bones", f"{self.skinning.n_influences} influences"]
        if with_error:
            rmse = self.rmse()
            parts.append(f"RMSE {rmse:.3g} ({100 * rmse / self.diagonal:.3g} % of the diagonal)")
            parts.append(f"E = {1000 * rmse / math.sqrt(3):.3g}")
        return "  ·  ".join(parts)

    @functools.cached_property
    def lit(self) -> dict[Any, Stage]:
        """The stage that was drawn last."""
        return {}

    @functools.cached_property
    def centroids(self) -> Float:
        assert self.skinning is not None
        return np.asarray(self.skinning.centroids(), dtype=np.float64)

    @functools.cached_property
    def limb_ends(self) -> Float:
        """Where each bone of a hierarchy ends in the rest pose."""
        model = self.skinning
        assert model is not None
        tree = model.joint_positions, model.parents
        return limb_ends(*tree, model.rest, model.indices, model.weights)

    @functools.cached_property
    def palette(self) -> Float:
        return bone_colors(self.centroids)

    @functools.cached_property
    def weight_colors(self) -> Float:
        assert self.skinning is not None
        colors = mix(self.palette, self.skinning.weights, self.skinning.indices)
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
        track: Float | None = None,
    ) -> View:
        """Frame the motion; where it travels far, walk with it.

        With a `track` ``(F, 3)`` the camera moves by just that.

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
        if track is not None:
            follow = False
            shift = {t: np.asarray(track[t], dtype=np.float64) for t in frames}
            points = [p - track[t] for p, t in zip(points, some, strict=True)]
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
                narrowest = 0.66 if scene.parts else 0.75
                extent = np.ptp(everything @ level.axes.T, axis=0)
                extent = np.maximum(extent[:2], 0.05 * extent.max() + 1e-30)
                aspect = float(np.clip(extent[0] / extent[1], narrowest, 1.7))
            fitted = Camera.fit(
                everything,
                azimuth=turn,
                elevation=elevation,
                up=up,
                aspect=aspect,
                perspective=perspective,
            )
        return cls(fitted, aspect, ground, shift)


def three_digits(value: float) -> str:
    """A number with three digits, zeros at the end too."""
    return f"{value:#.3g}".rstrip(".")


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
