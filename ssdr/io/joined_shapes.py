"""Joining of the shapes of a scene's meshes into those of one mesh."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..shapes import Shapes
from .budget import afford


def join_shapes(
    held: Sequence[Sequence[Shapes | None]], starts: NDArray[np.int64], name: str
) -> Shapes | None:
    """Shapes of the joined vertices, from the shapes `held` by each part in each clip, or None.

    Shapes of several parts that have the same name and amounts become one.  `starts` holds the
    first vertex of each part, then the number of vertices; `name` is that of the file, for
    messages.
    """
    rows: dict[tuple[str, bytes], dict[int, NDArray[np.floating]]] = {}
    amounts: dict[tuple[str, bytes], NDArray[np.float64]] = {}
    for k, of_clips in enumerate(zip(*held, strict=True)):
        some = [shapes for shapes in of_clips if shapes is not None]
        for s in range(len(some[0]) if some else 0):
            column = np.concatenate([shapes.amounts[:, s] for shapes in some])
            key = some[0].names[s], column.tobytes()
            rows.setdefault(key, {})[k] = some[0].displacements[s]
            amounts[key] = column
    if not rows:
        return None
    afford(24.0 * len(rows) * starts[-1], f"{len(rows)} shapes of {starts[-1]} vertices", name)
    moved = np.zeros((len(rows), starts[-1], 3))
    for one, of_parts in zip(moved, rows.values(), strict=True):
        for k, displacements in of_parts.items():
            one[starts[k] : starts[k + 1]] = displacements
    columns = np.stack(list(amounts.values()), axis=1)
    return Shapes(moved, columns, names=[known for known, _ in rows])
