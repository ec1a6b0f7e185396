"""Positions, colours and errors of the subject of a picture."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .. import lbs
from ..errors import InputError
from ..frames.normals import holders_of
from ..frames.shaped_normals import ShapedNormals, shaped_normals
from ..hierarchy.bone_ends import limb_ends
from ..io.corners import Corners, rest_normals, split_corners
from ..normals import NormalHolders, surface_normals
from ..sequence import MeshSequence
from ..skinning import Skinning, skinning_in
from .palette import bone_colors, mix
from .parts import Part, checked_parts, checked_regions
from .raster import unit as normalised

Style = Literal["plain", "weights", "bones", "error", "normals"]
Unit = tuple[str, float]
Float = NDArray[np.float64]

_SOME_FRAMES = 24  # frames that represent a sequence; fewer may miss motion
# Share of the errors that a scale covers (not all, since a few may be much larger than the others),
# and an error above the rounding of float32, relative to the diagonal or in degrees.
ERRORS: dict[Style, tuple[float, float]] = {"error": (0.995, 1e-6), "normals": (0.95, 0.1)}


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """Subject and reference of a picture, with the same vertices.

    A welded subject is shown on the vertices of its unwelded reference.

    Attributes
    ----------
    subject : MeshSequence or Skinning
    reference : MeshSequence or None
    vertex_map : (V,) int32 or None
        For each vertex shown, its index in the welded subject.
    parts : tuple of Part
        At least one; errors are those of the measured parts.
    has_parts : bool
        Whether the caller gave parts.
    regions : dict of str to (V,) bool
        Sets of vertices whose RMSE is stated.
    """

    subject: MeshSequence | Skinning
    reference: MeshSequence | None
    vertex_map: NDArray[np.int32] | None
    parts: tuple[Part, ...]
    has_parts: bool
    regions: dict[str, NDArray[np.bool_]]

    @classmethod
    def of(
        cls,
        subject: Any,
        reference: MeshSequence | None,
        parts: Sequence[Part] = (),
        regions: Mapping[str, Any] | None = None,
    ) -> Scene:
        """Check the arguments and return a Scene.

        Raises
        ------
        InputError
            If the subject is of an unknown type or does not match the reference, or parts or
            regions do not fit it.
        """
        subject = skinning_in(subject)
        if not isinstance(subject, (MeshSequence, Skinning)):
            kind = type(subject).__name__
            raise InputError("subject", "a MeshSequence, Skinning or Decomposition", kind)
        vertex_map, count = None, subject.n_vertices
        if reference is not None:
            if not isinstance(reference, MeshSequence):
                raise InputError("reference", "a MeshSequence", type(reference).__name__)
            if subject.vertex_map is not None and reference.n_vertices != count:
                vertex_map = np.asarray(subject.vertex_map)
                count = len(vertex_map)
            if (reference.n_frames, reference.n_vertices) != (subject.n_frames, count):
                raise InputError(
                    "reference",
                    f"{subject.n_frames} frames of {count} vertices, as the subject has",
                    f"{reference.n_frames} frames of {reference.n_vertices}",
                )
        if parts and not len(subject.faces):
            raise InputError("parts", "a subject with triangles", "a cloud of points")
        return cls(
            subject,
            reference,
            vertex_map,
            checked_parts(parts, count),
            bool(parts),
            checked_regions(regions, count),
        )

    @property
    def has_bones(self) -> bool:
        """Whether the subject is a skinning."""
        return isinstance(self.subject, Skinning)

    @property
    def model(self) -> Skinning:
        """The subject, which must be a Skinning (see `has_bones`)."""
        assert isinstance(self.subject, Skinning)
        return self.subject

    @property
    def name(self) -> str:
        other = self.reference.name if self.reference is not None else ""
        return self.subject.name or other or "untitled"

    @functools.cached_property
    def faces(self) -> NDArray[np.int32]:
        """Triangles ``(T, 3)`` of the subject, on the vertices shown."""
        return np.asarray(self._first[self.subject.faces], dtype=np.int32)

    @functools.cached_property
    def _first(self) -> NDArray[np.intp]:
        """Index of the first displayed vertex that was welded into each vertex of the subject."""
        if self.vertex_map is None:
            return np.arange(self.subject.n_vertices)
        return np.asarray(np.unique(self.vertex_map, return_index=True)[1])

    @functools.cached_property
    def split(self) -> Corners:
        """Mesh to be lit, with a copy of a vertex for each of its rest normals in a model."""
        given = rest_normals(self.model, self.model.rest) if self.has_bones else None
        if self._shaped is not None:
            given = self._shaped.rest[self._shaped.corner].astype(np.float32)
        return split_corners(self.faces, len(self.measured), None, given)

    @functools.cached_property
    def _shaped(self) -> ShapedNormals | None:
        """Rest normals and added vectors of a model with shapes; None for other subjects."""
        shaped = self.has_bones and self.model.shapes is not None and len(self.faces)
        return shaped_normals(self.model) if shaped else None

    def _rest_normals(self, frame: int) -> NDArray[np.floating]:
        """Rest normals at the vertices of `split`, with the vectors that a frame's shapes add."""
        assert self.split.normals is not None
        if self._shaped is None or self.model.shapes is None:
            return self.split.normals
        added = np.tensordot(self.model.shapes.amounts[frame], self._shaped.added, 1)
        out = self.split.normals.astype(np.float64)
        out[self.split.faces] += added[self._shaped.corner]
        return out

    def drawn_normals(self, frame: int) -> Float | None:
        """Unit normals of the vertices of `split` as engines draw them, or None for a sequence.

        Rest normals are transformed by the blended 3×3 blocks of the bones, as in the shaders of
        three.js (``skinnormal_vertex``).
        """
        if self.split.normals is None:
            return None
        rows = self.split.vertex
        rows = rows if self.vertex_map is None else self.vertex_map[rows]
        turns = self.model.transforms[frame].copy()
        turns[..., 3] = 0
        skin = self.model.indices[rows], self.model.weights[rows]
        return normalised(lbs.skin(self._rest_normals(frame), *skin, turns, dtype=np.float64))

    @functools.cached_property
    def diagonal(self) -> float:
        """Diagonal of the bounding box in the frame where it is largest; 1 if it is 0."""
        shown = self.reference or self.subject
        if isinstance(shown, MeshSequence):
            return shown.diagonal() or 1.0
        some = [self.positions(t) for t in evenly(shown.n_frames)]
        return max(float(np.linalg.norm(np.ptp(p, axis=0))) for p in some) or 1.0

    def positions(self, frame: int) -> Float:
        """Vertices of a frame, ``(V, 3)`` float64."""
        if isinstance(self.subject, MeshSequence):
            p = self.subject.frames(frame).astype(np.float64)
        else:
            p = self.subject.skin(frame)[0].astype(np.float64)
        return p if self.vertex_map is None else p[self.vertex_map]

    def visible(self, frame: int) -> Float:
        """Vertices of a frame, where those without triangles are moved onto another vertex."""
        points = self.positions(frame)
        if len(self.faces):
            points[self._loose] = points[self.faces[0, 0]]
        return points

    @functools.cached_property
    def _loose(self) -> NDArray[np.bool_]:
        return np.asarray(np.bincount(self.faces.ravel(), minlength=len(self.measured)) == 0)

    def errors(self, frame: int, style: Style = "error") -> Float:
        """Distance ``(V,)`` of each vertex to the reference or, as "normals", angle in degrees."""
        assert self.reference is not None
        truth = np.asarray(self.reference.frames(frame), dtype=np.float64)
        if style == "normals":
            return self._angles(frame, truth)
        return np.asarray(np.linalg.norm(self.positions(frame) - truth, axis=1))

    @functools.cached_property
    def _holders(self) -> NormalHolders:
        """Which corners share a normal of the reference's surface, by the subject's hard edges."""
        assert self.reference is not None
        vertices, surface = self.reference.vertices, self.subject.surface
        return holders_of(MeshSequence(vertices, self.faces, surface=surface, validate=False))

    def _angles(self, frame: int, truth: Float) -> Float:
        """Angles ``(V,)``, in degrees, between the drawn normals and the reference's.

        The angle of a vertex is the mean over its triangles, or 0 if it has none.
        """
        holders, drawn = self._holders, self.drawn_normals(frame)
        own, b = surface_normals(np.stack([self.positions(frame), truth]), holders)
        a = own[holders.corner] if drawn is None else drawn[self.split.faces]
        b = b[holders.corner]
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=2), (a * b).sum(axis=2))
        corner, count = self.faces.ravel(), len(self.measured)
        total = np.bincount(corner, np.degrees(angle).ravel(), count)
        mean = np.asarray(total / np.bincount(corner, minlength=count).clip(1))
        return mean if self.vertex_map is None else mean[self._first][self.vertex_map]

    @functools.cached_property
    def measured(self) -> NDArray[np.bool_]:
        """Mask ``(V,)`` of the vertices of measured parts."""
        return np.asarray(np.any([p.vertices for p in self.parts if p.measured], axis=0))

    def error_range(self, frames: Sequence[int], style: Style = "error") -> tuple[float, float]:
        """High percentile and maximum of the errors of measured vertices in some frames."""
        errors = np.stack([self.errors(t, style)[self.measured] for t in frames])
        share, least = ERRORS[style]
        least *= self.diagonal if style == "error" else 1.0
        return max(float(np.quantile(errors, share)), least), float(errors.max())

    def rmse(
        self, frames: Sequence[int] | None = None, where: NDArray[np.bool_] | None = None
    ) -> float:
        """sqrt(Σ |d|² / (F V)) over frames (by default all) and vertices (by default measured)."""
        chosen = self.measured if where is None else where
        order = range(self.subject.n_frames) if frames is None else frames
        total = sum(float((self.errors(t)[chosen] ** 2).sum()) for t in order)
        return math.sqrt(total / (len(order) * int(chosen.sum())))

    def figures(self, frames: Sequence[int] | None, unit: Unit) -> str:
        """Text with the RMSE of each region or, without regions, of the measured vertices."""
        name, factor = unit
        found = []
        for region, mask in (self.regions or {"": self.measured}).items():
            value = f"{factor * self.rmse(frames, mask):#.3g}".rstrip(".")
            found.append(f"{region} {value} {name}".strip())
        return ", ".join(found)

    @property
    def measured_name(self) -> str:
        """Names of the measured parts, joined by " and "."""
        return " and ".join(p.name for p in self.parts if p.measured)

    def summary(self, with_error: bool, unit: Unit) -> str:
        """Line of text: numbers of vertices, frames and bones and, if `with_error`, the error."""
        texts = [f"{self.subject.n_vertices:,} vertices", f"{self.subject.n_frames:,} frames"]
        if self.has_parts:
            texts[0] = f"{self.measured_name}: {int(self.measured.sum()):,} vertices"
            texts += [f"RMSE: {self.figures(None, unit)}"] if with_error else []
            return "  ·  ".join(texts)
        if self.has_bones:
            texts += [f"{self.model.n_bones} bones", f"{self.model.n_influences} influences"]
        if with_error:
            rmse = self.rmse()
            texts.append(
                f"RMSE {number(rmse, unit)} ({100 * rmse / self.diagonal:.3g} % of the diagonal)"
            )
            texts.append(f"E = {1000 * rmse / math.sqrt(3):.3g}")
        return "  ·  ".join(texts)

    @functools.cached_property
    def centroids(self) -> Float:
        """Centroid ``(B, 3)``, in the rest pose, of the vertices that each bone moves."""
        return np.asarray(self.model.centroids(), dtype=np.float64)

    @functools.cached_property
    def limb_ends(self) -> Float:
        """End ``(B, 3)`` of each bone of a hierarchy in the rest pose."""
        model = self.model
        tree = model.joint_positions, model.parents
        return limb_ends(*tree, model.rest, model.indices, model.weights)

    @functools.cached_property
    def palette(self) -> Float:
        """Linear RGB of each bone, ``(B, 3)``."""
        return bone_colors(self.centroids)

    @functools.cached_property
    def weight_colors(self) -> Float:
        """Linear RGB of each vertex, mixed by its weights, ``(V, 3)``."""
        colors = mix(self.palette, self.model.weights, self.model.indices)
        return colors if self.vertex_map is None else colors[self.vertex_map]

    @functools.cached_property
    def ball_radius(self) -> float:
        """Radius at which the points of a cloud nearly touch."""
        p = self.positions(0)
        if len(p) < 2:
            return 0.02 * self.diagonal
        gap = np.asarray(cKDTree(p).query(p, k=2)[0])[:, 1]
        gap = gap[gap > 0]
        return float(np.quantile(gap, 0.8)) * 0.75 if len(gap) else 0.01 * self.diagonal


def number(value: float, unit: Unit) -> str:
    """Text of a number in a unit, with three digits."""
    name, factor = unit
    return f"{factor * value:.3g}{'' if name == '°' else ' '}{name}".rstrip()


def evenly(count: int, most: int = _SOME_FRAMES) -> list[int]:
    """At most `most` integers, spread evenly from 0 to count − 1."""
    return [int(k) for k in np.linspace(0, count - 1, min(count, most))]
