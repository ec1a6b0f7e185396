"""All metrics of two sequences in one call."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..common.errors import check_flag
from ..common.short_repr import short_repr
from ..model.drawn_normals import NormalErrors
from ..model.shapes import Skinned
from ..model.skinning import skinning_in
from .edge_difference import Sted
from .edge_difference import sted as _sted
from .hausdorff_distance import Hausdorff
from .hausdorff_distance import hausdorff as _hausdorff
from .matching import Frames, as_pair
from .normal_angles import known_errors as _normals
from .vertex_distances import Distances, distances


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Comparison(Distances):
    """Every metric of one animated mesh against a reference; ``str()`` prints a table.

    Attributes
    ----------
    n_frames, n_vertices : int
    hausdorff : Hausdorff or None
    sted : Sted or None
        None if it was not requested.
    normals : NormalErrors or None
        Errors of the normals that engines draw if the mesh is a skinning, otherwise of its surface
        normals; None without triangles.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> comparison = ssdr.metrics.compare(dancer, dancer, hausdorff=False, sted=False)
    >>> comparison.rmse, comparison.n_frames
    (0.0, 24)
    """

    n_frames: int
    n_vertices: int
    hausdorff: Hausdorff | None = None
    sted: Sted | None = None
    normals: NormalErrors | None = None

    __repr__ = short_repr

    def as_dict(self, *, arrays: bool = False) -> dict[str, Any]:
        """Dictionary of plain numbers, for JSON.

        Parameters
        ----------
        arrays : bool
            Whether to include the errors per frame and per vertex, as lists.
        """
        return _plain(self, arrays)

    def __str__(self) -> str:
        rows: list[tuple[str, str]] = [
            ("RMSE, % of motion", f"{self.percent_of_motion:.4g}"),
            ("RMSE", f"{self.rmse:.6g}"),
            ("RMSE, % of diagonal", f"{self.percent_of_diagonal:.4g}"),
            ("mean distance", f"{self.mean:.6g}"),
            ("max distance", f"{self.max:.6g}  (frame {self.max_frame}, vertex {self.max_vertex})"),
        ]
        if math.isnan(self.percent_of_motion):
            del rows[0]
        if self.normals is not None:
            kind = "of the surface" if self.normals.surface is None else "as engines draw them"
            rows.append(("normals", f"{self.normals}, {kind}"))
        if self.hausdorff is not None:
            h = self.hausdorff
            rows.append(("Hausdorff, vertices", _mean_max(h.vertex_mean, h.vertex_max)))
            if h.surface_mean is not None and h.surface_max is not None:
                rows.append(("Hausdorff, surfaces", _mean_max(h.surface_mean, h.surface_max)))
        if self.sted is not None:
            s = self.sted
            parts = f"(spatial {s.spatial:.4g}, temporal {s.temporal:.4g})"
            rows.append(("STED", f"{s.value:.4g}  {parts}"))
        head = f"{self.n_frames} frames of {self.n_vertices} vertices, diagonal {self.diagonal:.6g}"
        width = max(len(name) for name, _ in rows)
        return "\n".join([head, *(f"{name:<{width}}  {text}" for name, text in rows)])


def compare(
    reference: Frames,
    other: Frames,
    faces: ArrayLike | None = None,
    *,
    hausdorff: bool = True,
    sted: bool = True,
) -> Comparison:
    """Compare two animations of one mesh by every metric.

    Parameters
    ----------
    reference, other : MeshSequence, Skinning, a result that has one, or (F, V, 3) array
        Sequences that are not in memory are read by chunks of frames.  The normals of a skinning
        `other` are compared as engines draw them.
    faces : (T, 3) int array, optional
        Triangles of both animations; by default those of either.  Without triangles, the Hausdorff
        distance is that of the vertices alone and STED has no spatial part.
    hausdorff, sted : bool
        Whether to compute these metrics, which take most of the time.  For parameters other than
        the defaults call :func:`~ssdr.metrics.hausdorff` and :func:`~ssdr.metrics.sted`.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If shapes differ, a number is not finite or a flag is not a bool, or if a skinning has other
        triangles than the reference.

    Examples
    --------
    >>> reference = np.zeros((2, 4, 3))
    >>> comparison = ssdr.metrics.compare(reference, reference + [3, 0, 0], sted=False)
    >>> round(comparison.rmse, 3), round(comparison.hausdorff.vertex_max, 3)
    (3.0, 3.0)
    """
    model = skinning_in(other)
    first, second = as_pair(reference, other, faces)
    check_flag(hausdorff, "hausdorff")
    check_flag(sted, "sted")
    return Comparison(
        **vars(distances(first, second)),
        n_frames=first.n_frames,
        n_vertices=first.n_vertices,
        hausdorff=_hausdorff(first, second) if hausdorff else None,
        sted=_sted(first, second) if sted else None,
        normals=_normals(first, model if isinstance(model, Skinned) else second),
    )


def _plain(result: Any, arrays: bool) -> dict[str, Any]:
    plain: dict[str, Any] = {}
    for name, value in vars(result).items():
        if isinstance(value, (Hausdorff, NormalErrors, Sted)):
            plain[name] = _plain(value, arrays)
        elif isinstance(value, np.ndarray):
            plain |= {name: value.tolist()} if arrays else {}
        elif value is not None or name.endswith(("_max", "_mean")):
            # JSON has no infinity, the percentage where the diagonal is 0
            unknown = isinstance(value, float) and not math.isfinite(value)
            plain[name] = None if unknown else value
    return plain


def _mean_max(mean: float, largest: float) -> str:
    return f"{mean:.6g} mean, {largest:.6g} max over frames"
