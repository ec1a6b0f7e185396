"""Displacements of a rest pose, added before it is skinned: morph targets, blend shapes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .checks import check_floats
from .clips import unique_names
from .errors import InputError
from .parallel import serial_blas
from .representation import short_repr


@dataclasses.dataclass(frozen=True, eq=False)
class Shapes:
    """Displacements of the rest pose, and how much of each is added in every frame.

    The rest pose of frame t is p + Σ_s a_ts d_s, to which skinning is then applied.

    Parameters
    ----------
    displacements : (S, V, 3) array
        In the rest pose, in the mesh's units; files store only those that are not 0.
    amounts : (F, S) array
        Factor of each shape in every frame.  Blender and Unity clamp it to 0 to 1.
    names : tuple of str, optional
        ``shape_0``, ``shape_1``, ... by default.

    Raises
    ------
    InputError
        If displacements, amounts and names are not of the same number, or a value is not finite.

    Examples
    --------
    >>> smile = ssdr.Shapes(np.ones((1, 3, 3)), [[0], [0.5]], names=["smile"])
    >>> model = ssdr.Skinning.from_dense(
    ...     np.eye(3), np.ones((3, 1)), np.tile(np.eye(3, 4), (2, 1, 1, 1)), shapes=smile
    ... )
    >>> model.skin()[1, 0]
    array([1.5, 0.5, 0.5])
    """

    displacements: Any
    amounts: Any
    _: dataclasses.KW_ONLY
    names: Any = None

    def __post_init__(self) -> None:
        moved = check_floats(self.displacements, "shapes.displacements", ("S", "V", 3))
        amounts = check_floats(self.amounts, "shapes.amounts", ("F", "S"))
        count = len(moved)
        if amounts.shape[1] != count:
            raise InputError("shapes.amounts", f"{count} columns", amounts.shape[1])
        names = [f"shape_{s}" for s in range(count)] if self.names is None else self.names
        if np.shape(names) != (count,):
            raise InputError("shapes.names", f"{count} names", repr(names)[:80])
        object.__setattr__(self, "displacements", moved)
        object.__setattr__(self, "amounts", amounts)
        object.__setattr__(self, "names", unique_names([str(name) for name in names], "shape"))

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.displacements)

    @property
    def moved(self) -> NDArray[np.bool_]:
        """Mask ``(S, V)`` of the vertices that each shape moves."""
        return np.asarray(np.any(self.displacements, axis=2))

    @serial_blas()
    def added(self, frames: Any = slice(None)) -> NDArray[np.floating]:
        """Displacement ``(f, V, 3)`` of the rest pose in the given frames."""
        return np.asarray(np.tensordot(self.amounts[frames], self.displacements, 1))

    def check(self, n_frames: int, n_vertices: int) -> None:
        """Raise an InputError if the numbers of frames and vertices differ from a model's."""
        found, text = (len(self.amounts), self.displacements.shape[1]), "{} frames, {} vertices"
        if found != (n_frames, n_vertices):
            raise InputError("shapes", text.format(n_frames, n_vertices), text.format(*found))

    def in_frames(self, frames: Any) -> Shapes:
        """Copy with only the amounts of the given frames, in the given order."""
        return dataclasses.replace(self, amounts=self.amounts[frames])
