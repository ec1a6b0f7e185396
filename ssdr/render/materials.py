"""Parts of a subject, such as a body and its cloth, each with a material of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError

__all__ = ["FABRIC", "NEUTRAL", "SKIN", "Material", "Part", "checked_parts", "checked_regions"]


@dataclasses.dataclass(frozen=True)
class Material:
    """How a part of a subject looks.

    Parameters
    ----------
    color : (r, g, b)
        Diffuse reflection in sRGB, 0 to 1.
    back : (r, g, b), optional
        Of the other side of the triangles; by default that of `color`.
    gloss : float
        Strength of the highlight, 0 to 1.
    sheen : float
        Light that fibres scatter where the surface is seen edge-on, 0 to 1.
    soft : float
        How far light reaches round the edge of the lit side, as it does in skin; 0 to 1.

    Raises
    ------
    InputError
        If a number is not in its range.

    Examples
    --------
    >>> from ssdr.render import Material
    >>> Material((0.2, 0.4, 0.6), gloss=0.1).gloss
    0.1
    """

    color: tuple[float, float, float] = (0.84, 0.82, 0.79)
    back: tuple[float, float, float] | None = None
    gloss: float = 0.0
    sheen: float = 0.0
    soft: float = 0.0

    def __post_init__(self) -> None:
        for name in ("color", "back"):
            value = getattr(self, name)
            if value is None:
                continue
            rgb = np.asarray(value, dtype=np.float64)
            if rgb.shape != (3,) or not ((rgb >= 0) & (rgb <= 1)).all():
                raise InputError(name, "red, green and blue from 0 to 1", value)
            object.__setattr__(self, name, tuple(float(c) for c in rgb))
        for name in ("gloss", "sheen", "soft"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(name, "0 to 1", getattr(self, name))


SKIN = Material((0.87, 0.68, 0.58), gloss=0.10, soft=0.35)
"""Matte skin."""
FABRIC = Material((0.27, 0.50, 0.66), back=(0.24, 0.41, 0.53), sheen=0.45)
"""Blue cloth, darker on its inside."""
NEUTRAL = Material((0.62, 0.62, 0.63), soft=0.2)
"""Grey: what is shown beside an error and not measured."""


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """Some vertices of a subject that look alike.

    Parameters
    ----------
    name : str
    vertices : (V,) bool array, (n,) int array or slice
    material : Material
    measured : bool
        Whether the error is coloured, and counted, on this part.  What is not measured is grey
        in the style `error`.

    Examples
    --------
    >>> from ssdr.render import Part, SKIN
    >>> Part("body", slice(0, 1200), material=SKIN, measured=False).measured
    False
    """

    name: str
    vertices: Any
    material: Material = Material()
    measured: bool = True


def checked_parts(parts: Sequence[Part], n_vertices: int) -> tuple[Part, ...]:
    """The parts, their vertices as masks.

    Raises
    ------
    InputError
        If two parts have one name or one vertex, a vertex has no part, none is measured, or the
        vertices are no mask and no indices.
    """
    count = np.zeros(n_vertices, dtype=np.int64)
    done: list[Part] = []
    for part in parts:
        if not isinstance(part, Part):
            raise InputError("parts", "Part objects", type(part).__name__)
        if part.name in [p.name for p in done]:
            raise InputError("parts", "names that differ", repr(part.name))
        mask = _mask(f"part {part.name!r}", part.vertices, n_vertices)
        count += mask
        done.append(dataclasses.replace(part, vertices=mask))
    if len(done) and (count != 1).any():
        v = int(np.flatnonzero(count != 1)[0])
        raise InputError("parts", f"each of {n_vertices} vertices once", f"{v}: {count[v]} times")
    if len(done) and not any(p.measured for p in done):
        raise InputError("parts", "at least one that is measured", [p.name for p in done])
    return tuple(done)


def checked_regions(
    regions: Mapping[str, Any] | None, n_vertices: int
) -> dict[str, NDArray[np.bool_]]:
    """Named sets of vertices as masks.

    Raises
    ------
    InputError
        If one is no mask and no indices, or empty.
    """
    return {k: _mask(f"region {k!r}", v, n_vertices) for k, v in (regions or {}).items()}


def _mask(name: str, vertices: ArrayLike | slice, n_vertices: int) -> NDArray[np.bool_]:
    expected = f"a mask of {n_vertices} vertices, or indices of them"
    mask = np.zeros(n_vertices, dtype=bool)
    if isinstance(vertices, slice):
        mask[vertices] = True
    else:
        chosen = np.asarray(vertices)
        if chosen.dtype == bool:
            if chosen.shape != (n_vertices,):
                raise InputError(name, expected, f"a mask of shape {chosen.shape}")
            mask = chosen.copy()
        elif chosen.ndim == 1 and np.issubdtype(chosen.dtype, np.integer):
            if len(chosen) and (chosen.min() < 0 or chosen.max() >= n_vertices):
                raise InputError(name, expected, f"indices {chosen.min()} to {chosen.max()}")
            mask[chosen] = True
        else:
            raise InputError(name, expected, f"{chosen.dtype} of shape {chosen.shape}")
    if not mask.any():
        raise InputError(name, "at least one vertex", "none")
    return mask
