"""Parts of a subject, such as a body and its cloth, each in a colour of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import check_mask
from ..errors import InputError

Color = tuple[float, float, float]
CLAY: Color = (0.84, 0.82, 0.79)
"""Light warm grey."""
SKIN: Color = (0.87, 0.68, 0.58)
"""Pale skin."""
FABRIC: Color = (0.27, 0.50, 0.66)
"""Blue cloth."""
NEUTRAL: Color = (0.62, 0.62, 0.63)
"""Grey of parts that are not measured."""


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """Set of vertices with a colour of their own.

    Parameters
    ----------
    name : str
    vertices : (V,) bool array, (n,) int array or slice
    color : (r, g, b)
        sRGB, 0 to 1.
    measured : bool
        Whether errors are measured on this part.  Other parts are grey in the styles "error" and
        "normals".

    Raises
    ------
    InputError
        If the colour is not valid.

    Examples
    --------
    >>> from ssdr.render import Part, SKIN
    >>> Part("body", slice(0, 1200), color=SKIN, measured=False).measured
    False
    """

    name: str
    vertices: Any
    color: Color = CLAY
    measured: bool = True

    def __post_init__(self) -> None:
        rgb = np.asarray(self.color, dtype=np.float64)
        if rgb.shape != (3,) or not ((rgb >= 0) & (rgb <= 1)).all():
            raise InputError("color", "red, green and blue from 0 to 1", self.color)


def checked_parts(parts: Sequence[Part], n_vertices: int) -> tuple[Part, ...]:
    """Check the parts and return them with `vertices` as masks ``(V,)``.

    If there are none, a single part with all vertices is returned.

    Raises
    ------
    InputError
        If two parts have the same name, a vertex does not belong to exactly one part, no part is
        measured, or vertices are neither a mask nor indices.
    """
    if not parts:
        return (Part("", np.ones(n_vertices, dtype=bool)),)
    done: list[Part] = []
    for part in parts:
        if not isinstance(part, Part):
            raise InputError("parts", "Part objects", type(part).__name__)
        mask = _mask(f"part {part.name!r}", part.vertices, n_vertices)
        done.append(dataclasses.replace(part, vertices=mask))
    if len({part.name for part in done}) < len(done):
        raise InputError("parts", "names that differ", [part.name for part in done])
    count = np.sum([part.vertices for part in done], axis=0)
    if (count != 1).any():
        v = int(np.flatnonzero(count != 1)[0])
        raise InputError("parts", f"each of {n_vertices} vertices once", f"{v}: {count[v]} times")
    if not any(part.measured for part in done):
        raise InputError("parts", "at least one that is measured", [part.name for part in done])
    return tuple(done)


def checked_regions(
    regions: Mapping[str, Any] | None, n_vertices: int
) -> dict[str, NDArray[np.bool_]]:
    """Check named sets of vertices and return them as masks ``(V,)``.

    Raises
    ------
    InputError
        If a set is empty, or neither a mask nor indices.
    """
    return {k: _mask(f"region {k!r}", v, n_vertices) for k, v in (regions or {}).items()}


def _mask(name: str, vertices: Any, n_vertices: int) -> NDArray[np.bool_]:
    if isinstance(vertices, slice):
        vertices = np.arange(n_vertices)[vertices]
    mask = check_mask(vertices, name, n_vertices)
    if not mask.any():
        raise InputError(name, "at least one vertex", "none")
    return mask
