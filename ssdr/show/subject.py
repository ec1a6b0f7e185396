"""Subject of a picture: its vertices, normals, colours and errors in each frame."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .. import metrics
from ..common.checks import check_mask
from ..common.errors import InputError
from ..mesh.normals import NormalHolders, normal_holders, surface_normals
from ..mesh.sequence import MeshSequence, sequence_in
from ..metrics.matching import matched
from ..model.drawn_normals import posed, rest_vectors
from ..model.shapes import ShapedSkinning, Skinned, skinning_and_shapes
from ..model.skinning import Skinning, skinning_in
from .camera import Float
from .palette import CLAY, NEUTRAL, bone_colors, heat, linear_from_srgb, mix

Style = Literal["plain", "weights", "bones", "error"]
# Share of the errors that a scale covers (not all, since a few may be much larger than the others),
# and an error above the rounding of float32, relative to the diagonal.
_COVERED, _LEAST = 0.995, 1e-6
_SOME_FRAMES = 24  # frames that represent a sequence; fewer may miss motion


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """Subject and reference of a picture, with the same vertices.

    Attributes
    ----------
    subject : MeshSequence or Skinning
    reference : MeshSequence or None
    colors : (V, 3) float64
        Colours of the subject in the styles "plain" and "bones", linear RGB.
    measured : (V,) bool
        The vertices whose errors are measured; the others are grey.
    """

    subject: MeshSequence | Skinned
    reference: MeshSequence | None
    colors: Float
    measured: NDArray[np.bool_]

    @classmethod
    def of(
        cls, subject: Any, reference: Any = None, colors: Any = None, measured: Any = None
    ) -> Scene:
        """Check the subject, and the arguments of :func:`render_frame`, and return the scene.

        Raises
        ------
        InputError
            If the subject is of an unknown type, or another argument does not match it.
        """
        subject, reference = sequence_in(skinning_in(subject)), sequence_in(reference)
        if not isinstance(subject, (MeshSequence, Skinning, ShapedSkinning)):
            kind = type(subject).__name__
            raise InputError("subject", "a MeshSequence, Skinning or Decomposition", kind)
        if reference is not None:
            if not isinstance(reference, MeshSequence):
                raise InputError("reference", "a MeshSequence", type(reference).__name__)
            reference = matched(reference, subject)
        count = subject.n_vertices
        rgb = np.asarray(CLAY if colors is None else colors, dtype=np.float64)
        if rgb.shape not in ((3,), (count, 3)) or not ((rgb >= 0) & (rgb <= 1)).all():
            expected = f"red, green and blue from 0 to 1, of shape (3,) or ({count}, 3)"
            raise InputError("colors", expected, f"shape {rgb.shape}")
        mask = check_mask(measured, "measured", count, default=True)
        if not mask.any():
            raise InputError("measured", "at least one vertex", "none")
        return cls(subject, reference, np.broadcast_to(linear_from_srgb(rgb), (count, 3)), mask)

    def truth(self) -> Scene:
        """Scene of the reference."""
        return Scene(self.reference, None, self.colors, self.measured)  # type: ignore[arg-type]

    @property
    def has_bones(self) -> bool:
        """Whether the subject is a skinning."""
        return isinstance(self.subject, Skinned)

    @property
    def model(self) -> Skinning:
        """The skinning of the subject, which must have one (see `has_bones`)."""
        assert isinstance(self.subject, Skinned)
        return skinning_and_shapes(self.subject)[0]

    @functools.cached_property
    def _lit(self) -> NormalHolders:
        """Normals by which the subject is lit, of a sequence smooth."""
        surface = self.subject.surface if self.has_bones else None
        return normal_holders(self.subject.faces, self.subject.n_vertices, surface)

    @functools.cached_property
    def _at_rest(self) -> Float:
        """Vectors in the rest pose that are turned to the normals of a model."""
        assert isinstance(self.subject, Skinned)
        return rest_vectors(self.subject, self._lit)

    @functools.cached_property
    def _used(self) -> tuple[NDArray[np.integer], NDArray[np.int32]]:
        """Index of each normal that a triangle has, and its row at each triangle corner."""
        used, corner = np.unique(self._lit.corner, return_inverse=True)
        return used, corner.reshape(-1, 3).astype(np.int32)

    @property
    def faces(self) -> NDArray[np.int32]:
        """Triangles ``(T, 3)`` of the lit vertices."""
        return self._used[1]

    @functools.cached_property
    def vertex(self) -> NDArray[np.integer]:
        """Index ``(N,)`` of the vertex at which each normal stands; in a cloud, of every vertex."""
        if not len(self.faces):
            return np.arange(self.subject.n_vertices)
        return np.asarray(self._lit.vertex[self._used[0]])

    def normals(self, frame: int) -> Float:
        """Normals ``(N, 3)`` of the lit vertices in a frame, of any norm.

        Those of a model are the ones that engines draw, those of a sequence its surface's.
        """
        if isinstance(self.subject, MeshSequence):
            return np.asarray(
                surface_normals(self.positions(frame)[None], self._lit)[0, self._used[0]]
            )
        (model, shapes), rows = skinning_and_shapes(self.subject), self._lit.vertex
        some = slice(frame, frame + 1)
        amounts = np.zeros((1, 0)) if shapes is None else shapes.amounts[some]
        turns = model.transforms[some] * [1, 1, 1, 0]
        skin = model.indices[rows], model.weights[rows]
        return np.asarray(posed(self._at_rest, *skin, turns, amounts)[0, self._used[0]])

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
            return np.asarray(self.subject.frames(frame), dtype=np.float64)
        return np.asarray(self.subject.skin(frame), dtype=np.float64)

    @functools.cached_property
    def distances(self) -> metrics.Distances:
        """Errors of the measured vertices over all frames."""
        assert self.reference is not None
        truth, subject, chosen = self.reference, self.subject, self.measured
        if chosen.all():
            return metrics.distances(truth, subject)
        vertices = subject.skin() if isinstance(subject, Skinned) else subject.frames(slice(None))
        return metrics.distances(truth.frames(slice(None))[:, chosen], vertices[:, chosen])

    def errors(self, frame: int) -> Float:
        """Distance ``(V,)`` of each vertex to the reference."""
        assert self.reference is not None
        truth = np.asarray(self.reference.frames(frame), dtype=np.float64)
        return np.asarray(np.linalg.norm(self.positions(frame) - truth, axis=1))

    def error_range(self, frames: Sequence[int]) -> tuple[float, float]:
        """High percentile and maximum of the errors of measured vertices in some frames."""
        errors = np.stack([self.errors(t)[self.measured] for t in frames])
        high = float(np.quantile(errors, _COVERED))
        return max(high, _LEAST * self.diagonal), float(errors.max())

    def colors_of(self, style: Style, frame: int, top: float) -> Float:
        """Linear RGB of each vertex ``(V, 3)``; an error of `top` has the last colour."""
        if style == "weights":
            return mix(self.palette, self.model.weights, self.model.indices)
        if style != "error":
            return self.colors
        colors = heat(self.errors(frame) / top)
        colors[~self.measured] = linear_from_srgb(NEUTRAL)
        return colors

    @functools.cached_property
    def palette(self) -> Float:
        """Linear RGB of each bone, ``(B, 3)``."""
        return bone_colors(self.model.centroids())

    @functools.cached_property
    def ball_radius(self) -> float:
        """Radius at which the points of a cloud nearly touch."""
        p = self.positions(0)
        if len(p) < 2:
            return 0.02 * self.diagonal
        gap = np.asarray(cKDTree(p).query(p, k=2)[0])[:, 1]
        gap = gap[gap > 0]
        return float(np.quantile(gap, 0.8)) * 0.75 if len(gap) else 0.01 * self.diagonal


def evenly(count: int, most: int = _SOME_FRAMES) -> list[int]:
    """At most `most` integers, spread evenly from 0 to count − 1."""
    return [int(k) for k in np.linspace(0, count - 1, min(count, most))]
