"""Unit of length and up axis of coordinates."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Literal

from .errors import InputError, is_real

Up = Literal["y", "z"]


@dataclasses.dataclass(frozen=True)
class Space:
    """Unit and up axis of coordinates, as far as they are known.

    Parameters
    ----------
    units : float, optional
        Metres in a unit of length: 0.01 for centimetres. None: not known.
    up : {"y", "z"}, optional
        Up axis. None: not known.

    Raises
    ------
    InputError
        If `units` is not a positive number, or `up` is another axis.

    Examples
    --------
    >>> print(ssdr.Space(0.01, "z"))
    0.01 m a unit, z up
    >>> print(ssdr.Space())
    unit not stated, up axis not stated
    """

    units: float | None = None
    up: Up | None = None

    def __post_init__(self) -> None:
        if self.units is not None and not (is_real(self.units) and self.units > 0):
            raise InputError("units", "metres in a unit, a positive number", repr(self.units))
        if self.up not in ("y", "z", None):
            raise InputError("up", '"y", "z" or None', repr(self.up))

    def __str__(self) -> str:
        unit = f"{self.units:g} m a unit" if self.units else "unit not stated"
        return f"{unit}, {f'{self.up} up' if self.up else 'up axis not stated'}"

    def but(self, other: Space) -> Space:
        """Space with unit and up axis of `other` where these are known, otherwise of this one."""
        return Space(other.units or self.units, other.up or self.up)


def check_space(space: object) -> None:
    """Raise an InputError unless `space` is a Space."""
    if not isinstance(space, Space):
        raise InputError("space", "a Space", repr(space))


UNKNOWN = Space()
METRES_Y_UP = Space(1.0, "y")  # the space of glTF, and of files exchanged with Blender


def common_space(spaces: Iterable[Space]) -> Space:
    """Space of several meshes; a unit or up axis in which they differ is unknown."""
    units, up = (set(known) for known in zip(*((s.units, s.up) for s in spaces), strict=True))
    return Space(units.pop() if len(units) == 1 else None, up.pop() if len(up) == 1 else None)
