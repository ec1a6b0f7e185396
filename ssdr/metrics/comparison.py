"""All metrics of two sequences in one call."""

from __future__ import annotations

import dataclasses
import inspect
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError, check_flag
from .edge_difference import Sted
from .edge_difference import sted as _sted
from .hausdorff_distance import Hausdorff
from .hausdorff_distance import hausdorff as _hausdorff
from .inputs import Frames, as_pair
from .vertex_distances import Distances, distances

__all__ = ["Comparison", "compare"]

_NAMED = inspect.Parameter.KEYWORD_ONLY


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Comparison:
    """Every metric of one animated mesh against a reference.

    Attributes
    ----------
    n_frames, n_vertices : int
    distances : Distances
        Between corresponding vertices; its scalars are attributes here too.
    hausdorff : Hausdorff or None
    sted : Sted or None
        None where it was not asked for; ``str()`` prints a table.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> comparison = ssdr.metrics.compare(dancer, dancer, hausdorff=False, sted=False)
    >>> comparison.rmse, comparison.n_frames
    (0.0, 24)
    """

    n_frames: int
    n_vertices: int
    distances: Distances
    hausdorff: Hausdorff | None = None
    sted: Sted | None = None

    @property
    def rmse(self) -> float:
        return self.distances.rmse

    @property
    def coordinate_rmse(self) -> float:
        return self.distances.coordinate_rmse

    @property
    def E(self) -> float:
        return self.distances.E

    @property
    def percent_of_diagonal(self) -> float:
        return self.distances.percent_of_diagonal

    @property
    def mean(self) -> float:
        return self.distances.mean

    @property
    def max(self) -> float:
        return self.distances.max

    def as_dict(self, *, arrays: bool = False) -> dict[str, Any]:
        """Plain numbers for JSON.

        Parameters
        ----------
        arrays : bool
            Include the errors per frame and per vertex, as lists.
        """
        result: dict[str, Any] = {"n_frames": self.n_frames, "n_vertices": self.n_vertices}
        result |= _plain(self.distances, arrays)
        if self.hausdorff is not None:
            h = self.hausdorff
            result["hausdorff"] = {
                "vertex_max": h.vertex_max,
                "vertex_mean": h.vertex_mean,
                "surface_max": h.surface_max,
                "surface_mean": h.surface_mean,
            } | _plain(h, arrays)
        if self.sted is not None:
            result["sted"] = _plain(self.sted, arrays)
        return result

    def __str__(self) -> str:
        d = self.distances
        rows: list[tuple[str, str]] = [
            ("RMSE", f"{d.rmse:.6g}"),
            ("RMSE per coordinate", f"{d.coordinate_rmse:.6g}"),
            ("RMSE, % of diagonal", f"{d.percent_of_diagonal:.4g}"),
            ("E", f"{d.E:.6g}"),
            ("mean distance", f"{d.mean:.6g}"),
            ("max distance", f"{d.max:.6g}  (frame {d.max_frame}, vertex {d.max_vertex})"),
        ]
        if self.hausdorff is not None:
            h = self.hausdorff
            rows.append(("Hausdorff, vertices", _mean_max(h.vertex_mean, h.vertex_max)))
            if h.surface_mean is not None and h.surface_max is not None:
                rows.append(("Hausdorff, surfaces", _mean_max(h.surface_mean, h.surface_max)))
        if self.sted is not None:
            s = self.sted
            parts = f"(spatial {s.spatial:.4g}, temporal {s.temporal:.4g})"
            rows.append(("STED", f"{s.value:.4g}  {parts}"))
        head = f"{self.n_frames} frames of {self.n_vertices} vertices, diagonal {d.diagonal:.6g}"
        width = max(len(name) for name, _ in rows)
        return "\n".join([head, *(f"{name:<{width}}  {text}" for name, text in rows)])


def compare(
    reference: Frames,
    other: Frames,
    faces: ArrayLike | None = None,
    *,
    hausdorff: bool = True,
    sted: bool = True,
    hausdorff_options: Mapping[str, Any] | None = None,
    sted_options: Mapping[str, Any] | None = None,
) -> Comparison:
    """Compare two animations of one mesh by every metric.

    Parameters
    ----------
    reference, other : MeshSequence or (F, V, 3) array
        Sequences that are not in memory are read by chunks of frames.
    faces : (T, 3) int array, optional
        Triangles of both; those of either sequence by default.  Without any,
        Hausdorff is that of the vertices alone and STED has no spatial part.
    hausdorff, sted : bool
        Whether to compute them; they take most of the time.
    hausdorff_options, sted_options : mapping, optional
        Keyword arguments of :func:`~ssdr.metrics.hausdorff` and
        :func:`~ssdr.metrics.sted`.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If shapes differ, a number is not finite or an option is not usable.

    Examples
    --------
    >>> reference = np.zeros((2, 4, 3))
    >>> comparison = ssdr.metrics.compare(reference, reference + [3, 0, 0], sted=False)
    >>> round(comparison.rmse, 3), round(comparison.hausdorff.vertex_max, 3)
    (3.0, 3.0)
    """
    first, second = as_pair(reference, other, faces)
    check_flag(hausdorff, "hausdorff")
    check_flag(sted, "sted")
    for name, function, options in (
        ("hausdorff_options", _hausdorff, hausdorff_options),
        ("sted_options", _sted, sted_options),
    ):
        known = [
            p.name for p in inspect.signature(function).parameters.values() if p.kind is _NAMED
        ]
        if options is not None and not (
            isinstance(options, Mapping) and set(options) <= set(known)
        ):
            raise InputError(name, f"a mapping of {', '.join(known)}", repr(options))
    return Comparison(
        n_frames=first.n_frames,
        n_vertices=first.n_vertices,
        distances=distances(first, second),
        hausdorff=_hausdorff(first, second, **(hausdorff_options or {})) if hausdorff else None,
        sted=_sted(first, second, **(sted_options or {})) if sted else None,
    )


def _plain(result: Any, arrays: bool) -> dict[str, Any]:
    plain: dict[str, Any] = {}
    for field in dataclasses.fields(result):
        value = getattr(result, field.name)
        if isinstance(value, np.ndarray):
            if arrays:
                plain[field.name] = value.tolist()
        elif not (value is None and field.name.endswith("_per_frame")):
            # JSON has no Infinity: a share of a diagonal of 0 is no number
            unknown = isinstance(value, float) and not math.isfinite(value)
            plain[field.name] = None if unknown else value
    return plain


def _mean_max(mean: float, largest: float) -> str:
    return f"{mean:.6g} mean, {largest:.6g} max over frames"
